"""Keys of the noise of races, derived from one root seed."""

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.checks import check_seed


def race_seed(seed: int, index: int) -> np.uint64:
    """Noise key of one race: a function of the root seed and the race's index alone."""
    # The first number keeps the noise apart from the start lines, whose key begins with 0.
    key = np.random.SeedSequence(check_seed(seed), spawn_key=(1, index))
    return key.generate_state(1, np.uint64)[0]


def race_seeds(seed: int, races: int) -> NDArray[np.uint64]:
    """Noise keys of the races 0 to ``races`` - 1, shape (races,)."""
    return np.array([race_seed(seed, index) for index in range(races)], np.uint64)
