"""Training by PPO: from settings to weights and learning curves, in a folder.

Each seed is a task of a job: its result depends only on the settings and the seed, and any process
can train it. A stopped run resumes with its finished seeds and restarts the others. The weights are
bit-identical to the weights of an uninterrupted run (on the same machine and versions; torch
guarantees no more).
"""

import time
from collections.abc import Callable, Mapping
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from pcs_racing.base.dense import DenseLayers, layers_from_bytes, layers_to_bytes
from pcs_racing.base.errors import require
from pcs_racing.base.settings import plain_settings
from pcs_racing.game.archive import PolicyArchive
from pcs_racing.game.config import GameConfig
from pcs_racing.race.driving import default_threads
from pcs_racing_agents.base.chunks import Arrays
from pcs_racing_agents.base.jobs import open_job
from pcs_racing_agents.base.progress import Progress
from pcs_racing_agents.base.tasks import in_other_processes
from pcs_racing_agents.learning.ppo.duels import DuelTask, make_duel_task
from pcs_racing_agents.learning.ppo.evaluation import (
    EvaluationCurve,
    Matchup,
    MatchupScore,
    mean_score,
    write_evaluations,
)
from pcs_racing_agents.learning.ppo.learner import (
    actor_layers,
    learn_once,
    make_model,
    own_randomness,
)
from pcs_racing_agents.learning.ppo.settings import DuelSettings, load_ppo_settings

Report = Callable[[int, int, float], None]
"""``report(seed, steps, payoff)``: called after every update with the last evaluation's payoff."""


@dataclass(frozen=True, eq=False)
class PPOResult:
    """A trained policy and its learning curves."""

    settings: DuelSettings
    task: DuelTask
    curves: tuple[EvaluationCurve, ...]  #: Learning curve of each seed.
    layers: DenseLayers  #: Policy with the highest payoff in all evaluations of all seeds.
    seed: int  #: Seed of the policy.
    steps: int  #: Training steps of the policy.
    #: Scores of the policy, biased upwards: the maximum of many evaluations in the same races.
    scores: Mapping[Matchup, MatchupScore]
    seconds: float  #: Training time of all seeds, without interruptions, s.
    folder: Path  #: Folder of the weights, their manifest, and the curves.


