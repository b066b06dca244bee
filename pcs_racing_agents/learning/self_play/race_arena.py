"""Races as an arena of self-play: every move of one car is tried, and both cars play by the same network."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pcs_racing.game.identity import GameIdentity, game_identity
from pcs_racing.game.rules import RaceGame
from pcs_racing_agents.agents.agent import Agent
from pcs_racing_agents.agents.blind import ConstantStrategy
from pcs_racing_agents.agents.from_network import regret_matching
from pcs_racing_agents.agents.observing import ObservationBatch
from pcs_racing_agents.agents.setting import Setting
from pcs_racing_agents.jobs.chunks import Arrays
from pcs_racing_agents.learning.responses.branches import branch_games
from pcs_racing_agents.networks import RegretNetwork
from pcs_racing_agents.tournament.games import game_between

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ExploringStrategy:
    """Regret matching by a network of advantages, mixed with uniformly random moves."""

    network: RegretNetwork
    exploration: float  #: Probability of a random move.
    count: int  #: Number of moves M that there are; those that the network does not value are never made.

    def __call__(self, observation: ObservationBatch) -> Floats:
        """Probabilities of the moves, shape (B, M)."""
        values = self.network.unclipped(observation)
        offered = values.shape[1]
        probabilities = np.zeros((len(observation), self.count))
        mixed = (1.0 - self.exploration) * regret_matching(values) + self.exploration / offered
        probabilities[:, :offered] = mixed
        return probabilities


@dataclass(frozen=True, eq=False)
class RaceArena:
    """The game on one circuit, as :func:`pcs_racing_agents.learning.self_play.learn_self_play` plays it."""

    game: RaceGame
    setting: Setting  #: Archive and rules, as agents know them.
    worth: str = "win"  #: "win" or "utility": Value of an outcome.

    @property
    def identity(self) -> GameIdentity:
        """The game that a network learns; any circuit belongs to it."""
        return game_identity(self.game)

    @property
    def steps(self) -> int:
        """Number of moves that each car makes."""
        return self.game.config.moves

    def traverse(
        self, network: RegretNetwork | None, exploration: float, step: int, keys: NDArray[np.uint64]
    ) -> Arrays:
        """Return the advantages of all moves of car 0 at a step, in games with both cars in the same strategy.

        Car 0 comes to the step by uniformly random moves, as in external sampling (Lanctot et al. 2009): its own
        probability of coming there is then the same in all iterations, and advantages of several iterations can be
        averaged without importance weights. Whether it starts in front or behind is drawn, so it learns for both cars.
        """
        random = self._random(seed=0)
        first, second = (self._player(network, exploration, seed) for seed in (0, 1))
        arena = game_between(self.game, first, second)
        moves = len(self.identity.moves)
        branches = branch_games(arena, second, keys, step, [random], first, self.worth, moves)
        chances = first.probabilities(branches.observations)[:, :moves]
        baseline = (chances * branches.outcomes).sum(axis=1, keepdims=True)
        return {
            "observations": branches.observations,
            "advantages": branches.outcomes - baseline,
            "game": branches.game,
        }

    def _player(self, network: RegretNetwork | None, exploration: float, seed: int) -> Agent:
        if network is None:
            return self._random(seed)
        strategy = ExploringStrategy(network, exploration, len(self.setting.moves))
        return Agent("self-play", strategy, self.setting, seed)

    def _random(self, seed: int) -> Agent:
        offered = len(self.identity.moves)
        probabilities = (np.arange(len(self.setting.moves)) < offered) / offered
        # Draws are a function of seed and observation: other seeds than those of the players by regret matching.
        return Agent("random-moves", ConstantStrategy(probabilities), self.setting, seed + 2)
