"""The interface of learning tasks: groups of training environments, and an evaluation.

The races of a group share a circuit, rules and a mixture of opponents.
"""

from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from pcs_racing.base.dense import DenseLayers
from pcs_racing.envs.vector import BatchVectorEnv
from pcs_racing_agents.learning.ppo.evaluation import Matchup, MatchupScore


class LearningTask(Protocol):
    """A learning task: :class:`pcs_racing_agents.learning.ppo.duels.DuelTask` or ``DriveTask``."""

    activation: str  #: "relu" or "tanh": Between the layers of the policy.
    limit: float  #: Largest weight that the policy may have.
    unit: str  #: Name of a step, for reports.

    @property
    def threads(self) -> int:
        """Groups that may be stepped at the same time; the results do not depend on it."""

    @property
    def default_name(self) -> str:
        """Name under which the zoo looks for the policy."""

    @property
    def identity(self) -> dict[str, Any]:
        """What the results depend on beside the settings."""

    def env_groups(self) -> Sequence[BatchVectorEnv]:
        """Make the training environments."""

    def evaluate(self, layers: DenseLayers) -> dict[Matchup, MatchupScore]:
        """Race without exploration noise, and return the scores."""

    def save(self, layers: DenseLayers, folder: Path, name: str, about: Mapping[str, Any]) -> Path:
        """Write a policy."""


def group_seeds(seed: int, groups: int, purpose: int) -> list[int]:
    """Return seeds so far apart that no two groups, seeds or purposes share a generator.

    Parameters
    ----------
    groups : int
        How many are needed.
    purpose : int
        0 for learning, 1 for evaluation.
    """
    sequences = [np.random.SeedSequence(seed, spawn_key=(purpose, group)) for group in range(groups)]
    return [int(sequence.generate_state(1, np.uint64)[0] >> np.uint64(2)) for sequence in sequences]


def split_envs(envs: int, weights: Sequence[int]) -> list[int]:
    """Return numbers of environments in proportion to weights, at least one for each.

    Examples
    --------
    >>> split_envs(10, [3, 1])
    [8, 2]
    """
    edges = np.cumsum([0, *weights]) * envs / sum(weights)
    return [max(1, round(high) - round(low)) for low, high in pairwise(edges)]
