"""Tests and intervals that draw the races again: the pigeonhole bootstrap and sign flips of whole clusters."""

import numpy as np
from numpy.typing import ArrayLike

from pcs_racing.base.errors import InputError
from pcs_racing_agents.tournament.statistics.student_t import check_level
from pcs_racing_agents.tournament.statistics.units import Floats, check_values, cluster_codes

__all__ = ["bootstrap_interval", "sign_flip_p"]

EXACT_FLIPS = 32  # clusters up to which all signs are tried: 2**16 sums for each half


def bootstrap_interval(
    values: ArrayLike,
    ego: ArrayLike,
    opponent: ArrayLike,
    rng: np.random.Generator,
    *,
    replicates: int = 2000,
    level: float = 0.95,
) -> tuple[float, float]:
    """Return a percentile interval of the mean by the pigeonhole bootstrap (Owen 2007).

    Egos and opponents are drawn with replacement, independently of each other; a race counts as often as both of its
    clusters were drawn.

    Parameters
    ----------
    values : array_like, shape (U,)
        For two arms, their differences.
    ego, opponent : array_like, shape (U,)
    rng : numpy.random.Generator
    replicates : int
        At least 100.
    level : float

    Returns
    -------
    low, high : float

    Raises
    ------
    InputError
        If a value is not finite, shapes differ, there are fewer than two clusters of a kind or too few replicates, or
        the races are so few that a replicate may hold none.
    """
    check_level(level)
    if not replicates >= 100:
        raise InputError(f"replicates is {replicates!r}; an interval needs at least 100")
    x = check_values("values", values)
    egos, n_egos = cluster_codes(ego, x, "ego")
    opponents, n_opponents = cluster_codes(opponent, x, "opponent")
    cell = egos * n_opponents + opponents
    shape = (n_egos, n_opponents)
    total = np.bincount(cell, x, minlength=n_egos * n_opponents).reshape(shape)
    count = np.bincount(cell, minlength=n_egos * n_opponents).reshape(shape).astype(np.float64)
    ego_weights = rng.multinomial(n_egos, np.full(n_egos, 1.0 / n_egos), size=replicates).astype(np.float64)
    weights = rng.multinomial(n_opponents, np.full(n_opponents, 1.0 / n_opponents), size=replicates)
    drawn = ((ego_weights @ count) * weights).sum(axis=1)
    if not drawn.all():
        raise InputError(f"{len(x)} races of {n_egos} egos and {n_opponents} opponents are too few to be resampled")
    means = ((ego_weights @ total) * weights).sum(axis=1) / drawn
    low, high = np.quantile(means, [(1.0 - level) / 2.0, (1.0 + level) / 2.0])
    return float(low), float(high)


def sign_flip_p(
    values: ArrayLike, ego: ArrayLike, rng: np.random.Generator | None = None, *, flips: int = 99_999
) -> float:
    """Return the p-value of the mean being 0 by flipping the signs of whole ego clusters.

    The test holds exactly where every ego's sum has a distribution symmetric about 0. Up to 32 egos every combination
    of signs counts (the sums of two halves are combined, so that 2**32 combinations take 2**16 sums each); with more
    egos, random ones. Like the paired t-test it takes the opponents as given.

    Parameters
    ----------
    values : array_like, shape (U,)
        For two arms, their differences.
    ego : array_like, shape (U,)
    rng : numpy.random.Generator, optional
        Needed with more than 32 egos.
    flips : int
        Random combinations of signs, at least 99.

    Raises
    ------
    InputError
        If a value is not finite, shapes differ, there are fewer than two egos, or ``rng`` is needed and missing.
    """
    x = check_values("values", values)
    codes, number = cluster_codes(ego, x, "ego")
    sums: Floats = np.bincount(codes, x).astype(np.float64)
    bound = abs(sums.sum()) - 1e-12 * np.abs(sums).sum()  # equal sums may differ in the last digit
    if number <= EXACT_FLIPS:
        left = _signed_sums(sums[: number // 2])
        right = np.sort(_signed_sums(sums[number // 2 :]))
        above = len(right) - np.searchsorted(right, bound - left, side="left")
        below = np.searchsorted(right, -bound - left, side="right")
        extreme = int(above.sum() + below.sum()) if bound > 0.0 else 2**number
        return extreme / 2**number
    if rng is None:
        raise InputError(f"there are {number} ego variants; with more than {EXACT_FLIPS} the test needs an rng")
    if not flips >= 99:
        raise InputError(f"flips is {flips!r}; it must be at least 99")
    extreme = 0
    for begin in range(0, flips, 10_000):
        signs = rng.integers(0, 2, size=(min(10_000, flips - begin), number)) * 2.0 - 1.0
        extreme += int((np.abs(signs @ sums) >= bound).sum())
    return (1 + extreme) / (1 + flips)


def _signed_sums(values: Floats) -> Floats:
    """All sums of the values with either sign, shape (2**len(values),)."""
    sums = np.zeros(1)
    for value in values:
        sums = np.concatenate([sums - value, sums + value])
    return sums
