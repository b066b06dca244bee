"""Training by PPO: from settings to weights and curves, in a folder that a stopped training goes on in.

Between two updates everything that a training depends on is plain arrays: the races under way with their generators,
the networks, the optimiser, and the random generators of the process. Every few seconds a training stops and goes on
from these arrays, here or in another process; they are kept as a checkpoint. A training that was stopped, or that went
from one worker to another, therefore ends with the same weights, to the bit, as one that was not (on the same machine
and versions; torch promises no more).
"""

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from pcs_racing.base.errors import InputError
from pcs_racing.base.files import write_atomically
from pcs_racing.game.archive import PolicyArchive
from pcs_racing.game.config import GameConfig
from pcs_racing_agents.jobs.chunks import Arrays
from pcs_racing_agents.jobs.configuration import plain_settings
from pcs_racing_agents.jobs.jobs import Progress, open_job
from pcs_racing_agents.jobs.tasks import in_other_processes
from pcs_racing_agents.learning.ppo.curves import Curve, write_curve
from pcs_racing_agents.learning.ppo.learner import FIGURES, check_packages
from pcs_racing_agents.learning.ppo.level import Level, make_level
from pcs_racing_agents.learning.ppo.scores import Cell, Score, total
from pcs_racing_agents.learning.ppo.seed_run import Record, Trainer
from pcs_racing_agents.learning.ppo.settings import DuelSettings, Settings, load_ppo_settings
from pcs_racing_agents.networks.layers import Layers

__all__ = ["Trained", "check_checkpoint_seconds", "train_ppo"]

CHECKPOINT_SECONDS = 20.0


@dataclass(frozen=True, eq=False)
class Trained:
    """What came of a training.

    Attributes
    ----------
    settings : Settings
    level : Level
    curves : tuple of Curve
        Of each seed.
    layers : Layers
        The policy: of all evaluations of all seeds the one of highest worth.
    seed : int
        That it is from.
    steps : int
        After which it was evaluated.
    scores : mapping of Cell to Score
        That evaluation. It is a little flattering: the best of many, in the same races every time.
    seconds : float
        That all seeds took, with all interruptions left out.
    folder : Path
        What was written: weights, what describes them, and the curves.
    """

    settings: Settings
    level: Level
    curves: tuple[Curve, ...]
    layers: Layers
    seed: int
    steps: int
    scores: Mapping[Cell, Score]
    seconds: float
    folder: Path


