"""Training by PPO: from settings to weights and learning curves, in a folder.

A seed is a task of a job: it depends on nothing but the settings and itself, and trains in whatever process there is.
A training that was stopped keeps the seeds that were finished, and begins the others anew; its weights are those of an
undisturbed one, to the bit (on the same machine and versions; torch guarantees no more).
"""

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from pcs_racing.base.dense import DenseLayers
from pcs_racing.base.errors import InputError
from pcs_racing.base.settings import plain_settings
from pcs_racing.game.archive import PolicyArchive
from pcs_racing.game.config import GameConfig
from pcs_racing.race.driving import default_threads
from pcs_racing_agents.jobs.jobs import open_job
from pcs_racing_agents.jobs.progress import Progress
from pcs_racing_agents.jobs.tasks import in_other_processes
from pcs_racing_agents.learning.ppo.drives import make_drive_task
from pcs_racing_agents.learning.ppo.duels import make_duel_task
from pcs_racing_agents.learning.ppo.evaluation import (
    EvaluationCurve,
    Matchup,
    MatchupScore,
    mean_score,
    write_evaluations,
)
from pcs_racing_agents.learning.ppo.learner import FIGURES, check_packages
from pcs_racing_agents.learning.ppo.seed_training import LearningTask, SeedRecord, train_seed
from pcs_racing_agents.learning.ppo.settings import DriveSettings, DuelSettings, PPOSettings, load_ppo_settings
from pcs_racing_agents.results.csv_files import write_csv


@dataclass(frozen=True, eq=False)
class PPOResult:
    """A trained policy and its learning curves."""

    settings: PPOSettings
    task: LearningTask
    curves: tuple[EvaluationCurve, ...]  #: Of each seed.
    layers: DenseLayers  #: The policy: of all evaluations of all seeds the one of highest worth.
    seed: int  #: That it is from.
    steps: int  #: After which it was evaluated.
    #: That evaluation. It is biased upwards: the best of many, in the same races every time.
    scores: Mapping[Matchup, MatchupScore]
    seconds: float  #: Time of the training with all seeds, without interruptions.
    folder: Path  #: Holds the weights, what describes them, and the curves.


def train_ppo(
    config: str | Path | PPOSettings,
    folder: str | Path,
    *,
    name: str | None = None,
    executor: Executor | None = None,
    progress: Progress | None = None,
    policies: PolicyArchive | None = None,
    rules: GameConfig | None = None,
    **changes: Any,
) -> PPOResult:
    """Train by PPO, or resume a training that was stopped.

    Parameters
    ----------
    config : str, Path or PPOSettings
        A shipped configuration's name, a YAML file, or settings.
    folder : str or Path
        A new or empty folder, or that of the same training. It gets ``policy/`` (the weights, what describes them, and
        every evaluation as ``curve.csv``), ``updates.csv`` (figures of every update) and the result of each finished
        seed in ``chunks/``.
    name : str, optional
        Of the policy; by default the one under which the agent ``ppo`` or the driver ``ppo-drive`` looks for it.
    executor : Executor, optional
        Where to train: processes and workers of a cluster train with several seeds side by side. Threads are not used,
        since torch's random generator belongs to the process. It has no influence on the result.
    progress : callable, optional
        Called as ``progress(steps, total of all seeds, label)`` after every update, or after every seed that another
        process has trained with.
    policies : PolicyArchive, optional
        Archive in place of that of the settings of a duel.
    rules : GameConfig, optional
        Rules in place of the race and the size of moves in the settings of a duel.
    """
    settings = load_ppo_settings(config, **changes)
    if isinstance(settings, DuelSettings):
        settings = _named(settings, policies, rules)
    check_packages()
    elsewhere = in_other_processes(executor)
    # Trainings side by side share the cores; a single one, or one after the other, may use all of them.
    threads = 1 if elsewhere is not None and len(settings.seeds) > 1 else default_threads()
    task = make_task(settings, archive=policies, rules=rules, threads=threads)
    identity = {**plain_settings(settings), "opponents": dict(settings.opponents), **task.identity}
    steps_of_seeds = 0  # that are finished

    def seeds_done(done: int, seeds: int, _: str) -> None:
        nonlocal steps_of_seeds
        steps_of_seeds = done * settings.steps
        if progress is not None:
            progress(steps_of_seeds, seeds * settings.steps, f"{done} of {seeds} seeds")

    def update_done(record: SeedRecord) -> None:
        if progress is not None:
            made = min(int(record.updates[-1][0]), settings.steps)
            label = f"seed {record.seed}, worth {record.worth(-1):.3f}"
            progress(steps_of_seeds + made, len(settings.seeds) * settings.steps, label)

    train = partial(train_seed, task, update_done if elsewhere is None else None)
    with open_job(folder, "ppo", identity) as job:
        results = job.run("seed", train, settings.seeds, executor=elsewhere, progress=seeds_done)
        runs = [
            SeedRecord.from_arrays(seed, task, result) for seed, result in zip(settings.seeds, results, strict=True)
        ]
        run = max(runs, key=lambda run: run.worth(run.best_at))  # of equals the first
        curves = tuple(run.curve for run in runs)
        _write_updates(runs, job.folder / "updates.csv")
        assert run.best is not None  # there is an evaluation before the first update
        trained = PPOResult(
            settings=settings,
            task=task,
            curves=curves,
            layers=run.best,
            seed=run.seed,
            steps=run.steps[run.best_at],
            scores=run.scores[run.best_at],
            seconds=sum(run.seconds for run in runs),
            folder=job.folder / "policy",
        )
        task.save(trained.layers, trained.folder, name or task.default_name, _about(trained))
        write_evaluations(curves, trained.folder / "curve.csv")
    return trained


def make_task(
    settings: PPOSettings,
    *,
    archive: PolicyArchive | None = None,
    rules: GameConfig | None = None,
    threads: int = 1,
) -> LearningTask:
    """Load circuits, archive and opponents, and check that they fit together.

    Parameters
    ----------
    archive, rules : optional
        Those of the game, in place of what the settings of a duel name.
    threads : int
        Threads that drive the games of a duel. They do not change the results.
    """
    if isinstance(settings, DuelSettings):
        return make_duel_task(settings, archive, rules, threads)
    if archive is not None or rules is not None:
        raise InputError("settings of level drive know no archive and no game; give settings of level duel")
    assert isinstance(settings, DriveSettings)
    return make_drive_task(settings)


def _named(settings: DuelSettings, archive: PolicyArchive | None, rules: GameConfig | None) -> DuelSettings:
    """Return the settings with the names of the archive and the rules that replace theirs, for the stored settings."""
    if archive is not None:
        settings = replace(settings, archive=archive.name)
    if rules is not None:
        epsilon = rules.epsilon if isinstance(rules.epsilon, float) else settings.epsilon
        settings = replace(settings, race=rules.race.name, epsilon=epsilon)
    return settings


# Reports


def _write_updates(runs: Sequence[SeedRecord], file: Path) -> None:
    rows: list[tuple[object, ...]] = [("seed", "steps", *FIGURES, "reward")]
    for run in runs:
        rows += [(run.seed, int(steps), *(f"{value:.6g}" for value in figures)) for steps, *figures in run.updates]
    write_csv(rows, file)


def _about(trained: PPOResult) -> dict[str, str | int | float | bool]:
    """Return facts about the training for the policy's manifest: texts and numbers by name."""
    import stable_baselines3
    import torch

    settings, score = trained.settings, mean_score(trained.scores, trained.settings.opponents)
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
