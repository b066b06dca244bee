"""Seeds of the noise of races, derived from one root seed."""

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.errors import InputError

__all__ = ["checked_seed", "race_seed", "race_seeds"]


def checked_seed(seed: int) -> int:
    """Check a seed and return it as a plain integer.

    Raises
    ------
    InputError
        If it is not a whole number of at least 0.
    """
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
        raise InputError(f"seed is {seed!r}; it must be a whole number from 0")
    return int(seed)


def race_seed(seed: int, index: int) -> np.uint64:
    """Return the noise seed of one race, which depends only on the root seed and the index of the race."""
    key = np.random.SeedSequence(checked_seed(seed), spawn_key=(1, index))
    return key.generate_state(1, np.uint64)[0]


def race_seeds(seed: int, races: int) -> NDArray[np.uint64]:
    """Return the noise seeds of the races 0 to ``races`` - 1, shape (races,)."""
    return np.array([race_seed(seed, index) for index in range(races)], np.uint64)
