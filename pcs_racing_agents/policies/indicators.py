"""Hypervolume indicators: quality of a set of points, and the contribution of one more point.

All objectives are **maximised**. The hypervolume of a set is the volume of the region that its
points dominate: the region below the set and above a reference point on every axis.
``pip install "pcs-racing[synthesis]"`` brings moocore, which computes it exactly.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.errors import InputError, require

Floats = NDArray[np.float64]


def non_dominated(points: ArrayLike, *, duplicates: bool = True) -> NDArray[np.bool_]:
    """Return which of K points no other point beats, shape (K,).

    A point beats another point if it is at least as large on all axes and larger on one. Equal
    points all stay, since they don't beat each other; without ``duplicates`` only the first stays.
    """
    points = _points(points)
    if len(points) == 0:
        return np.zeros(0, np.bool_)
    return np.asarray(
        _moocore().is_nondominated(points, maximise=True, keep_weakly=duplicates), np.bool_
    )


def hypervolume(points: ArrayLike, reference: ArrayLike) -> float:
    """Return the volume that a set of points dominates above a reference point.

    Points that don't exceed the reference on all axes add nothing. See Fonseca, Paquete,
    Lopez-Ibanez, CEC 2006.

    Parameters
    ----------
    points : array_like, shape (K, G)
    reference : array_like, shape (G,) or ()
        Worst point that counts; one number applies to all axes.
    """
    points = _points(points)
    return _hypervolume(points, _reference(reference, points.shape[1]))


def contributions(points: ArrayLike, reference: ArrayLike) -> Floats:
    """Return the hypervolume that the front of some points loses without each point, shape (K,).

    0 for points that another point beats or equals; such points do not reduce other contributions.
    """
    points = _points(points)
    reference = _reference(reference, points.shape[1])
    if len(points) == 0:
        return np.zeros(0)
    return np.maximum(
        np.asarray(_moocore().hv_contributions(points, ref=reference, maximise=True), np.float64),
        0.0,
    )


def total_hypervolume(points: ArrayLike, front: ArrayLike, reference: ArrayLike) -> Floats:
    """Return the hypervolume of a front, shape (K, G), with each of n points added, shape (n,)."""
    points = _points(points)
    front = _front(front, points.shape[1])
    reference = _reference(reference, points.shape[1])
    total = np.full(len(points), _hypervolume(front, reference))
    # Most points add nothing; the slow part, a hypervolume, is computed only for the others.
    better = distance_to_improvement(points, front, reference) == 0.0
    for i in np.flatnonzero(better):
        total[i] = max(total[i], _hypervolume(np.vstack([front, points[i]]), reference))
    return total


def uncrowded_improvement(points: ArrayLike, front: ArrayLike, reference: ArrayLike) -> Floats:
    """Return the uncrowded hypervolume improvement of each point, shape (n,), to be maximised.

    Positive for a point that adds hypervolume to the front: the added hypervolume. Otherwise minus
    the distance to the nearest place where a point adds hypervolume. Unlike the hypervolume alone
    it distinguishes bad from worse points (C. Toure and others, Uncrowded hypervolume improvement:
    COMO-CMA-ES and the Sofomore framework, GECCO 2019).

    Parameters
    ----------
    points : array_like, shape (n, G)
    front : array_like, shape (K, G)
        Front; may be empty and may hold beaten points.
    reference : array_like, shape (G,) or ()
    """
    points = _points(points)
    front = _front(front, points.shape[1])
    reference = _reference(reference, points.shape[1])
    distance = distance_to_improvement(points, front, reference)
    before = _hypervolume(front, reference)
    gain = -distance
    for i in np.flatnonzero(distance == 0.0):
        gain[i] = max(_hypervolume(np.vstack([front, points[i]]), reference) - before, 0.0)
    return gain


def distance_to_improvement(points: ArrayLike, front: ArrayLike, reference: ArrayLike) -> Floats:
    """Return the Euclidean distance of each point to the region that improves a front, shape (n,).

    0 inside the region and on its border. Inside the region all axes exceed the reference, and no
    point of the front is at least as large on all axes.
    """
    points = _points(points)
    corners = search_corners(front, _reference(reference, points.shape[1]))
    nearest = np.empty(len(points))
    for first in range(0, len(points), 256):  # bounded memory
        short = np.maximum(corners[None] - points[first : first + 256, None], 0.0)
        nearest[first : first + 256] = np.sqrt(np.sum(short * short, axis=-1)).min(axis=1)
    return nearest


def search_corners(front: ArrayLike, reference: ArrayLike) -> Floats:
    """Return the lower corners of the region that improves a front, shape (C, G).

    A point improves the front if it exceeds a corner on all axes: the region is the union of the
    boxes above the corners (the local bounds of K. Klamroth, R. Lacour and D. Vanderpooten, On the
    representation of the search region in multi-objective optimization, EJOR 2015, for
    maximisation).
    """
    reference = _reference(reference, np.size(reference))
    front = _front(front, len(reference))
    front = front[np.all(front > reference, axis=1)]
    front = front[non_dominated(front, duplicates=False)]
    if len(front) == 0:
        return reference[None]
    # With two axes the corners are the inner corners of a staircase.
    if len(reference) == 2:
        front = front[np.argsort(-front[:, 0])]
        return np.column_stack(
            [np.append(front[:, 0], reference[0]), np.insert(front[:, 1], 0, reference[1])]
        )
    corners = reference[None]
    for point in front:
        # The point dominates the lower part of these boxes. The rest of each box is a union of
        # boxes that exceed the point on one axis.
        inside = np.all(corners < point, axis=1)
        cut = np.repeat(corners[inside], len(reference), axis=0)
        axes = np.tile(np.arange(len(reference)), int(inside.sum()))
        cut[np.arange(len(cut)), axes] = point[axes]
        corners = np.vstack([corners[~inside], cut])
        # A box is part of another box if the other box has a lower corner.
        corners = corners[non_dominated(-corners, duplicates=False)]
    return corners


def _points(points: ArrayLike) -> Floats:
    try:
        table = np.ascontiguousarray(points, np.float64)
    except (TypeError, ValueError):
        raise InputError("points hold something that is no number") from None
    if table.ndim != 2 or table.shape[1] == 0:
        raise InputError(
            f"points have shape {table.shape}; they must have (number of points, number of axes)"
        )
    if not np.isfinite(table).all():
        row, axis = np.argwhere(~np.isfinite(table))[0]
        raise InputError(
            f"points hold {table[row, axis]} in row {row}, axis {axis}; they must be finite"
        )
    return table


def _front(front: ArrayLike, axes: int) -> Floats:
    if np.size(front) == 0:
        return np.zeros((0, axes))
    table = _points(front)
    if table.shape[1] != axes:
        raise InputError(f"the front has {table.shape[1]} axes; it must have {axes}")
    return table


def _reference(reference: ArrayLike, axes: int) -> Floats:
    point = np.asarray(reference, np.float64)
    if point.shape not in ((), (axes,)) or not np.isfinite(point).all():
        raise InputError(
            f"the reference point is {point.tolist()}; it must be one finite number or {axes} of"
            " them"
        )
    return np.array(np.broadcast_to(point, (axes,)))


def _hypervolume(points: Floats, reference: Floats) -> float:
    return (
        float(_moocore().hypervolume(points, ref=reference, maximise=True)) if len(points) else 0.0
    )


def _moocore():
    require("moocore", extra="synthesis")
    import moocore

    return moocore
