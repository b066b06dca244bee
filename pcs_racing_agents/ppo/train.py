"""Training by PPO: from settings to weights and curves, in a folder that a stopped training goes on in.

Between two updates everything that a training depends on is plain arrays: the races under way with their generators,
the networks, the optimiser, and the random generators of the process. They are written to a checkpoint every few
seconds. A training that was stopped therefore ends with the same weights, to the bit, as one that was not (on the same
machine and versions; torch promises no more).
"""

import logging
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from pcs_racing.errors import InputError
from pcs_racing_agents.chunk_files import Arrays, fingerprint, read_chunk, write_chunk
from pcs_racing_agents.configuration import plain_settings
from pcs_racing_agents.jobs import JobError, Progress, open_job
from pcs_racing_agents.ppo.curves import Curve, write_curve
from pcs_racing_agents.ppo.layers import Layers
from pcs_racing_agents.ppo.learner import (
    FIGURES,
    Learner,
    actor_layers,
    check_packages,
    learn_once,
    make_learner,
    own_randomness,
    restore_learner,
    store_learner,
)
from pcs_racing_agents.ppo.parts import Part
from pcs_racing_agents.ppo.scores import Cell, Score, total
from pcs_racing_agents.ppo.settings import DuelSettings, Settings, load_ppo_settings

__all__ = ["Level", "Trained", "make_level", "train_ppo"]

CHECKPOINT_SECONDS = 20.0

_log = logging.getLogger("pcs_racing_agents")


class Level(Protocol):
    """What there is to learn: :class:`pcs_racing_agents.ppo.duels.DuelLevel` or its sibling for driving."""

    activation: str
    limit: float
    unit: str

    @property
    def default_name(self) -> str:
        """Name under which the result is looked for."""

    @property
    def identity(self) -> dict[str, Any]:
        """What the results depend on beside the settings."""

    def parts(self) -> Sequence[Part]:
        """Make the environments to learn from."""

    def judge(self, layers: Layers) -> dict[Cell, Score]:
        """Race without exploring, and count what comes of it."""

    def save(self, layers: Layers, folder: Path, name: str, about: Mapping[str, Any]) -> Path:
        """Write a policy."""


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


def make_level(settings: Settings) -> Level:
    """Load circuits, archive and opponents, and check that they fit together.

    Raises
    ------
    InputError
        If one of them is unknown, or they do not fit.
    """
    if isinstance(settings, DuelSettings):
        from pcs_racing_agents.ppo.duels import duel_level

        return duel_level(settings)
    from pcs_racing_agents.ppo.drives import drive_level

    return drive_level(settings)  # type: ignore[arg-type]


