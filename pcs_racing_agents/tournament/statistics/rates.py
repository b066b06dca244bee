"""Rates and tables of tests: Wilson intervals, sizes of effects, and Holm's correction."""

from statistics import NormalDist
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from pcs_racing.base.errors import InputError
from pcs_racing_agents.tournament.statistics.comparison import paired_t
from pcs_racing_agents.tournament.statistics.student_t import check_level
from pcs_racing_agents.tournament.statistics.units import Floats, check_arms, check_values

__all__ = ["EffectSizes", "effect_sizes", "holm", "wilson"]


class EffectSizes(NamedTuple):
    """How large a difference is, in the units that different fields use.

    Attributes
    ----------
    cohen_d : float
        Mean difference over the standard deviation of the ego variants' differences.
    risk_difference : float
        Mean score of arm a minus that of arm b.
    risk_ratio : float
        Mean score of arm a divided by that of arm b; infinite where b scores nothing, NaN where neither does.
    odds_ratio : float
        Odds of scoring, arm a over arm b; 1 means no difference, infinite and NaN as above.
    """

    cohen_d: float
    risk_difference: float
    risk_ratio: float
    odds_ratio: float


def effect_sizes(a: ArrayLike, b: ArrayLike, ego: ArrayLike) -> EffectSizes:
    """Return how large the difference of two arms is; parameters and errors as for :func:`paired_t`."""
    first, second = check_arms(a, b)
    for name, values in (("a", first), ("b", second)):
        outside = (values < 0.0) | (values > 1.0)
        if outside.any():
            at = int(np.argmax(outside))
            raise InputError(f"{name}[{at}] is {values[at]:g}; risks and odds need scores from 0 to 1")
    mean_a, mean_b = float(first.mean()), float(second.mean())
    odds = mean_a * (1.0 - mean_b), mean_b * (1.0 - mean_a)
    d = paired_t(first, second, ego).cohen_d
    return EffectSizes(d, mean_a - mean_b, _quotient(mean_a, mean_b), _quotient(*odds))


def holm(p_values: ArrayLike) -> Floats:
    """Return the p-values of a table, adjusted so that all of them hold together (Holm 1979).

    The chance of one false positive or more among those below 0.05 is at most 0.05, however the tests depend on each
    other.

    Parameters
    ----------
    p_values : array_like, shape (T,)

    Returns
    -------
    ndarray, shape (T,)
        In the same order, from 0 to 1.

    Raises
    ------
    InputError
        If a value is not between 0 and 1.
    """
    p = check_values("p_values", p_values)
    wrong = (p < 0.0) | (p > 1.0)
    if wrong.any():
        at = int(np.argmax(wrong))
        raise InputError(f"p_values[{at}] is {p[at]:g}; it must be from 0 to 1")
    order = np.argsort(p, kind="stable")
    adjusted = np.empty_like(p)
    adjusted[order] = np.minimum(1.0, np.maximum.accumulate(p[order] * np.arange(len(p), 0, -1)))
    return adjusted


def wilson(successes: ArrayLike, races: ArrayLike, *, level: float = 0.95) -> tuple[Floats, Floats]:
    """Return Wilson's interval of rates of independent races (Wilson 1927).

    It is right for rates near 0 or 1, such as crash rates, but takes races as independent: where they share egos and
    opponents, :func:`clustered_mean` of the 0/1 outcomes is wider, and right.

    Parameters
    ----------
    successes, races : array_like
        Counts of the same shape, ``0 <= successes <= races`` and ``races >= 1``; ties may count half.
    level : float

    Returns
    -------
    low, high : ndarray

    Raises
    ------
    InputError
        If a count is impossible.
    """
    check_level(level)
    hits, n = np.broadcast_arrays(np.asarray(successes, dtype=np.float64), np.asarray(races, dtype=np.float64))
    wrong = ~((hits >= 0.0) & (hits <= n) & (n >= 1.0))
    if wrong.any():
        at = int(np.argmax(wrong.ravel()))
        raise InputError(
            f"{hits.ravel()[at]:g} successes in {n.ravel()[at]:g} races are impossible; "
            "there must be at least 1 race and from 0 to all of them successes"
        )
    z = NormalDist().inv_cdf(0.5 + 0.5 * level)
    rate = hits / n
    centre = (rate + z**2 / (2.0 * n)) / (1.0 + z**2 / n)
    half = z / (1.0 + z**2 / n) * np.sqrt(rate * (1.0 - rate) / n + z**2 / (4.0 * n**2))
    # At the ends the formula gives 0 and 1 but for the last digit.
    low = np.where(hits == 0.0, 0.0, centre - half)
    high = np.where(hits == n, 1.0, centre + half)
    return low, high


def _quotient(value: float, by: float) -> float:
    """Return ``value / by``; infinite for division by 0, NaN for 0 / 0."""
    if by > 0.0:
        return value / by
    return np.nan if value == 0.0 else np.inf
