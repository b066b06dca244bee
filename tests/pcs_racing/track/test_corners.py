import numpy as np

from pcs_racing.track.corners import TOGETHER, corner_lists
from pcs_racing.track.obstacles import with_obstacles

BOXES = np.array([[1.0, 2.0, 0.3, 0.4, 0.3], [3.0, 1.0, 0.0, 0.5, 0.0]])  # a box and a round one


def segments(corners: np.ndarray) -> set[tuple[float, ...]]:
    """The segments between successive corners, shape (2, C); none begins or ends at NaN."""
    pairs = np.concatenate([corners[:, :-1], corners[:, 1:]]).T
    found = [tuple(pair) for pair in pairs[~np.isnan(pairs).any(axis=1)].tolist()]
    assert len(found) == len(set(found))
    return set(found)


def test_each_list_holds_the_segments_that_its_stretch_sees(oval):
    for track in (oval, with_obstacles(oval, BOXES)):
        t = track.arrays
        everywhere = t.corners[:, t.corners_start[-1] :]
        assert (everywhere.shape[1] == 0) == (track is oval)
        assert everywhere.shape[1] % TOGETHER == 0
        assert (t.corners_start % TOGETHER == 0).all()
        for m in range(len(t.seen_middle)):
            listed = t.walls[t.seen[t.seen_start[m] : t.seen_start[m + 1]]]
            corners = t.corners[:, t.corners_start[m] : t.corners_start[m + 1]]
            assert segments(corners) | segments(everywhere) == {tuple(wall) for wall in listed.tolist()}


def test_segments_that_meet_share_a_corner():
    """Three sides of a square, of which the last is listed first, and a wall far away."""
    walls = np.array([[0, 0, 1, 0], [1, 0, 1, 1], [1, 1, 0, 1], [9, 9, 8, 9]], float)
    start, corners = corner_lists(walls, np.array([0, 4, 6]), np.array([2, 0, 3, 1, 3, 0], np.int32))
    assert start.tolist() == [0, 16, 32]
    nan = [np.nan, np.nan]
    expected = [[0, 0], [1, 0], [1, 1], [0, 1], nan, [9, 9], [8, 9], *[nan] * 9]
    np.testing.assert_array_equal(corners[:, :16].T, expected)
    np.testing.assert_array_equal(corners[:, 16:].T, [[0, 0], [1, 0], nan, [9, 9], [8, 9], *[nan] * 11])
