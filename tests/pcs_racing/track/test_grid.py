"""Tools for occupancy grids, each against the plainest way to compute the same."""

import numpy as np
from hypothesis import given, strategies as st
from hypothesis.extra import numpy as hnp

from pcs_racing.track.grid import cast, distance_to_walls

grids = hnp.arrays(np.bool_, st.tuples(st.integers(1, 14), st.integers(1, 14)))


def _padded(grid):
    return np.pad(grid, 1)


@given(drivable=grids)
def test_distances_are_exact_at_cell_centres(drivable):
    drivable = _padded(drivable)
    wall_rows, wall_cols = np.nonzero(~drivable)
    found = distance_to_walls(drivable, 0.5)
    for i, j in np.ndindex(drivable.shape):
        dx = np.maximum(np.abs(wall_cols - j) - 0.5, 0.0)
        dy = np.maximum(np.abs(wall_rows - i) - 0.5, 0.0)
        expected = 0.5 * np.hypot(dx, dy).min() if drivable[i, j] else 0.0
        np.testing.assert_allclose(found[i, j], expected, rtol=1e-6)
    assert found.dtype == np.float32


@given(
    drivable=grids,
    x=st.floats(0.0, 1.0),
    y=st.floats(0.0, 1.0),
    angle=st.floats(-np.pi, np.pi) | st.sampled_from([0.0, 0.5 * np.pi, np.pi, -0.5 * np.pi]),
)
def test_a_ray_ends_at_the_first_wall_that_small_steps_find(drivable, x, y, angle):
    height, width = drivable.shape
    drivable = _padded(drivable)
    x, y = 1.0 + x * width * 0.999, 1.0 + y * height * 0.999
    cos, sin = np.cos(angle), np.sin(angle)
    distance, row, col, side = cast(drivable, x, y, cos, sin, np.inf)
    if not drivable[int(y), int(x)]:
        assert (distance, side) == (0.0, -1)
        return
    assert drivable[row, col]
    assert not drivable[row + (side == 2) - (side == 0), col + (side == 1) - (side == 3)]
    r = np.arange(0.0, distance - 1e-6, 0.01)
    rows, cols = np.floor(y + r * sin + 1e-9).astype(int), np.floor(x + r * cos + 1e-9).astype(int)
    # A small step may cut a corner that the ray goes round by less than the step.
    assert np.count_nonzero(~drivable[rows, cols]) <= 1
    if distance > 0.0:  # a ray that gives up before the wall leaves through no side
        given_up = cast(drivable, x, y, cos, sin, 0.5 * distance)
        assert (given_up[0], given_up[3]) == (0.5 * distance, -1)
