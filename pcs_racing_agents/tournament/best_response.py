"""The exact best response to an agent, without a game tree: the agent plays against every sequence of moves.

Against a deterministic agent each sequence of moves of the opponent gives a single race, so a few hundred simulated
steps are enough. It evaluates agents that make the move "stay", which game trees leave out.
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
from pcs_racing_agents.tournament.games import game_between

__all__ = ["ResponseUtility", "best_response_utility"]

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]


class ResponseUtility(NamedTuple):
    """Utility of an agent against a best response, and against random moves; means over the seeds.

    Attributes
    ----------
    best : float
        Utility of the agent against a best response.
    random : float
        Utility against an opponent that draws all moves uniformly.
    """

    best: float
    random: float


def best_response_utility(
    game: RaceGame, agent: Competitor, *, policies: ArrayLike, start: Starts, seeds: ArrayLike, car: int = 0
) -> ResponseUtility:
    """Return the utility of an agent against a best response, from races against every sequence of moves.

    The opponent observes the moves that both have made. It knows the agent, but not the seed of the noise. The agent
    has its ordinary observations.

    Parameters
    ----------
    game : RaceGame
        The opponent has its moves; the agent also has "stay".
    agent : Competitor
        An agent or model that makes moves. It draws the same move for the same observation, so a mixed strategy is
        evaluated as if the opponent knew its draws.
    policies : array_like of int, shape (2,)
        Start policies of both cars.
    start : Starts
        Of one game.
    seeds : array_like of int, shape (S,)
        Keys of the noise.
    car : int
        The agent's, 0 or 1.

    Raises
    ------
    InputError
        If the agent is a driver, which makes no moves, or does not fit the game.
    """
    if isinstance(agent, Driver):
        raise InputError(f"{agent.name!r} is a driver and makes no moves; only agents can be judged by responses")
    if car not in (0, 1):
        raise InputError(f"car is {car!r}; it must be 0 or 1")
    options = game.table.shape[1]
    arena = game_between(game, agent, agent)
    keys = np.atleast_1d(np.asarray(seeds, np.uint64))
    state = arena.reset(keys, policies=np.asarray(policies), starts=start.take(np.zeros(len(keys), np.int64)))
    information = np.zeros(len(keys), np.int64)  # the opponent's information set: one for each history of both's moves
    levels: list[tuple[Indices, Indices]] = []  # of each game: the information set before its last move, and that move
    parents: list[Indices] = []
    for _ in range(arena.config.moves):
        own = ask_moves(agent, arena, state, car)
        games = np.repeat(np.arange(state.games), options)
        responses = np.tile(np.arange(options), state.games)
        actions = np.zeros((len(games), 2), np.int64)
        actions[:, car], actions[:, 1 - car] = own[games], responses
        levels.append((information[games], responses))
        parents.append(games)
        state = arena.step(take_games(state, games), actions)
        history = (information[games] * len(arena.move_names) + actions[:, car]) * options + responses
        information = np.unique(history, return_inverse=True)[1].astype(np.int64)
    utility = arena.reward(state)[:, car].astype(np.float64)
    return ResponseUtility(best=_least_utility(utility, levels, parents), random=float(utility.mean()))


def _least_utility(utility: Floats, levels: list[tuple[Indices, Indices]], parents: list[Indices]) -> float:
    """Return the mean utility if the opponent minimises it in each information set, by backward induction."""
    for (information, response), parent in zip(reversed(levels), reversed(parents), strict=True):
        options = int(response.max()) + 1
        sums = np.zeros((int(information.max()) + 1, options))
        np.add.at(sums, (information, response), utility)
        best = sums.argmin(axis=1)[information] == response
        parent_utility = np.zeros(int(parent.max()) + 1)
        parent_utility[parent[best]] = utility[best]
        utility = parent_utility
    return float(utility.mean())
