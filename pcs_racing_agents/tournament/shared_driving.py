"""Games of several egos from the same starts against one opponent, driven once for as long as they are the same.

A step of a race follows from the state before it and from the policies that drive it. All egos begin with the same
policies, so the first step of a game is the same for all of them; later ones are the same for those whose policies
were the same so far. Their games are the branches of a tree, and each of its steps is driven once. The results are
those of games that are driven one by one, to the bit.
"""

import copy
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcs_racing.game.competitor import ask_moves
from pcs_racing.game.rules import RaceGame
from pcs_racing.game.state import GameState, take_games
from pcs_racing.race.start_grid import Starts
from pcs_racing_agents.agents.agent import Competitor, Driver

Indices = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class SharedGames:
    """B games of each of K egos, of m moves."""

    state: GameState  #: The ends of all different games.
    branch: Indices  #: shape (K, B): Where in ``state`` each ego's games are.
    #: shape (K, B, 2, m + 1): Policy of the archive that was driven in each step; -1 for a driver and for steps after a
    #: crash.
    policy: Indices
    moves: Indices  #: shape (K, B, 2, m): Moves made; -1 for a driver and after a crash.


def drive_shared(
    arena: RaceGame,
    egos: Sequence[Competitor],
    opponent: Competitor,
    variants: Indices,
    starts: Starts,
    keys: NDArray[Any],
) -> SharedGames:
    """Play the same B games with each of several egos.

    Parameters
    ----------
    arena : RaceGame
        With the planners of both cars and the move "stay".
    egos : sequence of K competitors
        Several of them only if none is a driver.
    variants : ndarray of int, shape (B, 2)
        What each car starts with: a policy of the archive; for a driver which of its policies.
    starts : Starts
        B of them.
    keys : ndarray of int, shape (B,)
        Of the games' noise.
    """
    games, steps = len(variants), arena.config.moves
    drivers = [
        [car.policies[i] for i in variants[:, place]] if isinstance(car, Driver) else None
        for place, car in enumerate((egos[0], opponent))
    ]
    first = np.where([driver is None for driver in drivers], variants, -1)
    state = arena.reset(keys, policies=first, starts=starts, egos=drivers[0], opponents=drivers[1])
    branch = np.tile(np.arange(games), (len(egos), 1))
    policy = np.full((len(egos), games, 2, steps + 1), -1, np.int64)
    moves = np.full((len(egos), games, 2, steps), -1, np.int64)
    policy[..., 0] = first
    memories: list[list[Any]] = [[None] * games for _ in egos]
    opponent_memories: list[Any] = [None] * games
    for step in range(steps):
        over = arena.done(state)
        if over.all():
            break
        running = ~over[branch]
        seen = arena.observation(state)
        own = np.zeros(branch.shape, np.int64)
        for k, ego in enumerate(egos):
            if not isinstance(ego, Driver):
                own[k], memories[k] = _ask_ego(ego, arena, state, branch[k], seen, memories[k])
                moves[k, running[k], 0, step] = own[k, running[k]]
        replies = np.zeros(state.games, np.int64)
        if drivers[1] is None:
            replies = ask_moves(opponent, arena, state, 1, observation=seen[:, 1], memories=opponent_memories)
            moves[running, 1, step] = replies[branch][running]
        # Two egos with different moves that lead to the same policy go on together.
        policies = np.where(running, arena.next_policy(state.policy[branch, 0], own), 0)
        _, chosen, after = np.unique(branch * len(arena.archive) + policies, return_index=True, return_inverse=True)
        parents = branch.reshape(-1)[chosen]
        both = np.stack([own.reshape(-1)[chosen], replies[parents]], axis=1)
        opponent_memories = _branched(opponent_memories, parents)
        state = arena.apply(take_games(state, parents), both)
        branch = after.reshape(branch.shape)
        policy[running, :, step + 1] = state.policy[branch][running]
    return SharedGames(state, branch, policy, moves)


def _ask_ego(
    ego: Competitor, arena: RaceGame, state: GameState, rows: Indices, seen: NDArray[np.float32], memories: list[Any]
) -> tuple[Indices, list[Any]]:
    """Moves of an ego in its games, which are some rows of a state, and what it remembers of each of them after it."""
    remembered: list[Any] = [None] * state.games
    for row, memory in zip(rows, memories, strict=True):
        remembered[row] = memory
    moves = ask_moves(ego, arena, state, 0, rows=rows, observation=seen[:, 0], memories=remembered)
    return moves[rows], [remembered[row] for row in rows]


def _branched(memories: list[Any], parents: Indices) -> list[Any]:
    """What is remembered in each branch; branches that part do not share what may be changed in place."""
    if all(memory is None for memory in memories):
        return [None] * len(parents)
    parted = np.bincount(parents) > 1
    return [copy.deepcopy(memories[parent]) if parted[parent] else memories[parent] for parent in parents]
