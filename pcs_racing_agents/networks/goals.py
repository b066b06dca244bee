"""Goals of a network's outputs: targets of rows, scaled to order 1, and weights of their errors.

Targets are learned in one of three ways:

- *clipped*: values below 0 count as 0, as the regrets of the paper. In a row without a positive
  value the values are learned as they are, so that the network learns the best of the bad moves;
- *relative*: the mean of a row's moves, and their differences from it, are each in units of their
  own spread, since situations differ much more than the moves in one situation. Targets far below
  the highest of their row are raised: it does not matter which of two bad moves is worse;
- otherwise as they are, each move around its mean.
"""

from typing import Any, NamedTuple

import numpy as np

from pcs_racing.base.typing import Singles
from pcs_racing_agents.networks.rows import Rows

FLOOR = 0.25
"""Relative targets are raised to at most this many times the mean loss of random moves below
the highest target of their row."""


class Scaling(NamedTuple):
    """Scaling of inputs and targets to order 1."""

    mean: Singles  #: shape (D,): ``mean``, ``scale``: Scaling of the inputs.
    scale: Singles
    #: Maximum distance of a target below the highest of its row; infinite unless relative.
    depth: float
    centre: Singles  #: shape (A,): Mean target of each move; 0 for clipped targets.
    size: np.float32  #: Unit of the targets.
    #: Mean square, in units of ``size``, of targets in rows without a positive target.
    hopeless: float
    #: Ratio of ``size`` to the spread of the rows' means, at most 1; None unless relative.
    level: float | None


class Goals(NamedTuple):
    """Inputs and goals of R rows, as arrays or as tensors."""

    inputs: Any  #: shape (R, D)
    values: Any  #: shape (R, A): Goals of the outputs.
    weights: Any  #: shape (R, A): Weights of the squared errors.
    one_sided: Any  #: shape (R, A): True where only errors upwards count.


def scale_rows(rows: Rows, clipped: bool, relative: bool) -> Scaling:
    """Return the scaling of rows from their weighted means and spreads.

    Inputs get mean 0 and deviation 1 (a constant input retains its unit). Targets are measured
    around every move's mean (around 0 if clipped: 0 must stay 0), in units of their root mean
    square.
    """
    share = rows.weights / rows.weights.sum()
    mean = share @ rows.observations.astype(np.float64)
    deviation = np.sqrt(share @ (rows.observations - mean) ** 2)
    # A target counts a share of its row.
    each = np.tile(share[:, None] / rows.targets.shape[1], rows.targets.shape[1])
    depth, level = np.inf, None
    if relative:
        lost_by_random_moves = np.sum(each * (_highest(rows) - rows.targets))
        depth = FLOOR * lost_by_random_moves or np.inf
    targets = _raised(rows, depth).astype(np.float64)
    centre = np.zeros(targets.shape[1]) if clipped else share @ targets
    values = np.maximum(targets, 0.0) if clipped else targets - centre
    means = values.mean(axis=1, keepdims=True)
    if relative:
        values = values - means
    size = np.sqrt(np.sum(each * values**2)) or 1.0
    if relative:
        # The mean never counts more than the differences: means of advantages hold no information.
        level = float(size / max(np.sqrt(share @ means[:, 0] ** 2), size))
    # Depth below 0 of the targets in rows without a positive target.
    hopeless = each * ~(targets > 0.0).any(axis=1, keepdims=True)
    squares = np.sum(hopeless * (targets / size) ** 2)
    return Scaling(
        mean.astype(np.float32),
        # A constant input has no information; divided by its deviation it would be noise.
        np.where(deviation > 1e-6, deviation, 1.0).astype(np.float32),
        float(depth),
        centre.astype(np.float32),
        np.float32(size),
        float(squares / hopeless.sum()) if hopeless.any() else 1.0,
        level,
    )


def row_goals(rows: Rows, by: Scaling, clipped: bool) -> Goals:
    """Return the scaled inputs and goals of rows."""
    inputs = (rows.observations - by.mean) / by.scale
    values = (_raised(rows, by.depth) - by.centre) / by.size
    weights = np.full(values.shape, 1.0 / values.shape[1], np.float32)
    if not clipped:
        return Goals(inputs, values, weights, np.zeros(values.shape, np.bool_))
    # In a row without a positive regret clipped values do not identify the best of the bad moves.
    # Such rows can lie far below 0: they count in units of their own spread.
    hopeless = ~(values > 0.0).any(axis=1, keepdims=True)
    one_sided = (values <= 0.0) & ~hopeless
    weights = np.where(hopeless, np.float32(1.0 / max(by.hopeless, 1.0)) * weights, weights)
    return Goals(inputs, np.where(one_sided, np.float32(0.0), values), weights, one_sided)


def _highest(rows: Rows) -> Singles:
    return rows.targets.max(axis=1, keepdims=True)


def _raised(rows: Rows, depth: float) -> Singles:
    """Return targets, raised to at most ``depth`` below the highest target of their row."""
    return np.maximum(rows.targets, _highest(rows) - np.float32(depth))
