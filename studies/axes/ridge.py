"""Ridge regression of a few targets on products of standardised inputs.

Rows are means over a few segments of races of one policy, since that is what a player can see of an opponent.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np
from numpy.typing import NDArray

from studies.axes.learned import BOUND, TIMES

Floats = NDArray[np.float64]

PENALTIES = tuple(float(10.0**k) for k in range(-4, 2))
"""Penalties on squared weights that cross-validation chooses from, for terms of variance 1."""


@dataclass(frozen=True, eq=False)
class Regression:
    """A linear function of terms."""

    intercept: Floats  #: shape (C,)
    weights: Floats  #: shape (K, C): Of K terms for C targets.

    def predict(self, terms: Floats) -> Floats:
        """Return the targets, shape (..., C), of terms (..., K)."""
        return np.asarray(self.intercept + terms @ self.weights)


def input_scales(values: Floats) -> tuple[Floats, Floats]:
    """Return mean and standard deviation of each input over segments, shape (I,) each; NaN segments do not count."""
    flat = values.reshape(-1, values.shape[-1])
    flat = flat[~np.isnan(flat).any(axis=1)]
    deviation = flat.std(axis=0)
    return flat.mean(axis=0), np.where(deviation > 1e-9, deviation, 1.0)


def standardise(values: Floats, mean: Floats, scale: Floats) -> Floats:
    """Return inputs on the scale on which they enter terms."""
    return np.clip((values - mean) / scale, -BOUND, BOUND)


def term_names(inputs: Sequence[str], degree: int) -> list[str]:
    """Names of all products of up to ``degree`` inputs."""
    return [TIMES.join(inputs[i] for i in factors) for factors in _factors(len(inputs), degree)]


def term_values(standardised: Floats, degree: int) -> Floats:
    """Return the terms, shape (..., K), of standardised inputs (..., I), in the order of :func:`term_names`."""
    products = [standardised[..., factors].prod(axis=-1) for factors in _factors(standardised.shape[-1], degree)]
    return np.stack(products, axis=-1)


def fit_ridge(terms: Floats, targets: Floats, penalties: Sequence[float]) -> Regression:
    """Fit each target with its own penalty.

    Parameters
    ----------
    terms : ndarray, shape (R, K)
    targets : ndarray, shape (R, C)
    penalties : sequence of C floats
        The loss is the mean squared error plus the penalty times the sum of squared weights of terms of variance 1.
    """
    mean, deviation = terms.mean(axis=0), terms.std(axis=0)
    deviation = np.where(deviation > 1e-9, deviation, 1.0)
    x, y = (terms - mean) / deviation, targets - targets.mean(axis=0)
    gram, moments = x.T @ x / len(x), x.T @ y / len(x)
    weights = np.column_stack(
        [
            np.linalg.solve(gram + penalty * np.eye(len(gram)), column)
            for penalty, column in zip(penalties, moments.T, strict=True)
        ]
    )
    weights = weights / deviation[:, None]
    return Regression(targets.mean(axis=0) - mean @ weights, weights)


def _factors(inputs: int, degree: int) -> list[list[int]]:
    return [
        list(factors) for size in range(1, degree + 1) for factors in combinations_with_replacement(range(inputs), size)
    ]
