"""Training by PPO: from settings to weights and learning curves, in a folder.

Each seed is a task of a job: its result depends only on the settings and the seed, and any process
can train it. A stopped run resumes with its finished seeds and restarts the others. The weights are
bit-identical to the weights of an uninterrupted run (on the same machine and versions; torch
guarantees no more).
"""

import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from pcs_racing.base.dense import DenseLayers, layers_from_bytes, layers_to_bytes
from pcs_racing.base.errors import InputError
from pcs_racing.base.settings import plain_settings
from pcs_racing.game.archive import PolicyArchive
from pcs_racing.game.config import GameConfig
from pcs_racing.race.driving import default_threads
from pcs_racing_agents.base.chunks import Arrays
from pcs_racing_agents.base.jobs import open_job
from pcs_racing_agents.base.progress import Progress
from pcs_racing_agents.base.tables import write_csv
from pcs_racing_agents.base.tasks import in_other_processes
from pcs_racing_agents.learning.ppo.drives import DriveTask, make_drive_task
from pcs_racing_agents.learning.ppo.duels import DuelTask, make_duel_task
from pcs_racing_agents.learning.ppo.evaluation import (
    EvaluationCurve,
    Matchup,
    MatchupScore,
    mean_score,
    write_evaluations,
)
from pcs_racing_agents.learning.ppo.learner import (
    FIGURES,
    actor_layers,
    check_packages,
    learn_once,
    make_model,
    own_randomness,
)
from pcs_racing_agents.learning.ppo.settings import (
    DriveSettings,
    DuelSettings,
    PPOSettings,
    load_ppo_settings,
)

LearningTask = DuelTask | DriveTask


@dataclass
class SeedRecord:
    """Evaluations, updates and best policy of a training run."""

    seed: int
    weights: Mapping[str, int]  #: Relative frequency of each opponent.
    steps: list[int] = field(default_factory=list)  #: Training steps before each evaluation.
    scores: list[dict[Matchup, MatchupScore]] = field(default_factory=list)  #: Evaluations.
    updates: list[tuple[float, ...]] = field(default_factory=list)  #: Steps and figures per update.
    best: DenseLayers | None = None  #: Policy of the best evaluation; None before any evaluation.
    seconds: float = 0.0  #: Training time, s.

    @property
    def curve(self) -> EvaluationCurve:
        """Learning curve of all evaluations so far."""
        return EvaluationCurve(self.seed, tuple(self.steps), tuple(self.scores))

    def payoff(self, evaluation: int) -> float:
        """Return the mean payoff of an evaluation."""
        return mean_score(self.scores[evaluation], self.weights).worth

    @property
    def best_at(self) -> int:
        """Index of the best evaluation; the first one in case of a tie."""
        return max(range(len(self.scores)), key=self.payoff)

    def add(self, steps: int, scores: dict[Matchup, MatchupScore], layers: DenseLayers) -> None:
        """Add an evaluation, and store the weights if the evaluation is the best so far."""
        self.steps.append(steps)
        self.scores.append(scores)
        if self.best_at == len(self.scores) - 1:
            self.best = layers

    def arrays(self) -> Arrays:
        """Return the record of a finished training run as arrays."""
        assert self.best is not None
        return {
            "steps": np.array(self.steps, np.int64),
            "matchups": np.array([list(matchup) for matchup in self.scores[0]], np.str_),
            "scores": np.array(
                [[list(score) for score in scores.values()] for scores in self.scores]
            ),
            "updates": np.array(self.updates, np.float64),
            "best": np.frombuffer(layers_to_bytes(self.best), np.uint8),
            "seconds": np.array(self.seconds),
        }

    @classmethod
    def from_arrays(cls, seed: int, task: LearningTask, arrays: Arrays) -> "SeedRecord":
        """Return the record with the contents of such arrays."""
        matchups = [Matchup(*row) for row in arrays["matchups"].tolist()]
        scores = [
            [MatchupScore(int(row[0]), *row[1:]) for row in rows]
            for rows in arrays["scores"].tolist()
        ]
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