def train_ppo(
    config: str | Path | Settings,
    folder: str | Path,
    *,
    name: str | None = None,
    executor: Executor | None = None,
    progress: Progress | None = None,
    checkpoint_seconds: float = CHECKPOINT_SECONDS,
    policies: PolicyArchive | None = None,
    rules: GameConfig | None = None,
    **changes: Any,
) -> Trained:
    """Train by PPO, or go on with a training that was stopped.

    Parameters
    ----------
    config : str, Path or Settings
        A shipped configuration's name, a YAML file, or settings.
    folder : str or Path
        A new or empty folder, or that of the same training. It gets ``policy/`` (the weights, what describes them, and
        every evaluation as ``curve.csv``), ``updates.csv`` (figures of every update) and a checkpoint for each seed in
        ``chunks/``.
    name : str, optional
        Of the policy; by default the one under which the agent ``ppo`` or the driver ``ppo-drive`` looks for it.
    executor : Executor, optional
        Where to train: processes and workers of a cluster train with several seeds side by side, in pieces that end
        with a checkpoint. Threads are not used, since torch's random generator belongs to the process. It has no
        influence on the result.
    progress : callable, optional
        Called after every update, and where other processes train after every piece, as ``progress(steps, of all seeds,
        what)``.
    checkpoint_seconds : float
        Time between two checkpoints; it has no influence on the result.
    policies : PolicyArchive, optional
        Archive of the game, in place of the one that the settings of a duel name: one that has just been made, for
        instance.
    rules : GameConfig, optional
        Of the game, in place of the race and the size of moves that the settings of a duel name.
    **changes
        Settings that are to be others.

    Returns
    -------
    Trained

    Raises
    ------
    InputError
        If settings are impossible, name something unknown, or the folder holds something else; nothing is touched then.
    JobError
        If another process trains in the folder, or it can't be written to.
    ModuleNotFoundError
        If Stable-Baselines3 is not installed.
    """
    settings = load_ppo_settings(config, **changes)
    check_checkpoint_seconds(checkpoint_seconds)
    if isinstance(settings, DuelSettings):  # what is written of them is what they were
        if policies is not None:
            settings = replace(settings, archive=policies.name)
        if rules is not None:
            epsilon = rules.epsilon if isinstance(rules.epsilon, float) else settings.epsilon
            settings = replace(settings, race=rules.race.name, epsilon=epsilon)
    check_packages()
    level = make_level(settings, archive=policies, rules=rules)
    identity = {**plain_settings(settings), "opponents": dict(settings.opponents), **level.identity}
    elsewhere = in_other_processes(executor)
    steps = dict.fromkeys(settings.seeds, 0)

    def tell(record: Record) -> None:
        steps[record.seed] = settings.steps if record.finished else min(record.made, settings.steps)
        if progress is not None:
            what = f"seed {record.seed}, worth {record.last_worth:.3f}"
            progress(sum(steps.values()), settings.steps * len(steps), what)

    def read(index: int, state: Arrays) -> Record:
        return Record.from_arrays(settings.seeds[index], settings.opponents, state)

    trainer = Trainer(level, settings, checkpoint_seconds, tell if elsewhere is None else None)
    with open_job(folder, "ppo", identity) as job:
        states = job.run_chains(
            "seed", trainer, settings.seeds, executor=elsewhere, on_state=lambda index, state: tell(read(index, state))
        )
        runs = [read(index, state) for index, state in enumerate(states)]
        run = max(runs, key=lambda run: run.best_worth)  # of equals the first
        curves = tuple(run.curve for run in runs)
        _write_updates(runs, job.folder / "updates.csv")
        trained = Trained(
            settings=settings,
            level=level,
            curves=curves,
            layers=run.best,
            seed=run.seed,
            steps=run.steps[run.best_at],
            scores=run.scores[run.best_at],
            seconds=sum(run.seconds for run in runs),
            folder=job.folder / "policy",
        )
        level.save(run.best, trained.folder, name or level.default_name, _about(trained))
        write_curve(curves, trained.folder / "curve.csv")
    return trained


def check_checkpoint_seconds(seconds: float) -> None:
    """Refuse a time between two checkpoints that is none.

    Raises
    ------
    InputError
        If it is below 0 or not a number.
    """
    if not seconds >= 0.0:
        raise InputError(f"the time between two checkpoints is {seconds!r} s; it must be 0 or more")


# What is told of it


def _write_updates(runs: Sequence[Record], file: Path) -> None:
    rows = [",".join(("seed", "steps", *FIGURES, "reward"))]
    rows += [
        f"{run.seed},{int(row[0])},{','.join(f'{value:.6g}' for value in row[1:])}"
        for run in runs
        for row in run.updates
    ]
    write_atomically(file, lambda stream: stream.write(("\n".join(rows) + "\n").encode("utf-8")))


def _about(trained: Trained) -> dict[str, str | int | float | bool]:
    """What the policy's own files say of its training: texts and numbers by name."""
    import stable_baselines3
    import torch

    settings, score = trained.settings, total(trained.scores, trained.settings.opponents)
    about: dict[str, str | int | float | bool] = {
        "algorithm": "PPO",
        "stable_baselines3": stable_baselines3.__version__,
        "torch": str(torch.__version__),
        "seed": trained.seed,
        "steps": trained.steps,
        "steps_of_all_seeds": sum(curve.steps[-1] for curve in trained.curves),
        "evaluations": sum(len(curve.steps) for curve in trained.curves),
        **{key: float(f"{value:.4g}") for key, value in score._asdict().items() if key != "races"},
    }
    for key, value in plain_settings(settings).items():
        if isinstance(value, Mapping):
            value = ", ".join(f"{weight} {name}" for name, weight in value.items())
        elif isinstance(value, list):
            value = ", ".join(map(str, value))
        about[f"setting_{key}"] = value
    return about
