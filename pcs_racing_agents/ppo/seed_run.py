"""The training with one seed: everything that it depends on is in its checkpoint."""

import logging
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from pcs_racing.errors import InputError
from pcs_racing_agents.chunk_files import Arrays, read_chunk, write_chunk
from pcs_racing_agents.jobs import JobError, Progress
from pcs_racing_agents.ppo.curves import Curve
from pcs_racing_agents.ppo.layers import Layers
from pcs_racing_agents.ppo.learner import (
    Learner,
    actor_layers,
    learn_once,
    make_learner,
    restore_learner,
    store_learner,
)
from pcs_racing_agents.ppo.level import Level
from pcs_racing_agents.ppo.scores import Cell, Score, total
from pcs_racing_agents.ppo.settings import Settings

__all__ = ["SeedRun", "train_seed"]

_log = logging.getLogger("pcs_racing_agents")


@dataclass
class SeedRun:
    """A training under way.

    Attributes
    ----------
    seed : int
    learner : Learner
    weights : mapping of str to int
        How often each opponent is met.
    steps : list of int
    scores : list of dict of Cell to Score
        The evaluations, and after how many steps they were made.
    updates : list of tuple of float
        Steps, and the figures of every update.
    best_at : int
        Index of the best evaluation.
    best : Layers
        The policy at that time.
    seconds : float
        Time spent.
    finished : bool
    """

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
        """Every evaluation so far."""
        return Curve(self.seed, tuple(self.steps), tuple(self.scores))

    @property
    def best_worth(self) -> float:
        """Mean worth in the best of them."""
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
        """Everything, as arrays; there must have been an evaluation and an update."""
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
        """Go on from what `store` returned."""
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


def train_seed(
    level: Level,
    settings: Settings,
    seed: int,
    path: Path,
    mark: str,
    checkpoint_seconds: float,
    progress: Progress | None,
    number: int,
) -> SeedRun:
    """Train with one seed, from the start or from its checkpoint."""
    learner = make_learner(settings, level.parts(), seed, level.activation, level.limit)
    run = SeedRun(seed, learner, settings.opponents)
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
