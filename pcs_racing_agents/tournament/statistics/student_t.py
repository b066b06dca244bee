"""Student's t distribution without scipy: tail probabilities, critical values, and the power of a t-test."""

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.errors import InputError

__all__ = ["check_level", "critical_value", "noncentral_power", "two_sided_p"]

Floats = NDArray[np.float64]

NODES = 128


def two_sided_p(t: float, df: int) -> float:
    """Return the probability that ``|T| >= |t|`` under Student's t distribution.

    With ``tan(x) = t / sqrt(df)`` the density becomes proportional to ``cos(x)**(df - 1)``; the tail itself is
    integrated, so that small probabilities keep their relative precision (1e-10 against scipy for ``df`` to 1000).

    Parameters
    ----------
    t : float
        Infinity is allowed.
    df : int
        Degrees of freedom, at least 1.

    Returns
    -------
    float
        From 0 to 1.

    Raises
    ------
    InputError
        If ``df`` is below 1 or ``t`` is NaN.
    """
    if math.isnan(t):
        raise InputError("t is nan; a test statistic must be a number")
    if not df >= 1:
        raise InputError(f"df is {df!r}; there must be at least 1 degree of freedom")
    if math.isinf(t):
        return 0.0
    end = math.atan2(math.sqrt(df), abs(t))
    at, weights = _quadrature(0.0, end)
    log_scale = math.lgamma((df + 1) / 2) - math.lgamma(df / 2) + math.log(2.0) - 0.5 * math.log(math.pi)
    with np.errstate(divide="ignore"):
        density = np.exp(log_scale + (df - 1) * np.log(np.sin(at)))
    return min(1.0, float(density @ weights))


@lru_cache(maxsize=256)
def critical_value(level: float, df: int) -> float:
    """Return the ``t`` that a confidence interval of this level uses: ``two_sided_p(t, df) == 1 - level``.

    Raises
    ------
    InputError
        If the level is not between 0 and 1 or ``df`` is below 1.
    """
    check_level(level)
    alpha = 1.0 - level
    low, high = 0.0, 1.0
    while two_sided_p(high, df) > alpha:
        low, high = high, 2.0 * high
    for _ in range(80):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if two_sided_p(middle, df) > alpha else (low, middle)
    return 0.5 * (low + high)


def noncentral_power(shift: float, df: int, level: float = 0.95) -> float:
    """Return the probability that a two-sided t-test rejects when the true effect is ``shift`` standard errors.

    ``P(|Z + shift| > c S)`` with ``Z`` normal, ``S = sqrt(chi2(df) / df)`` and ``c`` the critical value, integrated
    over ``S`` (the non-central t distribution).

    Parameters
    ----------
    shift : float
        True effect divided by its standard error.
    df : int
        At least 1.
    level : float
        1 minus the size of the test.

    Returns
    -------
    float
        From 0 to 1.
    """
    limit = critical_value(level, df)
    # S lies within these bounds but for 1e-9: the mean of a chi-square plus and minus 6.5 sd, and 0 where it is skewed.
    spread = 6.5 / math.sqrt(df)
    at, weights = _quadrature(max(0.0, 1.0 - spread), 1.0 + spread)
    log_density = math.log(2.0) + 0.5 * df * math.log(0.5 * df) - math.lgamma(0.5 * df)
    with np.errstate(divide="ignore"):
        density = np.exp(log_density + (df - 1) * np.log(at) - 0.5 * df * at**2)
    beyond = [_normal_tail(limit * s - shift) + _normal_tail(limit * s + shift) for s in at]
    return min(1.0, float(np.array(beyond) @ (density * weights)))


def check_level(level: float) -> None:
    """Raise InputError unless the level of an interval is between 0 and 1."""
    if not 0.0 < level < 1.0:
        raise InputError(f"level is {level!r}; it must be between 0 and 1, for instance 0.95")


def _normal_tail(x: float) -> float:
    return 0.5 * math.erfc(x / math.sqrt(2.0))


def _quadrature(low: float, high: float) -> tuple[Floats, Floats]:
    """Gauss-Legendre nodes and weights on an interval."""
    nodes, weights = _nodes()
    half = 0.5 * (high - low)
    return low + half * (nodes + 1.0), half * weights


@lru_cache(maxsize=1)
def _nodes() -> tuple[Floats, Floats]:
    nodes, weights = np.polynomial.legendre.leggauss(NODES)
    return nodes, weights
