"""Policy characteristics: numbers that describe how a policy drives, estimated from its
trajectories.

A characteristic maps a segment of racing (the states before and after it) to one value per race and
car; a policy's coordinate in the Policy Characteristic Space is the mean over races (Remark 1 of
the paper).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.errors import InputError, UnknownNameError
from pcs_racing.race import state as _state
from pcs_racing.race.config import DT
from pcs_racing.race.state import RaceState

BOTH_SIDES = 1.0
"""Min time driven both in front and behind before a reaction to the lead is measured, s."""


@dataclass(frozen=True, eq=False)
class Segment:
    """A segment of a batch of races: each car's progress and running sums between two moments."""

    progress: NDArray[np.float64]  #: shape (B, 2): Progress of each car during the segment, m.
    #: shape (B, 2, 9): Growth of the running sums (:data:`pcs_racing.race.state.SUMS`).
    sums: NDArray[np.float64]
    #: shape (B,): Time driven, s; shorter than ``duration`` after a crash.
    time: NDArray[np.float64]
    duration: float  #: Requested time, s.

    @classmethod
    def between(cls, before: RaceState, after: RaceState, duration: float) -> "Segment":
        """Return the segment between two states of the same races."""
        return cls(
            after.progress - before.progress,
            after.sums - before.sums,
            np.asarray((after.tick - before.tick) * DT, np.float64),
            float(duration),
        )

    @classmethod
    def so_far(cls, state: RaceState, duration: float) -> "Segment":
        """Return the segment from the start of races."""
        return cls(
            state.progress, state.sums, np.asarray(state.tick * DT, np.float64), float(duration)
        )


@dataclass(frozen=True)
class Characteristic:
    """One axis of the Policy Characteristic Space."""

    name: str  #: Name in tables and settings.
    unit: str  #: Unit of the values.
    meaning: str  #: Description in one line.
    #: Function ``evaluate(segment) -> (B, 2)``, one value for each race and car.
    evaluate: Callable[[Segment], NDArray[np.float64]]
    #: True if one segment is too short a sample. A policy's coordinate is then evaluated on the sum
    #: of all its segments (not the mean of their values), and the players' observation on all of
    #: the race so far.
    pooled: bool = False


def _lead(segment: Segment) -> NDArray[np.float64]:
    return segment.progress - segment.progress[:, ::-1]


def _pace(segment: Segment) -> NDArray[np.float64]:
    return _lead(segment) / np.maximum(segment.time, 0.5)[:, None] * segment.duration


def _restraint(segment: Segment) -> NDArray[np.float64]:
    return segment.sums[..., _state.ITTC] / np.maximum(segment.sums[..., _state.ITTC_SAMPLES], 1.0)


def _smoothness(segment: Segment) -> NDArray[np.float64]:
    return -segment.sums[..., _state.STEERING] / np.maximum(segment.sums[..., _state.TIME], 0.5)


def _blocking(segment: Segment) -> NDArray[np.float64]:
    return segment.sums[..., _state.BLOCKING] / np.maximum(segment.sums[..., _state.TIME], 0.5)


def _cornering(segment: Segment) -> NDArray[np.float64]:
    return np.sqrt(
        segment.sums[..., _state.LATERAL] / np.maximum(segment.sums[..., _state.TIME], 0.5)
    )


def _speed(segment: Segment) -> NDArray[np.float64]:
    return segment.sums[..., _state.PROFILE] / np.maximum(segment.sums[..., _state.TIME], 0.5)


def _reaction(segment: Segment) -> NDArray[np.float64]:
    behind, profile_behind = (
        segment.sums[..., _state.TIME_BEHIND],
        segment.sums[..., _state.PROFILE_BEHIND],
    )
    ahead, profile_ahead = (
        segment.sums[..., _state.TIME] - behind,
        segment.sums[..., _state.PROFILE] - profile_behind,
    )
    difference = profile_behind / np.maximum(behind, BOTH_SIDES) - profile_ahead / np.maximum(
        ahead, BOTH_SIDES
    )
    return np.where(np.minimum(behind, ahead) >= BOTH_SIDES, difference, 0.0)


_registered = {
    one.name: one
    for one in (
        Characteristic(
            "aggressiveness", "m", "progress gained over the opponent (the paper's g_agg)", _lead
        ),
        Characteristic(
            "pace",
            "m",
            "progress gained over the opponent per time driven, scaled to the full duration",
            _pace,
        ),
        Characteristic(
            "restraint",
            "s",
            "mean of the minimum instantaneous time to collision (the paper's g_res)",
            _restraint,
        ),
        Characteristic("smoothness", "rad/s", "minus the mean steering rate", _smoothness),
        Characteristic(
            "blocking",
            "1",
            "share of the time spent just ahead and in the opponent's way",
            _blocking,
        ),
        Characteristic(
            "speed",
            "1",
            "speed along the race line, in parts of its profile at pace 1: time of the profile"
            " for the driven way, per time driven",
            _speed,
        ),
        Characteristic(
            "reaction",
            "1",
            "reaction to the lead: how much faster behind than in front, in parts of the profile"
            f" at pace 1; 0 before both lasted {BOTH_SIDES:g} s",
            _reaction,
            pooled=True,
        ),
        Characteristic(
            "cornering", "m/s^2", "root mean square of the lateral acceleration", _cornering
        ),
    )
}


def register_characteristic(characteristic: Characteristic) -> None:
    """Register a characteristic under its name; repeating an equal registration does nothing."""
    if _registered.setdefault(characteristic.name, characteristic) != characteristic:
        raise InputError(
            f"a characteristic named {characteristic.name!r} exists already; choose another name"
        )


def get_characteristics(names: Sequence[str]) -> tuple[Characteristic, ...]:
    """Return characteristics by name."""
    texts = not isinstance(names, str) and all(isinstance(name, str) for name in names)
    if not texts or len(names) == 0 or len(set(names)) != len(names):
        raise InputError(f"characteristics are {list(names)!r:.200}; name at least one, each once")
    for name in names:
        if name not in _registered:
            raise UnknownNameError(
                f"characteristic {name!r} is unknown; known are {', '.join(_registered)}"
            )
    return tuple(_registered[name] for name in names)


def measure(
    segment: Segment, characteristics: Sequence[Characteristic], so_far: Segment | None = None
) -> NDArray[np.float64]:
    """Evaluate characteristics on a segment, (B, 2, |G|); pooled ones on ``so_far``, if given."""
    values = np.empty((*segment.progress.shape, len(characteristics)))
    for k, characteristic in enumerate(characteristics):
        values[..., k] = characteristic.evaluate(
            so_far if so_far is not None and characteristic.pooled else segment
        )
    return values
