"""Policy paths: the different sequences of policies that a player's moves lead through.

Moves of an archive often lead to the same policy, and a race knows only policies, not the names of the moves. So two
histories of moves that pass through the same policies are one race, and only one of them has to be driven.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.errors import InputError

Indices = NDArray[np.int64]

MAX_LEAVES = 10_000_000


class PolicyPaths(NamedTuple):
    """The different policy paths of one player, level by level; ``U_k`` of them after ``k`` moves."""

    policy: tuple[Indices, ...]  #: shape (U_k,): Policy at the end of each path.
    parent: tuple[Indices, ...]  #: shape (U_k,): Path of the level above that it continues.
    #: shape (A**k,): Path that each history of the player's own moves goes along; histories in row-major order, first
    #: move first.
    history: tuple[Indices, ...]

    def count(self, level: int) -> int:
        """Return the number of different paths after so many moves."""
        return len(self.policy[level])


def policy_paths(table: Indices, start: int, moves: int) -> PolicyPaths:
    """Follow all moves from a policy, so many in turn; ``table`` (K, A) says where each leads from every policy."""
    policy, parent = [np.array([start], np.int64)], [np.zeros(1, np.int64)]
    history = [np.zeros(1, np.int64)]
    policies, options = table.shape
    for _ in range(moves):
        # A path is known by the number of the one that it continues and by the policy that the move leads to.
        reached = np.arange(len(policy[-1]))[:, None] * policies + table[policy[-1]]
        different, which = np.unique(reached, return_inverse=True)
        parent.append(different // policies)
        policy.append(different % policies)
        history.append(which.reshape(-1, options)[history[-1]].reshape(-1))
    return PolicyPaths(tuple(policy), tuple(parent), tuple(history))


def own_histories(level: int, options: int) -> tuple[Indices, Indices]:
    """Return each player's own history within every joint history of a level, shapes (A**(2 level),).

    Joint histories stand in row-major order of (move of car 0, move of car 1), first step first; own histories in
    row-major order of the own moves.
    """
    first = second = np.zeros(1, np.int64)
    moves = np.arange(options)
    for _ in range(level):
        first = (first[:, None] * options + np.repeat(moves, options)).reshape(-1)
        second = (second[:, None] * options + np.tile(moves, options)).reshape(-1)
    return first, second


def check_size(options: int, moves: int) -> None:
    """Check that a tree is not too large."""
    leaves = options ** (2 * moves)
    if leaves > MAX_LEAVES:
        raise InputError(
            f"a tree of {moves} moves with {options} choices for each player has {leaves:.3g} leaves; at most "
            f"{MAX_LEAVES:,} are possible: play fewer moves, or fewer step sizes"
        )
