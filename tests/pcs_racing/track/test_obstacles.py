"""Obstacles on a track: the same walls for the distance field, the lidar and contacts."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from refusal import refused

from pcs_racing.car.collision import Rectangle, car_hits_wall, rectangles_overlap
from pcs_racing.car.lidar import Lidar
from pcs_racing.track.obstacles import with_obstacles

# on the lower straight of the oval, whose race line runs through (x, -4)
BOX = [0.0, -4.0, 0.3, 0.6, 0.4]


@pytest.fixture(scope="module")
def blocked(oval):
    return with_obstacles(oval, [BOX])


def outside(point, box):
    """Distance of a point from a box, m."""
    x, y, heading, length, width = box
    dx, dy = point[0] - x, point[1] - y
    along = abs(dx * np.cos(heading) + dy * np.sin(heading)) - 0.5 * length
    across = abs(dy * np.cos(heading) - dx * np.sin(heading)) - 0.5 * width
    return float(np.hypot(max(along, 0.0), max(across, 0.0)))


def test_boxes_change_the_distance_field_and_not_the_track_itself(oval, blocked):
    arrays, before = blocked.arrays, oval.arrays.distance
    rows, columns = np.nonzero(before > 0.0)
    expected = [
        min(
            before[i, j],
            outside(
                np.array([j + 0.5, i + 0.5]) * arrays.cell + (arrays.origin_x, arrays.origin_y), BOX
            ),
        )
        for i, j in zip(rows, columns, strict=True)
    ]
    np.testing.assert_allclose(arrays.distance[rows, columns], expected, atol=1e-6)
    assert (arrays.distance[before == 0.0] == 0.0).all()
    assert (arrays.distance != before).sum() > 100
    assert blocked.arrays is not oval.arrays
    assert len(blocked.arrays.walls) == len(oval.arrays.walls) + 4
    assert blocked.content_hash == oval.content_hash
    assert blocked.calibration == oval.calibration
    assert with_obstacles(oval, []) is oval
    assert oval.wall_distance([0.0, -4.0]) > 1.0
    assert blocked.wall_distance([0.0, -4.0]) == 0.0


def test_the_lidar_measures_the_way_to_a_box(oval, blocked):
    """A beam straight ahead ends at the near side; those that pass the box measure what they
    measured before.
    """
    lidar = {"beams": 181, "fov": np.pi}
    at = [-3.0, -4.0, 0.0]
    before, after = Lidar(oval, **lidar).scan(at), Lidar(blocked, **lidar).scan(at)
    near = BOX[2]
    ahead = 3.0 - 0.3 / np.cos(near)  # where the x axis enters the box through its short side
    assert after[90] == pytest.approx(ahead, abs=0.02)
    seen = np.flatnonzero(np.abs(after - before) > 0.05)
    assert seen.min() >= 75
    assert seen.max() <= 105
    np.testing.assert_allclose(after[:70], before[:70], atol=0.02)


@given(x=st.floats(-1.5, 1.5), y=st.floats(-4.6, -3.4), heading=st.floats(0.0, 6.28))
def test_a_car_hits_a_box_when_the_two_rectangles_overlap(blocked, x, y, heading):
    for scale in (0.9, 1.1):  # exact contacts are a matter of the field's cells
        box = Rectangle(*BOX[:3], 0.5 * scale * BOX[3], 0.5 * scale * BOX[4])
        overlap = rectangles_overlap(Rectangle(x, y, heading, 0.29, 0.155), box)
        if overlap == (scale < 1.0):
            s, _ = blocked.to_frenet([x, y])
            assert car_hits_wall(blocked.arrays, x, y, heading, 0.29, 0.155, s) == overlap


CIRCLE = [0.0, -4.0, 0.0, 0.5, 0.0]


def test_a_circle_is_round_for_the_distance_field_and_the_lidar(oval):
    round_one = with_obstacles(oval, [CIRCLE])
    arrays, before = round_one.arrays, oval.arrays.distance
    rows, columns = np.nonzero(before > 0.0)
    x, y = (
        (columns + 0.5) * arrays.cell + arrays.origin_x,
        (rows + 0.5) * arrays.cell + arrays.origin_y,
    )
    expected = np.minimum(before[rows, columns], np.maximum(np.hypot(x, y + 4.0) - 0.25, 0.0))
    np.testing.assert_allclose(arrays.distance[rows, columns], expected, atol=1e-6)
    for angle in np.linspace(0.0, 2.0 * np.pi, 11):  # from every side it is as near
        at = [np.cos(angle), -4.0 + np.sin(angle), angle + np.pi]
        assert Lidar(round_one, beams=3, fov=0.1).scan(at)[1] == pytest.approx(0.75, abs=0.02)


def test_boxes_and_circles_stand_together_listed_near_ones_first(oval):
    both = with_obstacles(oval, [CIRCLE, [4.0, -4.0, 0.0, 0.2, 0.3]])
    assert len(both.arrays.walls) == len(oval.arrays.walls) + 16 + 4
    assert both.wall_distance([0.0, -4.0]) == both.wall_distance([4.0, -4.0]) == 0.0
    boxes = [[x, -4.0, 0.0, 0.2, 0.2] for x in (-4.0, 4.0, 0.0)]
    arrays = with_obstacles(oval, boxes).arrays
    for first, last in zip(arrays.seen_start[:-1], arrays.seen_start[1:], strict=True):
        assert (np.diff(arrays.seen_distance[first:last]) >= 0.0).all()
        listed = arrays.seen[first:last]
        assert len(np.unique(listed)) == len(listed)
        assert set(range(len(oval.arrays.walls), len(arrays.walls))) <= set(listed.tolist())


def test_impossible_boxes_are_refused(oval):
    for boxes in [
        [[0.0, 0.0, 0.0]],
        [[0.0, 0.0, 0.0, 0.01, 0.3]],
        [[0.0, 0.0, 0.0, 0.01, 0.0]],
        [[0.0, 0.0, 0.0, 0.3, -0.3]],
        [[0.0, np.nan, 0.0, 0.3, 0.3]],
        [BOX] * 101,
        "boxes",
        [["x"] * 5],
        [[*BOX, 1.0, 0.0], BOX],
    ]:
        refused("obstacle", with_obstacles, oval, boxes)
