"""The training with one seed: everything that it depends on is in its state, which any process can go on from."""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from pcs_racing_agents.jobs.chunks import Arrays
from pcs_racing_agents.learning.ppo.curves import Curve
from pcs_racing_agents.learning.ppo.learner import (
    Learner,
    actor_layers,
    learn_once,
    make_learner,
    own_randomness,
    restore_learner,
    store_learner,
)
from pcs_racing_agents.learning.ppo.level import Level
from pcs_racing_agents.learning.ppo.scores import Cell, Score, total
from pcs_racing_agents.learning.ppo.settings import Settings
from pcs_racing_agents.networks.layers import Layers

__all__ = ["Record", "Trainer"]


@dataclass
class Record:
    """What came of a training so far.

    Attributes
    ----------
    seed : int
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

    @property
    def last_worth(self) -> float:
        """Mean worth in the last of them."""
        return total(self.scores[-1], self.weights).worth

    @property
    def made(self) -> int:
        """Steps made up to the last update."""
        return int(self.updates[-1][0]) if self.updates else 0

    def add(self, steps: int, scores: dict[Cell, Score], layers: Layers) -> None:
        """Add an evaluation, and keep the weights if none was better."""
        self.steps.append(steps)
        self.scores.append(scores)
        if len(self.scores) == 1 or self.last_worth > self.best_worth:
            self.best_at, self.best = len(self.scores) - 1, layers

    def arrays(self) -> Arrays:
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
        return arrays

    @classmethod
    def from_arrays(cls, seed: int, weights: Mapping[str, int], arrays: Arrays) -> "Record":
        """Return what `arrays` took apart."""
        cells = [Cell(*(str(text) for text in row)) for row in arrays["curve.cells"]]
        count = sum(key.startswith("best.weights.") for key in arrays)
        return cls(
            seed,
            weights,
            steps=arrays["curve.steps"].tolist(),
            scores=[
                {cell: Score(int(row[0]), *row[1:].tolist()) for cell, row in zip(cells, rows, strict=True)}
                for rows in arrays["curve.scores"]
            ],
            updates=[tuple(row) for row in arrays["updates"].tolist()],
            best_at=int(arrays["best_at"]),
            best=Layers(*(tuple(arrays[f"best.{key}.{i}"] for i in range(count)) for key in Layers._fields)),
            seconds=float(arrays["seconds"]),
            finished=bool(arrays["finished"]),
        )


@dataclass(frozen=True, eq=False)
class Trainer:
    """What trains with a seed, piece by piece; it travels to other processes together with the level.

    Attributes
    ----------
    level : Level
    settings : Settings
    seconds : float
        Length of a piece; it has no influence on the result, nor has the process that does it.
    told : callable, optional
        Called with the record at the beginning of a piece and after every update.
    """

    level: Level
    settings: Settings
    seconds: float
    told: Callable[[Record], None] | None = None

    def __call__(self, piece: tuple[int, Arrays | None]) -> Arrays:
        """Train with a seed from the start, or from the state in which another piece has stopped, for some time."""
        seed, state = piece
        level, settings = self.level, self.settings
        with own_randomness():
            learner = make_learner(settings, level.parts(), seed, level.activation, level.limit)
            record = Record(seed, settings.opponents)
            if state is not None:
                record = Record.from_arrays(seed, settings.opponents, state)
                restore_learner(learner, _under(state))
            begin, before = time.monotonic(), record.seconds
            if not record.scores:
                _judge(level, learner, record)
            self._tell(record)
            spent = 0.0
            while not record.finished and (spent == 0.0 or spent < self.seconds):
                self._update(learner, record)
                spent = time.monotonic() - begin
                record.seconds = before + spent
                self._tell(record)
            return record.arrays() | {f"learner.{key}": value for key, value in store_learner(learner).items()}

    def _update(self, learner: Learner, record: Record) -> None:
        settings = self.settings
        figures = learn_once(learner)
        steps = learner.model.num_timesteps
        record.updates.append((float(steps), *figures.values()))
        # An evaluation is due where a multiple of the interval was crossed, and at the end.
        if steps // settings.evaluate_every > record.steps[-1] // settings.evaluate_every or steps >= settings.steps:
            _judge(self.level, learner, record)
        since = len(record.scores) - 1 - record.best_at
        record.finished = steps >= settings.steps or (0 < settings.patience <= since)

    def _tell(self, record: Record) -> None:
        if self.told is not None:
            self.told(record)


def _judge(level: Level, learner: Learner, record: Record) -> None:
    layers = actor_layers(learner)
    record.add(learner.model.num_timesteps, level.judge(layers), layers)


def _under(state: Arrays) -> Arrays:
    """The learner's part of a state."""
    prefix = "learner."
    return {key.removeprefix(prefix): value for key, value in state.items() if key.startswith(prefix)}
