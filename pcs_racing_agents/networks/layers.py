"""The layers of a policy network, as arrays."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["Layers"]


class Layers(NamedTuple):
    """The layers of a policy network.

    Attributes
    ----------
    weights : tuple of ndarray, shape (out, in), float32
    biases : tuple of ndarray, shape (out,), float32
    """

    weights: tuple[NDArray[np.float32], ...]
    biases: tuple[NDArray[np.float32], ...]
