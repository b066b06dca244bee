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

from pcs_racing.base.errors import InputError
from pcs_racing.base.settings import OneOf
from pcs_racing.game.identity import GameIdentity, game_identity
from pcs_racing.game.players import random_moves
from pcs_racing.game.rules import RaceGame
from pcs_racing_agents.agents.agent import Agent
from pcs_racing_agents.agents.from_network import regret_matching
from pcs_racing_agents.agents.game_spec import GameSpec
from pcs_racing_agents.agents.observing import ObservationBatch
from pcs_racing_agents.base.chunks import Arrays
from pcs_racing_agents.base.configurations import load_config
from pcs_racing_agents.base.jobs import Job, Workers
from pcs_racing_agents.learning.responses.branches import (
    GameBlock,
    block_rows,
    branch_games,
    game_blocks,
)
from pcs_racing_agents.learning.responses.kept_networks import merge_networks, train_kept
from pcs_racing_agents.learning.responses.learner import LearnerSettings
from pcs_racing_agents.networks import NetworkSet, RegretNetwork, Rows, join_rows
from pcs_racing_agents.networks.settings import TrainSettings
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
    members: Annotated[
        int, Interval(ge=1, le=32), "Networks fitted in each iteration; their mean is used."
    ] = 1
    seed: Annotated[int, Interval(ge=0, le=2**50), "Seed of the games and of the networks."] = 0

    def iteration_weight(self, iteration: int) -> float:
        """Return the weight of an iteration, counted from 1."""
        return float(iteration) if self.weights == "linear" else 1.0

    def train_settings(self, iteration: int, member: int) -> TrainSettings:
        """Return the settings of a network of an iteration, counted from 1."""
        return self.fit_settings((self.seed * 64 + iteration) * 32 + member)


def load_self_play_settings(
    source: str | Path | SelfPlaySettings | None = None, **changes: Any
) -> SelfPlaySettings:
    """Return settings from a name, a YAML file or settings, with changes (:func:`load_config`)."""
    return load_config("self-play", SelfPlaySettings(), source, **changes)


def learn_self_play(
    samplers: "Sequence[RaceSampler]",
    settings: SelfPlaySettings,
    job: Job,
    *,
    name: str = "self-play",
    **workers: Unpack[Workers],
) -> NetworkSet:
    """Learn a strategy for both cars by counterfactual regret minimisation in self-play.

    Parameters
    ----------
    samplers : sequence of RaceSampler
        A sampler for each track, all of one game; they share one network.
    job : Job
        Job that stores rows and networks, so that a stopped run can be resumed.

    Returns
    -------
    NetworkSet
        Advantage network of each iteration, to be played by regret matching, with the weights of
        the average strategy. The last network was fitted to the rows of all iterations: it
        predicts the mean counterfactual regrets.
    """
    if len(samplers) == 0:
        raise InputError("there is no game to learn; give at least one")
    identity, steps = samplers[0].identity, samplers[0].steps
    for i, sampler in enumerate(samplers):
        if sampler.identity != identity or sampler.steps != steps:
            raise InputError(
                f"game {i} is another one than game 0; all must have one archive and one set of"
                " rules"
            )
    rows: list[Rows] = []
    networks: list[RegretNetwork] = []
    for iteration in range(1, settings.iterations + 1):
        place = f"iteration-{iteration}"
        blocks = [
            block
            for i in range(len(samplers))
            for step in range(steps)
            for block in game_blocks(settings.seed, (i, step, iteration), settings.starts)
        ]
        work = partial(
            _traverse, samplers, networks[-1] if networks else None, settings.exploration
        )
        results = job.run(place, work, blocks, **workers)
        weight = settings.iteration_weight(iteration)
        for arrays, block in zip(results, blocks, strict=True):
            if len(arrays["game"]):  # some of its games were still running
                i, step, _ = block.place
                rows.append(
                    block_rows(arrays, block, (iteration * 100 + step) * 1000 + i, step, weight)
                )
        members = [settings.train_settings(iteration, member) for member in range(settings.members)]
        fitted = train_kept(
            job,
            f"{place}-networks",
            join_rows(rows),
            identity,
            members,
            place,
            workers.get("executor"),
        )
        networks.append(merge_networks(fitted, place))
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


def _traverse(
    samplers: "Sequence[RaceSampler]",
    network: RegretNetwork | None,
    exploration: float,
    block: GameBlock,
) -> Arrays:
    i, step, _ = block.place
    return samplers[i].traverse(network, exploration, step, block.keys)


# Races


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


@dataclass(frozen=True, eq=False)
class RaceSampler:
    """Sampler of games on one track; all moves of car 0 are tried, both cars use one network."""

    game: RaceGame
    spec: GameSpec  #: Archive and rules, as known to agents.
    payoff: str = "win"  #: Payoff of a game: "win" or "utility".

    @property
    def identity(self) -> GameIdentity:
        """Identity of the learned game; it is the same for all tracks."""
        return game_identity(self.game)

    @property
    def steps(self) -> int:
        """Number of moves of each car."""
        return self.game.config.moves

    def traverse(
        self, network: RegretNetwork | None, exploration: float, step: int, keys: NDArray[np.uint64]
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
        keys : ndarray, shape (B,)
            Keys of the games; all random draws depend only on them.

        Returns
        -------
        dict of ndarray
            ``observations`` (R, D) of the player; ``advantages`` (R, A), the value of each move
            minus the strategy's value; ``game`` (R,), the index of the key.
        """
        random = random_moves(self.game, seed=2)
        first, second = (self._player(network, exploration, seed) for seed in (0, 1))
        game = game_between(self.game, first, second)
        moves = len(self.identity.moves)
        branches = branch_games(game, second, keys, step, [random], first, self.payoff, moves)
        chances = first.probabilities(branches.observations)[:, :moves]
        baseline = (chances * branches.outcomes).sum(axis=1, keepdims=True)
        return {
            "observations": branches.observations,
            "advantages": branches.outcomes - baseline,
            "game": branches.game,
        }

    def _player(self, network: RegretNetwork | None, exploration: float, seed: int) -> Any:
        if network is None:
            # Draws are a function of seed and observation: these seeds differ from the seeds of the
            # regret-matching players.
            return random_moves(self.game, seed=seed + 2)
        strategy = ExploringStrategy(network, exploration, len(self.spec.moves))
        return Agent("self-play", strategy, self.spec, seed)
