"""PPO of the duel: Stable-Baselines3, and a callback that evaluates the policy in races.

The policy of the best evaluation becomes the network of the agent ``ppo``. Each seed is a task of a
job: a stopped training resumes with its finished seeds and restarts the others. The weights are
bit-identical to the weights of an uninterrupted training (on the same machine and versions; torch
guarantees no more).
"""

import random
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from importlib.metadata import version
from itertools import product
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
from annotated_types import Interval, Len, MinLen
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from pcs_racing.base.dense import DenseLayers, layers_from_bytes, layers_to_bytes
from pcs_racing.base.errors import InputError, require
from pcs_racing.base.seeds import signed_seed
from pcs_racing.base.settings import (
    DIFFERENT,
    Layers,
    Names,
    OneOf,
    Settings,
    Text,
    plain_settings,
)
from pcs_racing.envs.duel import DuelVectorEnv
from pcs_racing.game.archive_files import load_archive
from pcs_racing.game.make import make_game
from pcs_racing.game.players import competitor
from pcs_racing.game.rules import RaceGame
from pcs_racing.race.config import load_rules
from pcs_racing.race.driving import default_threads
from pcs_racing_agents.agents.from_network import network_agent
from pcs_racing_agents.agents.sb3_files import frozen_model
from pcs_racing_agents.base.configurations import load_config
from pcs_racing_agents.base.executors import in_other_processes
from pcs_racing_agents.base.jobs import Arrays, Progress, open_job
from pcs_racing_agents.base.tables import Column, write_csv
from pcs_racing_agents.learning.branches import PAYOFFS
from pcs_racing_agents.networks import RegretNetwork, save_network
from pcs_racing_agents.networks.training import torch_alone
from pcs_racing_agents.tournament.pairings import draw_schedule, play_pairings, schedule_pairing

RACE_SEED = 1_000_003
"""Seed of the evaluations: all networks drive the same races."""


@dataclass(frozen=True, kw_only=True)
class PPOSettings(Settings):
    """Settings of training by PPO (Schulman et al. 2017); a step is a move."""

    archive: Annotated[Text, "Name or folder of the archive of policies."] = "default"
    rules: Annotated[Text, 'Rules: "paper", "contest" or a YAML file.'] = "paper"
    tracks: Annotated[Names, "Circuits of the training."] = (
        "Tarnfjord",
        "Vellindra",
        "Kestrelheim",
    )
    opponents: Annotated[
        Mapping[Text, Annotated[int, Interval(ge=1, le=1000)]],
        MinLen(1),
        "Opponents, agents or planners such as lane-switcher:3, with relative frequencies.",
    ] = field(default_factory=lambda: {"never-switch": 1}, hash=False)
    steps: Annotated[int, Interval(ge=1, le=10**12), "Steps of the training with each seed."] = (
        200_000
    )
    seeds: Annotated[
        tuple[Annotated[int, Interval(ge=0, le=2**31 - 1)], ...],
        Len(1, 1000),
        DIFFERENT,
        "Seeds; one policy is trained with each, and the best is kept.",
    ] = (0,)
    envs: Annotated[int, Interval(ge=1, le=100_000), "Parallel games on each circuit."] = 64
    rollout: Annotated[
        int, Interval(ge=1, le=100_000), "Steps of each game between two updates."
    ] = 16
    learning_rate: Annotated[
        float,
        Interval(ge=1e-8, le=1.0),
        "Initial learning rate of Adam; it falls linearly to a tenth.",
    ] = 1e-3
    hidden: Annotated[Layers, "Units of each hidden layer of policy and value network."] = (64, 64)
    worth: Annotated[
        str,
        OneOf(PAYOFFS),
        "Reward of a game: a race won (1; a race lost -1), or a tenth of the game's utility.",
    ] = "utility"
    evaluate_every: Annotated[int, Interval(ge=1, le=10**12), "Steps between two evaluations."] = (
        40_000
    )
    evaluation_races: Annotated[
        int,
        Interval(ge=2, le=2000),
        "Races of an evaluation on each circuit, in equal shares against the opponents.",
    ] = 140


