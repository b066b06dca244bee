"""Receding-horizon control: at every decision simulate the next few steps, and solve that small game.

The paper solves the whole game before the race, and names that as its limit: with more decisions the tree becomes too
deep. A search from the present state needs no tree of the whole game. It uses positions and speeds of both cars, but
not the opponent's parameters (:mod:`pcs_racing_agents.agents.lookahead`).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.checks import check_choice, check_whole
from pcs_racing.base.errors import InputError
from pcs_racing.game.observation import LEAD_SCALE
from pcs_racing.game.reward import reward
from pcs_racing.game.rules import RaceGame
from pcs_racing.game.state import GameState, take_games
from pcs_racing_agents.agents.agent import draw, hash_rows
from pcs_racing_agents.agents.from_network import NetworkSource, fitting_network
from pcs_racing_agents.agents.lookahead import guess_games, look_ahead, root_games, search_game
from pcs_racing_agents.agents.setting import Setting
from pcs_racing_agents.agents.zoo import Entry
from pcs_racing_agents.base.fingerprint import fingerprint
from pcs_racing_agents.networks.network import RegretNetwork
from pcs_racing_agents.solvers import solve_matrix_games

Indices = NDArray[np.int64]
Floats = NDArray[np.float64]

LEAVES = {
    "rollout": "how the race ends if both cars keep their policies from there on",
    "now": "the lead at that moment",
    "network": "what a network of utilities (target static-q) says, halfway between the two players' views",
}
"""Values of the leaves of a search; a race that is over is valued by the rules."""

OPPONENTS = {
    "static": "keeps the policy that it seems to drive: the search is for a best response",
    "equilibrium": "has the same moves and looks as far ahead: the search is for an equilibrium",
}
"""Models of the opponent in a search."""

DECISIONS = {
    "argmax": "the most probable move",
    "sample": "drawn, by a hash of the observation and the agent's seed",
}
"""Choice of a move from an equilibrium strategy; a best response has a single one."""

NETWORK_TARGET = "static-q"
NOISES = 4  # default number of noise realisations
MAX_LEAVES = 100_000
LEAD_BONUS = 0.01  # per LEAD_SCALE of lead, at most 5 of them, if the utility is "win"
STATES = 20_000  # of games held in memory at a time, about 3 kB each


@dataclass(frozen=True, eq=False)
class RecedingHorizon:
    """A competitor that searches at every decision; a :class:`pcs_racing_agents.agents.Decider`."""

    name: str  #: Name in tables.
    setting: Setting  #: Archive and rules that it is made for.
    seed: int = 0  #: Seed of the noise in the search and of the draws of moves, from 0 to 2**63 - 1.
    depth: int = 1  #: Steps of the game to search, at least 1; near the end of the game there are fewer.
    leaf: str = "rollout"  #: One of :data:`LEAVES`.
    opponent: str = "static"  #: One of :data:`OPPONENTS`.
    decision: str = "argmax"  #: One of :data:`DECISIONS`.
    noises: int = 1  #: Number of realisations of the steering noise to average over.
    network: RegretNetwork | None = None  #: For the leaf "network".

    def __post_init__(self) -> None:
        agent = f"agent {self.name!r}"
        for key, minimum, below in (("seed", 0, 2**63), ("depth", 1, 2**31), ("noises", 1, 10_000)):
            check_whole(f"the {key} of {agent}", getattr(self, key), minimum, below - 1)
        for key, options in (("leaf", LEAVES), ("opponent", OPPONENTS), ("decision", DECISIONS)):
            check_choice(f"the {key} of {agent}", getattr(self, key), options)
        if (self.network is None) is (self.leaf == "network"):
            raise InputError(f"{agent} has leaf {self.leaf!r} and network {self.network!r}; it takes one for 'network'")
        if self.network is not None and self.network.target != NETWORK_TARGET:
            raise InputError(
                f"network {self.network.name!r} of {agent} has target {self.network.target!r}, which is no value of a "
                f"situation; it must be {NETWORK_TARGET!r}"
            )
        count = len(self.setting.moves)
        pairs = count if self.opponent == "static" else count * count
        leaves = self.noises * pairs ** min(self.depth, self.setting.config.moves)
        if leaves > MAX_LEAVES:
            raise InputError(
                f"{agent} would look at {leaves:.3g} ends for a decision, more than {MAX_LEAVES}; make its depth "
                f"{self.depth} or its noises {self.noises} smaller"
            )

    @property
    def content_hash(self) -> str:
        """SHA-256 of all that its moves depend on, without its name."""
        options = (self.seed, self.depth, self.leaf, self.opponent, self.decision, self.noises)
        network = self.network and (self.network.layers, self.network.mean, self.network.scale)
        return fingerprint("receding horizon", options, network, self.setting.archive.content_hash, self.setting.config)

    def decide(self, game: RaceGame, state: GameState, car: int) -> Indices:
        """Return the moves of one car in a batch of B games, shape (B,).

        A move depends on its own game alone. In games that are over the move means nothing.
        """
        games, observation = self.root_games(game, state, car)
        stay = bool(game.config.stay)
        if games.shape[2] == 1 or len(games) == 0:
            return _highest(games[:, :, 0], stay)
        probabilities = solve_matrix_games(games).rows
        return (
            draw(probabilities, observation, self.seed) if self.decision == "sample" else _highest(probabilities, stay)
        )

    def root_games(self, game: RaceGame, state: GameState, car: int) -> tuple[Floats, NDArray[np.float32]]:
        """Return the results of the search as matrix games of the next moves.

        They are the values of each pair of own move and opponent's move to the car, shape (B, A, C), with C = 1 against
        a static opponent and 0 in games that are over; and the car's observations, shape (B, D), float32.
        """
        self.setting.check_fits(game, self.name)
        outside = np.flatnonzero(state.policy[:, car] < 0)
        if len(outside):
            raise InputError(
                f"agent {self.name!r} is to move car {car} of game {outside[0]}, which is driven from outside the "
                "archive; it moves between policies of the archive"
            )
        search = search_game(game)
        own = np.arange(len(game.move_names))
        stay = np.array([len(search.move_names) - 1])
        moves = (own, own if self.opponent == "equilibrium" else stay)
        games = np.zeros((state.games, len(own), len(moves[1])))
        observation = game.observation(state)[:, car]
        remaining = np.where(game.done(state), 0, game.config.moves - state.step)
        # Games of a batch may have made different numbers of moves; those of equal depth are searched together.
        for moves_left in np.unique(remaining[remaining > 0]):
            depth = min(self.depth, int(moves_left))
            batch = max(1, STATES // (self.noises * (len(own) * len(moves[1])) ** depth))
            rows = np.flatnonzero(remaining == moves_left)
            for first in range(0, len(rows), batch):
                chunk = rows[first : first + batch]
                guess = self._guess(game, search, take_games(state, chunk), car, observation[chunk])
                leaf = "rollout" if depth == moves_left else self.leaf  # nothing but the end is left to be valued
                payoffs = look_ahead(search, guess, car, moves, depth, leaf, self._value)
                # Averaged before the games are solved: a player who knew the noise realisation would know the future.
                payoffs = payoffs.reshape(len(chunk), self.noises, *payoffs.shape[1:]).mean(axis=1)
                games[chunk] = root_games(payoffs, (len(own), len(moves[1])), depth)
        return games, observation

    def _guess(
        self, game: RaceGame, search: RaceGame, state: GameState, car: int, observation: NDArray[np.float32]
    ) -> GameState:
        """Return each game with each noise realisation: the same for all moves, and a function of the observation."""
        rows = np.repeat(np.arange(state.games), self.noises)
        realisation = np.tile(np.arange(self.noises, dtype=np.float32), state.games)
        seeds = hash_rows(np.column_stack([observation[rows], realisation]), self.seed)
        return guess_games(game, search, take_games(state, rows), car, seeds)

    def _value(self, search: RaceGame, state: GameState, car: int) -> Floats:
        """Return the values of the ends of a search to a car, shape (N,)."""
        done = search.done(state)
        values = reward(search.config, state.race, state.step)
        lead = state.race.lead / LEAD_SCALE
        if search.config.utility == "win":
            # The opponent is a guess: of two won races, the one with the larger lead is the more certain win.
            values = values + np.where(state.race.crashed, 0.0, LEAD_BONUS * np.clip(lead, -5.0, 5.0))
        if not done.all():
            if self.network is not None:
                best = self.network.unclipped(search.observation(state)).max(axis=2).astype(np.float64)
                # Both values are too high: the network assumes an opponent that does not observe the race.
                estimate = 0.5 * (best[:, 0] - best[:, 1])
            elif search.config.utility == "win":
                estimate = np.clip(lead, -1.0, 1.0)
            else:
                estimate = state.race.lead
            values = np.where(done, values, estimate)
        return values if car == 0 else -values


def _highest(values: Floats, stay: bool) -> Indices:
    """Return the column of the highest value of each row; of equal ones "stay" (the last) if it is a move, else the
    first.
    """
    highest = values.max(axis=1, keepdims=True)
    close = values >= highest - 1e-9 * np.maximum(np.abs(highest), 1.0)
    return np.where(close[:, -1] & stay, values.shape[1] - 1, close.argmax(axis=1))


def receding_horizon(
    setting: Setting,
    *,
    name: str = "receding-horizon",
    seed: int = 0,
    depth: int = 1,
    leaf: str = "rollout",
    opponent: str = "static",
    decision: str = "argmax",
    noises: int | None = None,
    network: NetworkSource = None,
) -> RecedingHorizon:
    """Simulate a few steps ahead at every decision.

    Parameters
    ----------
    depth : int
        Steps of the game to look ahead.
    leaf : str
        How the leaves of the search are valued: ``rollout`` (both cars keep their policies to the end of the race),
        ``now`` (the lead at that moment), or ``network``.
    opponent : str
        The model of the opponent: ``static`` (it keeps its estimated policy), or ``equilibrium`` (it searches as well).
    decision : str
        Which move of an equilibrium strategy to make: ``argmax`` or ``sample``.
    noises : int, optional
        Noise realisations to average over; by default 4, or 1 if the rules have no noise.
    network : RegretNetwork, str or path, optional
        For the leaf ``network``, of target ``static-q``: the name of a shipped one or its folder; by default the one
        that is shipped for the game.
    """
    loaded = None
    if leaf == "network":
        loaded = fitting_network(network, setting, NETWORK_TARGET, name)
    elif network is not None:
        raise InputError(f"agent {name!r} got a network, but its leaf is {leaf!r}; only leaf 'network' asks one")
    if noises is None:
        noises = NOISES if setting.config.race.steering_noise > 0.0 else 1
    return RecedingHorizon(name, setting, seed, depth, leaf, opponent, decision, noises, loaded)


RECEDING_HORIZON = Entry(
    receding_horizon,
    "simulates some steps ahead at every decision, and solves the small game of their outcomes",
    "receding horizon control, for the paper's first limitation: trees too deep for many decisions",
)
