"""Looking ahead: where all moves of the next few steps lead from where a game stands, driven in one batch per step.

What is looked into is a *guess* of the game (:func:`guess_games`): what can be seen from one of the cars, with what
can't be seen replaced: a decision by it uses neither the opponent's parameters nor its plans nor the noise to come.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pcs_racing.game.rules import RaceGame
from pcs_racing.game.state import GameState, take_games
from pcs_racing.race.races import advance
from pcs_racing_agents.solvers import solve_matrix_games

__all__ = ["guess_games", "look_ahead", "merge_histories", "root_games", "search_game"]

Indices = NDArray[np.int64]
Floats = NDArray[np.float64]


def search_game(game: RaceGame) -> RaceGame:
    """Return the game in which an agent looks ahead: both cars drive policies of the archive, and may keep theirs."""
    family = game.archive.family()
    if game.config.stay and all(planner is family for planner in game.setup.planners):
        return game
    return replace(game, config=replace(game.config, stay=True), ego_planner=None, opponent_planner=None)


def guess_games(game: RaceGame, search: RaceGame, state: GameState, car: int, seeds: NDArray[np.uint64]) -> GameState:
    """Return games as one of the players may think that they stand.

    Both cars are where they are, and as fast. The opponent drives the policy of the archive that is nearest to what was
    measured of it in the last step, and has just begun to do so: what its planner remembers, its path and its command
    are forgotten. So is the present steering disturbance of both cars.

    Parameters
    ----------
    game : RaceGame
        What is played.
    search : RaceGame
        Where it is looked ahead (:func:`search_game`).
    state : GameState
        B games that go on. Left as it is.
    car : int
        Who looks ahead.
    seeds : ndarray, shape (B,), uint64
        Keys of the noise that is imagined.
    """
    other = 1 - car
    own_memory = game.setup.planners[car].memory_total
    memory = np.zeros((state.games, 2, search.setup.memory_size))
    memory[:, car, :own_memory] = state.race.memory[:, car, :own_memory]
    guess = state.copy()
    race = guess.race._replace(seed=np.array(seeds, np.uint64), memory=memory)
    race.disturbance[:] = 0.0
    for array in (race.path, race.command):
        array[:, other] = 0.0
    nearest = search.archive.nearest(state.estimates[:, other])
    guess.own[:, other] = search.points[nearest]
    guess.policy[:, other] = nearest[np.arange(state.games), state.step]
    return guess._replace(race=race, theta=search.theta(guess.policy))


def merge_histories(table: Indices, policy: Indices, depth: int) -> list[Indices]:
    """Find the histories of moves that pass through the same policies.

    Parameters
    ----------
    table : ndarray, shape (K, A)
        Where every move leads from every policy.
    policy : ndarray, shape (B,)
        Policies to start with.
    depth : int

    Returns
    -------
    list of ndarray, shape (B, A**k)
        For ``k`` from 0 to ``depth`` moves: the first history of them that is one race with each history. Histories
        stand in row-major order, first move first.
    """
    options = table.shape[1]
    first = (table[:, :, None] == table[:, None, :]).argmax(axis=2)  # of the moves that lead to the same policy
    here = policy[:, None]
    same = [np.zeros((len(policy), 1), np.int64)]
    for _ in range(depth):
        same.append((same[-1][:, :, None] * options + first[here]).reshape(len(policy), -1))
        here = table[here].reshape(len(policy), -1)
    return same


def look_ahead(
    search: RaceGame,
    guess: GameState,
    car: int,
    moves: tuple[Indices, Indices],
    depth: int,
    leaf: str,
    value: Callable[[RaceGame, GameState, int], Floats],
) -> Floats:
    """Drive all that may happen in the next steps, and value where it leads.

    Histories of moves that pass through the same policies are driven once. A crash ends its branch.

    Parameters
    ----------
    search : RaceGame
    guess : GameState
        B games that go on, all after the same number of moves and with as many left as ``depth`` at least.
    car : int
        Who looks ahead.
    moves : tuple of two ndarray, shapes (A,) and (C,)
        Indices of the moves that it thinks of, and of those that it expects of the opponent.
    depth : int
    leaf : {"rollout", "now", "network"}
        Where a branch ends: at the end of the race, both cars keeping the policies of the last move; or after the last
        move, where "network" also needs to know what was seen until then.
    value : callable
        ``value(search, states, car) -> (N,)``: what the ends are worth to the car.

    Returns
    -------
    ndarray, shape (B, A**depth, C**depth)
        Histories of the own moves and of the opponent's, in row-major order, first move first.
    """
    options = tuple(len(m) for m in moves)
    tables = tuple(search.table[:, m] for m in moves)
    same = tuple(merge_histories(tables[i], guess.policy[:, (car, 1 - car)[i]], depth) for i in range(2))
    state, where = guess, np.arange(guess.games).reshape(-1, 1, 1)
    for k in range(1, depth + 1):
        alone = [same[i][k] == np.arange(options[i] ** k) for i in range(2)]
        game, mine, theirs = np.nonzero(alone[0][:, :, None] & alone[1][:, None, :])
        parents = take_games(state, where[game, mine // options[0], theirs // options[1]])
        actions = np.empty((len(game), 2), np.int64)
        actions[:, car] = moves[0][mine % options[0]]
        actions[:, 1 - car] = moves[1][theirs % options[1]]
        if k < depth or leaf == "network":
            state = search.step(parents, actions)
        else:
            state = _drive_on(search, parents, actions, to_the_end=leaf == "rollout")
        where = np.zeros((guess.games, options[0] ** k, options[1] ** k), np.int64)
        where[game, mine, theirs] = np.arange(len(game))
    worth = value(search, state, car)
    game = np.arange(guess.games)[:, None, None]
    return worth[where[game, same[0][depth][:, :, None], same[1][depth][:, None, :]]]


def _drive_on(search: RaceGame, state: GameState, actions: Indices, *, to_the_end: bool) -> GameState:
    """Move in place and drive on, measuring nothing: of what was to be seen only the race is right afterwards."""
    going = ~search.done(state)
    policy = search.table[state.policy, actions]
    left = search.config.moves - state.step
    ticks = search.config.step_ticks * (int(left.max(initial=0)) if to_the_end else 1)
    # Races that are over stand still, whatever drives them.
    advance(search.setup, state.race, search.theta(policy), ticks, threads=search.threads, ittc=False)
    if to_the_end:
        driven = -(-state.race.tick // search.config.step_ticks) - 1  # the step in which a race ended counts
        state.step[going] = driven[going]
    else:
        state.step[going] += 1
    return state


def root_games(payoffs: Floats, options: tuple[int, int], depth: int) -> Floats:
    """Solve all but the first moves by backward induction over zero-sum matrix games.

    Parameters
    ----------
    payoffs : ndarray, shape (B, A**depth, C**depth)
        As :func:`look_ahead` returns them.
    options : (int, int)
        Numbers of moves A and C.
    depth : int

    Returns
    -------
    ndarray, shape (B, A, C)
        What the first moves are worth, both playing on by an equilibrium; against an opponent with a single move (C =
        1) that is the best reply.
    """
    own, other = options
    values = payoffs
    for k in range(depth - 1, 0, -1):
        games = values.reshape(-1, own**k, own, other**k, other).transpose(0, 1, 3, 2, 4)
        flat = games.reshape(-1, own, other)
        solved = flat.max(axis=1)[:, 0] if other == 1 else solve_matrix_games(flat).values
        values = solved.reshape(-1, own**k, other**k)
    return values.reshape(-1, own, other)
