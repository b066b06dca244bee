"""How a learner's environments are shared out: in parts, each with a circuit, rules and opponents of its own."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

__all__ = ["part_seeds", "split_envs"]


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
