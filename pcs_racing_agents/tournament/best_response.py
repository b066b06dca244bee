"""The best response to an agent without a game tree: it is played against every sequence of moves.

A deterministic agent leaves a single race for each sequence of moves of its opponent, so the best response is
found exactly from a few hundred pieces of driving. This is how agents are judged that make the move "stay", which game
trees leave out.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.errors import InputError
from pcs_racing.game.competitor import ask_moves
from pcs_racing.game.rules import RaceGame
from pcs_racing.game.state import take_games
from pcs_racing.race.start_grid import Starts
from pcs_racing_agents.agents.agent import Competitor, Driver
from pcs_racing_agents.tournament.matches import game_between

__all__ = ["ResponseUtility", "best_response_utility"]

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]


class ResponseUtility(NamedTuple):
    """Utility of an agent against the opponent that responds best, and against random moves.

    Attributes
    ----------
    best : float
        Utility of the agent if the opponent knows it and responds best, mean over the seeds.
    random : float
        What it gets if the opponent draws every move, all with the same chance.
    """

    best: float
    random: float


def best_response_utility(
    game: RaceGame, agent: Competitor, *, policies: ArrayLike, start: Starts, seeds: ArrayLike, car: int = 0
) -> ResponseUtility:
    """Play an agent against every sequence of moves of its opponent.

    The opponent responds best to what it sees: the moves that both have made. It knows the agent, but not the seed of
    the noise; the agent sees what it always sees.

    Parameters
    ----------
    game : RaceGame
        The opponent has its moves; the agent may stay as well.
    agent : Competitor
        An agent or model that makes moves; what it draws, it draws in the same way whenever it sees the same, so a
        mixed strategy is judged as if the opponent knew its draws.
    policies : array_like of int, shape (2,)
        That both cars start with.
    start : Starts
        Of one game.
    seeds : array_like of int, shape (S,)
        Keys of the noise.
    car : int
        The agent's, 0 or 1.

    Raises
    ------
    InputError
        If it is a driver, which makes no moves, or something does not fit the game.
    """
    if isinstance(agent, Driver):
        raise InputError(f"{agent.name!r} is a driver and makes no moves; only agents can be judged by responses")
    if car not in (0, 1):
        raise InputError(f"car is {car!r}; it must be 0 or 1")
    options = game.table.shape[1]
    arena = game_between(game, agent, agent)
    keys = np.atleast_1d(np.asarray(seeds, np.uint64))
    state = arena.reset(keys, policies=np.asarray(policies), starts=start.take(np.zeros(len(keys), np.int64)))
    seen = np.zeros(len(keys), np.int64)  # what the opponent has seen: a number for each history of both cars' moves
    levels: list[tuple[Indices, Indices]] = []  # of each game: what was seen before its last move, and that move
    parents: list[Indices] = []
    for _ in range(arena.config.moves):
        own = ask_moves(agent, arena, state, car)
        games = np.repeat(np.arange(state.games), options)
        responses = np.tile(np.arange(options), state.games)
        actions = np.zeros((len(games), 2), np.int64)
        actions[:, car], actions[:, 1 - car] = own[games], responses
        levels.append((seen[games], responses))
        parents.append(games)
        state = arena.step(take_games(state, games), actions)
        history = (seen[games] * len(arena.move_names) + actions[:, car]) * options + responses
        seen = np.unique(history, return_inverse=True)[1].astype(np.int64)
    worth = arena.reward(state)[:, car].astype(np.float64)
    return ResponseUtility(best=_smallest(worth, levels, parents), random=float(worth.mean()))


def _smallest(worth: Floats, levels: list[tuple[Indices, Indices]], parents: list[Indices]) -> float:
    """Return what an opponent leaves that makes it small, knowing what it has seen, mean over the seeds."""
    for (seen, response), parent in zip(reversed(levels), reversed(parents), strict=True):
        options = int(response.max()) + 1
        sums = np.zeros((int(seen.max()) + 1, options))
        np.add.at(sums, (seen, response), worth)
        chosen = sums.argmin(axis=1)[seen] == response
        above = np.zeros(int(parent.max()) + 1)
        above[parent[chosen]] = worth[chosen]
        worth = above
    return float(worth.mean())
