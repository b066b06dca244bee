"""Comparison of two arms (agents) over the same units.

A unit is one race that both arms drove: (ego start policy, opponent, start line, side). Units that share an ego policy
or an opponent are correlated, so 4,000 races of 20 ego policies against 20 opponents hold far less information than
4,000 independent ones. ``docs/reports/statistics.md`` measures the coverage of the estimators on such data.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from pcs_racing.base.errors import InputError
from pcs_racing_agents.tournament.statistics.clusters import (
    Floats,
    check_arms,
    check_values,
    cluster_codes,
    clustered_mean,
    ratio,
    t_interval,
)


@dataclass(frozen=True)
class Comparison:
    """Result of a comparison of arm a with arm b over the same races."""

    mean_a: float  #: ``mean_a``, ``mean_b``: Mean scores.
    mean_b: float
    difference: float  #: ``mean_a - mean_b``.
    #: ``low``, ``high``: Interval of the difference, robust to ego and opponent clusters; the result to quote.
    low: float
    high: float
    se: float  #: Standard error behind it.
    df: int  #: Its degrees of freedom.
    p_clustered: float  #: Two-sided p-value that belongs to it.
    #: p-value of the paper's test over ego variants. It takes the opponents as given: it is about these ones only.
    p_paired_t: float
    cohen_d: float  #: Difference over the standard deviation of the ego variants' differences.
    units: int  #: ``units``, ``egos``, ``opponents``: Number of races of each arm, of ego variants and of opponents.
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
        Scores of the arms (:func:`score`: 1 win, 0.5 tie, 0 else), race by race in the same order
        (:func:`match_units`).
    ego, opponent : array_like, shape (U,)
        Labels of the ego start policy and of the opponent of each race. A single opponent is taken as given.
    start : array_like, shape (U,), optional
        Labels of the start lines, where all pairs shared the same few: they are then a third kind of cluster. Leave it
        out where every pair had lines of its own.
    """
    first, second = check_arms(a, b)
    single = len(np.unique(np.asarray(opponent))) == 1  # such as a driver with one policy: the interval is for this one
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

    The family-wise error rate at 0.05 is at most 0.05, however the tests depend on each other. (scipy adjusts for the
    false discovery rate only.)

    Both have shape (T,) and the same order.
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


def _paired_t(differences: Floats, ego: ArrayLike) -> tuple[float, float]:
    """Return the p-value and Cohen's d of the paper's paired t-test over the ego variants.

    Each variant's races are averaged first. The test takes the opponents as given; where an arm's advantage varies over
    opponents it rejects a true null hypothesis about all such opponents too often.
    """
    codes, number = cluster_codes(ego, differences, "ego")
    means = np.bincount(codes, differences) / np.bincount(codes)
    mean, deviation = float(means.mean()), float(means.std(ddof=1))
    if deviation <= 1e-12 * float(np.abs(means).max()):
        deviation = 0.0  # equal differences whose means differ in the last digit
    _, _, p = t_interval(mean, deviation / math.sqrt(number), number - 1)
    return p, ratio(mean, deviation)
