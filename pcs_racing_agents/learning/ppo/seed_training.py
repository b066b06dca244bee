"""Training with one seed, in pieces that any process can continue from the state of the piece before."""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from pcs_racing.base.dense import DenseLayers
from pcs_racing_agents.jobs.chunks import Arrays
from pcs_racing_agents.learning.ppo.checkpoint import restore_learner, store_learner, under
from pcs_racing_agents.learning.ppo.evaluation import EvaluationCurve, Matchup, MatchupScore, mean_score
from pcs_racing_agents.learning.ppo.learner import Learner, actor_layers, learn_once, make_learner, own_randomness
from pcs_racing_agents.learning.ppo.settings import PPOSettings
from pcs_racing_agents.learning.ppo.tasks import LearningTask


@dataclass
class SeedRecord:
    """Evaluations and updates of a training so far, and its best policy."""

    seed: int
    weights: Mapping[str, int]  #: How often each opponent is met.
    steps: list[int] = field(default_factory=list)  #: Steps learned before each evaluation.
    scores: list[dict[Matchup, MatchupScore]] = field(default_factory=list)  #: The evaluations.
    updates: list[tuple[float, ...]] = field(default_factory=list)  #: Steps, and the figures of every update.
    best_at: int = 0  #: Index of the best evaluation.
    best: DenseLayers | None = None  #: The policy at that time; None before the first evaluation.
    seconds: float = 0.0  #: Time spent.
    finished: bool = False

    @property
    def curve(self) -> EvaluationCurve:
        """Every evaluation so far."""
        return EvaluationCurve(self.seed, tuple(self.steps), tuple(self.scores))

    @property
    def best_worth(self) -> float:
        """Mean worth in the best evaluation."""
        return mean_score(self.scores[self.best_at], self.weights).worth

    @property
    def last_worth(self) -> float:
        """Mean worth in the last evaluation."""
        return mean_score(self.scores[-1], self.weights).worth

    @property
    def steps_made(self) -> int:
        """Steps made up to the last update."""
        return int(self.updates[-1][0]) if self.updates else 0

    def add(self, steps: int, scores: dict[Matchup, MatchupScore], layers: DenseLayers) -> None:
        """Add an evaluation, and keep the weights if none was better."""
        self.steps.append(steps)
        self.scores.append(scores)
        if len(self.scores) == 1 or self.last_worth > self.best_worth:
            self.best_at, self.best = len(self.scores) - 1, layers

    def arrays(self) -> Arrays:
        """Return the record as arrays; it must hold an evaluation and an update."""
        assert self.best is not None
        arrays = {
            "curve.steps": np.array(self.steps, np.int64),
            "curve.matchups": np.array([list(matchup) for matchup in self.scores[0]], np.str_),
            "curve.scores": np.array([[list(score) for score in scores.values()] for scores in self.scores]),
            "updates": np.array(self.updates, np.float64),
            "best_at": np.array(self.best_at),
            "seconds": np.array(self.seconds),
            "finished": np.array(self.finished),
        }
        for kind in ("weights", "biases"):
            arrays |= {f"best.{kind}.{i}": array for i, array in enumerate(getattr(self.best, kind))}
        return arrays

    @classmethod
    def from_arrays(cls, seed: int, weights: Mapping[str, int], arrays: Arrays) -> "SeedRecord":
        """Return the record from its arrays."""
        matchups = [Matchup(*(str(text) for text in row)) for row in arrays["curve.matchups"]]
        count = sum(key.startswith("best.weights.") for key in arrays)
        best = (tuple(arrays[f"best.{kind}.{i}"] for i in range(count)) for kind in ("weights", "biases"))
        return cls(
            seed,
            weights,
            steps=arrays["curve.steps"].tolist(),
            scores=[
                {m: MatchupScore(int(row[0]), *row[1:].tolist()) for m, row in zip(matchups, rows, strict=True)}
                for rows in arrays["curve.scores"]
            ],
            updates=[tuple(row) for row in arrays["updates"].tolist()],
            best_at=int(arrays["best_at"]),
            best=DenseLayers(*best),
            seconds=float(arrays["seconds"]),
            finished=bool(arrays["finished"]),
        )


@dataclass(frozen=True, eq=False)
class SeedTraining:
    """A function that trains with a seed for some time; it is sent to other processes with the task."""

    task: LearningTask
    settings: PPOSettings
    seconds: float  #: Duration of a call; it does not change the result, nor does the process.
    #: Called with the record at the beginning of a piece and after every update.
    on_update: Callable[[SeedRecord], None] | None = None

    def __call__(self, piece: tuple[int, Arrays | None]) -> Arrays:
        """Train with a seed from the start, or from the state that an earlier call returned."""
        seed, state = piece
        task, settings = self.task, self.settings
        with own_randomness():
            learner = make_learner(settings, task.env_groups(), seed, task.activation, task.limit, task.threads)
            record = SeedRecord(seed, settings.opponents)
            if state is not None:
                record = SeedRecord.from_arrays(seed, settings.opponents, state)
                restore_learner(learner, under(state, "learner"))
            begin, before = time.monotonic(), record.seconds
            if not record.scores:
                _evaluate(task, learner, record)
            self._report(record)
            spent = 0.0
            while not record.finished and (spent == 0.0 or spent < self.seconds):
                self._update(learner, record)
                spent = time.monotonic() - begin
                record.seconds = before + spent
                self._report(record)
            return record.arrays() | {f"learner.{key}": value for key, value in store_learner(learner).items()}

    def _update(self, learner: Learner, record: SeedRecord) -> None:
        settings = self.settings
        figures = learn_once(learner)
        steps = learner.model.num_timesteps
        record.updates.append((float(steps), *figures.values()))
        # An evaluation is due where a multiple of the interval was crossed, and at the end.
        if steps // settings.evaluate_every > record.steps[-1] // settings.evaluate_every or steps >= settings.steps:
            _evaluate(self.task, learner, record)
        since = len(record.scores) - 1 - record.best_at
        record.finished = steps >= settings.steps or (0 < settings.patience <= since)

    def _report(self, record: SeedRecord) -> None:
        if self.on_update is not None:
            self.on_update(record)


def _evaluate(task: LearningTask, learner: Learner, record: SeedRecord) -> None:
    layers = actor_layers(learner)
    record.add(learner.model.num_timesteps, task.evaluate(layers), layers)
