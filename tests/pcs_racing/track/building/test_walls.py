"""Walls as polylines: true to the cells, the track on their left, and listed wherever they can be
seen.
"""

import itertools

import numpy as np
from hypothesis import given, strategies as st
from hypothesis.extra import numpy as hnp
from numba import njit
from refusal import refused

from pcs_racing.base.errors import MapError
from pcs_racing.track import frenet
from pcs_racing.track.building.clearance import checked_grid, wall_clearance
from pcs_racing.track.building.walls import simplify, trace_outlines
from pcs_racing.track.frenet import LEFT, RIGHT, TOGETHER
from pcs_racing.track.obstacles import with_obstacles

grids = hnp.arrays(np.bool_, st.tuples(st.integers(1, 12), st.integers(1, 12))).map(
    lambda grid: np.pad(grid, 1)
)


def _faces(outlines):
    """Start and end of each face, the cell on its left."""
    start = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])[outlines.side]
    end = np.array([[1, 0], [1, 1], [0, 1], [0, 0]])[outlines.side]
    cell = np.column_stack([outlines.col, outlines.row])
    return cell + start, cell + end


@given(drivable=grids)
def test_outlines_hold_every_wall_face_once_in_closed_loops(drivable):
    outlines = trace_outlines(drivable)
    expected = set()
    for side, (di, dj) in enumerate([(-1, 0), (0, 1), (1, 0), (0, -1)]):
        for i, j in np.argwhere(drivable):
            if not drivable[i + di, j + dj]:
                expected.add((i, j, side))
    found = list(
        zip(outlines.row.tolist(), outlines.col.tolist(), outlines.side.tolist(), strict=True)
    )
    assert len(found) == len(set(found)) == len(expected)
    assert set(found) == expected
    start, end = _faces(outlines)
    for first, last in zip(outlines.start[:-1], outlines.start[1:], strict=True):
        np.testing.assert_array_equal(end[first:last], np.roll(start[first:last], -1, axis=0))
    # Green's theorem: loops with the region on their left enclose its area.
    assert np.sum(start[:, 0] * end[:, 1] - start[:, 1] * end[:, 0]) == 2 * np.count_nonzero(
        drivable
    )


@given(drivable=grids, tolerance=st.floats(0.3, 1.5))
def test_segments_stay_within_the_tolerance_of_the_faces_they_stand_for(drivable, tolerance):
    outlines = trace_outlines(drivable)
    segments, owner, start = simplify(outlines, tolerance, 0.0)
    middle = 0.5 * sum(_faces(outlines))
    x0, y0, x1, y1 = segments[owner].T
    along = np.column_stack([x1 - x0, y1 - y0])
    t = np.sum((middle - np.column_stack([x0, y0])) * along, axis=1) / np.maximum(
        np.sum(along**2, axis=1), 1e-12
    )
    foot = np.column_stack([x0, y0]) + np.clip(t, 0.0, 1.0)[:, None] * along
    assert np.linalg.norm(middle - foot, axis=1).max(initial=0.0) <= tolerance + 1e-9
    for first, last in itertools.pairwise(start):
        np.testing.assert_array_equal(
            segments[first:last, 2:], np.roll(segments[first:last, :2], -1, axis=0)
        )


def test_specks_keep_their_shape():
    """A single wall cell on the track is seen from every side."""
    drivable = np.zeros((11, 11), dtype=bool)
    drivable[1:10, 1:10] = True
    drivable[5, 5] = False
    segments, _, start = simplify(trace_outlines(drivable), 0.5, 0.25)
    speck = segments[start[1] : start[2]]
    assert len(speck) == 4
    assert np.abs(np.sum(speck[:, 0] * speck[:, 3] - speck[:, 1] * speck[:, 2])) > 0.5


@njit
def _scan(walls, chosen, x, y, angles, reach):
    """Ranges by trying every chosen wall segment on every beam."""
    out = np.full(angles.size, reach)
    for a in range(angles.size):
        c, s = np.cos(angles[a]), np.sin(angles[a])
        for k in chosen:
            px, py = walls[k, 0] - x, walls[k, 1] - y
            dx, dy = walls[k, 2] - walls[k, 0], walls[k, 3] - walls[k, 1]
            det = c * dy - s * dx
            if det != 0.0:
                r = (px * dy - py * dx) / det
                u = (px * s - py * c) / det
                if 0.0 < r < out[a] and 0.0 <= u <= 1.0:
                    out[a] = r
    return out


