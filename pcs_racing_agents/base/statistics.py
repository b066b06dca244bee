"""Statistics of paired races: scores, cluster-robust means, comparisons of two arms, p-values.

An arm is an agent in a comparison. P-values of a table are adjusted for multiple testing.

A unit is one race of both arms: (number, ego start policy, opponent, start line, side). Units with
a common ego policy or opponent are correlated: 4,000 races of 20 ego policies against 20 opponents
hold far less information than 4,000 independent races. ``docs/reports/statistics.md`` measures the
coverage of the estimators on such data.
"""

import math
from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from functools import reduce
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.errors import InputError, check_array
from pcs_racing.base.typing import Floats

Ints = NDArray[np.intp]


def match_units(units_a: Sequence[Hashable], units_b: Sequence[Hashable]) -> Ints:
    """Return the order of arm b's units that matches arm a: ``units_b[order[i]] == units_a[i]``.

    A unit identifies a race, for instance ``(race, ego, opponent, start_s, side)``.
    """
    index_a, index_b = ({unit: i for i, unit in enumerate(units)} for units in (units_a, units_b))
    for arm, units, index in (("a", units_a, index_a), ("b", units_b, index_b)):
        if len(index) < len(units):
            twice = next(unit for i, unit in enumerate(units) if index[unit] != i)
            raise InputError(
                f"arm {arm} raced unit {twice!r} more than once; every unit must be there once"
            )
    for arm, own, others in (("b", index_a, index_b), ("a", index_b, index_a)):
        missing = [unit for unit in own if unit not in others]
        if missing:
            raise InputError(
                f"arm {arm} did not race unit {missing[0]!r} ({len(missing)} missing); both must"
                " race the same units"
            )
    return np.array([index_b[unit] for unit in units_a], dtype=np.intp)


def _cluster_codes(labels: ArrayLike, races: int, kind: str) -> tuple[Ints, int]:
    """Return labels as codes from 0, shape (U,), and their distinct count; InputError below 2."""
    array = np.asarray(labels)
    if array.shape != (races,):
        raise InputError(
            f"{kind} labels have shape {array.shape}; there must be one for each of {races} races"
        )
    is_float = array.dtype.kind == "f"
    if array.dtype.kind not in "biufUS" or (is_float and not np.isfinite(array).all()):
        raise InputError(f"{kind} labels must be text or finite numbers, not {array.dtype}")
    # Labels are only compared, never ordered or averaged: they may be text or numbers.
    unique, codes = np.unique(array, return_inverse=True)
    if len(unique) < 2:
        raise InputError(
            f"{kind} labels are {unique.tolist()}; a test needs at least 2 variants, since it looks"
            " at how they differ"
        )
    return codes.astype(np.intp), len(unique)


def t_interval(mean: float, se: float, df: int) -> tuple[float, float, float]:
    """Return both ends of an estimate's 95 % interval, and the two-sided p-value of the value 0."""
    from scipy.special import stdtr, stdtrit  # local: the import takes 0.25 s

    reach = float(stdtrit(df, 0.975)) * se
    t = abs(_ratio(mean, se))
    p = 0.0 if math.isinf(t) else 2.0 * float(stdtr(df, -t))
    return mean - reach, mean + reach, p


def _ratio(value: float, scale: float) -> float:
    """Return ``value / scale``; 0 if both are 0 (identical arms), infinite if only scale is 0."""
    if scale > 0.0:
        return float(value / scale)
    return 0.0 if value == 0.0 else math.copysign(math.inf, value)


Kind = tuple[Ints, ...]
"""Cluster codes: one array, or two for clusters shared between two roles; shape (U,) each."""

KINDS = ("ego", "opponent", "start")


class Estimate(NamedTuple):
    """Estimate of a mean over dependent races."""

    mean: float
    low: float  #: ``low``, ``high``: 95 % confidence interval.
    high: float
    se: float  #: Cluster-robust standard error.
    df: int  #: Degrees of freedom of the t distribution: minimum number of clusters minus 1.
    p: float  #: Two-sided p-value for a mean of 0.
    units: int  #: Number of races.
    clusters: tuple[int, ...]  #: Number of clusters of each kind.


