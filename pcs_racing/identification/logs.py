"""Logs of a driving car: columns with units, and checks that find the usual mistakes."""

import os
from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.errors import InputError
from pcs_racing.base.files import write_atomically

Floats = NDArray[np.float64]

MIN_DURATION = 5.0
"""Min duration of a log, s."""
MAX_GAP = 0.2
"""Max time between two rows of a log, s."""
_MAX_ROWS = 500_000
# Largest plausible values, and the unit of larger values.
_LARGEST = {
    "steer": (1.5, "rad", "deg"),
    "delta": (1.5, "rad", "deg"),
    "psi_dot": (20.0, "rad/s", "deg/s"),
    "v_x": (40.0, "m/s", "km/h or rpm"),
    "v_y": (40.0, "m/s", "km/h"),
    "speed": (40.0, "m/s", "km/h or rpm"),
}


@dataclass(frozen=True, eq=False)
class DrivingLog:
    """Measurements and commands of a driving car, one row a moment; arrays of shape (N,).

    Required are ``t``, ``steer`` or ``delta``, ``v_x`` or ``x`` and ``y``, and ``psi_dot`` or
    ``psi``. Angles are in rad and grow to the left.
    """

    t: Floats  #: Time, s.
    v_x: Floats | None = None  #: Measured speed along the car, m/s.
    psi_dot: Floats | None = None  #: Measured yaw rate, rad/s.
    steer: Floats | None = None  #: Command of the steering angle, rad.
    delta: Floats | None = None  #: Measured steering angle, rad.
    speed: Floats | None = None  #: Command of the speed, m/s.
    v_y: Floats | None = None  #: Measured speed across the car at the centre of gravity, m/s.
    x: Floats | None = None  #: Measured position of the centre of gravity, m.
    y: Floats | None = None  #: Measured position of the centre of gravity, m.
    psi: Floats | None = None  #: Measured heading, rad.

    def __post_init__(self) -> None:
        for name in COLUMNS:
            if getattr(self, name) is not None:
                object.__setattr__(self, name, _column(name, getattr(self, name), self.t))
        _check_columns(self)
        _check_time(self.t)
        _check_units(self)
        _check_consistency(self)

    @property
    def duration(self) -> float:
        """Time between the first and the last row, s."""
        return float(self.t[-1] - self.t[0])

    def columns(self) -> Iterator[tuple[str, Floats]]:
        """Yield the names and values of all given columns."""
        for name in COLUMNS:
            if (values := getattr(self, name)) is not None:
                yield name, values

    def without(self, *names: str) -> "DrivingLog":
        """Return the log without some columns."""
        absent: dict[str, Any] = dict.fromkeys(names)
        return replace(self, **absent)


COLUMNS = tuple(field.name for field in fields(DrivingLog))
"""Names of all columns of a log."""


def smoothed(values: Floats, half: int) -> Floats:
    """Return values smoothed by quadratic fits over ``2 half + 1`` rows (Savitzky-Golay)."""
    from scipy.signal import savgol_filter

    return np.asarray(savgol_filter(values, 2 * half + 1, 2)) if half >= 1 else values.copy()


def _column(name: str, values: ArrayLike, t: ArrayLike) -> Floats:
    try:
        array = np.array(values, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"column {name!r} of the log must hold numbers") from None
    if array.ndim != 1 or array.shape != np.shape(t):
        raise InputError(
            f"column {name!r} of the log has shape {array.shape}; it must be {np.shape(t)[:1]}, as"
            " t has"
        )
    if len(array) > _MAX_ROWS:
        raise InputError(f"the log has {len(array)} rows; it may have at most {_MAX_ROWS}")
    wrong = np.flatnonzero(~(np.abs(array) < 1e12))
    if len(wrong):
        raise InputError(f"column {name!r} of the log is {array[wrong[0]]} in row {wrong[0]}")
    array.setflags(write=False)
    return array


