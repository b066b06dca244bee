"""Simulation of a log in short windows, and its residuals: the output-error method.

Every window starts from its own state, which is fitted with the car, so that neither a wrong start
nor the disturbances of earlier windows weigh on the car's parameters.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pcs_racing.car.vehicle import (
    BETA,
    COMMAND_PERIOD,
    DELTA,
    KINEMATIC_BELOW,
    PSI,
    PSI_DOT,
    STATE_SIZE,
    V,
    VehicleParams,
    X,
    Y,
    simulate,
)
from pcs_racing.identification.logs import DrivingLog, Floats, smoothed

STEP = 0.01
"""Max step of the simulation, s."""
WINDOW = 0.5
"""Length of a window of a search, s."""
MAX_WINDOWS = 240
OFFSET = STATE_SIZE
"""Column of a window's steering offset (rad), behind its start state."""
_SLOW = 2.0 * KINEMATIC_BELOW  # m/s; slower windows are left out
_SPINNING = 12.0  # m/s^2: speed times yaw rate that a car without a spin hardly reaches
_BOUND = 4.0  # max residual, in standard deviations
_FREE = 1e3  # limits of actuators that follow the measured motion
_MIN_SD = {
    **{"x": 0.003, "y": 0.003, "psi": 0.002, "v_x": 0.01, "v_y": 0.01},
    **{"psi_dot": 0.01, "delta": 0.003},
}
# Standard deviations of a window's start around the measured start: x, y, delta, v, psi, psi_dot,
# beta, and the offset of the steering around 0.
_START_SD = np.array([0.5, 0.5, 0.05, 0.3, 0.3, 1.0, 0.15, 0.03])
_START_STEP = np.array([1e-3, 1e-3, 1e-4, 1e-3, 1e-4, 1e-3, 1e-4, 1e-4])
_SHARES = np.array([1.0, 0.3, 0.05])  # of a Gauss-Newton step that are tried


@dataclass(frozen=True)
class Windows:
    """Windows of a log: commands, measurements and guessed starts."""

    period: float  #: Time between two rows, s.
    substeps: int  #: Steps of the simulation between two rows.
    rows: NDArray[np.int64]  #: shape (W, R): Rows of the log.
    measured: dict[str, Floats]  #: Measurements by column, shape (N,).
    steer: Floats | None  #: Steering commands, shape (N,).
    speed: Floats | None  #: Speed commands, shape (N,).
    delta: Floats  #: Smoothed steering angle, shape (N,).
    v: Floats  #: Smoothed speed, shape (N,).
    yaw_rate: Floats  #: Smoothed yaw rate, shape (N,).
    starts: Floats  #: shape (W, 8): States at the start, and steering offsets.
    start_sd: Floats  #: shape (8,): Standard deviations of the starts.

    @property
    def seconds(self) -> float:
        """Total time of the windows, s."""
        return self.rows.size * self.period

    @property
    def yaw_rate_raw(self) -> Floats:
        """Measured yaw rate, else the smoothed derivative of the heading, rad/s, shape (N,)."""
        return self.measured.get("psi_dot", self.yaw_rate)


def resampled(log: DrivingLog) -> DrivingLog:
    """Return a log with rows at equal times: measurements interpolated, commands held."""
    steps = np.diff(log.t)
    period = max(float(np.median(steps)), 0.005)
    if np.ptp(steps) < 0.02 * period:
        return log
    t = np.arange(log.t[0], log.t[-1], period)
    held = np.searchsorted(log.t, t + 1e-9, side="right") - 1
    columns = {
        name: values[held]
        if name in ("steer", "speed")
        else np.interp(t, log.t, np.unwrap(values) if name == "psi" else values)
        for name, values in log.columns()
    }
    return DrivingLog(**{**columns, "t": t})