def clustered_mean(values: ArrayLike, *clusters: ArrayLike, same_pool: bool = False) -> Estimate:
    """Return a mean with an interval that is robust to clusters of one or several crossed kinds.

    The variance is the sum over the kinds of clusters minus double counts (Cameron, Gelbach and
    Miller 2011), each term with the factor ``G / (G - 1)`` of its ``G`` clusters. For weak clusters
    this sum can be too small, even negative; the variance is therefore at least the maximum of its
    terms (MacKinnon, Nielsen and Webb 2024, arXiv 2406.08880, take the maximum one-way term). The t
    distribution has ``min(G) - 1`` degrees of freedom.

    Parameters
    ----------
    values : array_like, shape (U,)
        One number for each race; races may be missing from the crossed design.
    *clusters : array_like, shape (U,)
        Race labels (numbers or text) for each kind of cluster: ego variant, opponent.
    same_pool : bool
        True if egos and opponents, the first two kinds, come from one pool of policies with common
        labels. Races with a common policy, in either role, then form a cluster (Aronow, Samii and
        Assenova 2015). The variance is the maximum of the variances with and without these
        clusters.
    """
    x = check_array("values", values, (None,))
    if not clusters:
        raise InputError(
            "there are no cluster labels; without them there is nothing to be robust to"
        )
    names = [*KINDS, *["cluster"] * len(clusters)]
    coded = [
        _cluster_codes(labels, len(x), name) for labels, name in zip(clusters, names, strict=False)
    ]
    numbers = tuple(number for _, number in coded)
    kinds: list[Kind] = [(codes,) for codes, _ in coded]
    mean = float(x.mean())
    variance = _variance(x - mean, kinds)
    if same_pool:
        if len(clusters) < 2:
            raise InputError("same_pool is about the labels of ego and opponent; give both")
        labels = np.concatenate([np.asarray(labels) for labels in clusters[:2]])
        pool = np.unique(labels, return_inverse=True)[1].reshape(2, -1)
        variance = max(variance, _variance(x - mean, [tuple(pool), *kinds[2:]]))
    se = float(np.sqrt(variance))
    # The minimum number of clusters limits the information, for any number of races.
    df = min(numbers) - 1
    low, high, p = t_interval(mean, se, df)
    return Estimate(mean, low, high, se, df, p, len(x), numbers)


def varied(*labels: ArrayLike) -> list[ArrayLike]:
    """Return the cluster labels with variation, else the races themselves as clusters.

    Labels without variation have no measurable spread, and are taken as given.
    """
    return [one for one in labels if len(np.unique(one)) > 1] or [
        np.arange(len(np.asarray(labels[0])))
    ]


def _variance(residual: Floats, kinds: list[Kind]) -> float:
    """Return the variance of the mean; every pair of races with a common label counts once."""
    variance, largest = 0.0, 0.0
    for number in range(1, len(kinds) + 1):
        for subset in combinations(kinds, number):
            term = _shared_variance(residual, reduce(_joined, subset))
            variance += term if number % 2 else -term
            largest = max(largest, term)
    return max(variance, largest)


def _joined(kind: Kind, other: Kind) -> Kind:
    """Return the codes of the intersection of two kinds; the second kind has a single code."""
    (more,) = other
    codes = np.concatenate([codes * (int(more.max()) + 1) + more for codes in kind])
    _, small = np.unique(codes, return_inverse=True)
    return tuple(np.split(small, len(kind)))


def _shared_variance(residual: Floats, kind: Kind) -> float:
    """Return the sum over all pairs of races with a common label, divided by the races squared.

    With two codes for each race (two policies of one pool) a pair may share both; it counts once.
    """
    # The sum over pairs equals the sum of squared cluster sums: linear cost, not quadratic.
    size = max(int(codes.max()) for codes in kind) + 1
    first, last = kind[0], kind[-1]
    two = first != last
    sums = np.bincount(first, residual, size) + np.bincount(last[two], residual[two], size)
    number = int(
        np.count_nonzero(np.bincount(first, minlength=size) + np.bincount(last, minlength=size))
    )
    total = sums @ sums * _correction(number)
    # Two races with the same two policies were counted twice, once for each policy.
    if two.any():
        pairs = np.minimum(first, last)[two] * size + np.maximum(first, last)[two]
        _, pair = np.unique(pairs, return_inverse=True)
        twice = np.bincount(pair, residual[two])
        total -= twice @ twice * _correction(len(twice))
    return float(total) / len(residual) ** 2


