"""Tools for occupancy grids, each against the plainest way to compute the same."""

import numpy as np
from hypothesis import given, strategies as st
from hypothesis.extra import numpy as hnp

from pcs_racing.track.grid import cast, distance_to_walls, lookup_grid, way_out

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


def test_the_lookup_does_not_go_through_walls_and_the_way_out_leads_through_the_gap():
    """Two corridors, one cell of wall between them; a point of the upper one lies close to the
    wall.
    """
    drivable = _padded(np.ones((7, 20), dtype=bool))
    drivable[4, 1:19] = False  # open at the right end only
    x = np.concatenate([np.arange(1.5, 20.0), [20.5], np.arange(19.5, 1.0, -1.0)])
    y = np.concatenate([np.full(19, 1.5), [4.5], np.full(19, 5.5)])
    table = lookup_grid(drivable, x, y, 1)
    for col in range(2, 17):
        assert y[table[3, col]] == 1.5  # the other corridor's point is nearer here ...
        assert abs(x[table[3, col]] - col - 0.5) <= 1.0
        assert y[table[6, col]] == 5.5
    assert (table >= 0).all()
    coarse = lookup_grid(drivable, x, y, 4)
    assert coarse.shape == (3, 6)
    assert (coarse >= 0).all()
    occupied = np.zeros((30, 40), dtype=bool)
    occupied[5, 5:35] = occupied[25, 5:35] = occupied[5:26, 5] = occupied[5:26, 34] = True
    occupied[25, 20] = False
    way = way_out(occupied, np.array([10]), np.array([10]))
    assert [25, 20] in way.tolist()
    assert way[-1].tolist() == [10, 10]
    assert way[0, 0] == 29
