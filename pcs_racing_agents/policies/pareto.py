"""Pareto fronts and hypervolumes of sets of points. All objectives are **maximised**.

The hypervolume of a set is the volume of the region that its points dominate: the region below the
set and above a reference point on every axis. ``pip install "pcs-racing[synthesis]"`` brings
moocore, which computes it exactly.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.errors import InputError, require
from pcs_racing.base.typing import Floats

REFERENCE = -0.1
"""Reference point on every axis: a tenth of the scale's range below its worst values."""


class Scale(NamedTuple):
    """Points normalised to 1 and 0 on each axis for hypervolumes."""

    ideal: Floats  #: shape (G,): ``ideal``, ``nadir``: Points normalised to 1 and 0.
    nadir: Floats

    @classmethod
    def of(cls, objectives: Floats) -> "Scale":
        """Return the range of points, shape (n, G), as a scale."""
        _check_size(objectives)
        low, high = objectives.min(axis=0), objectives.max(axis=0)
        if not np.all(low < high):
            axis = int(np.argmin(low < high))
            raise InputError(
                f"objective {axis} is {low[axis]:g} in the whole initial sample; it must differ"
                " between points, since its range is the scale of the search"
            )
        return cls(high, low)

    def __call__(self, objectives: Floats) -> Floats:
        """Return normalised objectives, shape (..., G)."""
        return np.asarray((objectives - self.nadir) / (self.ideal - self.nadir), np.float64)


def non_dominated(points: Floats) -> NDArray[np.bool_]:
    """Return which of K points no other point beats, shape (K,).

    A point beats another point if it is at least as large on all axes and larger on one. Of equal
    points only the first stays.
    """
    found = _moocore().is_nondominated(points, maximise=True, keep_weakly=False)
    return np.asarray(found, np.bool_)


def front_layers(points: Floats) -> NDArray[np.int64]:
    """Return the layer of each point, shape (K,).

    Layer 0 holds points that no other point beats, layer 1 points that only points of layer 0 beat,
    and so on.
    """
    return np.asarray(_moocore().pareto_rank(points, maximise=True), np.int64)


def hypervolume(points: Floats, reference: float = REFERENCE) -> float:
    """Return the volume that points, shape (K, G), dominate above a reference point.

    Points that don't exceed the reference on all axes add nothing. See Fonseca, Paquete,
    Lopez-Ibanez, CEC 2006.
    """
    _check_size(points)
    return float(_moocore().hypervolume(points, ref=reference, maximise=True))


def contributions(front: Floats, reference: float = REFERENCE) -> Floats:
    """Return the hypervolume that a front loses without each of its points, shape (K,)."""
    _check_size(front)
    lost = _moocore().hv_contributions(front, ref=reference, maximise=True)
    return np.maximum(np.asarray(lost, np.float64), 0.0)


def uncrowded_improvement(points: Floats, front: Floats, reference: float = REFERENCE) -> Floats:
    """Return the uncrowded hypervolume improvement of each of n points, shape (n,).

    Positive for a point that adds hypervolume to the front: the added hypervolume. Otherwise minus
    the distance to the nearest place where a point adds hypervolume. Unlike the hypervolume alone
    it distinguishes bad from worse points (C. Toure and others, Uncrowded hypervolume improvement:
    COMO-CMA-ES and the Sofomore framework, GECCO 2019).
    """
    distance = distance_to_improvement(points, front, reference)
    before = hypervolume(front, reference)
    gain = -distance
    # The slow part, a hypervolume, is computed only for points that add some.
    for i in np.flatnonzero(distance == 0.0):
        gain[i] = max(hypervolume(np.vstack([front, points[i]]), reference) - before, 0.0)
    return gain


def distance_to_improvement(points: Floats, front: Floats, reference: float = REFERENCE) -> Floats:
    """Return the Euclidean distance of each point to the region that improves a front, shape (n,).

    0 inside the region and on its border. Inside the region all axes exceed the reference, and no
    point of the front is at least as large on all axes.
    """
    corners = improving_corners(front, reference)
    short = np.maximum(corners[None] - points[:, None], 0.0)
    return np.asarray(np.sqrt(np.sum(short * short, axis=-1)).min(axis=1))


def improving_corners(front: Floats, reference: float = REFERENCE) -> Floats:
    """Return the lower corners of the region that improves a front, shape (C, G).

    A point improves the front if it exceeds a corner on all axes: the region is the union of the
    boxes above the corners (the local bounds of K. Klamroth, R. Lacour and D. Vanderpooten, On the
    representation of the search region in multi-objective optimization, EJOR 2015, for
    maximisation).
    """
    axes = front.shape[1]
    corners = np.full((1, axes), reference)
    for point in front[np.all(front > reference, axis=1)]:
        # The point dominates the lower part of these boxes. The rest of each box is a union of
        # boxes that exceed the point on one axis.
        inside = np.all(corners < point, axis=1)
        cut = np.repeat(corners[inside], axes, axis=0)
        raised = np.tile(np.arange(axes), int(inside.sum()))
        cut[np.arange(len(cut)), raised] = point[raised]
        corners = np.vstack([corners[~inside], cut])
        # A box is part of another box if the other box has a lower corner.
        corners = corners[non_dominated(-corners)]
    return corners


def _check_size(points: Floats) -> None:
    """Refuse points, shape (K, G), with a hypervolume beyond all numbers."""
    size = np.abs(points)
    if not (size < 1e300 ** (1.0 / size.shape[1])).all():
        raise InputError(
            f"points hold {size.max():g}, whose hypervolume is beyond all numbers; scale"
            " them (Scale)"
        )


def _moocore():
    require("moocore", extra="synthesis")
    import moocore

    return moocore
