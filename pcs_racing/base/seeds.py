"""Keys of race noise, derived from one root seed, and the hash from keys to random numbers."""

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.checks import check_seed
from pcs_racing.base.compilation import inner_kernel

GOLDEN = np.uint64(0x9E3779B97F4A7C15)
"""Step between the inputs of `scramble` in a sequence of random numbers (splitmix64)."""


def signed_seed(sequence: np.random.SeedSequence) -> int:
    """Return a seed of 63 bits from a seed sequence; seeds are stored as signed numbers."""
    return int(sequence.generate_state(1, np.uint64)[0] >> np.uint64(1))


def race_seed(seed: int, index: int) -> np.uint64:
    """Return the noise key of one race: a function of the root seed and the race's index alone."""
    # The first number separates the noise from the start lines, whose key begins with 0.
    key = np.random.SeedSequence(check_seed(seed), spawn_key=(1, index))
    return key.generate_state(1, np.uint64)[0]


def race_seeds(seed: int, races: int) -> NDArray[np.uint64]:
    """Return the noise keys of the races 0 to ``races`` - 1, shape (races,)."""
    return np.array([race_seed(seed, index) for index in range(races)], np.uint64)


def scramble(bits):
    """Scramble 64 bits, or each number of an array: splitmix64's finaliser (Steele et al. 2014)."""
    bits = (bits ^ (bits >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    bits = (bits ^ (bits >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return bits ^ (bits >> np.uint64(31))


scramble_one = inner_kernel(scramble, forceinline=True)
"""Variant of `scramble` for one number, in compiled functions."""
