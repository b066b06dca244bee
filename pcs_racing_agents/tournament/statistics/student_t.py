"""Student's t distribution: the interval and the p-value of an estimate that has a standard error."""

import math

from pcs_racing.base.errors import InputError


def t_interval(mean: float, se: float, df: int, level: float) -> tuple[float, float, float]:
    """Return the confidence interval of an estimate, and the two-sided p-value of its being 0.

    Parameters
    ----------
    mean, se : float
        Estimate and its standard error.
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