@dataclass(frozen=True, eq=False)
class PPOResult:
    """A trained policy and its learning curves."""

    settings: PPOSettings
    task: LearningTask
    curves: tuple[EvaluationCurve, ...]  #: Learning curve of each seed.
    layers: DenseLayers  #: Policy with the highest payoff in all evaluations of all seeds.
    seed: int  #: Seed of the policy.
    steps: int  #: Training steps of the policy.
    #: Scores of the policy, biased upwards: the maximum of many evaluations in the same races.
    scores: Mapping[Matchup, MatchupScore]
    seconds: float  #: Training time of all seeds, without interruptions, s.
    folder: Path  #: Folder of the weights, their manifest, and the curves.


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
    """Train by PPO, or resume a stopped training run.

    Parameters
    ----------
    config : str, Path or PPOSettings
        A shipped configuration's name, a YAML file, or settings.
    folder : str or Path
        New or empty folder, or the folder of the same training run. Output: ``policy/`` (weights,
        manifest, and every evaluation in ``curve.csv``), ``updates.csv`` (figures of every update)
        and the result of each finished seed in ``chunks/``.
    name : str, optional
        Name of the policy; by default the name used by the agent ``ppo`` or the planner
        ``ppo-drive``.
    executor : Executor, optional
        Executor of the training; no effect on the result. Processes and cluster workers train
        several seeds in parallel. Threads are not used, since torch's random generator belongs to
        the process.
    progress : callable, optional
        Called as ``progress(steps, total of all seeds, label)`` after every update, or after every
        seed trained in another process.
    policies : PolicyArchive, optional
        Archive that replaces the archive of a duel's settings.
    rules : GameConfig, optional
        Rules that replace the race and the size of moves of a duel's settings.
    """
    settings = load_ppo_settings(config, **changes)
    if isinstance(settings, DuelSettings):
        settings = _named(settings, policies, rules)
    check_packages()
    elsewhere = in_other_processes(executor)
    # Parallel runs share the cores; a single run, or sequential runs, may use all of them.
    threads = 1 if elsewhere is not None and len(settings.seeds) > 1 else default_threads()
    task = make_task(settings, archive=policies, rules=rules, threads=threads)
    identity = {**plain_settings(settings), "opponents": dict(settings.opponents), **task.identity}
    steps_of_seeds = 0  # steps of finished seeds

    def seeds_done(done: int, seeds: int, _: str) -> None:
        nonlocal steps_of_seeds
        steps_of_seeds = done * settings.steps
        if progress is not None:
            progress(steps_of_seeds, seeds * settings.steps, f"{done} of {seeds} seeds")

    def update_done(record: SeedRecord) -> None:
        if progress is not None:
            made = min(int(record.updates[-1][0]), settings.steps)
            label = f"seed {record.seed}, payoff {record.payoff(-1):.3f}"
            progress(steps_of_seeds + made, len(settings.seeds) * settings.steps, label)

    train = partial(train_seed, task, update_done if elsewhere is None else None)
    with open_job(folder, "ppo", identity) as job:
        results = job.run("seed", train, settings.seeds, executor=elsewhere, progress=seeds_done)
        runs = [
            SeedRecord.from_arrays(seed, task, result)
            for seed, result in zip(settings.seeds, results, strict=True)
        ]
        run = max(runs, key=lambda run: run.payoff(run.best_at))  # the first one in case of a tie
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


def train_seed(
    task: LearningTask, on_update: Callable[[SeedRecord], None] | None, seed: int
) -> Arrays:
    """Train with a seed until the settings' number of steps or the end of their patience.

    Parameters
    ----------
    on_update : callable, optional
        Called with the record after every update.

    Returns
    -------
    dict of ndarray
        Arrays of :meth:`SeedRecord.arrays`. All but the time depend only on task and seed.
    """
    settings = task.settings
    record = SeedRecord(seed, settings.opponents)
    begin = time.monotonic()
    with own_randomness():
        model = make_model(settings, task.env_groups(), seed, task.activation, task.threads)
        steps, since_best = 0, 0
        while True:
            # Evaluate before the first update, after each multiple of the interval, and at the end.
            # Updates consist of whole rollouts, so few of them end at a multiple.
            crossed = (
                not record.steps
                or steps // settings.evaluate_every > record.steps[-1] // settings.evaluate_every
            )
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


def make_task(
    settings: PPOSettings,
    *,
    archive: PolicyArchive | None = None,
    rules: GameConfig | None = None,
    threads: int = 1,
) -> LearningTask:
    """Load a level's tracks and opponents, and check their consistency.

    Arguments as for :func:`pcs_racing_agents.learning.ppo.duels.make_duel_task`.
    """
    if isinstance(settings, DuelSettings):
        return make_duel_task(settings, archive, rules, threads)
    if archive is not None or rules is not None:
        raise InputError(
            "settings of level drive know no archive and no game; give settings of level duel"
        )
    assert isinstance(settings, DriveSettings)
    return make_drive_task(settings)


def _named(
    settings: DuelSettings, archive: PolicyArchive | None, rules: GameConfig | None
) -> DuelSettings:
    """Return the settings, to be stored, with the names of the replacing archive and rules."""
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
        rows += [
            (run.seed, int(steps), *(f"{value:.6g}" for value in figures))
            for steps, *figures in run.updates
        ]
    write_csv(rows, file)


def _about(trained: PPOResult) -> dict[str, str | int | float | bool]:
    """Return facts about the training run for the policy's manifest: texts and numbers by name."""
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
