"""Keys of race noise, derived from one root seed, and the hash from keys to random numbers.

Random numbers are pure functions of a key, a car and a count: no generator has a state.
"""

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.compilation import inner_kernel, kernel
from pcs_racing.base.errors import check_seed

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


@inner_kernel(forceinline=True)
def _drawn_bits(seed, car, count):
    # Neighbouring counts and cars differ in few bits: after two rounds of scrambling no trace of
    # that is left. Every two cars have their own sequence: in a shared sequence car 2 would get at
    # a count the noise that car 0 gets at the next count.
    pair = seed + np.uint64(0xA0761D6478BD642F) * np.uint64(car >> 1)
    key = scramble_one(pair + GOLDEN * np.uint64(2 * count + (car & 1) + 1))
    return scramble_one(key + np.uint64(0xD1B54A32D192ED03))


@kernel
def normal_noise(seed, car, count):
    """Draw nearly normal noise, mean 0 and variance 1, as a pure function of the arguments.

    It is the sum of four 16-bit uniform numbers: bounded by 3.5 standard deviations, excess
    kurtosis -0.3.
    """
    key, mask = _drawn_bits(seed, car, count), np.uint64(0xFFFF)
    total = (
        float(key & mask)
        + float((key >> np.uint64(16)) & mask)
        + float((key >> np.uint64(32)) & mask)
        + float((key >> np.uint64(48)) & mask)
    )
    return (total / 65535.0 - 2.0) * 1.7320508075688772


@kernel
def uniform_noise(seed, car, count):
    """Draw a multiple of 2**-53 in [0, 1), uniformly, as a pure function of the arguments."""
    return float(_drawn_bits(seed, car, count) >> np.uint64(11)) * 2.0**-53


def random_bits(keys: NDArray[np.uint64], attempt: int) -> NDArray[np.uint64]:
    """Return five numbers of 64 random bits for each key, shape (B, 5).

    They are a hash of the key by splitmix64 (Steele et al. 2014) and not a stream: a game is the
    same in a batch of any size.
    """
    # Every attempt has its own numbers; no other attempt reads them.
    counters = np.arange(5, dtype=np.uint64) + np.uint64(5 * attempt + 1)
    return np.asarray(scramble(scramble(keys)[:, None] + counters * GOLDEN))
