"""Identification of a car from its log: tyres, lags and limits, with uncertainty.

The car is simulated in windows of 0.5 s, and its parameters minimise the squared residuals of all
measurements (output-error method), with weak priors around the start car. A parameter keeps the
value of the start car if the log narrows its prior by less than half. Standard deviations come from
the Gauss-Newton covariance, with the residuals of a window as one cluster.
"""

import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from pcs_racing.base.errors import InputError
from pcs_racing.base.files import write_atomically
from pcs_racing.base.settings import plain_settings
from pcs_racing.car.tyres import GRAVITY, pacejka_curve, pacejka_peak
from pcs_racing.car.vehicle import BETA, DELTA, PSI, PSI_DOT, V, VehicleParams, X, Y
from pcs_racing.identification.logs import DrivingLog, Floats
from pcs_racing.identification.search import (
    UNKNOWNS,
    Fit,
    changed,
    pruned,
    reshaped,
    search,
    settled,
    with_delay,
)
from pcs_racing.identification.windows import (
    OFFSET,
    Model,
    Residuals,
    Windows,
    make_windows,
    outputs,
)

_MIN_SECONDS = 5.0
LINEAR = ("c_sf", "c_sr")
PACEJKA = ("b_f", "c_f", "d_f", "e_f", "b_r", "c_r", "d_r", "e_r")
_PEAK = 0.9  # share of a tyre's peak that a log must reach to show it
_MIN_CHANGE = 0.1  # m/s of the speed command
_MIN_TURNING = 1.0  # m/s^2 of lateral acceleration
_BEYOND = 0.03  # rad by which commands must pass a reached angle to show the lock


@dataclass(frozen=True)
class Finding:
    """A parameter of an identified car."""

    name: str
    value: float
    deviation: float  #: Standard deviation; NaN for a delay or a kept value.
    start: float  #: Value of the start car.
    reason: str = ""  #: Reason to keep the start car's value; empty for a found value.


@dataclass(frozen=True, eq=False)
class Identification:
    """An identified car, with the uncertainty of its parameters."""

    vehicle: VehicleParams
    start: VehicleParams
    findings: tuple[Finding, ...]
    windows: Windows  #: Log with rows at equal times, cut into windows of 0.5 s.
    states: Floats  #: shape (W, R, 7): Simulated states of the windows.

    def error(self, name: str) -> float:
        """Return the RMS error of a simulated column, as a share of the measured RMS."""
        return _error(self.windows, self.states, name)

    def rows(self) -> list[tuple[str, ...]]:
        """Return a table of the parameters as texts, headings first."""
        rows: list[tuple[str, ...]] = [("parameter", "value", "95 % interval", "start", "")]
        for one in self.findings:
            half = 1.96 * one.deviation
            interval = f"{one.value - half:.4g} to {one.value + half:.4g}" if half == half else "-"
            about = f"kept: {one.reason}" if one.reason else ""
            rows.append((one.name, f"{one.value:.4g}", interval, f"{one.start:.4g}", about))
        return rows


def identify(log: DrivingLog, start: VehicleParams) -> Identification:
    """Find the tyres, lags and limits of a car from its log.

    Parameters
    ----------
    log : DrivingLog
        At least 5 s above 1 m/s; 30 s of driving up to the limits show all parameters.
    start : VehicleParams
        Car with the right mass, inertia, geometry and friction coefficient: mu and the peak factors
        d_f and d_r are not separable. ``tyres`` chooses the model.

    Returns
    -------
    Identification

    Examples
    --------
    >>> from pcs_racing.car.vehicle import load_vehicle
    >>> from pcs_racing.identification import identify, record_test_drive
    >>> car, start = load_vehicle("forzaeth-nuc2"), load_vehicle("f1tenth-pacejka")
    >>> identify(record_test_drive(car, seed=1), start).vehicle.d_f  # doctest: +SKIP
    0.65
    """
    windows = make_windows(log, start)
    if windows.seconds < 0.98 * _MIN_SECONDS:
        raise InputError(
            f"the log holds {windows.seconds:.3g} s of driving above 1 m/s; at least"
            f" {_MIN_SECONDS:g} s are needed"
        )
    turning = float(np.abs(windows.v * windows.yaw_rate)[windows.rows].max())
    if turning < _MIN_TURNING:
        raise InputError(
            f"the log reaches {turning:.2g} m/s^2 of lateral acceleration; tyres show from"
            f" {_MIN_TURNING:g} m/s^2 on: drive bends"
        )
    lateral = _lateral(windows, start)
    fits, states = [lateral], lateral.residuals.states(lateral.car)
    car = lateral.car
    moves = windows.speed is not None and np.ptp(windows.speed[windows.rows]) > _MIN_CHANGE
    if moves and "v_x" in windows.measured:
        fits.append(_longitudinal(lateral, start))
        car = fits[-1].car
        states = fits[-1].residuals.states(car)
    kept = plain_settings(start)
    values = {
        name: value if value == kept[name] else _rounded(value)
        for name, value in plain_settings(car).items()
    }
    vehicle = VehicleParams(**values)
    findings = _findings(fits, vehicle, start, windows, states)
    return Identification(vehicle, start, findings, windows, states)


