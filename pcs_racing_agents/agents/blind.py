"""Agents that never look at the opponent: the same chances for ever, a plan made beforehand, a walk to one policy.

They are what an adaptive agent must be compared with (:mod:`pcs_racing_agents.tournament.fitting` finds the best plan
and the best walk). Each is a value with a function from observations (B, D) to chances of the moves (B, M).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.errors import InputError
from pcs_racing.game.archive import PolicyArchive
from pcs_racing_agents.agents.observing import Observations, moves_made, own
from pcs_racing_agents.agents.setting import Setting

__all__ = ["Blend", "Schedule", "Walk", "path_moves", "walk_to"]

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Blend:
    """The same chances in every situation.

    Attributes
    ----------
    chances : ndarray, shape (M,)
    """

    chances: Floats

    def __call__(self, observation: Observations) -> Floats:
        """Chances of the moves, shape (B, M)."""
        return np.tile(self.chances, (len(observation), 1))


@dataclass(frozen=True, eq=False)
class Schedule:
    """A sequence of moves that was chosen before the race.

    Attributes
    ----------
    sequence : ndarray, shape (m,)
        The move of each step.
    count : int
        Number of moves M that there are.
    axes : int
        Number of axes of the game.
    """

    sequence: NDArray[np.int64]
    count: int
    axes: int

    def __call__(self, observation: Observations) -> Floats:
        """Chances of the moves, shape (B, M)."""
        step = np.minimum(moves_made(observation, self.axes), len(self.sequence) - 1)
        return np.eye(self.count)[self.sequence[step]]


@dataclass(frozen=True, eq=False)
class Walk:
    """From any policy the same way, step by step: the next move depends on the own policy alone.

    Attributes
    ----------
    next_move : ndarray, shape (K,)
        The move to make with each policy.
    archive : PolicyArchive
    count : int
        Number of moves M that there are.
    """

    next_move: NDArray[np.int64]
    archive: PolicyArchive
    count: int

    def __call__(self, observation: Observations) -> Floats:
        """Chances of the moves, shape (B, M)."""
        policy = self.archive.nearest(own(observation, len(self.archive.characteristics)))
        return np.eye(self.count)[self.next_move[policy]]


def walk_to(setting: Setting, target: int) -> Walk:
    """Return the walk to a policy: a shortest path of moves there, then moves that keep it.

    Where no path leads there, it goes to the policy nearest to the target that can be reached. Of several shortest
    paths it takes the one whose moves come first in the list.

    Raises
    ------
    InputError
        If the archive has no such policy.
    """
    policies = len(setting.archive)
    if isinstance(target, bool) or not isinstance(target, int | np.integer) or not 0 <= target < policies:
        raise InputError(
            f"target is {target!r}; it must be the index of a policy in archive {setting.archive.name!r}, 0 to "
            f"{policies - 1}"
        )
    moves = path_moves(setting.table, setting.archive.normalised, int(target))
    return Walk(moves, setting.archive, len(setting.moves))


def path_moves(table: ArrayLike, points: ArrayLike, target: int) -> NDArray[np.int64]:
    """First move of a shortest path from each policy to a target, shape (K,).

    Parameters
    ----------
    table : array_like, shape (K, M)
        Where every move leads from every policy.
    points : array_like, shape (K, G)
        Where the policies lie.
    target : int

    Returns
    -------
    ndarray, shape (K,)
        At the end of its path, a policy gets the move whose outcome lies nearest: one that keeps it, if there is one.
    """
    leads_to = np.asarray(table, np.int64)
    where = np.asarray(points, np.float64)
    policies = len(leads_to)
    steps = _distances(leads_to)
    away = np.linalg.norm(where - where[target], axis=1)
    first = np.empty(policies, np.int64)
    for k in range(policies):
        reached = np.flatnonzero(steps[k] < policies)
        goal = target if steps[k, target] < policies else reached[np.argmin(away[reached])]
        if goal == k:
            first[k] = np.argmin(np.linalg.norm(where[leads_to[k]] - where[k], axis=1))
            # The move "stay" comes last and is told from a move that fails only by its meaning: prefer it.
            if leads_to[k, -1] == k:
                first[k] = leads_to.shape[1] - 1
        else:
            first[k] = np.argmax(steps[leads_to[k], goal] == steps[k, goal] - 1)
    return first


def _distances(leads_to: NDArray[np.int64]) -> NDArray[np.int64]:
    """Fewest moves from each policy to each other one, shape (K, K); K where there is no way."""
    policies = len(leads_to)
    steps = np.full((policies, policies), policies, np.int64)
    np.fill_diagonal(steps, 0)
    for _ in range(policies):
        shorter = np.minimum(steps, 1 + steps[leads_to].min(axis=1))
        if (shorter == steps).all():
            break
        steps = shorter
    return steps
