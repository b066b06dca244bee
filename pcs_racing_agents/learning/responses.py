"""Learned responses: approximate best responses to a pool, by backward induction on branched games.

At the last step every move is tried in games against the pool, and a network learns the advantage
of each move from the observation. The step before follows in the same way; there this network makes
the later moves. The induction ends at the first step. This is fitted Q-iteration (Ernst et al.
2005) over a finite horizon with one pass per round, on advantages with a variance reduced by common
random numbers. Observations contain nothing about the track, so the network works on any track.

Policy-space response oracles (PSRO, Lanctot et al. 2017) with learned responses.

Each round learns a response to the equilibrium mixture of all earlier responses, and races it
against them. The equilibrium of the extended game is the next mixture. The first response is
learned against a pool of opponents.
"""

import json
from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Unpack

import numpy as np
from annotated_types import Interval

from pcs_racing.base.dense import DenseLayers
from pcs_racing.base.errors import InputError
from pcs_racing.base.settings import Layers, OneOf, Settings, Text
from pcs_racing.game.identity import GameIdentity
from pcs_racing.game.players import Competitor, random_moves
from pcs_racing.game.rules import RaceGame
from pcs_racing_agents.agents.agent import Agent
from pcs_racing_agents.agents.from_network import network_agent
from pcs_racing_agents.base.configurations import load_config
from pcs_racing_agents.base.executors import in_other_processes
from pcs_racing_agents.base.fingerprint import fingerprint
from pcs_racing_agents.base.jobs import Arrays, Job, Workers
from pcs_racing_agents.learning.branches import (
    PAYOFFS,
    GameBlock,
    branch_games,
    branched_rows,
    common_identity,
    game_blocks,
)
from pcs_racing_agents.networks import NetworkSet, RegretNetwork, Rows, join_rows, train_network
from pcs_racing_agents.networks.network_files import (
    check_weights,
    network_to_bytes,
    weights_from_bytes,
)
from pcs_racing_agents.networks.training import TrainSettings
from pcs_racing_agents.tournament.fitting import MetaStrategy, TrainingRaces, fit_psro
from pcs_racing_agents.tournament.games import game_between

FIT = TrainSettings(
    learning_rate=3e-3, weight_decay=1e-3, batch_size=512, rows_per_epoch=50_000, patience=12
)
"""Training of a network on the rows of branched games."""


@dataclass(frozen=True)
class LearnerSettings(Settings):
    """Settings of the payoff of branched games and of the networks."""

    # The name of this option is in the files of shipped networks.
    worth: Annotated[
        str, OneOf(PAYOFFS), "Payoff of a game: a race won, or the game's utility."
    ] = "win"
    hidden: Annotated[Layers, "Units of each hidden layer of a network."] = (64, 64)
    epochs: Annotated[
        int, Interval(ge=1, le=100_000), "Maximum number of epochs of a network's training."
    ] = 60

    def fit_settings(self, seed: int) -> TrainSettings:
        """Return the settings of one network's training."""
        return replace(FIT, hidden=self.hidden, epochs=self.epochs, seed=seed)


@dataclass(frozen=True)
class ResponseSettings(LearnerSettings):
    """Settings of response training."""

    starts: Annotated[
        int,
        Interval(ge=4, le=1_000_000),
        "Games branched at every step of a round, on each circuit: against each opponent of the"
        " pool or, where the opponents have shares, against all of them together.",
    ] = 1024
    rounds: Annotated[
        int,
        Interval(ge=1, le=20),
        "Passes from the last step to the first. In the first pass, games reach a step by random"
        " moves; in later passes, every other game reaches it by the moves of the current network.",
    ] = 2
    members: Annotated[
        int, Interval(ge=1, le=32), "Networks of the ensemble; the response is their mean."
    ] = 4
    seed: Annotated[int, Interval(ge=0, le=2**57 - 1), "Seed of the games and of the networks."] = 0


def load_response_settings(
    source: str | Path | ResponseSettings | None = None, **changes: Any
) -> ResponseSettings:
    """Return settings from a name, a YAML file or settings, with changes (:func:`load_config`)."""
    return load_config("response", ResponseSettings(), source, **changes)