def load_ppo_settings(source: str | Path | PPOSettings, **changes: Any) -> PPOSettings:
    """Return settings from a name, a YAML file or settings, with changes (:func:`load_config`)."""
    return load_config("ppo", PPOSettings(), source, **changes)


class Evaluation(NamedTuple):
    """Races of a policy in training against an opponent on a track; a line of ``curve.csv``."""

    seed: int
    steps: int  #: Steps of the training before the races.
    track: str
    opponent: str
    races: int
    score: float  #: Mean score: 1 for a win, 0.5 for a tie.
    own_crash: float  #: Share of races with a crash by own fault.
    lead: float  #: Mean lead at the end, m.


COLUMNS = (
    Column("track"),
    Column("opponent"),
    Column("races"),
    Column("score", format=".3f"),
    Column("own_crash", "own crashes", ".1%"),
    Column("lead", "lead, m", ".1f"),
)
"""Columns of a table of evaluations."""


class TrainedPPO(NamedTuple):
    """Result of a training."""

    network: RegretNetwork  #: Trained policy with the max score over all evaluations and seeds.
    curve: list[Evaluation]  #: All evaluations of all seeds.
    best: list[Evaluation]  #: Evaluation of the network; as a maximum it is biased upwards.
    seconds: float  #: Time of the training, without interruptions, s.


def train_ppo(
    config: str | Path | PPOSettings,
    folder: str | Path,
    *,
    name: str | None = None,
    executor: Executor | None = None,
    progress: Progress | None = None,
    **changes: Any,
) -> TrainedPPO:
    """Train by PPO, or resume a stopped training.

    Parameters
    ----------
    config : str, Path or PPOSettings
        Name of a shipped configuration, a YAML file, or settings.
    folder : str or Path
        New or empty folder, or the folder of the same training. The network and ``curve.csv`` are
        written into its folder ``agent``.
    name : str, optional
        Name of the network (default: name of the shipped network of the agent ``ppo``).
    executor : Executor, optional
        Executor of the seeds, if its tasks run in other processes: torch's random generator belongs
        to the process. It changes no result.
    progress : callable, optional
        Called as ``progress(steps, total, label)`` before every update, or after every seed if
        seeds train in other processes.
    """
    settings = load_ppo_settings(config, **changes)
    require("stable_baselines3", extra="learning")
    wins: Any = {"utility": "win", "fault_penalty": 0.0} if settings.worth == "win" else {}
    archive, rules = load_archive(settings.archive), load_rules(settings.rules, **wins)
    games = [make_game(track, archive, rules) for track in settings.tracks]
    identity = {
        "settings": plain_settings(settings),
        "archive": archive.content_hash,
        "rules": repr(rules),
        "tracks": [game.track.content_hash for game in games],
    }
    elsewhere, total = in_other_processes(executor), len(settings.seeds) * settings.steps

    def show(steps: int, label: str) -> None:
        if progress is not None:
            progress(min(steps, total), total, label)

    def show_seeds(done: int, seeds: int, _: str) -> None:
        show(done * settings.steps, f"{done} of {seeds} seeds")

    train = partial(_train_seed, settings, games, show if elsewhere is None else None)
    with open_job(folder, "ppo", identity) as job:
        seeds = job.run("seed", train, settings.seeds, executor=elsewhere, progress=show_seeds)
        means = [_means(settings, one["scores"][one["at"]]) for one in seeds]
        best = int(np.argmax([score for score, *_ in means]))
        curve = [
            line
            for seed, one in zip(settings.seeds, seeds, strict=True)
            for line in _lines(settings, seed, one)
        ]
        kept = settings.seeds[best], int(seeds[best]["steps"][seeds[best]["at"]])
        weights = seeds[best]["best"].tobytes()
        network = _network(
            games[0],
            layers_from_bytes(job.folder, weights, list(settings.hidden))[0],
            name or f"{archive.name}-{rules.name}-ppo",
            _facts(settings, *kept, means[best]),
        )
        place = save_network(network, job.folder / "agent")
        write_csv([Evaluation._fields, *curve], place / "curve.csv")
    return TrainedPPO(
        network,
        curve,
        [line for line in curve if line[:2] == kept],
        sum(float(one["seconds"]) for one in seeds),
    )