def train_ppo(
    config: str | Path | Settings,
    folder: str | Path,
    *,
    name: str | None = None,
    progress: Progress | None = None,
    checkpoint_seconds: float = CHECKPOINT_SECONDS,
    **changes: Any,
) -> Trained:
    """Train by PPO, or go on with a training that was stopped.

    Parameters
    ----------
    config : str, Path or Settings
        A shipped configuration's name, a YAML file, or settings.
    folder : str or Path
        A new or empty folder, or that of the same training. It gets ``policy/`` (the weights, what describes them, and
        every evaluation as ``curve.csv``), ``updates.csv`` (figures of every update) and a checkpoint for each seed.
    name : str, optional
        Of the policy; by default the one under which the agent ``ppo`` or the driver ``ppo-drive`` looks for it.
    progress : callable, optional
        Called after every update as ``progress(steps, of all seeds, what)``.
    checkpoint_seconds : float
        Time between two checkpoints; it has no influence on the result.
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
    check_packages()
    level = make_level(settings)
    identity = {**plain_settings(settings), "opponents": dict(settings.opponents), **level.identity}
    with open_job(folder, "ppo", identity) as job, own_randomness():
        runs = []
        for number, seed in enumerate(settings.seeds):
            path = job.folder / f"seed-{seed}.npz"
            run = _train_seed(
                level, settings, seed, path, fingerprint(identity, seed), checkpoint_seconds, progress, number
            )
            runs.append(run)
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


# One seed


@dataclass
class _Run:
    """A training under way; all of it is in the checkpoint."""

    seed: int
    learner: Learner
    weights: Mapping[str, int]
    steps: list[int] = field(default_factory=list)
    scores: list[dict[Cell, Score]] = field(default_factory=list)
    updates: list[tuple[float, ...]] = field(default_factory=list)
    best_at: int = 0
    best: Layers = field(default_factory=lambda: Layers((), ()))
    seconds: float = 0.0
    finished: bool = False

    @property
    def curve(self) -> Curve:
        return Curve(self.seed, tuple(self.steps), tuple(self.scores))

    @property
    def best_worth(self) -> float:
        return total(self.scores[self.best_at], self.weights).worth

    def judge(self, level: Level) -> None:
        """Add an evaluation, and keep the weights if none was better."""
        layers = actor_layers(self.learner)
        self.steps.append(self.learner.model.num_timesteps)
        self.scores.append(level.judge(layers))
        worth = total(self.scores[-1], self.weights).worth
        if len(self.scores) == 1 or worth > self.best_worth:
            self.best_at, self.best = len(self.scores) - 1, layers

    def store(self) -> Arrays:
        arrays = {
            "curve.steps": np.array(self.steps, np.int64),
            "curve.cells": np.array([list(cell) for cell in self.scores[0]], np.str_),
            "curve.scores": np.array([[list(score) for score in scores.values()] for scores in self.scores]),
            "updates": np.array(self.updates, np.float64),
            "best_at": np.array(self.best_at),
            "seconds": np.array(self.seconds),
            "finished": np.array(self.finished),
        }
        for key, values in self.best._asdict().items():
            arrays |= {f"best.{key}.{i}": value for i, value in enumerate(values)}
        return arrays | {f"learner.{key}": value for key, value in store_learner(self.learner).items()}

    def restore(self, arrays: Arrays) -> None:
        cells = [Cell(*(str(text) for text in row)) for row in arrays["curve.cells"]]
        self.steps = arrays["curve.steps"].tolist()
        self.scores = [
            {cell: Score(int(row[0]), *row[1:].tolist()) for cell, row in zip(cells, rows, strict=True)}
            for rows in arrays["curve.scores"]
        ]
        self.updates = [tuple(row) for row in arrays["updates"].tolist()]
        self.best_at, self.seconds = int(arrays["best_at"]), float(arrays["seconds"])
        self.finished = bool(arrays["finished"])
        count = sum(key.startswith("best.weights.") for key in arrays)
        self.best = Layers(*(tuple(arrays[f"best.{key}.{i}"] for i in range(count)) for key in Layers._fields))
        prefix = "learner."
        restore_learner(
            self.learner, {key.removeprefix(prefix): value for key, value in arrays.items() if key.startswith(prefix)}
        )


def _train_seed(
    level: Level,
    settings: Settings,
    seed: int,
    path: Path,
    mark: str,
    checkpoint_seconds: float,
    progress: Progress | None,
    number: int,
) -> _Run:
    """Train with one seed, from the start or from its checkpoint."""
    learner = make_learner(settings, level.parts(), seed, level.activation, level.limit)
    run = _Run(seed, learner, settings.opponents)
    arrays = _checkpoint(path, mark)
    if arrays is not None:
        run.restore(arrays)
    begin, before = time.monotonic(), run.seconds
    kept = begin
    everything = settings.steps * len(settings.seeds)

    def tell(what: str) -> None:
        steps = settings.steps if run.finished else min(learner.model.num_timesteps, settings.steps)
        if progress is not None:
            progress(number * settings.steps + steps, everything, f"seed {seed}, {what}")

    if not run.scores:
        run.judge(level)
    what = f"worth {total(run.scores[-1], run.weights).worth:.3f}"
    tell(what)
    while not run.finished:
        figures = learn_once(learner)
        steps = learner.model.num_timesteps
        run.updates.append((float(steps), *figures.values()))
        # An evaluation is due where a multiple of the interval was crossed, and at the end.
        if steps // settings.evaluate_every > run.steps[-1] // settings.evaluate_every or steps >= settings.steps:
            run.judge(level)
            what = f"worth {total(run.scores[-1], run.weights).worth:.3f}"
        since = len(run.scores) - 1 - run.best_at
        run.finished = steps >= settings.steps or (0 < settings.patience <= since)
        now = time.monotonic()
        run.seconds = before + now - begin
        if run.finished or now - kept >= checkpoint_seconds:
            _write_checkpoint(path, run.store(), mark)
            kept = now
        tell(what)
    return run


def _checkpoint(path: Path, mark: str) -> Arrays | None:
    """Read a checkpoint; None if there is none, or it is damaged, which is told."""
    if not path.exists():
        return None
    try:
        return read_chunk(path, mark)
    except InputError as error:
        _log.warning("%s; this seed begins again", error)
        return None


def _write_checkpoint(path: Path, arrays: Arrays, mark: str) -> None:
    try:
        write_chunk(path, arrays, mark)
    except OSError as error:
        raise JobError(f"can't write {path}: {error.strerror}; mend that and start the same again to go on") from None


# What is told of it


def _write_updates(runs: Sequence[_Run], file: Path) -> None:
    from pcs_racing.files import write_atomically

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