def _missed(track, views, beams, rng):
    """Share of beams whose range differs when only the segments of the stretch are tried."""
    arrays = track.arrays
    angles = np.linspace(-np.pi, np.pi, beams, endpoint=False)
    everything = np.arange(len(arrays.walls), dtype=np.int32)
    missed = 0
    for s in rng.uniform(0.0, track.length, views):
        row = track.line[int(s / arrays.ds) % len(track.line)]
        x, y, _ = frenet.to_cartesian(arrays, s, rng.uniform(-row[RIGHT] + 0.1, row[LEFT] - 0.1))
        m = int(s / arrays.seen_stretch)
        listed = arrays.seen[arrays.seen_start[m] : arrays.seen_start[m + 1]]
        found, expected = (
            _scan(arrays.walls, which, x, y, angles, 60.0) for which in (listed, everything)
        )
        missed += np.count_nonzero(found > expected)
    return missed / (views * beams)


def test_lists_hold_all_that_is_seen_in_the_order_of_the_distance(oval):
    """Rounded down, by less than a millimetre, and rising along each list without repetition."""
    arrays = oval.arrays
    assert (arrays.seen_start[0], arrays.seen_start[-1]) == (0, len(arrays.seen))
    assert len(arrays.seen_start) == round(oval.length / arrays.seen_stretch) + 1
    for m in range(len(arrays.seen_start) - 1):
        part = slice(arrays.seen_start[m], arrays.seen_start[m + 1])
        assert len(np.unique(arrays.seen[part])) == part.stop - part.start
        walls = arrays.walls[arrays.seen[part]]
        to, way = arrays.seen_middle[m] - walls[:, :2], walls[:, 2:] - walls[:, :2]
        share = np.clip((to * way).sum(axis=1) / (way**2).sum(axis=1), 0.0, 1.0)
        exact = np.linalg.norm(to - share[:, None] * way, axis=1)
        listed = arrays.seen_distance[part].astype(float)
        assert (listed <= exact + 1e-12).all()
        np.testing.assert_allclose(listed, exact, atol=1e-3)
        assert (np.diff(listed) >= 0.0).all()
        s, d = oval.to_frenet(arrays.seen_middle[m])
        assert abs(s - (m + 0.5) * arrays.seen_stretch) < arrays.seen_stretch
        assert abs(d) < 0.3
    assert _missed(oval, 60, 720, np.random.default_rng(7)) == 0.0


def segments_between(corners: np.ndarray) -> set[tuple[float, ...]]:
    """The segments between successive corners, shape (2, C); none begins or ends at NaN."""
    pairs = np.concatenate([corners[:, :-1], corners[:, 1:]]).T
    found = [tuple(pair) for pair in pairs[~np.isnan(pairs).any(axis=1)].tolist()]
    assert len(found) == len(set(found))
    return set(found)


def test_each_list_holds_the_segments_of_its_stretch(oval):
    a_box_and_a_round_one = np.array([[1.0, 2.0, 0.3, 0.4, 0.3], [3.0, 1.0, 0.0, 0.5, 0.0]])
    for track in (oval, with_obstacles(oval, a_box_and_a_round_one)):
        t = track.arrays
        everywhere = t.corners[:, t.corners_start[-1] :]
        assert (everywhere.shape[1] == 0) == (track is oval)
        assert everywhere.shape[1] % TOGETHER == 0
        assert (t.corners_start % TOGETHER == 0).all()
        for m in range(len(t.seen_middle)):
            listed = t.walls[t.seen[t.seen_start[m] : t.seen_start[m + 1]]]
            corners = t.corners[:, t.corners_start[m] : t.corners_start[m + 1]]
            assert segments_between(corners) | segments_between(everywhere) == {
                tuple(wall) for wall in listed.tolist()
            }


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