def learn_response(
    games: Sequence[RaceGame],
    pool: Sequence[Competitor],
    spec: RaceGame,
    settings: ResponseSettings,
    job: Job,
    *,
    shares: Sequence[float] | None = None,
    name: str = "response",
    part: str = "",
    **workers: Unpack[Workers],
) -> RegretNetwork:
    """Learn the advantage of each move against a pool of opponents.

    Parameters
    ----------
    games : sequence of RaceGame
        Games with equal archive and rules, one on each track.
    shares : sequence of float, optional
        Relative frequency of each opponent, in any unit. By default each opponent is met
        ``settings.starts`` times; with shares, ``settings.starts`` is the total.
    part : str
        Prefix of the names of this work in the job, for jobs that learn several networks.

    Returns
    -------
    RegretNetwork
        Network that predicts advantages over the mean of all moves, in shares of races won (or in
        units of utility).
    """
    if len(pool) == 0:
        raise InputError("there is no opponent to learn against; give at least one")
    identity = common_identity(games)
    starts = _starts(settings.starts, len(pool), shares)
    at_random: Competitor = random_moves(games[0], seed=settings.seed)
    played = [[game_between(game, at_random, opponent) for opponent in pool] for game in games]
    rows: list[Rows] = []
    network: RegretNetwork | None = None
    for round_ in range(settings.rounds):
        behaviours = [at_random] if network is None else [at_random, network_agent(network, spec)]
        for step in reversed(range(games[0].rules.moves)):
            # In the first pass, branches of the last step have no later moves: the continuation is
            # irrelevant.
            continuation = at_random if network is None else network_agent(network, spec)
            branch = partial(
                _branch, played, pool, behaviours, continuation, settings.worth, len(identity.moves)
            )
            blocks = [
                block
                for i in range(len(games))
                for j, count in enumerate(starts)
                for block in game_blocks(settings.seed, (i, j, step, round_), count)
            ]
            place = f"{part}round-{round_}-step-{step}"
            rows += branched_rows(job, place, branch, blocks, **workers)
            # Intermediate networks only continue branches; more members would change little.
            last = round_ == settings.rounds - 1 and step == 0
            members = range(settings.members if last else min(settings.members, 2))
            fits = [settings.fit_settings(settings.seed * 64 + member) for member in members]
            network = train_mean(
                job, place, join_rows(rows), identity, fits, name, workers.get("executor")
            )
    assert network is not None
    rest = {key: value for key, value in network.training.items() if key != "rows"}
    summary = {"rows": sum(map(len, rows)), "worth": settings.worth, **rest}
    return replace(network, training=summary)


def _starts(total: int, opponents: int, shares: Sequence[float] | None) -> list[int]:
    """Return the number of games against each opponent."""
    if shares is None:
        return [total] * opponents
    weights = check_weights("shares", shares, opponents)
    ends = np.rint(total * np.cumsum(weights) / weights.sum()).astype(int)
    return np.diff(ends, prepend=0).tolist()


def _branch(
    played: Sequence[Sequence[RaceGame]],
    pool: Sequence[Competitor],
    behaviours: Sequence[Competitor],
    continuation: Competitor,
    payoff: str,
    count: int,
    block: GameBlock,
) -> Arrays:
    i, j, step, _ = block.place
    branches = branch_games(
        played[i][j], pool[j], block.keys, step, behaviours, continuation, payoff, count
    )
    # The mean over all moves is the value of the situation, irrelevant for the choice of a move.
    advantages = branches.outcomes - branches.outcomes.mean(axis=1, keepdims=True)
    return {"observations": branches.observations, "advantages": advantages, "game": branches.game}


# Networks


def train_mean(
    job: Job,
    part: str,
    rows: Rows,
    identity: GameIdentity,
    settings: Sequence[TrainSettings],
    name: str,
    executor: Executor | None = None,
) -> RegretNetwork:
    """Train a network with each of several settings on the same rows, and return their mean.

    The job stores the networks. ``executor`` trains them if its tasks run in other processes.
    """
    # Rows are large and common to all members: a task holds their digest, the function holds them.
    digest = fingerprint(rows.observations, rows.targets, rows.weights, rows.pair)
    tasks = [(digest, one) for one in settings]
    learn = partial(_learn, rows, identity, name)
    stored = job.run(f"{part}-networks", learn, tasks, executor=in_other_processes(executor))
    networks = [
        RegretNetwork(
            name=name,
            identity=identity,
            target="advantage",
            clipped=False,
            **weights_from_bytes(Path(name), arrays["weights"].tobytes(), list(one.hidden)),
            training=json.loads(str(arrays["training"])),  # losses may be NaN
        )
        for arrays, one in zip(stored, settings, strict=True)
    ]
    return mean_network(networks)


