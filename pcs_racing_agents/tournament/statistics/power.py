"""How many egos and opponents does an effect need? Components of the variance, and the power of a design."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from pcs_racing.base.errors import InputError
from pcs_racing_agents.tournament.statistics.student_t import check_level, noncentral_power
from pcs_racing_agents.tournament.statistics.units import check_values, cluster_codes

__all__ = ["VarianceComponents", "detectable_effect", "power", "variance_components"]


class VarianceComponents(NamedTuple):
    """Where the differences between two arms vary; all are variances of one race's difference in score.

    Attributes
    ----------
    ego, opponent : float
        Between ego variants and between opponents.
    cell : float
        Between pairs of an ego variant and an opponent, beyond what each of them brings.
    unit : float
        Between the races of one pair.
    """

    ego: float
    opponent: float
    cell: float
    unit: float


def variance_components(values: ArrayLike, ego: ArrayLike, opponent: ArrayLike) -> VarianceComponents:
    """Estimate the components of a fully crossed design from its mean squares (analysis of variance).

    Parameters
    ----------
    values : array_like, shape (U,)
        Differences of two arms, race by race, for instance of a pilot study.
    ego, opponent : array_like, shape (U,)
        Labels. Every ego must have raced every opponent equally often. If that is once, ``cell`` and ``unit`` can't be
        told apart and all of it is ``cell``.

    Returns
    -------
    VarianceComponents
        Negative estimates count as 0.

    Raises
    ------
    InputError
        If a value is not finite, shapes differ, there are fewer than two egos or opponents, or the design is not
        balanced.
    """
    x = check_values("values", values)
    egos, n_egos = cluster_codes(ego, x, "ego")
    opponents, n_opponents = cluster_codes(opponent, x, "opponent")
    cell = egos * n_opponents + opponents
    count = np.bincount(cell, minlength=n_egos * n_opponents)
    if count.min() != count.max():
        raise InputError(
            f"pairs of ego and opponent have {count.min()} to {count.max()} races; "
            "variance components need equally many"
        )
    repeats = int(count[0])
    means = np.bincount(cell, x) / repeats
    within = x - means[cell]
    table = means.reshape(n_egos, n_opponents)
    by_ego, by_opponent, mean = table.mean(axis=1), table.mean(axis=0), table.mean()
    rest = table - by_ego[:, None] - by_opponent + mean
    square_ego = repeats * n_opponents * ((by_ego - mean) ** 2).sum() / (n_egos - 1)
    square_opponent = repeats * n_egos * ((by_opponent - mean) ** 2).sum() / (n_opponents - 1)
    square_cell = repeats * (rest**2).sum() / ((n_egos - 1) * (n_opponents - 1))
    unit = float((within**2).sum() / (len(x) - len(count))) if repeats > 1 else 0.0
    return VarianceComponents(
        ego=max(0.0, float(square_ego - square_cell) / (repeats * n_opponents)),
        opponent=max(0.0, float(square_opponent - square_cell) / (repeats * n_egos)),
        cell=max(0.0, (float(square_cell) - unit) / repeats),
        unit=unit,
    )


def power(
    effect: float,
    components: VarianceComponents,
    *,
    egos: int = 20,
    opponents: int = 20,
    races: int = 10,
    level: float = 0.95,
) -> float:
    """Return the probability that the interval of :func:`compare` excludes 0, in a crossed design.

    A t-test with ``min(egos, opponents) - 1`` degrees of freedom and the standard error that the components give. It
    is an approximation: the clustered standard error is not exactly a chi variable. ``docs/statistics.md`` holds it
    against simulations.

    Parameters
    ----------
    effect : float
        True mean difference in score.
    components : VarianceComponents
    egos, opponents : int
        Numbers of variants, at least 2.
    races : int
        Races of each pair, at least 1 (in the paper 2 sides x 5 start lines = 10).
    level : float

    Returns
    -------
    float
        From 0 to 1.

    Raises
    ------
    InputError
        If a number is impossible.
    """
    se = _standard_error(components, egos, opponents, races)
    check_level(level)
    if not math.isfinite(effect):
        raise InputError(f"effect is {effect!r}; it must be a finite number")
    if se == 0.0:
        return 0.0 if effect == 0.0 else 1.0
    return noncentral_power(effect / se, min(egos, opponents) - 1, level)


def detectable_effect(
    components: VarianceComponents,
    *,
    egos: int = 20,
    opponents: int = 20,
    races: int = 10,
    level: float = 0.95,
    wanted: float = 0.8,
) -> float:
    """Return the smallest effect that a design finds with the wanted power.

    Parameters and errors as for :func:`power`; ``wanted`` lies between the test's size and 1.
    """
    se = _standard_error(components, egos, opponents, races)
    check_level(level)
    if not 1.0 - level < wanted < 1.0:
        raise InputError(
            f"wanted power is {wanted!r}; it must be above {1.0 - level:g}, which chance gives, and below 1"
        )
    df = min(egos, opponents) - 1
    low, high = 0.0, 1.0
    while noncentral_power(high, df, level) < wanted:
        low, high = high, 2.0 * high
    for _ in range(50):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if noncentral_power(middle, df, level) < wanted else (low, middle)
    return high * se


def _standard_error(components: VarianceComponents, egos: int, opponents: int, races: int) -> float:
    for name, number, least in (("egos", egos, 2), ("opponents", opponents, 2), ("races", races, 1)):
        if not number >= least:
            raise InputError(f"{name} is {number!r}; it must be at least {least}")
    for name, variance in zip(components._fields, components, strict=True):
        if not 0.0 <= variance < math.inf:
            raise InputError(f"the variance component {name} is {variance!r}; it must be 0 or more")
    pairs = egos * opponents
    return math.sqrt(
        components.ego / egos
        + components.opponent / opponents
        + components.cell / pairs
        + components.unit / (pairs * races)
    )
