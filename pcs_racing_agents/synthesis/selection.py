"""The choice of an archive's policies: those that no other clearly beats, at a distance from each other.

Coordinates are means over races and carry errors. A policy that another one beats by less than the error of their
difference may well belong to the front, so it stays; all policies drive the same races, which makes that error small.
"""

import numpy as np
from numpy.typing import NDArray

from pcs_racing_agents.jobs.chunks import Arrays

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]


def front_layers(points: Floats) -> Indices:
    """Layer of each point, shape (K,): 0 if no other point beats it, 1 if only points of layer 0 do, and so on.

    A point beats another if it is at least as large in all coordinates and larger in one.
    """
    points = np.asarray(points, np.float64)
    better = np.all(points[:, None] >= points[None], axis=-1) & np.any(points[:, None] > points[None], axis=-1)
    layer = np.full(len(points), -1, np.int64)
    depth = 0
    while (layer < 0).any():
        remaining = np.flatnonzero(layer < 0)
        layer[remaining[~better[np.ix_(remaining, remaining)].any(axis=0)]] = depth
        depth += 1
    return layer


def difference_errors(raced: Arrays) -> Floats:
    """Standard errors of the differences between the coordinates of K policies, shape (K, K, G).

    ``raced`` is what :func:`~pcs_racing_agents.synthesis.evaluate.race_policies` returned: the same R races for all of
    them.
    """
    totals, segments = raced["totals"], raced["segments"].astype(np.float64)
    races = totals.shape[1]
    coordinates = totals.sum(axis=1) / segments.sum(axis=1)[:, None]
    # What each race contributes to the error of a ratio of sums, linearised.
    shares = (totals - coordinates[:, None] * segments[..., None]) / segments.sum(axis=1)[:, None, None]
    # Not BLAS, which chooses the order of a sum by its threads and the processor.
    products = np.einsum("irg,jrg->ijg", shares, shares)
    own = np.einsum("iig->ig", products)
    squares = own[:, None] + own[None] - 2.0 * products
    return np.asarray(np.sqrt(np.maximum(squares, 0.0) * races / max(races - 1, 1)), np.float64)


def beaten(coordinates: Floats, errors: Floats, error_bars: float) -> NDArray[np.bool_]:
    """Whether each of K policies is beaten: another one is better on all axes, by more than its error bars, shape (K,).

    Differences below ``error_bars`` standard errors (``errors``, shape (K, K, G)) do not count; with 0 every policy
    that is smaller on all axes is beaten.
    """
    # Of j over i, at (i, j).
    ahead = coordinates[None] - coordinates[:, None]
    return np.asarray(np.all(ahead > error_bars * errors, axis=-1).any(axis=1))


def spread_first(points: Floats, spacing: float, count: int) -> Indices:
    """The best ``count`` of K normalised points that keep a distance from each other, by layers of the front.

    Points of one layer come by their index; one that is nearer than ``spacing`` to a better one is passed over.
    """
    kept: list[int] = []
    for candidate in np.lexsort((np.arange(len(points)), front_layers(points))).tolist():
        away = np.sqrt(np.sum((points[kept] - points[candidate]) ** 2, axis=1))
        if len(kept) < count and not (away < spacing).any():
            kept.append(candidate)
    return np.array(kept, np.int64)


def thin_out(points: Floats, spacing: float, most: int) -> Indices:
    """Choose normalised points that keep a distance from each other, ascending indices.

    All are taken that :func:`spread_first` would take; the spacing is widened until no more than ``most`` remain.
    """
    while len(kept := spread_first(points, spacing, len(points))) > most:
        # A spacing of 0 would never grow.
        spacing = max(1.05 * spacing, 1e-4)
    return np.sort(kept)
