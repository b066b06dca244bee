"""Training with one seed: updates, evaluations between them, and the best policy."""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from pcs_racing.base.dense import DenseLayers, layers_from_bytes, layers_to_bytes
from pcs_racing_agents.jobs.chunks import Arrays
from pcs_racing_agents.learning.ppo.drives import DriveTask
from pcs_racing_agents.learning.ppo.duels import DuelTask
from pcs_racing_agents.learning.ppo.evaluation import EvaluationCurve, Matchup, MatchupScore, mean_score
from pcs_racing_agents.learning.ppo.learner import actor_layers, learn_once, make_model, own_randomness

LearningTask = DuelTask | DriveTask


@dataclass
class SeedRecord:
    """Evaluations and updates of a training so far, and its best policy."""

    seed: int
    weights: Mapping[str, int]  #: How often each opponent is met.
    steps: list[int] = field(default_factory=list)  #: Steps learned before each evaluation.
    scores: list[dict[Matchup, MatchupScore]] = field(default_factory=list)  #: The evaluations.
    updates: list[tuple[float, ...]] = field(default_factory=list)  #: Steps, and the figures of every update.
    best: DenseLayers | None = None  #: The policy of the best evaluation; None before the first one.
    seconds: float = 0.0  #: Time spent.

    @property
    def curve(self) -> EvaluationCurve:
        """Every evaluation so far."""
        return EvaluationCurve(self.seed, tuple(self.steps), tuple(self.scores))

    def worth(self, evaluation: int) -> float:
        """Return the mean worth in an evaluation."""
        return mean_score(self.scores[evaluation], self.weights).worth

    @property
    def best_at(self) -> int:
        """Index of the best evaluation, of equals the first."""
        return max(range(len(self.scores)), key=self.worth)

    def add(self, steps: int, scores: dict[Matchup, MatchupScore], layers: DenseLayers) -> None:
        """Add an evaluation, and keep the weights if none was better."""
        self.steps.append(steps)
        self.scores.append(scores)
        if self.best_at == len(self.scores) - 1:
            self.best = layers

    def arrays(self) -> Arrays:
        """Return the record of a finished training as arrays."""
        assert self.best is not None
        return {
            "steps": np.array(self.steps, np.int64),
            "matchups": np.array([list(matchup) for matchup in self.scores[0]], np.str_),
            "scores": np.array([[list(score) for score in scores.values()] for scores in self.scores]),
            "updates": np.array(self.updates, np.float64),
            "best": np.frombuffer(layers_to_bytes(self.best), np.uint8),
            "seconds": np.array(self.seconds),
        }

    @classmethod
    def from_arrays(cls, seed: int, task: LearningTask, arrays: Arrays) -> "SeedRecord":
        """Return the record from its arrays."""
        matchups = [Matchup(*row) for row in arrays["matchups"].tolist()]
        scores = [[MatchupScore(int(row[0]), *row[1:]) for row in rows] for rows in arrays["scores"].tolist()]
        hidden = list(task.settings.hidden)
        return cls(
            seed,
            task.settings.opponents,
            steps=arrays["steps"].tolist(),
            scores=[dict(zip(matchups, rows, strict=True)) for rows in scores],
            updates=[tuple(row) for row in arrays["updates"].tolist()],
            best=layers_from_bytes(Path(f"seed {seed}"), arrays["best"].tobytes(), hidden)[0],
            seconds=float(arrays["seconds"]),
        )


def train_seed(task: LearningTask, on_update: Callable[[SeedRecord], None] | None, seed: int) -> Arrays:
    """Train with a seed until the steps of the settings are made, or their patience is at its end.

    Parameters
    ----------
    on_update : callable, optional
        Called with the record after every update.

    Returns
    -------
    dict of ndarray
        :meth:`SeedRecord.arrays`. But for the time spent it depends on the task and the seed alone.
    """
    settings = task.settings
    record = SeedRecord(seed, settings.opponents)
    begin = time.monotonic()
    with own_randomness():
        model = make_model(settings, task.env_groups(), seed, task.activation, task.threads)
        steps, since_best = 0, 0
        while True:
            # An evaluation is due before the first update, where a multiple of the interval was crossed, and at the
            # end. Updates make whole rollouts, so few of them end at a multiple.
            crossed = not record.steps or steps // settings.evaluate_every > record.steps[-1] // settings.evaluate_every
            if crossed or steps >= settings.steps:
                layers = actor_layers(model)
                record.add(steps, task.evaluate(layers), layers)
                since_best = len(record.scores) - 1 - record.best_at
            record.seconds = time.monotonic() - begin
            if on_update is not None and steps > 0:
                on_update(record)
            if steps >= settings.steps or 0 < settings.patience <= since_best:
                return record.arrays()
            figures = learn_once(model, settings, task.limit)
            steps = model.num_timesteps
            record.updates.append((float(steps), *figures.values()))
