"""Cluster-robust intervals: the mean of races that share egos, opponents or start lines; Student's t."""

import math
from functools import reduce
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from pcs_racing.base.errors import InputError
from pcs_racing_agents.tournament.statistics.units import Floats, Ints, check_values, cluster_codes, pool_codes


def t_interval(mean: float, se: float, df: int, level: float) -> tuple[float, float, float]:
    """Return the confidence interval of an estimate, and the two-sided p-value of its being 0.

    Parameters
    ----------
    df : int
        Degrees of freedom, at least 1.
    level : float
        Level of the interval, between 0 and 1.

    Returns
    -------
    low, high, p : float
    """
    from scipy.special import stdtr, stdtrit  # a quarter of a second that importing this package does not pay

    reach = float(stdtrit(df, 0.5 + 0.5 * level)) * se
    t = abs(ratio(mean, se))
    p = 0.0 if math.isinf(t) else 2.0 * float(stdtr(df, -t))
    return mean - reach, mean + reach, p


def ratio(value: float, scale: float) -> float:
    """Return ``value / scale``; 0 where both are 0 (identical arms), infinite where only the scale is."""
    if scale > 0.0:
        return float(value / scale)
    return 0.0 if value == 0.0 else math.copysign(math.inf, value)


def check_level(level: float) -> None:
    """Raise InputError unless the level of an interval is between 0 and 1."""
    if not 0.0 < level < 1.0:
        raise InputError(f"level is {level!r}; it must be between 0 and 1, for instance 0.95")


Kind = tuple[Ints, ...]
"""One code for each race, or two where races of a kind of cluster share it in either of two roles; shape (U,) each."""

KINDS = ("ego", "opponent", "start")


class Estimate(NamedTuple):
    """A mean over races that are not independent."""

    mean: float
    low: float  #: ``low``, ``high``: Confidence interval.
    high: float
    se: float  #: Cluster-robust standard error.
    df: int  #: Degrees of freedom of its t distribution: the smallest number of clusters minus 1.
    p: float  #: Two-sided p-value of the mean being 0.
    units: int  #: Number of races.
    clusters: tuple[int, ...]  #: Number of clusters of each kind.


def clustered_mean(values: ArrayLike, *clusters: ArrayLike, same_pool: bool = False, level: float = 0.95) -> Estimate:
    """Return a mean with an interval that is robust to clusters of one or several crossed kinds.

    The variance is the sum over the kinds of clusters minus what is counted twice (Cameron, Gelbach and Miller
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
    same_pool : bool
        Egos and opponents, the first two kinds, were drawn from one pool of policies and have the same labels: races
        that share a policy, in either role, then form a cluster (Aronow, Samii and Assenova 2015). The variance is the
        larger one of the two with and without this.
    level : float
        Level of the interval, between 0 and 1.
    """
    check_level(level)
    x = check_values("values", values)
    if not clusters:
        raise InputError("there are no cluster labels; without them there is nothing to be robust to")
    coded = [cluster_codes(labels, x, KINDS[i] if i < len(KINDS) else "cluster") for i, labels in enumerate(clusters)]
    numbers = tuple(number for _, number in coded)
    kinds: list[Kind] = [(codes,) for codes, _ in coded]
    mean = float(x.mean())
    variance = _variance(x - mean, kinds)
    if same_pool:
        if len(clusters) < 2:
            raise InputError("same_pool is about the labels of ego and opponent; give both")
        variance = max(variance, _variance(x - mean, [pool_codes(clusters[0], clusters[1]), *kinds[2:]]))
    se = float(np.sqrt(variance))
    df = min(numbers) - 1
    low, high, p = t_interval(mean, se, df, level)
    return Estimate(mean, low, high, se, df, p, len(x), numbers)


def _variance(residual: Floats, kinds: list[Kind]) -> float:
    """Return the variance of the mean: every pair of races that share a label of some kind counts once."""
    variance, largest = 0.0, 0.0
    for number in range(1, len(kinds) + 1):
        for subset in combinations(kinds, number):
            term = _shared_variance(residual, reduce(_joined, subset))
            variance += term if number % 2 else -term
            largest = max(largest, term)
    return max(variance, largest)


def _joined(kind: Kind, other: Kind) -> Kind:
    """Return the codes of races that share a label of both kinds; the second one has a single code."""
    (more,) = other
    codes = np.concatenate([codes * (int(more.max()) + 1) + more for codes in kind])
    _, small = np.unique(codes, return_inverse=True)
    return tuple(np.split(small, len(kind)))


def _shared_variance(residual: Floats, kind: Kind) -> float:
    """Sum over all pairs of races that share a label of this kind, divided by the number of races squared.

    With two codes for each race (the policies of a pool that drove it) a pair may share both; it counts once.
    """
    size = max(int(codes.max()) for codes in kind) + 1
    first, last = kind[0], kind[-1]
    two = first != last
    sums = np.bincount(first, residual, size) + np.bincount(last[two], residual[two], size)
    number = int(np.count_nonzero(np.bincount(first, minlength=size) + np.bincount(last, minlength=size)))
    total = sums @ sums * _correction(number)
    if two.any():
        pairs = np.minimum(first, last)[two] * size + np.maximum(first, last)[two]
        _, pair = np.unique(pairs, return_inverse=True)
        twice = np.bincount(pair, residual[two])
        total -= twice @ twice * _correction(len(twice))
    return float(total) / len(residual) ** 2


def _correction(clusters: int) -> float:
    return clusters / (clusters - 1) if clusters > 1 else 0.0