def _train_seed(
    settings: PPOSettings,
    games: Sequence[RaceGame],
    show: Callable[[int, str], None] | None,
    seed: int,
) -> Arrays:
    """Train with a seed; return steps and scores of all evaluations, and the best one's weights."""
    import torch
    from stable_baselines3 import PPO
    from stable_baselines3.common.callbacks import BaseCallback
    from stable_baselines3.common.logger import Logger

    begun, before = time.monotonic(), settings.seeds.index(seed) * settings.steps
    steps: list[int] = []
    policies: list[DenseLayers] = []
    scores: list[NDArray[np.float64]] = []

    class _Evaluations(BaseCallback):
        """Races before the first update, after every interval of steps, and at the end."""

        def _on_step(self) -> bool:
            return True

        def _on_rollout_start(self) -> None:
            done, every = self.num_timesteps, settings.evaluate_every
            if not steps or done // every > steps[-1] // every:
                self.evaluate()
            if show is not None:
                show(before + done, f"seed {seed}, score {_means(settings, scores[-1])[0]:.3f}")

        def _on_training_end(self) -> None:
            self.evaluate()

        def evaluate(self) -> None:
            """Race the present policy."""
            steps.append(self.num_timesteps)
            policies.append(frozen_model(self.model, "ppo").layers)
            scores.append(_race(settings, games, policies[-1]))

    with own_randomness():
        envs = _make_envs(settings, games, seed)
        model = PPO(
            "MlpPolicy",
            envs,
            learning_rate=lambda left: settings.learning_rate * (0.1 + 0.9 * left),
            n_steps=settings.rollout,
            batch_size=min(512, settings.rollout * envs.num_envs),
            n_epochs=8,
            gamma=1.0,
            ent_coef=0.01,
            policy_kwargs={"net_arch": list(settings.hidden), "activation_fn": torch.nn.ReLU},
            seed=seed,
            device="cpu",
        )
        model.set_logger(Logger(None, []))  # the default one makes a folder
        try:
            model.learn(settings.steps, callback=_Evaluations(), log_interval=None)  # type: ignore[arg-type]
        except ValueError:  # torch's distributions refuse NaN
            if all(torch.isfinite(one).all() for one in model.policy.parameters()):
                raise
            raise InputError(
                f"a weight is no longer a number after {model.num_timesteps} steps; take a"
                f" learning_rate below {settings.learning_rate:g}"
            ) from None
    # The first policy has learned nothing.
    at = 1 + int(np.argmax([_means(settings, one)[0] for one in scores[1:]]))
    return {
        "steps": np.array(steps),
        "scores": np.array(scores),
        "at": np.array(at),
        "best": np.frombuffer(layers_to_bytes(policies[at]), np.uint8),
        "seconds": np.array(time.monotonic() - begun),
    }