def _learn(
    rows: Rows, identity: GameIdentity, name: str, task: tuple[str, TrainSettings]
) -> Arrays:
    network, _ = train_network(rows, identity, task[1], name=name, target="advantage")
    return {
        "weights": np.frombuffer(network_to_bytes(network), np.uint8),
        "training": np.array(json.dumps(dict(network.training))),
    }


def mean_network(networks: Sequence[RegretNetwork]) -> RegretNetwork:
    """Return a wider network whose outputs are the mean outputs of networks of one shape."""
    from scipy.linalg import block_diag

    layers = [network.scaled_layers for network in networks]
    weights = [
        block_diag(*(one.weights[k] for one in layers)) for k in range(len(layers[0].weights))
    ]
    biases = [np.concatenate(parts) for parts in zip(*(one.biases for one in layers), strict=True)]
    weights[0] = np.concatenate([one.weights[0] for one in layers])  # common inputs
    mean = np.tile(np.eye(layers[0].sizes[-1]), len(layers)) / len(layers)
    weights[-1], biases[-1] = mean @ weights[-1], mean @ biases[-1]
    return replace(
        networks[0],
        layers=DenseLayers(tuple(weights), tuple(biases)),
        mean=np.zeros_like(networks[0].mean),
        scale=np.ones_like(networks[0].scale),
        training={**networks[0].training, "members": len(networks)},
    )


MIXING_SEED = 6_000_000
"""Offset of the settings' seed, so that these races differ from the responses' training games."""


@dataclass(frozen=True)
class PSROSettings(Settings):
    """Settings of policy-space response oracles (PSRO)."""

    rounds: Annotated[int, Interval(ge=2, le=32), "Responses that are learned."] = 6
    races: Annotated[
        int,
        Interval(ge=2, le=2000),
        "Races of each two responses on each circuit, for the equilibrium; even.",
    ] = 200
    learner: Annotated[
        Text,
        "Settings of each learned response (response configuration: a name or a YAML file).",
    ] = "psro"
    seed: Annotated[int, Interval(ge=0, le=2**40), "Seed of the games and of the networks."] = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        self.response(0)  # refuse an unknown learner before any training

    def response(self, number: int) -> ResponseSettings:
        """Return the settings of one response, with its own seed."""
        settings = load_response_settings(self.learner)
        return replace(settings, seed=settings.seed + self.seed * 64 + number)


def load_psro_settings(
    source: str | Path | PSROSettings | None = None, **changes: Any
) -> PSROSettings:
    """Return settings from a name, a YAML file or settings, with changes (:func:`load_config`)."""
    return load_config("psro", PSROSettings(), source, **changes)


def learn_psro(
    games: Sequence[RaceGame],
    pool: Sequence[Competitor],
    spec: RaceGame,
    settings: PSROSettings,
    job: Job,
    *,
    name: str = "psro",
    **workers: Unpack[Workers],
) -> NetworkSet:
    """Learn responses to the equilibrium mixture of earlier responses, in several rounds.

    Parameters
    ----------
    games, spec
        As for :func:`pcs_racing_agents.learning.responses.learn_response`.
    pool : sequence of Competitor
        Opponents of the first response.

    Returns
    -------
    NetworkSet
        Responses in the support of the equilibrium, with their probabilities.
    """
    networks: list[RegretNetwork] = []
    members: list[Agent] = []
    opponents: Sequence[Competitor] = pool
    weights = np.full(len(pool), 1.0 / max(len(pool), 1))
    meta: MetaStrategy | None = None
    training = TrainingRaces(
        tuple(game.track for game in games),
        tuple(pool),
        spec,
        settings.races,
        settings.seed + MIXING_SEED,
    )
    for round_ in range(settings.rounds):
        network = learn_response(
            games,
            opponents,
            spec,
            settings.response(round_),
            job,
            shares=weights.tolist(),
            name=f"{name}-{round_}",
            part=f"response-{round_}-",
            **workers,
        )
        networks.append(network)
        members.append(network_agent(network, spec, settings.seed))
        # A single response is its own equilibrium. Payoffs of earlier rounds are reused.
        if round_ > 0:
            meta = fit_psro(training, members, known=meta, job=job, **workers)
        opponents, weights = members, np.ones(1) if meta is None else meta.weights
    played = np.flatnonzero(weights > 0.0)
    facts = {"rounds": settings.rounds, "races": settings.races, "seed": settings.seed}
    return NetworkSet(
        name, tuple(networks[int(i)] for i in played), weights[played], "argmax", facts
    )
