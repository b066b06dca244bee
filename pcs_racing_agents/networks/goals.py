"""Goals of a network's outputs for training rows, in units of order 1, and the weights of their errors."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcs_racing_agents.networks.rows import Rows
from pcs_racing_agents.networks.settings import TrainSettings

Floats = NDArray[np.float32]


class Scaling(NamedTuple):
    """Numbers that bring inputs and targets to order 1."""

    mean: Floats  #: shape (D,): ``mean``, ``scale``: Of the inputs.
    scale: Floats
    depth: float  #: How far below the highest of its row a target may lie; infinite without a floor.
    centre: Floats  #: shape (A,): Mean target of each move; 0 for clipped ones.
    size: np.float32  #: Unit of the targets.
    hopeless: float  #: Mean square, in that unit, of targets of rows that have none above 0.
    level: float  #: That unit in the spread of the rows' means, at most 1.


def scale_rows(rows: Rows, settings: TrainSettings, clipped: bool) -> Scaling:
    """Return the scaling of rows from their weighted means and spreads.

    Inputs get mean 0 and deviation 1 (an input that never changes keeps its unit). Targets are measured around every
    move's mean (around 0 if clipped: 0 must stay 0), in units of their root mean square.
    """
    share = rows.weights / rows.weights.sum()
    mean = share @ rows.observations.astype(np.float64)
    deviation = np.sqrt(share @ (rows.observations - mean) ** 2)
    known_share = share[:, None] * rows.mask
    total = known_share.sum(axis=0)
    depth = np.inf
    if settings.floor and not clipped:
        below_highest = _highest(rows) - rows.targets
        depth = settings.floor * np.sum(known_share * below_highest) / total.sum() or np.inf
    targets = _raised(rows, depth).astype(np.float64)
    if clipped:
        centre, values = np.zeros(targets.shape[1]), np.maximum(targets, 0.0)
        level = size = np.sqrt(np.sum(known_share * values**2) / total.sum()) or 1.0
    else:
        centre = np.sum(known_share * targets, axis=0) / np.where(total > 0.0, total, 1.0)
        values = np.where(rows.mask, targets - centre, 0.0)
        means = values.sum(axis=1, keepdims=True) / rows.mask.sum(axis=1, keepdims=True)
        if settings.differences:
            values = np.where(rows.mask, values - means, 0.0)
        size = np.sqrt(np.sum(known_share * values**2) / total.sum()) or 1.0
        # The mean never counts more than the differences: in rows of advantages there is nothing to learn of it.
        level = max(np.sqrt(share @ means[:, 0] ** 2), size)
    # How far below 0 the targets of rows without a positive one are, in that unit.
    known_share = known_share * ~(targets > 0.0).any(axis=1, keepdims=True)
    hopeless = np.sum(known_share * (targets / size) ** 2) / known_share.sum() if known_share.any() else 1.0
    return Scaling(
        mean.astype(np.float32),
        np.where(deviation > 1e-6, deviation, 1.0).astype(np.float32),
        float(depth),
        centre.astype(np.float32),
        np.float32(size),
        float(hopeless),
        float(size / level),
    )


def _highest(rows: Rows) -> Floats:
    return np.where(rows.mask, rows.targets, -np.inf).max(axis=1, keepdims=True)


def _raised(rows: Rows, depth: float) -> Floats:
    """Return targets, raised to at most ``depth`` below the highest of their row."""
    if np.isinf(depth):
        return rows.targets
    return np.where(rows.mask, np.maximum(rows.targets, _highest(rows) - np.float32(depth)), np.float32(0.0))


def row_goals(rows: Rows, by: Scaling, clipped: bool, below_zero: float) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """Return the goals of the outputs, the weights of their errors, and whether only errors upwards count."""
    goal = (_raised(rows, by.depth) - by.centre) / by.size
    weight = (rows.mask / rows.mask.sum(axis=1, keepdims=True)).astype(np.float32)
    if not clipped:
        return goal, weight, np.zeros(goal.shape, np.bool_)
    one_sided = goal <= 0.0
    if below_zero > 0.0:
        # In a row without a positive regret the clipped values would not tell which move is the least bad. Such rows
        # can lie far below 0: they count in units of their own spread.
        hopeless = ~(goal > 0.0).any(axis=1, keepdims=True)
        one_sided &= ~hopeless
        weight = np.where(hopeless, np.float32(below_zero / max(by.hopeless, 1.0)) * weight, weight)
    return np.where(one_sided, np.float32(0.0), goal), weight, one_sided