def _check_columns(log: DrivingLog) -> None:
    given = {name for name, _ in log.columns()}
    for needed in (("steer", "delta"), ("v_x", "x, y"), ("psi_dot", "psi")):
        if not any(set(names.split(", ")) <= given for names in needed):
            raise InputError(
                f"the log has no column {' or '.join(needed)}; it has {', '.join(sorted(given))},"
                f" and may have {', '.join(COLUMNS)}"
            )
    if ("x" in given) != ("y" in given):
        raise InputError("the log has only one of the columns x and y; give both or neither")


def _check_time(t: Floats) -> None:
    steps = np.diff(t)
    if (steps <= 0.0).any():
        row = int(np.argmax(steps <= 0.0)) + 1
        raise InputError(
            f"the time of the log goes from {t[row - 1]:.6g} to {t[row]:.6g} s at row {row}; it"
            " must increase"
        )
    if (length := float(steps.sum())) < MIN_DURATION:
        raise InputError(
            f"the log lasts {length:.3g} s; it must last at least {MIN_DURATION:g} s (t in s)"
        )
    if (period := float(np.median(steps))) > 0.1:
        raise InputError(
            f"the rows of the log are {period:.3g} s apart; they must be at most 0.1 s apart (t in"
            " s)"
        )
    if steps.max() > MAX_GAP:
        row = int(np.argmax(steps))
        raise InputError(
            f"the log has a gap of {steps[row]:.3g} s after t = {t[row]:.6g} s; cut it there, or"
            f" give a log without gaps above {MAX_GAP:g} s"
        )


def _check_units(log: DrivingLog) -> None:
    for name, (largest, unit, other) in _LARGEST.items():
        values = getattr(log, name)
        if values is not None and (found := float(np.abs(values).max())) > largest:
            raise InputError(
                f"{name} of the log reaches {found:.4g}; in {unit} a car reaches at most"
                f" {largest:g}: is it in {other}?"
            )


def _check_consistency(log: DrivingLog) -> None:
    """Compare columns that measure the same."""
    half = max(round(0.1 / float(np.median(np.diff(log.t)))), 2)
    speed = None if log.v_x is None else smoothed(np.abs(log.v_x), half)
    if log.x is not None and log.y is not None:
        moved = np.hypot(*(np.gradient(smoothed(values, half), log.t) for values in (log.x, log.y)))
        if speed is not None:
            _check_ratio("v_x", speed, "the path x, y", moved, "m and m/s")
    turned = None
    if log.psi is not None:
        turned = np.gradient(smoothed(np.unwrap(log.psi), half), log.t)
        if log.psi_dot is not None:
            _check_ratio("psi_dot", log.psi_dot, "psi", turned, "rad and rad/s")
    steering = log.delta if log.delta is not None else log.steer
    yaw_rate = log.psi_dot if log.psi_dot is not None else turned
    if steering is None or yaw_rate is None:
        return
    rolls = np.ones(len(log.t), np.bool_) if log.v_x is None else log.v_x > 1.0
    if rolls.sum() < 50 or min(np.std(steering[rolls]), np.std(yaw_rate[rolls])) < 1e-3:
        return
    if np.corrcoef(steering[rolls], yaw_rate[rolls])[0, 1] < -0.3:
        raise InputError(
            "the car of the log turns right where it steers left; all angles must grow to the left"
        )


def _check_ratio(name: str, values: Floats, other: str, derived: Floats, units: str) -> None:
    scales = [float(np.sqrt(np.mean(np.square(each)))) for each in (values, derived)]
    ratio = max(scales[0], 1e-3) / max(scales[1], 1e-3)
    if not 0.5 < ratio < 2.0 and max(scales) > 0.3:
        raise InputError(
            f"{name} of the log is {ratio:.3g} times as large as {other} says; they must be in"
            f" {units}"
        )


def write_log(log: DrivingLog, path: str | os.PathLike[str]) -> Path:
    """Write a log as csv, with a row of names."""
    names, columns = zip(*log.columns(), strict=True)
    rows = (",".join(f"{value:.6g}" for value in row) for row in np.stack(columns, axis=1))
    write_atomically(Path(path), "\n".join([",".join(names), *rows, ""]))
    return Path(path)
