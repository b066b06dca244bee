"""Does one strategy race better than another? Two arms that raced the same units.

A unit is one race that both arms drove: (ego start policy, opponent, start line, side). Units that share an ego policy
or an opponent go up and down together, so 4,000 races of 20 ego policies against 20 opponents are worth far less than
4,000 independent ones. Which estimator keeps its promises on such data is measured in ``docs/statistics.md``.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from pcs_racing_agents.tournament.statistics.clusters import clustered_mean, ratio
from pcs_racing_agents.tournament.statistics.student_t import check_level, critical_value, two_sided_p
from pcs_racing_agents.tournament.statistics.units import check_arms, cluster_codes

__all__ = ["Comparison", "PairedT", "compare", "paired_t"]


class PairedT(NamedTuple):
    """The paper's test: a paired t-test over the means of the ego variants.

    Attributes
    ----------
    difference : float
        Mean over ego variants of (mean of arm a minus mean of arm b), each variant counting alike.
    low, high : float
        The interval that belongs to the test.
    p : float
        Two-sided.
    df : int
        Ego variants minus 1.
    cohen_d : float
        Difference divided by the standard deviation of the variants' differences.
    """

    difference: float
    low: float
    high: float
    p: float
    df: int
    cohen_d: float


@dataclass(frozen=True)
class Comparison:
    """Arm a against arm b over the same races.

    Attributes
    ----------
    mean_a, mean_b : float
        Mean scores.
    difference : float
        ``mean_a - mean_b``.
    low, high : float
        Interval of the difference, robust to ego and opponent clusters; the result to quote.
    se : float
        Standard error behind it.
    df : int
        Its degrees of freedom.
    p_clustered : float
        Two-sided p-value that belongs to it.
    p_paired_t : float
        The paper's test over ego variants. It takes the opponents as given: it speaks about these ones only.
    cohen_d : float
        Difference over the standard deviation of the ego variants' differences.
    units, egos, opponents : int
        Number of races of each arm, of ego variants and of opponents.
    level : float
        Level of the interval.
    """

    mean_a: float
    mean_b: float
    difference: float
    low: float
    high: float
    se: float
    df: int
    p_clustered: float
    p_paired_t: float
    cohen_d: float
    units: int
    egos: int
    opponents: int
    level: float


def compare(
    a: ArrayLike,
    b: ArrayLike,
    ego: ArrayLike,
    opponent: ArrayLike,
    *,
    start: ArrayLike | None = None,
    same_pool: bool = False,
    level: float = 0.95,
) -> Comparison:
    """Compare two arms that raced the same units.

    Parameters
    ----------
    a, b : array_like, shape (U,)
        Scores of the arms (:func:`score`: 1 win, 0.5 tie, 0 else), race by race in the same order
        (:func:`match_units`).
    ego, opponent : array_like, shape (U,)
        Labels of the ego start policy and of the opponent of each race.
    start : array_like, shape (U,), optional
        Labels of the start lines, where all pairs shared the same few: they are then a third kind of cluster. Leave it
        out where every pair had lines of its own.
    same_pool : bool
        The same policies were egos and opponents, under the same labels (:func:`clustered_mean`).
    level : float
        Level of the interval, between 0 and 1.

    Returns
    -------
    Comparison

    Raises
    ------
    InputError
        If a score is not finite, shapes differ, or there are fewer than two ego variants, opponents or start lines.
    """
    first, second = check_arms(a, b)
    kinds = (ego, opponent) if start is None else (ego, opponent, start)
    result = clustered_mean(first - second, *kinds, same_pool=same_pool, level=level)
    paired = paired_t(first, second, ego, level=level)
    return Comparison(
        mean_a=float(first.mean()),
        mean_b=float(second.mean()),
        difference=result.mean,
        low=result.low,
        high=result.high,
        se=result.se,
        df=result.df,
        p_clustered=result.p,
        p_paired_t=paired.p,
        cohen_d=paired.cohen_d,
        units=result.units,
        egos=result.clusters[0],
        opponents=result.clusters[1],
        level=level,
    )


def paired_t(a: ArrayLike, b: ArrayLike, ego: ArrayLike, *, level: float = 0.95) -> PairedT:
    """Return the paper's paired t-test over the ego variants (20 of them there: 19 degrees of freedom).

    Each variant's races are averaged first. The test takes the opponents as given; where an arm's advantage varies over
    opponents it rejects a true null hypothesis about all such opponents too often.

    Parameters
    ----------
    a, b : array_like, shape (U,)
    ego : array_like, shape (U,)
    level : float

    Raises
    ------
    InputError
        If a score is not finite, shapes differ, or there are fewer than two ego variants.
    """
    check_level(level)
    first, second = check_arms(a, b)
    codes, number = cluster_codes(ego, first, "ego")
    differences = np.bincount(codes, first - second) / np.bincount(codes)
    mean, deviation = float(differences.mean()), float(differences.std(ddof=1))
    if deviation <= 1e-12 * float(np.abs(differences).max()):
        deviation = 0.0  # equal differences whose means differ in the last digit
    se = deviation / np.sqrt(number)
    reach = critical_value(level, number - 1) * se
    p = two_sided_p(ratio(mean, se), number - 1)
    return PairedT(mean, mean - reach, mean + reach, p, number - 1, ratio(mean, deviation))
