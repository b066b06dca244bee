"""Logs of simulated cars: a test drive that excites tyres and actuators, with noise."""

from dataclasses import dataclass

import numpy as np

from pcs_racing.base.checks import check_number, check_seed
from pcs_racing.car.vehicle import (
    BETA,
    COMMAND_PERIOD,
    DELTA,
    PSI,
    PSI_DOT,
    STATE_SIZE,
    V,
    VehicleParams,
    X,
    Y,
    simulate,
)
from pcs_racing.identification.logs import DrivingLog, Floats

_SEGMENT = 2.5  # s of a manoeuvre at one speed
_STEP_SECONDS = 0.7  # s between two steps of the commands
_NOISE_SECONDS = 0.28  # correlation time of the steering disturbance, as in races
_BRAKING = 0.2  # s
_GRIP = 7.0  # m/s^2 of lateral acceleration, about the limit of a 1:10 car
_SLIDING = 0.06  # rad: rear slip angle above which the driver steers against the slide
_COUNTER = 3.0  # rad of countersteering per rad of slip angle
_AHEAD = 0.06  # s by which the driver expects a slide
_SPIN = 0.5  # rad: rear slip angle above which the driver stops the car


@dataclass(frozen=True)
class SensorNoise:
    """Standard deviations of independent Gaussian noise in each row of a log."""

    speed: float = 0.05  #: m/s.
    yaw_rate: float = 0.05  #: rad/s.
    steering: float = 0.01  #: rad.
    position: float = 0.02  #: m.
    heading: float = 0.01  #: rad.


NO_NOISE = SensorNoise(0.0, 0.0, 0.0, 0.0, 0.0)


def record_test_drive(
    vehicle: VehicleParams,
    duration: float = 30.0,
    *,
    effort: float = 1.0,
    noise: SensorNoise = NO_NOISE,
    seed: int = 0,
) -> DrivingLog:
    """Drive a simulated car to its limits on open ground, and return the log at 50 Hz.

    The drive consists of slaloms, steps and ramps of the steering up to the full lock, with speed
    steps and braking in bends; a driver steers against slides. The car has its lags, delays and
    noise of commands (``steer_noise`` None: none). The log has all columns, with undisturbed
    commands.

    Parameters
    ----------
    vehicle : VehicleParams
    duration : float
        Length in s, from 6 to 600.
    effort : float
        Share of the full steering and braking, from 0.05 to 1; at 1 some cars spin, stop and go on.
    noise : SensorNoise
        Noise of the measurements.
    seed : int
        Seed of manoeuvres and noise.

    Returns
    -------
    DrivingLog
    """
    check_number("duration", duration, 6.0, 600.0)
    check_number("effort", effort, 0.05, 1.0)
    rng = np.random.default_rng(check_seed(seed))
    count = int(np.ceil(duration / _SEGMENT))
    segments = [_segment(number, effort, rng) for number in range(count)]
    plan = np.concatenate(segments)[: round(duration / COMMAND_PERIOD)]
    states, commands = _driven(vehicle, plan, rng)
    v, beta = states[:, V], states[:, BETA]
    exact = {
        "v_x": (v * np.cos(beta), noise.speed),
        "psi_dot": (states[:, PSI_DOT], noise.yaw_rate),
        "delta": (states[:, DELTA], noise.steering),
        "v_y": (v * np.sin(beta), noise.speed),
        "x": (states[:, X], noise.position),
        "y": (states[:, Y], noise.position),
        "psi": (states[:, PSI], noise.heading),
    }
    measured = {
        name: values + deviation * rng.standard_normal(len(values))
        for name, (values, deviation) in exact.items()
    }
    t = COMMAND_PERIOD * np.arange(len(states), dtype=np.float64)
    return DrivingLog(t, steer=commands[:, 0], speed=commands[:, 1], **measured)


def _segment(number: int, effort: float, rng: np.random.Generator) -> Floats:
    """Return steering angles and speeds of a manoeuvre, shape (125, 2)."""
    t = np.arange(round(_SEGMENT / COMMAND_PERIOD)) * COMMAND_PERIOD
    step = (t / _STEP_SECONDS).astype(int)
    speed = rng.uniform(2.5, 5.5)
    side = 1.0 if number % 2 else -1.0
    hard = float(np.clip(rng.uniform(1.0, 1.8) * 0.33 * _GRIP / speed**2, 0.1, 0.4))
    if number % 3 == 0:
        steer = hard * np.sin(2.0 * np.pi * rng.uniform(0.6, 1.4) * t)
    elif number % 3 == 1:
        signs = (-1.0) ** np.arange(step[-1] + 1)
        steer = (signs * rng.uniform(0.1, 0.41, step[-1] + 1))[step]
    else:
        steer = 0.41 * np.minimum(t / 2.0, 1.0)
        speed = min(speed, 4.0)
    speeds = speed + rng.uniform(-0.35, 0.35, step[-1] + 1)[step]
    # Braking takes load from the rear tyres, which then reach their limit.
    for start in rng.uniform(0.3, _SEGMENT - 0.3, 2):
        speeds[(t >= start) & (t < start + _BRAKING)] -= rng.uniform(0.4, 0.8) * effort
    return np.stack([side * effort * steer, speeds], axis=1)


def _driven(
    vehicle: VehicleParams, plan: Floats, rng: np.random.Generator
) -> tuple[Floats, Floats]:
    """Return states and commands of a drive along a plan, one row every 0.02 s."""
    keep = np.exp(-COMMAND_PERIOD / _NOISE_SECONDS)
    draws = rng.standard_normal((len(plan), 2))
    late = [round(delay / COMMAND_PERIOD) for delay in (vehicle.steer_delay, vehicle.speed_delay)]
    states, commands, sent = np.zeros((len(plan), STATE_SIZE)), plan.copy(), np.zeros_like(plan)
    state, disturbance, slip, spun = np.zeros(STATE_SIZE), 0.0, 0.0, False
    state[V] = plan[0, 1]
    for row in range(len(plan)):
        states[row] = state
        before, slip = slip, _rear_slip(state, vehicle)
        spun = state[V] > 0.6 and (spun or abs(slip) > _SPIN)
        commands[row] = (0.0, 0.0) if spun else _countered(plan[row], slip, slip - before, vehicle)
        disturbance = keep * disturbance + np.sqrt(1.0 - keep**2) * draws[row, 0]
        noise = ((vehicle.steer_noise or 0.0) * disturbance, vehicle.speed_noise * draws[row, 1])
        sent[row] = commands[row] + noise
        due = [sent[row - n, k] if row >= n else (0.0, plan[0, 1])[k] for k, n in enumerate(late)]
        state = simulate(state, [due, due], params=vehicle)[-1]  # two steps of the simulator
    return states, commands


def _rear_slip(state: Floats, vehicle: VehicleParams) -> float:
    """Return the slip angle of the rear axle, rad; 0 at low speed."""
    v, beta = float(state[V]), float(state[BETA])
    across = vehicle.lr * state[PSI_DOT] - v * np.sin(beta)
    return float(np.arctan2(across, v * np.cos(beta))) if v > 0.6 else 0.0


def _countered(
    planned: Floats, slip: float, change: float, vehicle: VehicleParams
) -> tuple[float, float]:
    """Return a command with the driver's steering against a slide of the rear axle."""
    expected = slip + _AHEAD * change / COMMAND_PERIOD
    slide = max(abs(expected) - _SLIDING, 0.0)
    steer = float(planned[0] - np.copysign(_COUNTER * slide, expected))
    return min(max(steer, -vehicle.steer_max), vehicle.steer_max), float(planned[1])
