"""What a learner drives in: groups of races side by side, each with a circuit, rules and opponents of its own."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any, NamedTuple, Protocol

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

__all__ = ["Part", "PartStep", "part_seeds", "split_envs"]


class PartStep(NamedTuple):
    """What a step of n environments brought.

    Attributes
    ----------
    observations : ndarray of float32, shape (n, D)
        Where an episode ended, the first one of the next.
    rewards : ndarray of float64, shape (n,)
    terminated, truncated : ndarray of bool, shape (n,)
        At most one of the two is true.
    last : ndarray of float32, shape (n, D)
        What the old episode ended with; only rows in which one ended mean anything.
    """

    observations: NDArray[np.float32]
    rewards: NDArray[np.float64]
    terminated: NDArray[np.bool_]
    truncated: NDArray[np.bool_]
    last: NDArray[np.float32]


class Part(Protocol):
    """A group of environments that begin anew in the step in which they end, each drawing from its own generator."""

    observation_space: spaces.Box[Any]
    action_space: spaces.Space[Any]

    def __len__(self) -> int:
        """Number of environments."""

    def reset(self, seed: int) -> NDArray[np.float32]:
        """Begin everywhere; environment ``i`` draws from a generator with seed ``seed + i``."""

    def step(self, actions: NDArray[Any]) -> PartStep:
        """Make a step."""

    def get_state(self) -> Any:
        """Return all that the rest of the episodes, and all later ones, depend on: nested tuples of arrays."""

    def set_state(self, state: Any) -> None:
        """Go on from what `get_state` returned, here or in an equal part."""


def part_seeds(seed: int, parts: int, purpose: int) -> list[int]:
    """Seeds far enough apart that no two parts, seeds or purposes share a generator.

    Parameters
    ----------
    seed : int
    parts : int
        How many are needed.
    purpose : int
        0 for learning, 1 for evaluation.
    """
    sequences = [np.random.SeedSequence(seed, spawn_key=(purpose, part)) for part in range(parts)]
    return [int(sequence.generate_state(1, np.uint64)[0] >> np.uint64(2)) for sequence in sequences]


def split_envs(envs: int, weights: Sequence[int]) -> list[int]:
    """Share environments out in proportion to weights, at least one to each.

    Examples
    --------
    >>> split_envs(10, [3, 1])
    [8, 2]
    """
    edges = np.cumsum([0, *weights]) * envs / sum(weights)
    return [max(1, round(high) - round(low)) for low, high in pairwise(edges)]
