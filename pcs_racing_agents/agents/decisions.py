"""Decision rules: from the values of the moves to their probabilities, functions from (B, M) to (B, M)."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.errors import UnknownNameError

Floats = NDArray[np.float64]


def argmax(values: NDArray[Any]) -> Floats:
    """Return probability 1 for the move of the highest value, the first of equal ones.

    With unclipped regrets this is the paper's rule (the argmax of the clipped regret) wherever a regret is positive.
    Where none is, the paper allows any move; this rule takes the one of the highest (least negative) regret.
    """
    probabilities = np.zeros(values.shape)
    np.put_along_axis(probabilities, np.argmax(values, axis=-1)[..., None], 1.0, axis=-1)
    return probabilities


def regret_matching(values: NDArray[Any]) -> Floats:
    """Return probabilities in proportion to positive regret (Hart and Mas-Colell 2000); argmax where none is positive.

    Outputs that are probabilities already stay as they are.
    """
    positive = np.maximum(np.asarray(values, np.float64), 0.0)
    total = positive.sum(axis=-1, keepdims=True)
    return np.where(total > 0.0, positive / np.where(total > 0.0, total, 1.0), argmax(values))


def softmax(values: NDArray[Any]) -> Floats:
    """Return probabilities in proportion to the exponential of the values, which are logits."""
    exponentials = np.asarray(values, np.float64)
    exponentials = np.exp(exponentials - exponentials.max(axis=-1, keepdims=True))
    return exponentials / exponentials.sum(axis=-1, keepdims=True)


DECISIONS: dict[str, Callable[[NDArray[Any]], Floats]] = {
    "argmax": argmax,
    "regret-matching": regret_matching,
    "sample": regret_matching,
    "softmax": softmax,
}
"""Decision rules by name."""


def get_decision(name: str) -> Callable[[NDArray[Any]], Floats]:
    """Return a decision rule."""
    if name not in DECISIONS:
        raise UnknownNameError(f"decision {name!r} is unknown; there are {', '.join(DECISIONS)}")
    return DECISIONS[name]