def train_ppo(
    config: str | Path | DuelSettings,
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
    config : str, Path or DuelSettings
        A shipped configuration's name, a YAML file, or settings.
    folder : str or Path
        New or empty folder, or the folder of the same training run. Output: ``policy/`` (weights,
        manifest, and every evaluation in ``curve.csv``) and the result of each finished seed in
        ``chunks/``.
    name : str, optional
        Name of the policy; by default the name used by the agent ``ppo``.
    executor : Executor, optional
        Executor of the training; no effect on the result. Processes and cluster workers train
        several seeds in parallel. Threads are not used, since torch's random generator belongs to
        the process.
    progress : callable, optional
        Called as ``progress(steps, total of all seeds, label)`` after every update, or after every
        seed trained in another process.
    policies : PolicyArchive, optional
        Archive that replaces the archive of the settings.
    rules : GameConfig, optional
        Rules that replace the race and the size of moves of the settings.
    """
    settings = load_ppo_settings(config, **changes)
    settings = _named(settings, policies, rules)
    require("stable_baselines3", extra="learning")
    elsewhere = in_other_processes(executor)
    # Parallel runs share the cores; a single run, or sequential runs, may use all of them.
    threads = 1 if elsewhere is not None and len(settings.seeds) > 1 else default_threads()
    task = make_duel_task(settings, policies, rules, threads)
    identity = {**plain_settings(settings), "opponents": dict(settings.opponents), **task.identity}
    total = len(settings.seeds) * settings.steps

    def seeds_done(done: int, seeds: int, _: str) -> None:
        if progress is not None:
            progress(done * settings.steps, total, f"{done} of {seeds} seeds")

    def update_done(seed: int, steps: int, payoff: float) -> None:
        if progress is not None:
            made = settings.seeds.index(seed) * settings.steps + min(steps, settings.steps)
            progress(made, total, f"seed {seed}, payoff {payoff:.3f}")

    train = partial(train_seed, task, update_done if elsewhere is None else None)
    with open_job(folder, "ppo", identity) as job:
        results = job.run("seed", train, settings.seeds, executor=elsewhere, progress=seeds_done)
        curves = tuple(map(_curve, settings.seeds, results))
        payoffs = [
            [mean_score(scores, settings.opponents).worth for scores in curve.scores]
            for curve in curves
        ]
        best = int(np.argmax([max(row) for row in payoffs]))  # the first one in case of a tie
        at = int(np.argmax(payoffs[best]))
        weights = results[best]["best"].tobytes()
        trained = PPOResult(
            settings=settings,
            task=task,
            curves=curves,
            layers=layers_from_bytes(job.folder, weights, list(settings.hidden))[0],
            seed=settings.seeds[best],
            steps=curves[best].steps[at],
            scores=curves[best].scores[at],
            seconds=sum(float(result["seconds"]) for result in results),
            folder=job.folder / "policy",
        )
        task.save(trained.layers, trained.folder, name or task.default_name, _about(trained))
        write_evaluations(curves, trained.folder / "curve.csv")
    return trained


def train_seed(task: DuelTask, report: Report | None, seed: int) -> Arrays:
    """Train with a seed until the settings' number of steps or the end of their patience.

    Returns
    -------
    dict of ndarray
        Steps, matchups and scores of all evaluations, the weights of the best one (the first in
        case of a tie), and the training time in ``seconds``. All but the time depend only on task
        and seed.
    """
    settings = task.settings
    begin = time.monotonic()
    steps: list[int] = []
    evaluations: list[dict[Matchup, MatchupScore]] = []
    payoffs: list[float] = []
    with own_randomness():
        model = make_model(settings, task.env_groups(), seed, task.activation, task.threads)
        best = actor_layers(model)
        while True:
            # Evaluate before the first update, after each multiple of the interval, and at the end.
            # Updates consist of whole rollouts, so few of them end at a multiple.
            done, every = model.num_timesteps, settings.evaluate_every
            if not steps or done // every > steps[-1] // every or done >= settings.steps:
                layers = actor_layers(model)
                steps.append(done)
                evaluations.append(task.evaluate(layers))
                payoffs.append(mean_score(evaluations[-1], settings.opponents).worth)
                if np.argmax(payoffs) == len(payoffs) - 1:
                    best = layers
            if report is not None and done > 0:
                report(seed, done, payoffs[-1])
            since_best = len(payoffs) - 1 - int(np.argmax(payoffs))
            if done >= settings.steps or 0 < settings.patience <= since_best:
                break
            learn_once(model, settings, task.limit)
    return {
        "steps": np.array(steps, np.int64),
        "matchups": np.array([list(matchup) for matchup in evaluations[0]], np.str_),
        "scores": np.array([[list(score) for score in one.values()] for one in evaluations]),
        "best": np.frombuffer(layers_to_bytes(best), np.uint8),
        "seconds": np.array(time.monotonic() - begin),
    }


def _curve(seed: int, result: Arrays) -> EvaluationCurve:
    """Return the learning curve in the result of :func:`train_seed`."""
    matchups = [Matchup(*row) for row in result["matchups"].tolist()]
    scores = [
        {
            matchup: MatchupScore(int(row[0]), *row[1:])
            for matchup, row in zip(matchups, rows, strict=True)
        }
        for rows in result["scores"].tolist()
    ]
    return EvaluationCurve(seed, tuple(result["steps"].tolist()), tuple(scores))


def _named(
    settings: DuelSettings, archive: PolicyArchive | None, rules: GameConfig | None
) -> DuelSettings:
    """Return the settings, to be stored, with the names of the replacing archive and rules."""
    if archive is not None:
        settings = replace(settings, archive=archive.name)
    if rules is not None:
        epsilon = rules.epsilon if isinstance(rules.epsilon, float) else settings.epsilon
        settings = replace(settings, rules=rules.race.name, epsilon=epsilon)
    return settings


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
