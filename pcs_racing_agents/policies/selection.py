"""Choice of an archive's policies: a front, or policies far from each other.

Coordinates are means over races and have errors. A policy stays on a front if another policy beats
it by less than the error of their difference, since it may belong to the front. All policies drive
the same races, so that error is small.

A Pareto front of two axes is a line: less of one axis is more of the other. If only strong
policies remain, they may be as far from each other as possible instead, in all directions.
"""

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.typing import Floats, Indices
from pcs_racing_agents.base.jobs import Arrays
from pcs_racing_agents.policies.evaluate import summarise
from pcs_racing_agents.policies.pareto import front_layers

# A front


def clearly_beaten(raced: Arrays, rows: Indices, error_bars: float = 1.0) -> NDArray[np.bool_]:
    """Return which of the policies in ``rows`` are beaten within ``rows``, shape (len(rows),).

    ``raced`` is the result of :func:`~pcs_racing_agents.policies.evaluate.race_policies`: the same
    races for all policies. A policy is beaten if another policy is better on all axes. Differences
    below ``error_bars`` standard errors do not count; with 0 every policy that is smaller on all
    axes is beaten.
    """
    subset = {key: values[rows] for key, values in raced.items()}
    coordinates = summarise(subset).coordinates
    # Difference of j from i, at (i, j).
    ahead = coordinates[None] - coordinates[:, None]
    beaten = np.all(ahead > error_bars * difference_errors(subset), axis=-1).any(axis=1)
    return np.asarray(beaten, np.bool_)


def difference_errors(raced: Arrays) -> Floats:
    """Return standard errors of coordinate differences between K policies, shape (K, K, G)."""
    totals, segments = raced["totals"], raced["segments"].astype(np.float64)
    races, begun = totals.shape[1], segments.sum(axis=1)
    coordinates = totals.sum(axis=1) / begun[:, None]
    # Contribution of each race to the error of a ratio of sums, linearised.
    shares = (totals - coordinates[:, None] * segments[..., None]) / begun[:, None, None]
    # No BLAS: its order of a sum depends on its threads and on the processor.
    products = np.einsum("irg,jrg->ijg", shares, shares)
    own = np.einsum("iig->ig", products)
    squares = own[:, None] + own[None] - 2.0 * products
    return np.asarray(np.sqrt(np.maximum(squares, 0.0) * races / max(races - 1, 1)), np.float64)


def spread_first(points: Floats, spacing: float, count: int) -> Indices:
    """Return the best ``count`` of K normalised points with a minimum spacing, by front layer.

    Points of one layer are ordered by index; a point nearer than ``spacing`` to a better point is
    skipped.
    """
    kept: list[int] = []
    for candidate in np.argsort(front_layers(points), kind="stable").tolist():
        away = np.sqrt(np.sum((points[kept] - points[candidate]) ** 2, axis=1))
        if len(kept) < count and not (away < spacing).any():
            kept.append(candidate)
    return np.array(kept, np.int64)


def thin_out(points: Floats, spacing: float, maximum: int) -> Indices:
    """Choose normalised points with a minimum spacing; return ascending indices.

    The choice is the result of :func:`spread_first`; the spacing is widened until at most
    ``maximum`` points remain.
    """
    while len(kept := spread_first(points, spacing, len(points))) > maximum:
        # A spacing of 0 would never grow.
        spacing = max(1.05 * spacing, 1e-4)
    return np.sort(kept)


def spread_out(points: Floats, count: int, first: int = 1) -> Indices:
    """Choose up to ``count`` of K normalised points that are far from each other, in this order.

    The ``first`` points are chosen first; then always the point whose nearest chosen point is
    farthest away (T. Gonzalez, Clustering to minimize the maximum intercluster distance, TCS 1985).
    """
    kept = list(range(first))
    away = np.min([np.sum((points - points[k]) ** 2, axis=1) for k in kept], axis=0)
    while len(kept) < count and away.max() > 0.0:
        kept.append(int(away.argmax()))
        away = np.minimum(away, np.sum((points - points[kept[-1]]) ** 2, axis=1))
    return np.array(kept, np.int64)