def _make_envs(settings: PPOSettings, games: Sequence[RaceGame], seed: int) -> Any:
    """Make the games of the training: a batch for each track and opponent, by its frequency."""
    from pcs_racing.envs.sb3 import SB3VecEnv

    ends = np.cumsum([0, *settings.opponents.values()]) / sum(settings.opponents.values())
    shares = np.maximum(np.diff(np.rint(settings.envs * ends)).astype(int), 1).tolist()
    batches = [
        DuelVectorEnv(
            share,
            track=game.track,
            archive=game.archive,
            rules=game.rules,
            opponent=opponent,
            autoreset_mode=AutoresetMode.SAME_STEP,
            threads=1,
        )
        for game in games
        for opponent, share in zip(settings.opponents, shares, strict=True)
    ]
    roots = [np.random.SeedSequence(seed, spawn_key=(k,)) for k in range(len(batches))]
    return SB3VecEnv(
        batches,
        seeds=[signed_seed(root) for root in roots],
        reward_scale=1.0 if settings.worth == "win" else 0.1,
        threads=default_threads(),
    )


def _race(
    settings: PPOSettings, games: Sequence[RaceGame], layers: DenseLayers
) -> NDArray[np.float64]:
    """Return score, own crashes and lead of a policy for each track and opponent, shape (K, 3)."""
    spec = games[0].anywhere
    agent = network_agent(_network(games[0], layers, "ppo", {}), spec)
    pairings = []
    for game in games:
        schedule = draw_schedule(game.track, game.rules.for_game, _races(settings), RACE_SEED)
        pairings += [
            schedule_pairing(game, agent, competitor(name, spec), schedule, RACE_SEED)
            for name in settings.opponents
        ]
    return np.array(
        [
            [one.score.mean(), (one.fault[:, 0] > 0).mean(), one.lead.mean()]
            for one in play_pairings(pairings)
        ]
    )


def _races(settings: PPOSettings) -> int:
    """Return the races of a pair on a track in an evaluation, an even number."""
    return 2 * max(1, settings.evaluation_races // (2 * len(settings.opponents)))


def _means(settings: PPOSettings, scores: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return means of scores (..., K, 3) by the frequencies of the opponents, shape (..., 3)."""
    weights = np.tile(list(settings.opponents.values()), len(settings.tracks))
    return np.average(scores, axis=-2, weights=weights)


def _lines(settings: PPOSettings, seed: int, trained: Arrays) -> Iterator[Evaluation]:
    for steps, scores in zip(trained["steps"], trained["scores"], strict=True):
        for pair, row in zip(product(settings.tracks, settings.opponents), scores, strict=True):
            yield Evaluation(seed, int(steps), *pair, _races(settings), *row.round(6).tolist())


def _network(
    game: RaceGame, layers: DenseLayers, name: str, facts: Mapping[str, str | int | float | bool]
) -> RegretNetwork:
    """Return a policy as a network with the logits of the moves as values."""
    mean = np.zeros(layers.sizes[0], np.float32)
    return RegretNetwork(name, game.identity, "ppo", False, layers, mean, np.ones_like(mean), facts)


def _facts(
    settings: PPOSettings, seed: int, steps: int, means: NDArray[np.float64]
) -> dict[str, str | int | float | bool]:
    """Return the facts about the training that the network states."""
    versions = {name: version(name.replace("_", "-")) for name in ("stable_baselines3", "torch")}
    scores = dict(zip(Evaluation._fields[-3:], means.round(4).tolist(), strict=True))
    options = plain_settings(settings)
    for key, value in options.items():
        if isinstance(value, Mapping):
            value = [f"{weight} {name}" for name, weight in value.items()]
        options[key] = ", ".join(map(str, value)) if isinstance(value, list) else value
    stated = {f"setting_{key}": value for key, value in options.items()}
    return {"algorithm": "PPO", **versions, "seed": seed, "steps": steps, **scores, **stated}


@contextmanager
def own_randomness() -> Iterator[None]:
    """Restore the process's random generators at exit; reserve them and torch for one thread."""
    with torch_alone() as torch:
        states = random.getstate(), np.random.get_state(), torch.get_rng_state()  # noqa: NPY002
        try:
            yield
        finally:
            random.setstate(states[0])
            np.random.set_state(states[1])  # noqa: NPY002
            torch.set_rng_state(states[2])