def yaw_rate_error(vehicle: VehicleParams, log: DrivingLog, seconds: float = 1.0) -> float:
    """Return the RMS error of a car's yaw rate on a log, as a share of the measured RMS.

    The car is simulated in windows of ``seconds`` from the measured states, along the measured
    speed, by the steering commands (without commands: by the measured steering).
    """
    windows = make_windows(log, vehicle, seconds)
    if not len(windows.rows):
        raise InputError(f"the log holds no {seconds:g} s above 1 m/s")
    residuals = Residuals(windows, _model(windows, vehicle), (), ())
    return _error(windows, residuals.states(vehicle), "psi_dot")


def write_vehicle(found: Identification, path: str | os.PathLike[str]) -> Path:
    """Write an identified car as YAML for :func:`pcs_racing.car.vehicle.load_vehicle`, with the
    uncertainty of its parameters as comments.
    """
    import yaml

    path = Path(path)
    notes = {one.name: one for one in found.findings}
    lines = ["# Identified by pcs-racing identify; +-: 95 % interval"]
    for name, value in plain_settings(found.vehicle).items():
        line = yaml.safe_dump({name: value}).strip()
        if (one := notes.get(name)) is not None:
            half = 1.96 * one.deviation
            found_words = f"+- {half:.2g}" if half == half else "found"
            line += f"  # {f'kept: {one.reason}' if one.reason else found_words}"
        lines.append(line)
    write_atomically(path, "\n".join([*lines, ""]))
    return path


def _rounded(value: Any) -> Any:
    """Return a number with six digits."""
    return float(f"{value:.6g}") if isinstance(value, float) else value


def _error(windows: Windows, states: Floats, name: str) -> float:
    if name == "psi_dot":
        measured = windows.yaw_rate_raw[windows.rows]
    else:
        measured = windows.measured[name][windows.rows]
    wrong = outputs(states, name) - measured
    return float(np.sqrt(np.mean(np.square(wrong)) / np.mean(np.square(measured))))


def _model(windows: Windows, car: VehicleParams, speed: bool = False) -> Model:
    return Model(windows.steer is not None, speed).delayed(car)


def _lateral(windows: Windows, start: VehicleParams) -> Fit:
    """Fit tyres and steering; the car follows the measured speed."""
    names, first = list(PACEJKA if start.tyres == "pacejka" else LINEAR), start
    known = ("x", "y", "psi", "psi_dot", "v_y")
    channels: list[str] = [name for name in known if name in windows.measured]
    starts = [column for column, name in ((X, "x"), (Y, "y"), (PSI, "psi")) if name in channels]
    starts += [PSI_DOT, BETA, OFFSET]
    if windows.steer is not None:
        names += ["steer_lag", "steer_rate_max"]
        starts.append(DELTA)
        if "delta" in windows.measured:
            channels.append("delta")
            first, locks = _steering_guess(windows, start)
            names += ["steer_max"] if locks else []
    first = changed(first, steer_delay=0.0)
    residuals = Residuals(windows, _model(windows, first), channels, sorted(starts))
    residuals.starts = residuals.fitted(first, rounds=8)
    fit = search(residuals, first, start, names, 8)
    fit = settled(fit, start)
    if start.tyres == "pacejka":
        fit = reshaped(fit, start)
    fit = settled(fit, start)
    if windows.steer is not None:
        fit = settled(with_delay(fit, start, "steer_delay"), start)
    fit = pruned(fit, start)
    for number, axle in enumerate("fr"):
        peak = f"d_{axle}"
        if peak in fit.names and _reached(fit, number, axle) < _PEAK:
            names = [name for name in fit.names if name != peak]
            kept = changed(fit.car, **{peak: getattr(start, peak)})
            fit = pruned(search(fit.residuals, kept, start, names, 15), start)
    return fit


def _reached(fit: Fit, number: int, axle: str) -> float:
    """Return the share of its peak that the force of an axle reaches in the log."""
    slips = _slips(fit.car, fit.residuals.states(fit.car))[number]
    b, c, e = (getattr(fit.car, f"{name}_{axle}") for name in "bce")
    up_to = np.linspace(0.0, float(np.quantile(np.abs(slips), 0.98)), 50)
    return max(float(pacejka_curve(slip, b, c, e)) for slip in up_to) / float(pacejka_peak(c, e))


