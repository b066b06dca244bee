"""Learned characteristics: from a payoff matrix and behaviour in short segments of races to axes of a space.

1. All pairs of a pool race (:func:`~pcs_racing_agents.policies.policy_pool.pool_payoffs`). The mean payoff matrix of
   all circuits gives each policy a rating and a place in the leading cyclic plane.
2. Every policy is measured in segments of races: other characteristics, such as speed and restraint.
3. Ridge regression of 1 on 2, with cross-validation that leaves policies and circuits out. The result is a
   characteristic like any other: it can be estimated from what is seen of an opponent in one segment.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Unpack

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.errors import ConfigError, InputError
from pcs_racing.base.settings import Settings, checked, names, plain_settings, setting, tenths, whole
from pcs_racing.game.characteristics import get_characteristics
from pcs_racing.planners.planner import Policy
from pcs_racing_agents.base.jobs import Run
from pcs_racing_agents.policies.policy_pool import PolicyPool, pool_payoffs
from studies.axes.behaviour import common_planner, measure_behaviour
from studies.axes.coordinates import COORDINATES, PayoffCoordinates, payoff_coordinates
from studies.axes.learned import LearnedAxis, LearnedCharacteristics, LearnedInput, check_set_name
from studies.axes.ridge import fit_ridge, input_scales, standardise, term_names, term_values
from studies.axes.validation import Accuracy, cross_validate, draw_rows

Floats = NDArray[np.float64]

JUDGED = (1, 4, 16)
"""Numbers of segments from which held-out policies are estimated."""


@dataclass(frozen=True)
class LearnSettings(Settings):
    """Settings of learned characteristics."""

    name: str = setting("learned", checked(check_set_name), "Name of the set; the names of its axes begin with it.")
    inputs: tuple[str, ...] = setting(
        ("speed", "pace", "restraint", "smoothness", "blocking", "cornering"),
        names(),
        "Characteristics that the learned ones are made of; the first coordinate of the plane grows with the first.",
    )
    degree: int = setting(2, whole(1, 3), "Highest number of inputs that are multiplied with each other.")
    segments: int = setting(4, whole(1, 64), "Segments of races whose mean is a row of the regression.")
    segment_seconds: float = setting(8.0, tenths(0.1, 600.0), "Length of a segment, s.")
    opponents: int = setting(8, whole(1, 1000), "Opponents, out of the pool, in the races that measure behaviour.")
    starts: int = setting(2, whole(1, 1000), "Start lines for each opponent in these races.")
    folds: int = setting(6, whole(2, 100), "Folds of policies in the cross-validation.")

    def __post_init__(self) -> None:
        super().__post_init__()
        get_characteristics(self.inputs)
        races = 2 * self.opponents * self.starts
        if races < max(JUDGED[-1], self.segments):
            raise ConfigError(
                f"{self.opponents} opponents and {self.starts} starts make {races} races of a policy on a circuit; "
                f"there must be {max(JUDGED[-1], self.segments)}"
            )


@dataclass(frozen=True, eq=False)
class Learning:
    """Learned characteristics and what they were learned from."""

    characteristics: LearnedCharacteristics
    coordinates: PayoffCoordinates  #: Of the pool.
    behaviour: Floats  #: shape (T, N, M, I): Inputs in every segment.
    #: R2 of the three coordinates of policies on circuits that were left out, by number of segments.
    scores: dict[int, Accuracy]
    estimates: Floats  #: shape (N, 3): Coordinates of every policy as estimated when it was left out.


def learn_characteristics(pool: PolicyPool, settings: LearnSettings | None = None, **run: Unpack[Run]) -> Learning:
    """Race a pool of policies, and learn characteristics from it.

    Parameters
    ----------
    pool : PolicyPool
        Policies of one planner that differ in speed, the circuits, and the races.
    """
    settings = settings or LearnSettings()
    common_planner(pool.policies)
    if len(pool.policies) < settings.folds:
        raise InputError(f"the pool holds {len(pool.policies)} policies; {settings.folds} folds need as many")
    behaviour = measure_behaviour(
        pool.policies,
        spread_over(pool.policies, settings.opponents),
        pool.tracks,
        pool.config,
        settings.inputs,
        starts=settings.starts,
        segment_seconds=settings.segment_seconds,
        seed=pool.seed,
        **run,
    )
    payoffs = pool_payoffs(pool, **run)
    return fit_characteristics(payoffs, behaviour, settings, seed=pool.seed)


def fit_characteristics(
    payoffs: Floats, behaviour: Floats, settings: LearnSettings | None = None, *, seed: int = 0
) -> Learning:
    """Learn characteristics from races that were driven.

    Parameters
    ----------
    payoffs : ndarray, shape (T, F, N, N)
        See :func:`pcs_racing_agents.policies.policy_pool.pool_payoffs`.
    behaviour : ndarray, shape (T, N, M, I)
        See :func:`studies.axes.behaviour.measure_behaviour`.
    seed : int
        Of folds and rows.
    """
    settings = settings or LearnSettings()
    if behaviour.shape[:2] != (payoffs.shape[0], payoffs.shape[-1]) or behaviour.shape[-1] != len(settings.inputs):
        raise InputError(
            f"behaviour has shape {behaviour.shape}; payoffs {payoffs.shape} and {len(settings.inputs)} inputs need "
            f"({payoffs.shape[0]}, {payoffs.shape[-1]}, any, {len(settings.inputs)})"
        )
    trend = np.nanmean(behaviour[..., 0], axis=(0, 2))
    coordinates = payoff_coordinates(payoffs.mean(axis=0), trend)
    targets = coordinates.standard
    penalties, scores, estimates = cross_validate(
        behaviour,
        targets,
        degree=settings.degree,
        segments=settings.segments,
        folds=settings.folds,
        seed=seed,
        judged=JUDGED,
    )
    mean, scale = input_scales(behaviour)
    rows = draw_rows(term_values(standardise(behaviour, mean, scale), settings.degree), settings.segments, seed)
    wanted = np.broadcast_to(targets[:, None], (*rows.shape[:3], targets.shape[1]))
    regression = fit_ridge(rows.reshape(-1, rows.shape[-1]), wanted.reshape(-1, wanted.shape[-1]), penalties)
    terms = term_names(settings.inputs, settings.degree)
    meanings = (
        "strength against the pool learned from: estimated rating",
        f"place in the cyclic plane of the pool learned from, along the direction that grows with {settings.inputs[0]}",
        "place in the cyclic plane of the pool learned from, across the first direction",
    )
    axes = tuple(
        LearnedAxis(
            f"{settings.name}_{coordinate}",
            meaning,
            _rounded(regression.intercept[c]),
            tuple((term, _rounded(weight)) for term, weight in zip(terms, regression.weights[:, c], strict=True)),
        )
        for c, (coordinate, meaning) in enumerate(zip(COORDINATES, meanings, strict=True))
    )
    inputs = tuple(
        LearnedInput(name, _rounded(m), _rounded(s)) for name, m, s in zip(settings.inputs, mean, scale, strict=True)
    )
    facts = {
        f"r2_{name}_{count}": _rounded(score.r2[c])
        for count, score in scores.items()
        for c, name in enumerate(COORDINATES)
    }
    stated = {
        key: ", ".join(value) if isinstance(value, list) else value for key, value in plain_settings(settings).items()
    }
    training = {
        **stated,
        "policies": int(payoffs.shape[-1]),
        "circuits": int(payoffs.shape[0]),
        "seed": seed,
        "plane_strength": _rounded(coordinates.strength),
        "plane_noise": _rounded(coordinates.noise),
        **facts,
    }
    learned = LearnedCharacteristics(settings.name, inputs, axes, training)
    return Learning(learned, coordinates, behaviour, scores, estimates)


def spread_over(policies: Sequence[Policy], number: int) -> list[Policy]:
    """Return some policies, evenly spaced in their order; all of them if there are fewer."""
    number = min(number, len(policies))
    return [policies[int(i)] for i in np.linspace(0, len(policies) - 1, number).round()]


def _rounded(value: float) -> float:
    """A number as files hold it: six significant digits."""
    return float(f"{float(value):.6g}")
