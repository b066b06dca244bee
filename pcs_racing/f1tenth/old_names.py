"""Enums and functions that programs import from inside the gym."""

from enum import Enum

import numpy as np
from numpy.typing import ArrayLike, NDArray


class _Named(Enum):
    @classmethod
    def from_string(cls, name: str) -> "_Named":
        """Return the member of a name; case does not matter."""
        return {member.name.lower(): member for member in cls}[name.lower()]


class DynamicModel(_Named):
    """Vehicle models."""

    KS = 1
    ST = 2


class IntegratorType(_Named):
    """Integrators."""

    RK4 = 1
    Euler = 2


class LongitudinalActionEnum(_Named):
    """What drives the car."""

    Accl = 1
    Speed = 2


class SteerActionEnum(_Named):
    """What steers it."""

    Steering_Angle = 1
    Steering_Speed = 2


def get_vertices(pose: ArrayLike, length: float, width: float) -> NDArray[np.float64]:
    """Return the corners of a car at x, y, heading: rear left, rear right, front right, front left, shape (4, 2)."""
    x, y, theta = np.asarray(pose, np.float64)
    sine, cosine = np.sin(theta), np.cos(theta)
    corners = 0.5 * np.array([[-length, width], [-length, -width], [length, -width], [length, width]])
    return corners @ np.array([[cosine, sine], [-sine, cosine]]) + (x, y)


def pid(
    speed: float,
    steer: float,
    current_speed: float,
    current_steer: float,
    max_sv: float,
    max_a: float,
    max_v: float,
    min_v: float,
) -> tuple[float, float]:
    """Return the acceleration (m/s^2) and steering rate (rad/s) that lead to a speed and a steering angle."""
    error, difference = steer - current_steer, speed - current_speed
    gain = (10.0 if current_speed > 0.0 else 2.0) * max_a / (max_v if difference > 0.0 else -min_v)
    return gain * difference, float(np.sign(error)) * max_sv if abs(error) > 1e-4 else 0.0
