"""Does one strategy race better than another? The mean difference, with an interval that knows of clusters.

A unit is one race that both arms drove: (ego start policy, opponent, start line, side). Units that share an ego policy
or an opponent go up and down together, so 4,000 races of 20 ego policies against 20 opponents are worth far less than
4,000 independent ones. Which estimator keeps its promises on such data is measured in ``docs/statistics.md``.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from pcs_racing.errors import InputError
from pcs_racing_agents.tournament.statistics.student_t import check_level, critical_value, two_sided_p
from pcs_racing_agents.tournament.statistics.units import Floats, Ints, check_arms, check_values, cluster_codes

__all__ = ["Comparison", "Estimate", "PairedT", "clustered_mean", "compare", "paired_t"]

KINDS = ("ego", "opponent", "start")


class Estimate(NamedTuple):
    """A mean over races that are not independent.

    Attributes
    ----------
    mean : float
    low, high : float
        Confidence interval.
    se : float
        Cluster-robust standard error.
    df : int
        Degrees of freedom of its t distribution: the smallest number of clusters minus 1.
    p : float
        Two-sided p-value of the mean being 0.
    units : int
        Number of races.
    clusters : tuple of int
        Number of clusters of each kind.
    """

    mean: float
    low: float
    high: float
    se: float
    df: int
    p: float
    units: int
    clusters: tuple[int, ...]


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


def clustered_mean(values: ArrayLike, *clusters: ArrayLike, level: float = 0.95) -> Estimate:
    """Return a mean with an interval that is robust to clusters of one or several crossed kinds.

    The variance adds up over the kinds of clusters and takes away what is counted twice (Cameron, Gelbach and Miller
    2011), each term with the factor ``G / (G - 1)`` of its own ``G`` clusters. As it can come out too small, even
    negative, where clusters matter little, it is at least the largest of its terms (MacKinnon, Nielsen and Webb 2024,
    arXiv 2406.08880, take the largest one-way term). The t distribution has the smallest ``G`` minus 1 degrees of
    freedom.

    Parameters
    ----------
    values : array_like, shape (U,)
        One number for each race; races may be missing from the crossed design.
    *clusters : array_like, shape (U,)
        For each kind of cluster the labels of the races, numbers or text: ego variant, opponent.
    level : float
        Level of the interval, between 0 and 1.

    Returns
    -------
    Estimate

    Raises
    ------
    InputError
        If a value is not finite, shapes differ, or a kind has fewer than two clusters.
    """
    check_level(level)
    x = check_values("values", values)
    if not clusters:
        raise InputError("there are no cluster labels; without them there is nothing to be robust to")
    coded = [cluster_codes(labels, x, KINDS[i] if i < len(KINDS) else "cluster") for i, labels in enumerate(clusters)]
    numbers = tuple(number for _, number in coded)
    mean = float(x.mean())
    residual = x - mean
    variance, largest = 0.0, 0.0
    for kinds in range(1, len(coded) + 1):
        for chosen in combinations(coded, kinds):
            term = _cluster_variance(residual, chosen)
            variance += term if kinds % 2 else -term
            largest = max(largest, term)
    se = float(np.sqrt(max(variance, largest)))
    df = min(numbers) - 1
    reach = critical_value(level, df) * se
    p = two_sided_p(_ratio(mean, se), df)
    return Estimate(mean, mean - reach, mean + reach, se, df, p, len(x), numbers)


def compare(
    a: ArrayLike,
    b: ArrayLike,
    ego: ArrayLike,
    opponent: ArrayLike,
    *,
    start: ArrayLike | None = None,
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
    result = clustered_mean(first - second, *kinds, level=level)
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
    p = two_sided_p(_ratio(mean, se), number - 1)
    return PairedT(mean, mean - reach, mean + reach, p, number - 1, _ratio(mean, deviation))


def _cluster_variance(residual: Floats, kinds: Sequence[tuple[Ints, int]]) -> float:
    """One-way variance of the mean for the clusters that share all the labels of these kinds."""
    codes, number = kinds[0]
    for more, size in kinds[1:]:
        codes = codes * size + more
        found, codes = np.unique(codes, return_inverse=True)
        number = len(found)
    sums = np.bincount(codes, residual)
    if number < 2:
        return 0.0
    return float(sums @ sums) / len(residual) ** 2 * number / (number - 1)


def _ratio(value: float, scale: float) -> float:
    """Return ``value / scale``; 0 where both are 0 (identical arms), infinite where only the scale is."""
    if scale > 0.0:
        return float(value / scale)
    return 0.0 if value == 0.0 else float(np.copysign(np.inf, value))