def _correction(clusters: int) -> float:
    return clusters / (clusters - 1) if clusters > 1 else 0.0


@dataclass(frozen=True)
class Comparison:
    """Comparison of arm a with arm b over the same races."""

    mean_a: float  #: ``mean_a``, ``mean_b``: Mean scores.
    mean_b: float
    difference: float  #: ``mean_a - mean_b``.
    #: ``low``, ``high``: Interval of the difference, robust to ego and opponent clusters; the
    #: result to quote.
    low: float
    high: float
    se: float  #: Standard error of this interval.
    df: int  #: Degrees of freedom of this interval.
    p_clustered: float  #: Two-sided p-value of this interval.
    #: p-value of the paper's test over ego variants; it applies only to the opponents of the data.
    p_paired_t: float
    cohen_d: float  #: Difference over the standard deviation of the ego variants' differences.
    #: ``units``, ``egos``, ``opponents``: Number of races per arm, ego variants, and opponents.
    units: int
    egos: int
    opponents: int


def compare(
    a: ArrayLike,
    b: ArrayLike,
    ego: ArrayLike,
    opponent: ArrayLike,
    *,
    start: ArrayLike | None = None,
) -> Comparison:
    """Compare two arms that raced the same units.

    Parameters
    ----------
    a, b : array_like, shape (U,)
        Scores of the arms (1 for a win, 0.5 for a tie, else 0), race by race in the same order
        (:func:`match_units`).
    ego, opponent : array_like, shape (U,)
        Labels of the ego start policy and of the opponent of each race. A single opponent is no
        cluster: the result applies to this opponent.
    start : array_like, shape (U,), optional
        Labels of the start lines, a third kind of cluster. Use it if all pairs share a few lines;
        omit it if every pair has its own lines.
    """
    first, second = check_array("a", a, (None,)), check_array("b", b, (None,))
    if first.shape != second.shape:
        raise InputError(
            f"a has {len(first)} scores and b {len(second)}; both arms must have raced the same"
            " units"
        )
    # A single opponent is one cluster without spread: the interval applies to this opponent.
    single = len(np.unique(np.asarray(opponent))) == 1
    kinds = [ego, *([] if single else [opponent]), *([] if start is None else [start])]
    result = clustered_mean(first - second, *kinds)
    p_paired_t, cohen_d = _paired_t(first - second, ego)
    return Comparison(
        mean_a=float(first.mean()),
        mean_b=float(second.mean()),
        difference=result.mean,
        low=result.low,
        high=result.high,
        se=result.se,
        df=result.df,
        p_clustered=result.p,
        p_paired_t=p_paired_t,
        cohen_d=cohen_d,
        units=result.units,
        egos=result.clusters[0],
        opponents=1 if single else result.clusters[1],
    )


def holm(p_values: ArrayLike) -> Floats:
    """Return the p-values of a table, adjusted for multiple testing by Holm's method (1979).

    The family-wise error rate at 0.05 is at most 0.05 for any dependence of the tests. (scipy only
    adjusts for the false discovery rate.)

    Argument and result have shape (T,) and the same order.
    """
    p = check_array("p_values", p_values, (None,))
    order = np.argsort(p, kind="stable")
    adjusted = np.empty_like(p)
    # The running maximum preserves the order of the p-values.
    adjusted[order] = np.minimum(1.0, np.maximum.accumulate(p[order] * np.arange(len(p), 0, -1)))
    return adjusted


def _paired_t(differences: Floats, ego: ArrayLike) -> tuple[float, float]:
    """Return the p-value and Cohen's d of the paper's paired t-test over the ego variants.

    Each variant's races are averaged first. The test is conditional on the opponents: if an arm's
    advantage varies between opponents, it rejects a true null hypothesis about the population of
    opponents too often.
    """
    codes, number = _cluster_codes(ego, len(differences), "ego")
    means = np.bincount(codes, differences) / np.bincount(codes)
    mean, deviation = float(means.mean()), float(means.std(ddof=1))
    if deviation <= 1e-12 * float(np.abs(means).max()):
        deviation = 0.0  # equal differences with means that differ in the last digit
    _, _, p = t_interval(mean, deviation / math.sqrt(number), number - 1)
    return p, _ratio(mean, deviation)
