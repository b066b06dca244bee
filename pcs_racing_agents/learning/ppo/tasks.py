"""What PPO learns: a task, with groups of environments to learn in and races to be evaluated in.

A group holds races side by side that share a circuit, rules and a mixture of opponents.
"""

from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from pcs_racing.base.dense import DenseLayers
from pcs_racing_agents.learning.ppo.evaluation import Matchup, Score

__all__ = ["EnvGroup", "GroupStep", "LearningTask", "group_seeds", "split_envs"]


class GroupStep(NamedTuple):
    """Result of a step of n environments.

    Attributes
    ----------
    observations : ndarray of float32, shape (n, D)
        Where an episode ended, the first one of the next.
    rewards : ndarray of float64, shape (n,)
    terminated, truncated : ndarray of bool, shape (n,)
        At most one of the two is true.
    last : ndarray of float32, shape (n, D)
        Last observations of episodes that ended; the other rows mean nothing.
    """

    observations: NDArray[np.float32]
    rewards: NDArray[np.float64]
    terminated: NDArray[np.bool_]
    truncated: NDArray[np.bool_]
    last: NDArray[np.float32]


class EnvGroup(Protocol):
    """Environments that begin anew in the step in which they end, each drawing from its own generator."""

    observation_space: spaces.Box[Any]
    action_space: spaces.Space[Any]

    def __len__(self) -> int:
        """Number of environments."""

    def reset(self, seed: int) -> NDArray[np.float32]:
        """Begin everywhere; environment ``i`` draws from a generator with seed ``seed + i``."""

    def step(self, actions: NDArray[Any]) -> GroupStep:
        """Make a step."""

    def get_state(self) -> Any:
        """Return all that the rest of the episodes, and all later ones, depend on: nested tuples of arrays."""

    def set_state(self, state: Any) -> None:
        """Go on from what `get_state` returned, here or in an equal group."""


class LearningTask(Protocol):
    """What PPO learns: :class:`pcs_racing_agents.learning.ppo.duels.DuelTask`, or ``DriveTask`` for driving.

    Attributes
    ----------
    activation : {"relu", "tanh"}
        Between the layers of the policy.
    limit : float
        Largest weight that the policy may have.
    unit : str
        Name of a step, for reports.
    """

    activation: str
    limit: float
    unit: str

    @property
    def default_name(self) -> str:
        """Name under which the zoo looks for the policy."""

    @property
    def identity(self) -> dict[str, Any]:
        """What the results depend on beside the settings."""

    def env_groups(self) -> Sequence[EnvGroup]:
        """Make the environments to learn in."""

    def evaluate(self, layers: DenseLayers) -> dict[Matchup, Score]:
        """Race without exploring; returns the scores."""

    def save(self, layers: DenseLayers, folder: Path, name: str, about: Mapping[str, Any]) -> Path:
        """Write a policy."""


def group_seeds(seed: int, groups: int, purpose: int) -> list[int]:
    """Seeds far enough apart that no two groups, seeds or purposes share a generator.

    Parameters
    ----------
    seed : int
    groups : int
        How many are needed.
    purpose : int
        0 for learning, 1 for evaluation.
    """
    sequences = [np.random.SeedSequence(seed, spawn_key=(purpose, group)) for group in range(groups)]
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
