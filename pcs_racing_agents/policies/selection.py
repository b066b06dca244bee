"""Choice of an archive's policies: distant policies not clearly beaten, or a pool with headroom.

Coordinates are means over races and have errors. A policy stays if another policy beats it by less
than the error of their difference, since it may belong to the front. All policies drive the same
races, so that error is small.

A Pareto front of speed and restraint is a line of ever faster policies. If the faster policy wins,
one policy is the best response to all others. For headroom the archive is a pool with a game of
rock, paper and scissors. *Candidates* of all speeds, each beaten by some others, race each other on
all tracks. The choice is the pool with the maximum headroom, with equally many policies from each
group along the first axis.

The set with the maximum headroom of many sets on the same races has a biased headroom: it includes
the noise of every payoff. So payoffs are denoised first (:func:`denoised`). The set is then chosen
for the mean over all tracks, which leaves little room for sets that are good by chance.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.checks import check_whole
from pcs_racing.base.errors import InputError
from pcs_racing_agents.base.chunks import Arrays
from pcs_racing_agents.policies.evaluate import summarise
from pcs_racing_agents.policies.headroom import cyclic_planes, headroom, ratings, transitive_share
from pcs_racing_agents.policies.pareto import front_layers

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]

START_POOLS = 8
"""Number of random pools that the search for a pool starts from."""


# A front


def clearly_beaten(raced: Arrays, rows: Indices, error_bars: float) -> NDArray[np.bool_]:
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


# A pool with headroom


def best_of_each_interval(axis: Floats, score: Floats, count: int, intervals: int) -> Indices:
    """Choose up to ``count`` policies that span an axis, in its order, by score and interval.

    Each round takes the best remaining policy of each of several equal intervals, until ``count``
    policies are chosen or none is left.
    """
    edges = np.linspace(axis.min(), axis.max(), intervals + 1)[1:-1]
    interval = np.searchsorted(edges, axis, side="right")
    # The index decides between equal scores, so that the choice does not depend on the sorting.
    ranked = np.lexsort((np.arange(len(axis)), -score))
    rank = np.zeros(len(axis), np.int64)  # rank within the interval
    for k in range(intervals):
        inside = ranked[interval[ranked] == k]
        rank[inside] = np.arange(len(inside))
    # First the best of every interval, then the second best of each, and so on.
    chosen = np.lexsort((-score, rank))[:count]
    return np.asarray(chosen[np.argsort(axis[chosen], kind="stable")], np.int64)


def choose_for_headroom(
    payoffs: Floats, groups: int, count: int, seed: int
) -> tuple[Indices, dict[str, float]]:
    """Choose ``count`` of N candidates, and report the expected headroom.

    Parameters
    ----------
    payoffs : ndarray, shape (T, F, N, N)
        Payoffs of all pairs on each track, in the order of the candidates along the first axis.
    groups : int
        Number of groups of neighbours along this axis that as many policies are taken from.
    """
    expected = np.array([denoised(folds) for folds in payoffs])
    candidates = np.arange(payoffs.shape[-1])
    pool = choose_pool(expected, np.array_split(candidates, groups), count, seed=seed)
    return pool, {
        "choice_headroom": float(pool_headroom(expected, pool[None]).mean()),
        "choice_headroom_of_all_candidates": float(
            pool_headroom(expected, candidates[None]).mean()
        ),
    }


def headroom_notes(
    payoffs: Mapping[str, Floats], chosen_on: Sequence[str]
) -> dict[str, str | float]:
    """Return the headroom of a pool on each track, and means over the tracks of the choice and over
    all other tracks.

    ``payoffs``: payoffs by track, shape (F, N, N) each.
    """
    estimates = {track: headroom(folds) for track, folds in payoffs.items()}
    notes: dict[str, str | float] = {}
    elsewhere = [track for track in payoffs if track not in chosen_on]
    for suffix, tracks in (("", chosen_on), ("_elsewhere", elsewhere)):
        if tracks:
            values = [estimates[track].value for track in tracks]
            lows = [estimates[track].low for track in tracks]
            shares = np.array([transitive_share(payoffs[track]) for track in tracks])
            known = shares[np.isfinite(shares)]
            notes[f"headroom{suffix}"] = float(np.mean(values))
            notes[f"headroom_low{suffix}"] = float(np.mean(lows))
            notes[f"transitive_share{suffix}"] = float(known.mean()) if len(known) else "unknown"
    for track, estimate in estimates.items():
        notes[f"headroom_{track}"] = f"{estimate.value:+.3f} +- {estimate.opponents_error:.3f}"
    return notes


def denoised(payoffs: ArrayLike) -> Floats:
    """Return a payoff matrix without most of its noise, shape (N, N): ratings and shrunk cyclic
    planes.

    A plane of strength s gets the strength ``sqrt(s^2 - e^2)``, where e is the strength that noise
    alone reaches; a weaker plane is dropped. This shrinkage has the minimum expected squared error
    for a matrix of low rank in noise (Gavish and Donoho 2017, Optimal shrinkage of singular
    values).

    Parameters
    ----------
    payoffs : array_like, shape (F, N, N)
        Payoffs as for :func:`pcs_racing_agents.policies.headroom.cyclic_planes`.
    """
    # Ratings, means over all opponents, have little noise; only the cyclic part is shrunk.
    rating = ratings(payoffs)
    matrix = rating[:, None] - rating[None, :]
    for plane in cyclic_planes(payoffs):
        if plane.strength > plane.noise:
            x, y = plane.points.T
            matrix += np.sqrt(1.0 - (plane.noise / plane.strength) ** 2) * (
                np.outer(x, y) - np.outer(y, x)
            )
    return np.asarray(np.clip(matrix, -0.5, 0.5))


def pool_headroom(payoffs: Floats, pools: Indices) -> Floats:
    """Return the headroom of pools on each track for exactly known payoffs, shape (B, T).

    Parameters
    ----------
    payoffs : ndarray, shape (T, N, N)
    pools : ndarray of int, shape (B, K)
        Policies of each pool.
    """
    played = payoffs[:, pools[:, :, None], pools[:, None, :]]
    return np.asarray((played.max(axis=-2).mean(axis=-1) - played.mean(axis=-1).max(axis=-1)).T)


def choose_pool(
    payoffs: ArrayLike, groups: Sequence[ArrayLike], count: int, *, seed: int = 0
) -> Indices:
    """Choose the pool with the maximum headroom, mean over tracks; return ascending indices.

    The search exchanges one policy at a time, and starts from several random pools.

    Parameters
    ----------
    payoffs : array_like, shape (T, N, N)
        Payoffs without noise (:func:`denoised`), on T tracks.
    groups : sequence of array_like of int
        Disjoint sets of policies. The pool takes equally many policies from each set; if ``count``
        is no multiple of their number, it takes one more from some sets, evenly spaced.
    count : int
        Number of policies in the pool, at least 3.
    seed : int
        Seed of the random pools.
    """
    check_whole("count", count, 3)
    matrices = np.asarray(payoffs, np.float64)
    sets = [np.asarray(group, np.int64) for group in groups]
    # Group of each place in the pool; a remainder is spread over all groups, not the first ones.
    places = np.arange(count) * len(groups) // count
    for number, group in enumerate(sets):
        if len(group) < np.count_nonzero(places == number):
            raise InputError(
                f"group {number} holds {len(group)} policies; a pool of {count} needs more of them"
            )
    rng = np.random.default_rng(seed)
    found = [_exchanged(matrices, sets, places, rng) for _ in range(START_POOLS)]
    return np.sort(max(found, key=lambda pool_and_value: pool_and_value[1])[0])


def _exchanged(
    payoffs: Floats, groups: Sequence[Indices], places: Indices, rng: np.random.Generator
) -> tuple[Indices, float]:
    """Return a pool that no exchange of one policy within its group improves, and its mean
    headroom.
    """
    drawn = [
        rng.choice(group, np.count_nonzero(places == k), replace=False)
        for k, group in enumerate(groups)
    ]
    pool = np.concatenate(drawn).astype(np.int64)
    value = float(pool_headroom(payoffs, pool[None]).mean())
    while True:
        exchanges = [
            (k, other) for k, g in enumerate(places) for other in np.setdiff1d(groups[g], pool)
        ]
        if not exchanges:
            return pool, value
        pools = np.tile(pool, (len(exchanges), 1))
        place, other = np.transpose(exchanges)
        pools[np.arange(len(pools)), place] = other
        values = pool_headroom(payoffs, pools).mean(axis=1)
        # The margin prevents an endless exchange of two equal policies by rounding.
        if values.max() <= value + 1e-12:
            return pool, value
        pool, value = pools[values.argmax()], float(values.max())