def make_windows(log: DrivingLog, car: VehicleParams, seconds: float = WINDOW) -> Windows:
    """Cut a log into windows; parts below 1 m/s and spins are left out."""
    log = resampled(log)
    period = float(log.t[-1] - log.t[0]) / (len(log.t) - 1)
    half = max(round(0.08 / period), 1)
    columns = dict(log.columns())
    if log.psi is not None:
        columns["psi"] = np.unwrap(log.psi)
    soft = {name: smoothed(values, half) for name, values in columns.items()}
    rate = soft["psi_dot"] if "psi_dot" in soft else np.gradient(soft["psi"], log.t)
    if "v_x" in soft:
        along = soft["v_x"]
    else:
        along = smoothed(np.hypot(*(np.gradient(soft[name], log.t) for name in "xy")), half)
    v = np.hypot(along, soft["v_y"]) if "v_y" in soft else along
    delta = soft["delta"] if log.delta is not None else soft["steer"]
    size = max(round(seconds / period), 3)
    rows = np.arange(len(v) // size * size).reshape(-1, size)
    rows = rows[along[rows].min(axis=1) > _SLOW]  # a car that slides backwards is left out, too
    turning = np.abs(along * rate)[rows].max(axis=1, initial=0.0)
    if len(rows):
        rows = rows[turning < max(1.5 * float(np.quantile(turning, 0.8)), _SPINNING)]
    if len(rows) > MAX_WINDOWS:
        rows = rows[np.linspace(0, len(rows) - 1, MAX_WINDOWS).round().astype(int)]
    first = rows[:, 0]
    starts = np.zeros((len(rows), STATE_SIZE + 1))
    for column, name in ((X, "x"), (Y, "y"), (PSI, "psi")):
        starts[:, column] = soft[name][first] if name in soft else 0.0
    starts[:, DELTA], starts[:, V], starts[:, PSI_DOT] = delta[first], v[first], rate[first]
    starts[:, BETA] = (
        np.arctan2(soft["v_y"], along)[first]
        if "v_y" in soft
        else np.arctan(np.tan(delta[first]) * car.lr / car.wheelbase)
    )
    measured: dict[str, Floats] = {
        str(name): columns[name]
        for name in ("x", "y", "psi", "psi_dot", "v_x", "v_y", "delta")
        if name in columns
    }
    start_sd = _START_SD.copy()
    if log.delta is None:
        start_sd[DELTA] = 0.3
    substeps = max(int(np.ceil(period / STEP - 1e-6)), 1)
    return Windows(
        period, substeps, rows, measured, log.steer, log.speed, delta, v, rate, starts, start_sd
    )


@dataclass(frozen=True)
class Model:
    """Choice of simulated actuators; a measured motion replaces the others."""

    steering: bool
    speed: bool
    steer_delay: int = 0  #: Delay in units of 0.02 s.
    speed_delay: int = 0

    def delayed(self, car: VehicleParams) -> "Model":
        """Return the model with the delays of a car."""
        delays = [round(late / COMMAND_PERIOD) for late in (car.steer_delay, car.speed_delay)]
        return replace(self, steer_delay=delays[0], speed_delay=delays[1])

    def car(self, vehicle: VehicleParams, windows: Windows) -> VehicleParams:
        """Return the car with actuators that follow the measured motion exactly."""
        values = {name: getattr(vehicle, name) for name in vehicle.__dataclass_fields__}
        if not self.steering:
            values |= {"steer_lag": 0.0, "steer_rate_max": _FREE, "steer_max": 1.5}
        if not self.speed:
            free = dict.fromkeys(("a_max", "v_switch", "v_max"), _FREE)
            lag = windows.period / windows.substeps
            values |= {**free, "v_min": -_FREE, "speed_lag": lag}
        return VehicleParams.known(**values)

    def controls(self, windows: Windows) -> Floats:
        """Return the targets of all steps, shape (W, steps, 2), without offsets."""
        targets = [
            self._targets(windows, windows.steer, windows.delta, self.steering, self.steer_delay),
            self._targets(windows, windows.speed, windows.v, self.speed, self.speed_delay),
        ]
        return np.stack(targets, axis=-1)

    def _targets(
        self, windows: Windows, command: Floats | None, motion: Floats, commanded: bool, delay: int
    ) -> Floats:
        steps = np.arange((windows.rows.shape[1] - 1) * windows.substeps)
        # Steps since the start of the log.
        place = windows.rows[:, :1] * windows.substeps + steps
        if commanded:
            assert command is not None
            late = delay * COMMAND_PERIOD * windows.substeps / windows.period
            at = np.floor((place - late) / windows.substeps + 1e-6).astype(int)
            return command[np.maximum(at, 0)]
        return np.interp((place + 1) / windows.substeps, np.arange(len(motion)), motion)


def simulate_windows(
    windows: Windows, controls: Floats, cars: Sequence[VehicleParams], starts: Floats
) -> Floats:
    """Simulate all windows with several cars and starts of shape (P, W, 8); states at the rows.

    Return states of shape (P, W, R, 7).
    """
    count, number = starts.shape[:2]
    targets = np.tile(controls, (count, 1, 1, 1))
    targets[..., 0] += starts[:, :, None, OFFSET]
    rows = [car for car in cars for _ in range(number)]
    states = simulate(
        starts[:, :, :STATE_SIZE].reshape(-1, STATE_SIZE),
        targets.reshape(count * number, -1, 2),
        dt=windows.period / windows.substeps,
        params=rows,
    )
    return states.reshape(count, number, -1, STATE_SIZE)[:, :, :: windows.substeps]


def outputs(states: Floats, name: str) -> Floats:
    """Return a column of a log from states of shape (..., 7)."""
    if name == "v_x":
        return np.asarray(states[..., V] * np.cos(states[..., BETA]))
    if name == "v_y":
        return np.asarray(states[..., V] * np.sin(states[..., BETA]))
    column = {"x": X, "y": Y, "psi": PSI, "psi_dot": PSI_DOT, "delta": DELTA}[name]
    return np.asarray(states[..., column])


def noise_of(windows: Windows, name: str) -> float:
    """Return the standard deviation of a measurement around its smooth course."""
    values = windows.measured[name]
    rest = values - smoothed(values, max(round(0.06 / windows.period), 2))
    return max(1.3 * float(np.std(rest)), _MIN_SD[name])


class Residuals:
    """Residuals of all windows, in standard deviations, as a function of the car alone.

    The starts of the windows are fitted to each car: variable projection.
    """

    def __init__(
        self, windows: Windows, model: Model, channels: Sequence[str], free: Iterable[int]
    ) -> None:
        self.windows, self.model = windows, model
        self.channels, self.free = tuple(channels), np.array([*free], dtype=int)
        self.controls = model.controls(windows)
        self.starts = windows.starts.copy()
        self.sd = {name: noise_of(windows, name) for name in channels}
        self.bound = np.inf

    def like(self, *, windows: Windows | None = None, model: Model | None = None) -> "Residuals":
        """Return residuals with the starts, standard deviations and bound of these."""
        made = Residuals(windows or self.windows, model or self.model, self.channels, self.free)
        made.starts, made.sd, made.bound = self.starts.copy(), dict(self.sd), self.bound
        return made

    def states(self, car: VehicleParams) -> Floats:
        """Return the simulated states of a car, shape (W, R, 7)."""
        cars, starts = [self.model.car(car, self.windows)], self.fitted(car)[None]
        return simulate_windows(self.windows, self.controls, cars, starts)[0]

    def _raw(self, cars: Sequence[VehicleParams], starts: Floats) -> Floats:
        """Return residuals of shape (P, W, M), with the rows of the starts' distribution last."""
        cars = [self.model.car(car, self.windows) for car in cars]
        states = simulate_windows(self.windows, self.controls, cars, starts)
        parts = []
        for name in self.channels:
            wrong = outputs(states, name) - self.windows.measured[name][self.windows.rows]
            if name == "psi":
                wrong = (wrong + np.pi) % (2.0 * np.pi) - np.pi
            size = wrong / self.sd[name]
            parts.append(size / np.sqrt(1.0 + (size / self.bound) ** 2))
        around = (starts - self.windows.starts) / self.windows.start_sd
        return np.concatenate([*parts, around[:, :, self.free]], axis=2)

    def linear(self, car: VehicleParams, starts: Floats) -> tuple[Floats, Floats]:
        """Return residuals (W, M) and their derivatives by the starts, (W, M, S)."""
        moved = np.tile(starts, (len(self.free) + 1, 1, 1))
        for number, column in enumerate(self.free):
            moved[number + 1, :, column] += _START_STEP[column]
        raw = self._raw([car] * len(moved), moved)
        slopes = (raw[1:] - raw[0]) / _START_STEP[self.free][:, None, None]
        return raw[0], np.moveaxis(slopes, 0, -1)

    def fitted(self, car: VehicleParams, rounds: int = 2) -> Floats:
        """Return the starts that fit a car: damped Gauss-Newton steps, window by window."""
        starts = self.starts.copy()
        for _ in range(rounds if len(self.free) else 0):
            rest, slopes = self.linear(car, starts)
            step = np.linalg.solve(
                np.einsum("wms,wmt->wst", slopes, slopes),
                np.einsum("wms,wm->ws", slopes, rest)[:, :, None],
            )[:, :, 0]
            tried = np.tile(starts, (len(_SHARES), 1, 1))
            tried[:, :, self.free] -= _SHARES[:, None, None] * step
            tried = np.concatenate([starts[None], tried])
            costs = np.square(self._raw([car] * len(tried), tried)).sum(axis=2)
            costs = np.nan_to_num(costs, nan=np.inf)
            starts = tried[costs.argmin(axis=0), np.arange(len(starts))]
        return starts

    def at(self, car: VehicleParams) -> Floats:
        """Return the residuals of a car, shape (W, M)."""
        return self._raw([car], self.fitted(car)[None])[0]

    def slopes(self, cars: Sequence[VehicleParams], steps: Floats) -> Floats:
        """Return projected derivatives of the residuals by parameters, shape (W, M, P).

        Cars 1 to P differ from car 0 by a step of one parameter each.
        """
        self.starts = self.fitted(cars[0])
        _, inner = self.linear(cars[0], self.starts)
        raw = self._raw(cars, np.tile(self.starts, (len(cars), 1, 1)))
        outer = np.moveaxis((raw[1:] - raw[0]) / steps[:, None, None], 0, -1)
        basis, _ = np.linalg.qr(inner)
        return np.asarray(outer - basis @ (np.swapaxes(basis, 1, 2) @ outer))


def rescaled(residuals: Residuals, car: VehicleParams) -> Residuals:
    """Return residuals in the standard deviations that a fit has left; outliers are bounded."""
    made = residuals.like(windows=_with_slip(residuals.windows, residuals.states(car)))
    made.bound = np.inf
    rest = made.at(car)[:, : len(made.channels) * residuals.windows.rows.shape[1]]
    parts = np.split(np.abs(rest), len(made.channels), axis=1)
    for name, size in zip(made.channels, parts, strict=True):
        made.sd[name] = max(made.sd[name] * 1.4826 * float(np.median(size)), _MIN_SD[name] / 3.0)
    made.bound = _BOUND
    return made


def _with_slip(windows: Windows, states: Floats) -> Windows:
    """Return windows with the speed of the car's centre, for measured speeds along the car."""
    if "v_x" not in windows.measured or "v_y" in windows.measured:
        return windows
    v = smoothed(windows.measured["v_x"], max(round(0.08 / windows.period), 1))
    v[windows.rows] /= np.maximum(np.cos(states[..., BETA]), 0.5)
    return replace(windows, v=v)
