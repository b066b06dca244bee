"""Single deep CFR (Steinberger 2019) with external sampling on branched games.

In iteration t both cars play regret matching on the advantages predicted by the network of
iteration t - 1. At every step of many games all moves of one car are tried with the same noise;
the advantages of the moves over the strategy form a row. After each iteration a network is fitted
to the rows of all iterations; the rows of iteration t have weight t (linear CFR, Brown and Sandholm
2019). The network predicts the mean counterfactual regret of every move.

No player knows the noise, the start line or the opponent's policy: rows hold only observations, and
the moves after a branch depend only on observations, too. The final strategy is the average of the
iterations. Iteration t is weighted by t and by its own probability of reaching the situation: the
network of one iteration is drawn for each game, and
:class:`pcs_racing_agents.agents.mixture.Mixture` turns the draw into probabilities of moves.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Unpack

import numpy as np
from annotated_types import Interval
from numpy.typing import NDArray

from pcs_racing.base.settings import OneOf
from pcs_racing.game.players import ConstantPlayer, random_moves
from pcs_racing.game.rules import RaceGame
from pcs_racing_agents.agents.agent import Agent
from pcs_racing_agents.agents.from_network import regret_matching
from pcs_racing_agents.agents.observing import ObservationBatch
from pcs_racing_agents.base.configurations import load_config
from pcs_racing_agents.base.jobs import Arrays, Job, Workers
from pcs_racing_agents.learning.branches import (
    GameBlock,
    branch_games,
    branched_rows,
    common_identity,
    game_blocks,
)
from pcs_racing_agents.learning.responses import LearnerSettings, train_mean
from pcs_racing_agents.networks import NetworkSet, RegretNetwork, Rows, join_rows
from pcs_racing_agents.tournament.games import game_between

WEIGHTS = ("linear", "uniform")
"""Weights of iteration t in the regrets and in the average strategy: t (linear CFR), or 1 (vanilla
CFR, as in the paper)."""


@dataclass(frozen=True)
class SelfPlaySettings(LearnerSettings):
    """Settings of training by self-play."""

    iterations: Annotated[
        int,
        Interval(ge=1, le=63),
        "Iterations of CFR; after each the network is fitted to all rows.",
    ] = 16
    starts: Annotated[
        int,
        Interval(ge=4, le=1_000_000),
        "Games branched in each iteration, at every step and on each circuit.",
    ] = 512
    exploration: Annotated[
        float,
        Interval(ge=0.0, le=1.0),
        "Probability of a uniformly random move in place of one by regret matching, for both cars.",
    ] = 0.1
    weights: Annotated[
        str,
        OneOf(WEIGHTS),
        "Weight of iteration t in the regrets and in the average strategy: t (linear), or 1"
        " (uniform).",
    ] = "linear"
    seed: Annotated[int, Interval(ge=0, le=2**50), "Seed of the games and of the networks."] = 0

    def iteration_weight(self, iteration: int) -> float:
        """Return the weight of an iteration, counted from 1."""
        return float(iteration) if self.weights == "linear" else 1.0


def load_self_play_settings(
    source: str | Path | SelfPlaySettings | None = None, **changes: Any
) -> SelfPlaySettings:
    """Return settings from a name, a YAML file or settings, with changes (:func:`load_config`)."""
    return load_config("self-play", SelfPlaySettings(), source, **changes)


def learn_self_play(
    games: Sequence[RaceGame],
    spec: RaceGame,
    settings: SelfPlaySettings,
    job: Job,
    *,
    name: str = "self-play",
    **workers: Unpack[Workers],
) -> NetworkSet:
    """Learn a strategy for both cars by counterfactual regret minimisation in self-play.

    Parameters
    ----------
    games : sequence of RaceGame
        Games with equal archive and rules, one on each track; they share one network.
    spec : RaceGame
        Archive and rules, as known to agents.
    job : Job
        Job that stores rows and networks, so that a stopped run can be resumed.

    Returns
    -------
    NetworkSet
        Advantage network of each iteration, to be played by regret matching, with the weights of
        the average strategy. The last network was fitted to the rows of all iterations: it
        predicts the mean counterfactual regrets.
    """
    identity = common_identity(games)
    rows: list[Rows] = []
    networks: list[RegretNetwork] = []
    for iteration in range(1, settings.iterations + 1):
        place = f"iteration-{iteration}"
        blocks = [
            block
            for i in range(len(games))
            for step in range(games[0].rules.moves)
            for block in game_blocks(settings.seed, (i, step, iteration), settings.starts)
        ]
        strategy = networks[-1] if networks else None
        branch = partial(traverse, games, spec, settings.worth, strategy, settings.exploration)
        weight = settings.iteration_weight(iteration)
        rows += branched_rows(job, place, branch, blocks, weight, **workers)
        fit = settings.fit_settings((settings.seed * 64 + iteration) * 32)
        networks.append(
            train_mean(job, place, join_rows(rows), identity, [fit], place, workers.get("executor"))
        )
    # The network of iteration t is the strategy of iteration t + 1. The strategy of iteration 1
    # (random moves) is left out.
    weights = [settings.iteration_weight(iteration + 2) for iteration in range(settings.iterations)]
    facts: dict[str, str | int | float | bool] = {
        "rows": sum(map(len, rows)),
        "iterations": settings.iterations,
        "starts": settings.starts,
        "exploration": settings.exploration,
        "weights": settings.weights,
        "worth": settings.worth,
        "seed": settings.seed,
    }
    return NetworkSet(name, tuple(networks), np.array(weights), "regret-matching", facts)


def traverse(
    games: Sequence[RaceGame],
    spec: RaceGame,
    payoff: str,
    network: RegretNetwork | None,
    exploration: float,
    block: GameBlock,
) -> Arrays:
    """Return the advantages of all moves of car 0 at a step, if both cars play one strategy.

    Car 0 reaches the step by uniformly random moves, as in external sampling (Lanctot et al.
    2009). Its own reach probability is then the same in all iterations, and the advantages of
    several iterations can be averaged without importance weights. Its start position (in front
    or behind) is random, so the network learns for both cars.

    Parameters
    ----------
    network : RegretNetwork or None
        Advantages for the regret matching of both players; None for uniformly random moves.
    exploration : float
        Probability of a random move instead of a move by regret matching.

    Returns
    -------
    dict of ndarray
        ``observations`` (R, D) of the player; ``advantages`` (R, A), the value of each move
        minus the strategy's value; ``game`` (R,), the index in the block.
    """
    i, step, _ = block.place
    game = games[i]
    # Draws are a function of seed and observation: each player has a seed of its own.
    players: list[Agent | ConstantPlayer] = [random_moves(game, seed=seed) for seed in (2, 3)]
    if network is not None:
        strategy = ExploringStrategy(network, exploration, len(spec.moves))
        players = [Agent("self-play", strategy, spec, seed) for seed in (0, 1)]
    first, second = players
    before, moves = random_moves(game, seed=2), game.offered
    between = game_between(game, first, second)
    branches = branch_games(between, second, block.keys, step, [before], first, payoff, moves)
    chances = first.probabilities(branches.observations)[:, :moves]
    baseline = (chances * branches.outcomes).sum(axis=1, keepdims=True)
    return {
        "observations": branches.observations,
        "advantages": branches.outcomes - baseline,
        "game": branches.game,
    }


@dataclass(frozen=True, eq=False)
class ExploringStrategy:
    """Regret matching by a network of advantages, mixed with uniformly random moves."""

    network: RegretNetwork
    exploration: float  #: Probability of a random move.
    count: int  #: Total number of moves M; moves without a network output are never made.

    def __call__(self, observation: ObservationBatch) -> NDArray[np.float64]:
        """Return the probabilities of the moves, shape (B, M)."""
        values = self.network.unclipped(observation)
        offered = values.shape[1]
        probabilities = np.zeros((len(observation), self.count))
        mixed = (1.0 - self.exploration) * regret_matching(values) + self.exploration / offered
        probabilities[:, :offered] = mixed
        return probabilities
