"""Choice of a pool of policies with high headroom, from noisy payoffs on several tracks.

The set with the maximum headroom of many sets on the same races has a biased headroom: it includes
the noise of every payoff. So payoffs are denoised first (:func:`denoised`). The set is then chosen
for the mean over all tracks, with a fixed number of policies from each group of similar speed,
which leaves little room for sets that are good by chance.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.checks import check_whole
from pcs_racing.base.errors import InputError
from pcs_racing_agents.policies.headroom import cyclic_planes, ratings

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]


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
    folds = np.asarray(payoffs, np.float64)
    rating = ratings(folds)
    matrix = rating[:, None] - rating[None, :]
    for plane in cyclic_planes(folds):
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
    payoffs: ArrayLike, groups: Sequence[ArrayLike], count: int, *, starts: int = 8, seed: int = 0
) -> Indices:
    """Choose the pool with the maximum headroom, mean over tracks; return ascending indices.

    The search exchanges one policy at a time.

    Parameters
    ----------
    payoffs : array_like, shape (T, N, N)
        Payoffs without noise (:func:`denoised`), on T tracks.
    groups : sequence of array_like of int
        Disjoint sets of policies. The pool takes equally many policies from each set; if ``count``
        is no multiple of their number, it takes one more from some sets, evenly spaced.
    count : int
        Number of policies in the pool, at least 3.
    starts : int
        Number of random initial pools; the best result is returned.
    seed : int
        Seed of the initial pools.
    """
    check_whole("count", count, 3)
    matrices, sets = (
        np.asarray(payoffs, np.float64),
        [np.asarray(group, np.int64) for group in groups],
    )
    # Group of each place in the pool; a remainder is spread over all groups, not the first ones.
    places = np.arange(count) * len(groups) // count
    for number, group in enumerate(sets):
        if len(group) < np.count_nonzero(places == number):
            raise InputError(
                f"group {number} holds {len(group)} policies; a pool of {count} needs more of them"
            )
    rng = np.random.default_rng(seed)
    best, best_value = np.zeros(0, np.int64), -np.inf
    for _ in range(starts):
        pool, value = _exchanged(matrices, sets, places, rng)
        if value > best_value:
            best, best_value = pool, value
    return np.sort(best)


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
