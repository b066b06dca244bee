"""Grids drawn for these tests, rings around a closed line, and what the oval of all tests is made
of.
"""

import numpy as np
import pytest

from pcs_racing.track.mapping.circuits import walls_to_grid


def superellipse(a: float, b: float, power: float = 4.0, points: int = 400) -> np.ndarray:
    """Rounded rectangle with semi-axes a and b, counterclockwise."""
    t = np.linspace(0.0, 2.0 * np.pi, points, endpoint=False)
    x, y = np.cos(t), np.sin(t)
    return np.column_stack(
        [a * np.sign(x) * np.abs(x) ** (2.0 / power), b * np.sign(y) * np.abs(y) ** (2.0 / power)]
    )


@pytest.fixture(scope="session")
def box():
    """Rounded rectangle, 2.2 m wide: its line, grid, cell size and origin."""
    line = superellipse(12.0, 7.0)
    grid, origin = walls_to_grid(line, 2.2, 0.05)
    return line, grid, 0.05, origin


@pytest.fixture
def values(oval):
    """Sources of the oval, or nearly so: its grid is cropped, and infield and outfield are
    walls too.
    """
    arrays = oval.arrays
    return {
        "occupied": arrays.distance == 0.0,
        "resolution": arrays.cell,
        "origin": (arrays.origin_x, arrays.origin_y),
        "centerline": oval.centerline.copy(),
        "raceline_xy": oval.line[::3, :2].copy(),
    }
