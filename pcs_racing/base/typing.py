"""Types that all floors share."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]
Singles = NDArray[np.float32]


class ObservationElement(NamedTuple):
    """One number of an observation, for spaces and documentation."""

    name: str
    unit: str
    low: float  #: Min value, inclusive.
    high: float  #: Max value, inclusive.
    meaning: str
