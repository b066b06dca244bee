"""A search by simulation: all sequences of moves of the next few steps, one batch of games for each step.

The search simulates a *guess* of the game (:func:`guess_games`), built from what one of the cars can observe: it uses
neither the opponent's parameters nor its plans nor the noise to come.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pcs_racing.game.rules import RaceGame
from pcs_racing.game.state import GameState, take_games
from pcs_racing.race.races import advance
from pcs_racing_agents.solvers import solve_matrix_games

Indices = NDArray[np.int64]
Floats = NDArray[np.float64]


def search_game(game: RaceGame) -> RaceGame:
    """Return the game of a search: both cars drive policies of the archive and have the move "stay"."""
    family = game.archive.family()
    if game.config.stay and all(planner is family for planner in game.setup.planners):
        return game
    return replace(game, config=replace(game.config, stay=True), ego_planner=None, opponent_planner=None)


def guess_games(game: RaceGame, search: RaceGame, state: GameState, car: int, seeds: NDArray[np.uint64]) -> GameState:
    """Return the states of games that are not over as the player of a car can guess them, to be searched.

    Parameters
    ----------
    seeds : ndarray, shape (B,), uint64
        Keys of the noise in the search.
    """
    # Positions and speeds can be seen; the planners' memories, plans and commands, and the noise, can not.
    other = 1 - car
    own_memory = game.setup.planners[car].memory_total
    memory = np.zeros((state.games, 2, search.setup.memory_size))
    memory[:, car, :own_memory] = state.race.memory[:, car, :own_memory]
    guess = state.copy()  # the game that is played must not notice
    race = guess.race._replace(seed=np.array(seeds, np.uint64), memory=memory)
    race.disturbance[:] = 0.0
    for array in (race.path, race.command):
        array[:, other] = 0.0
    # The opponent's policy is hidden, too: it is taken for the one nearest to what was measured in the last step.
    nearest = search.archive.nearest(state.estimates[:, other])
    guess.own[:, other] = search.points[nearest]
    guess.policy[:, other] = nearest[np.arange(state.games), state.step]
    return guess._replace(race=race, theta=search.theta(guess.policy))


def merge_histories(table: Indices, policy: Indices, depth: int) -> list[Indices]:
    """Map every history of moves to the first one that passes through the same policies.

    ``table`` (K, A) holds the policy after every move from every policy, ``policy`` (B,) where they start. Of the
    result, array ``k`` (B, A**k) is for histories of ``k`` moves in row-major order, first move first.
    """
    options = table.shape[1]
    first = (table[:, :, None] == table[:, None, :]).argmax(axis=2)  # of the moves that lead to the same policy
    policies = policy[:, None]
    same = [np.zeros((len(policy), 1), np.int64)]
    for _ in range(depth):
        same.append((same[-1][:, :, None] * options + first[policies]).reshape(len(policy), -1))
        policies = table[policies].reshape(len(policy), -1)
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
    """Simulate all histories of moves of the next steps; return the values of their ends (B, A**depth, C**depth).

    Parameters
    ----------
    guess : GameState
        B games that are not over, all after the same number of moves and with at least ``depth`` moves left.
    moves : tuple of two ndarray, shapes (A,) and (C,)
        Indices of the moves of the car that searches, and of those of the opponent.
    leaf : {"rollout", "now", "network"}
        Where a branch ends: at the end of the race, both cars keeping the policies of the last move; or after the last
        move, with observations for "network". Histories are in row-major order, first move first.
    """
    options = tuple(len(m) for m in moves)
    tables = tuple(search.table[:, m] for m in moves)
    representative = tuple(merge_histories(tables[i], guess.policy[:, (car, 1 - car)[i]], depth) for i in range(2))
    # row[g, i, j]: the row of `state` that holds game g after the i-th own and the j-th opponent's history. Only
    # histories of different policies are simulated, as in game trees; the others have the row of their first equal.
    state, row = guess, np.arange(guess.games).reshape(-1, 1, 1)
    for k in range(1, depth + 1):
        distinct = [representative[i][k] == np.arange(options[i] ** k) for i in range(2)]
        game, own, other = np.nonzero(distinct[0][:, :, None] & distinct[1][:, None, :])
        parents = take_games(state, row[game, own // options[0], other // options[1]])
        actions = np.empty((len(game), 2), np.int64)
        actions[:, car] = moves[0][own % options[0]]
        actions[:, 1 - car] = moves[1][other % options[1]]
        if k < depth or leaf == "network":
            state = search.step(parents, actions)  # measures characteristics, which observations need
        else:
            state = _drive_on(search, parents, actions, to_the_end=leaf == "rollout")
        row = np.zeros((guess.games, options[0] ** k, options[1] ** k), np.int64)
        row[game, own, other] = np.arange(len(game))
    end_values = value(search, state, car)
    game = np.arange(guess.games)[:, None, None]
    return end_values[row[game, representative[0][depth][:, :, None], representative[1][depth][:, None, :]]]


def _drive_on(search: RaceGame, state: GameState, actions: Indices, *, to_the_end: bool) -> GameState:
    """Move and simulate in place without measurements: afterwards only the race of the state is valid."""
    running = ~search.done(state)
    policy = search.table[state.policy, actions]
    # A race that is over does not change any more.
    if to_the_end:
        ends = search.config.end_ticks
        advance(search.setup, state.race, search.theta(policy), int(ends[-1]), threads=search.threads, ittc=False)
        driven = np.searchsorted(ends, state.race.tick)  # the step in which a race ended counts
        state.step[running] = driven[running]
    else:
        search.drive_step(state.race, search.theta(policy), ittc=False)
        state.step[running] += 1
    return state


def root_games(payoffs: Floats, options: tuple[int, int], depth: int) -> Floats:
    """Solve all but the first moves by backward induction over zero-sum matrix games.

    Returns
    -------
    ndarray, shape (B, A, C)
        Values of the first moves if both then play an equilibrium, of what :func:`look_ahead` returned for A and C
        moves; against an opponent with a single move (C = 1) the value of a best response.
    """
    own, other = options
    values = payoffs
    for k in range(depth - 1, 0, -1):
        # Each pair of histories of k moves leads to a matrix game of the moves that follow.
        games = values.reshape(-1, own**k, own, other**k, other).transpose(0, 1, 3, 2, 4)
        flat = games.reshape(-1, own, other)
        solved = flat.max(axis=1)[:, 0] if other == 1 else solve_matrix_games(flat).values
        values = solved.reshape(-1, own**k, other**k)
    return values.reshape(-1, own, other)