def _steering_guess(windows: Windows, start: VehicleParams) -> tuple[VehicleParams, bool]:
    """Return a car with the measured rate of the steering, and whether the log shows its lock."""
    assert windows.steer is not None
    rate = np.quantile(np.abs(np.gradient(windows.delta, windows.period)), 0.99)
    reached = float(np.abs(windows.delta).max())
    beyond = np.abs(windows.steer) > reached + _BEYOND
    locks = float(beyond.sum()) * windows.period > 0.3
    changes = {"steer_rate_max": max(1.2 * float(rate), 0.5)}
    return changed(start, **changes, **({"steer_max": reached} if locks else {})), locks


def _longitudinal(lateral: Fit, start: VehicleParams) -> Fit:
    """Fit lag and limit of the speed, with fitted tyres and steering."""
    old = lateral.residuals
    starts = old.fitted(lateral.car)
    starts[:, V] = old.windows.v[old.windows.rows[:, 0]]
    windows = replace(old.windows, starts=starts)
    reached = np.quantile(np.abs(np.gradient(windows.v, windows.period)), 0.99)
    first = changed(lateral.car, a_max=max(1.2 * float(reached), 0.5), speed_delay=0.0)
    residuals = Residuals(windows, _model(windows, first, speed=True), ("v_x",), (V,))
    fit = settled(search(residuals, first, start, ("speed_lag", "a_max")), start)
    return pruned(settled(with_delay(fit, start, "speed_delay"), start), start)


def _findings(
    fits: list[Fit],
    vehicle: VehicleParams,
    start: VehicleParams,
    windows: Windows,
    states: Floats,
) -> tuple[Finding, ...]:
    tyres = PACEJKA if start.tyres == "pacejka" else LINEAR
    names = [name for name in UNKNOWNS if name in tyres or name not in (*PACEJKA, *LINEAR)]
    fitted = {name: fit for fit in fits for name in fit.names}
    findings = []
    for name in names:
        deviation, reason = np.nan, ""
        if name in fitted:
            deviation = fitted[name].deviation(name)
        else:
            reason = _reason(name, vehicle, windows, states)
        values = (getattr(vehicle, name), deviation, getattr(start, name), reason)
        findings.append(Finding(name, *values))
    for name in ("steer_delay", "speed_delay"):
        lag = f"{name.partition('_')[0]}_lag"
        reason = "" if lag in fitted else f"{lag} is not found either"
        value = getattr(vehicle if lag in fitted else start, name)
        findings.append(Finding(name, value, np.nan, getattr(start, name), reason))
    return tuple(findings)


def _reason(name: str, car: VehicleParams, windows: Windows, states: Floats) -> str:
    """Return the reason why a log does not show a parameter."""
    command = windows.steer if name.startswith("steer") else windows.speed
    if name.startswith(("steer", "speed", "a_")) and command is None:
        what = "steering" if name.startswith("steer") else "speed"
        return f"the log has no {what} command"
    if name in ("steer_rate_max", "steer_max", "a_max"):
        return "no command passes this limit"
    if name in ("steer_lag", "speed_lag") and command is not None:
        return f"the command varies by {np.ptp(command):.2g} only"
    if name in LINEAR:
        return "the car hardly turns"
    front = name.endswith("_f")
    slip = float(np.quantile(np.abs(_slips(car, states)[0 if front else 1]), 0.99))
    axle = "front" if front else "rear"
    return f"slip angles of the {axle} tyres up to {slip:.2g} rad do not show it"


def _slips(car: VehicleParams, states: Floats) -> tuple[Floats, Floats]:
    """Return the slip angles of front and rear tyres, rad, from states of shape (..., 7)."""
    along = states[..., V] * np.cos(states[..., BETA])
    across = states[..., V] * np.sin(states[..., BETA])
    front = states[..., DELTA] - np.arctan2(across + car.lf * states[..., PSI_DOT], along)
    return front, -np.arctan2(across - car.lr * states[..., PSI_DOT], along)


def tyre_points(found: Identification) -> tuple[Floats, Floats]:
    """Return slip angles (rad) and lateral forces per load of both axles, each shape (2, M).

    Forces follow from the measured yaw rate, yaw acceleration and speed; slip angles and the change
    of the car's slip angle are simulated.
    """
    windows, car = found.windows, found.vehicle
    rate, speed, ahead, turning = (
        values[windows.rows]
        for values in (
            windows.yaw_rate,
            windows.v,
            np.gradient(windows.v, windows.period),
            np.gradient(windows.yaw_rate, windows.period),
        )
    )
    aside = speed * (rate + np.gradient(found.states[..., BETA], windows.period, axis=1))
    yaw, shift = car.inertia * turning / car.m, ahead * car.h
    front = (aside * car.lr + yaw) / np.maximum(GRAVITY * car.lr - shift, 0.1)
    front /= np.cos(found.states[..., DELTA])
    rear = (aside * car.lf - yaw) / np.maximum(GRAVITY * car.lf + shift, 0.1)
    slips = np.stack([slip.ravel() for slip in _slips(car, found.states)])
    return slips, np.stack([front.ravel(), rear.ravel()])
