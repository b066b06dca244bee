"""A circuit for races in plain Python: coarse, because everything on it is many times slower."""

import numpy as np
import pytest

from pcs_racing.track.track import Calibration, build_track

STRAIGHT, RADIUS, HALF_WIDTH, CELL = 8.0, 4.0, 1.2, 0.2


@pytest.fixture(scope="session")
def stadium():
    """Two straights of 8 m and two half circles of 4 m radius, in cells of 0.2 m."""
    quarter = np.linspace(0.0, np.pi, 30, endpoint=False)
    along = np.linspace(-STRAIGHT / 2, STRAIGHT / 2, 30, endpoint=False)
    right = np.column_stack([STRAIGHT / 2 + RADIUS * np.sin(quarter), -RADIUS * np.cos(quarter)])
    bottom = np.column_stack([along, np.full_like(along, -RADIUS)])
    xy = np.concatenate([bottom, right, -bottom, -right])
    origin = (-STRAIGHT / 2 - RADIUS - 2.0, -RADIUS - 2.0)
    shape = (round(2 * (RADIUS + 2.0) / CELL), round((STRAIGHT + 2 * RADIUS + 4.0) / CELL))
    y, x = np.meshgrid(*((np.arange(n) + 0.5) * CELL for n in shape), indexing="ij")
    away = np.hypot(np.maximum(np.abs(x + origin[0]) - STRAIGHT / 2, 0.0), y + origin[1])
    occupied = (np.abs(away - RADIUS) > HALF_WIDTH) & (np.abs(away - RADIUS) < HALF_WIDTH + 0.5)
    # A block on the outer wall, so that walls are not all smooth.
    occupied |= (np.abs(away - RADIUS - HALF_WIDTH) < 0.3) & (np.abs(x + origin[0]) < 0.5)
    center = np.column_stack([xy, np.full((len(xy), 2), HALF_WIDTH)])
    # Known beforehand: to find it by driving would take plain Python an hour.
    lower, upper = ((2.0, 5.0),), ((22.5, 25.5),)
    calibration = {
        "paper": Calibration((0.8, 1.0), 0.9, {"left": lower, "right": upper}),
        "contest": Calibration((0.8, 1.0), 0.45, {"front": lower + upper}),
    }
    return build_track("stadium", occupied, CELL, origin, center, xy, calibration=calibration)
