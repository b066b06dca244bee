"""From what each move is worth to the probabilities of the moves: functions from (B, M) to (B, M)."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.errors import UnknownNameError

__all__ = ["DECISIONS", "argmax", "get_decision", "regret_matching", "softmax"]

Floats = NDArray[np.float64]


def argmax(values: NDArray[Any]) -> Floats:
    """The move that is worth most, and of equals the first.

    With unclipped regrets this is the paper's rule (its eq. for the argmax of the clipped regret) wherever a regret is
    positive. Where none is, the paper allows any move; this takes the one with the least regret lost.
    """
    chances = np.zeros(values.shape)
    np.put_along_axis(chances, np.argmax(values, axis=-1)[..., None], 1.0, axis=-1)
    return chances


def regret_matching(values: NDArray[Any]) -> Floats:
    """In proportion to positive regret (Hart and Mas-Colell 2000); the highest regret where none is positive.

    It also draws from networks that were taught probabilities.
    """
    positive = np.maximum(np.asarray(values, np.float64), 0.0)
    total = positive.sum(axis=-1, keepdims=True)
    return np.where(total > 0.0, positive / np.where(total > 0.0, total, 1.0), argmax(values))


def softmax(values: NDArray[Any]) -> Floats:
    """In proportion to the exponential of the values, for networks that put out logits."""
    raised = np.asarray(values, np.float64)
    raised = np.exp(raised - raised.max(axis=-1, keepdims=True))
    return raised / raised.sum(axis=-1, keepdims=True)


DECISIONS: dict[str, Callable[[NDArray[Any]], Floats]] = {
    "argmax": argmax,
    "regret-matching": regret_matching,
    "sample": regret_matching,
    "softmax": softmax,
}
"""Decision rules by name."""


def get_decision(name: str) -> Callable[[NDArray[Any]], Floats]:
    """Return a decision rule.

    Raises
    ------
    UnknownNameError
        If there is none of that name.
    """
    if name not in DECISIONS:
        raise UnknownNameError(f"decision {name!r} is unknown; there are {', '.join(DECISIONS)}")
    return DECISIONS[name]
