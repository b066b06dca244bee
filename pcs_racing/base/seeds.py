"""Keys of the noise of races, derived from one root seed."""

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.errors import InputError

__all__ = ["checked_seed", "race_seed", "race_seeds"]


def checked_seed(seed: int) -> int:
    """A seed as a plain whole number.

    Raises
    ------
    InputError
        If it is no whole number from 0.
    """
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
        raise InputError(f"seed is {seed!r}; it must be a whole number from 0")
    return int(seed)


def race_seed(seed: int, index: int) -> np.uint64:
    """Noise key of one race: a function of the root seed and the race's index alone."""
    key = np.random.SeedSequence(checked_seed(seed), spawn_key=(1, index))
    return key.generate_state(1, np.uint64)[0]


def race_seeds(seed: int, races: int) -> NDArray[np.uint64]:
    """Noise keys of the races 0 to ``races`` - 1, shape (races,)."""
    return np.array([race_seed(seed, index) for index in range(races)], np.uint64)
