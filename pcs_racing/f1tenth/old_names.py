"""Enums and functions that programs import from inside the gym."""

from enum import Enum

import numpy as np
from numpy.typing import ArrayLike, NDArray

DynamicModel = Enum("DynamicModel", "KS ST")
IntegratorType = Enum("IntegratorType", "RK4 Euler")
LongitudinalActionEnum = Enum("LongitudinalActionEnum", "Accl Speed")
SteerActionEnum = Enum("SteerActionEnum", "Steering_Angle Steering_Speed")


def get_vertices(pose: ArrayLike, length: float, width: float) -> NDArray[np.float64]:
    """Return the corners of a car at x, y, heading: rear left, rear right, front right, front left, shape (4, 2)."""
    x, y, theta = np.asarray(pose, np.float64)
    sine, cosine = np.sin(theta), np.cos(theta)
    corners = 0.5 * np.array([[-length, width], [-length, -width], [length, -width], [length, width]])
    return corners @ np.array([[cosine, sine], [-sine, cosine]]) + (x, y)
