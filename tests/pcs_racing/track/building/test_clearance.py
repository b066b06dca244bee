"""The exact distance of points from wall cells."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from refusal import refused

from pcs_racing.base.errors import MapError
from pcs_racing.track.building.clearance import checked_grid, wall_clearance


@given(seed=st.integers(0, 2**32 - 1), reach=st.floats(0.05, 2.0))
def test_clearance_is_the_distance_to_the_nearest_square(seed, reach):
    rng = np.random.default_rng(seed)
    occupied = rng.random((12, 17)) < 0.06
    resolution, origin = 0.1, np.array([-0.7, 0.4])
    size = np.array([1.7, 1.2])
    points = origin + rng.uniform(0.0, 1.0, size=(20, 2)) * size
    corners = origin + resolution * np.argwhere(occupied)[:, ::-1]
    gap = np.maximum(
        np.maximum(corners - points[:, None], points[:, None] - corners - resolution), 0.0
    )
    walls = np.hypot(gap[..., 0], gap[..., 1]).min(axis=1, initial=np.inf)
    border = np.minimum(points - origin, origin + size - points).min(axis=1)
    expected = np.minimum(np.minimum(walls, border), reach)
    np.testing.assert_allclose(
        wall_clearance(points, occupied, resolution, origin, reach), expected, atol=1e-12
    )


def test_a_point_off_the_map_has_no_clearance_and_impossible_grids_are_refused():
    assert (
        wall_clearance(np.array([[9.0, 0.5]]), np.zeros((10, 10), bool), 0.1, np.zeros(2), 1.0)[0]
        == 0.0
    )
    for grid, resolution, origin, words in [
        (np.zeros((9, 9)), 0.05, (0, 0), "float64 of shape"),
        (np.zeros(9, bool), 0.05, (0, 0), r"shape \(9,\)"),
        (np.zeros((9, 9), bool), 0.0, (0, 0), "resolution is 0.0"),
        (np.zeros((9, 9), bool), 0.05, (0, np.nan), "origin holds nan"),
    ]:
        refused(words, checked_grid, grid, resolution, origin, error=MapError)
