"""Holes in walls: beams pass through them to the next wall, and cars meet a wall as before."""

import numpy as np
import pytest
from refusal import refused

from pcs_racing.base.errors import MapError
from pcs_racing.car.collision import car_hits_wall
from pcs_racing.car.lidar import Lidar
from pcs_racing.race.rendering import Renderer
from pcs_racing.track.frenet import PSI, X, Y
from pcs_racing.track.holes import hole_segments, with_holes
from pcs_racing.track.loading import load_track
from pcs_racing.track.maps import MapFolder, write_map
from pcs_racing.track.obstacles import with_obstacles

# The race line of the oval starts at (-6, -4); its lower straight is 12 m long, and the walls are
# 1.1 m away from the line.
INNER = ("left", 5.0, 7.0)  # x from -1 to 1, y = -2.9
OUTER = ("right", 38.5, 1.0)  # over the start line


@pytest.fixture(scope="module")
def holed(oval):
    return with_holes(oval, [INNER, OUTER])


def cast(segments, x, y, angles, reach):
    """Ranges of beams by trying every segment, whichever side it shows."""
    px, py = (segments[:, :2] - (x, y)).T
    dx, dy = (segments[:, 2:] - segments[:, :2]).T
    c, s = np.cos(angles)[:, None], np.sin(angles)[:, None]
    det = c * dy - s * dx
    ranges, share = (px * dy - py * dx) / det, (px * s - py * c) / det
    fine = (ranges > 0.0) & (share >= 0.0) & (share <= 1.0)
    return np.minimum(np.where(fine, ranges, np.inf).min(axis=1), reach)


def test_a_beam_through_a_hole_ends_at_the_back_of_the_next_wall(holed, oval):
    lidar = {"beams": 3, "fov": 0.1, "max_range": 20.0}
    to_the_left = [0.0, -4.0, 0.5 * np.pi]
    assert Lidar(oval, **lidar).scan(to_the_left)[1] == pytest.approx(1.1, abs=0.02)
    # The other inner wall is at y = 2.9, and is met from behind.
    assert Lidar(holed, **lidar).scan(to_the_left)[1] == pytest.approx(6.9, abs=0.02)
    to_the_right = [-6.0, -4.0, -0.5 * np.pi]
    assert Lidar(oval, **lidar).scan(to_the_right)[1] == pytest.approx(1.1, abs=0.02)
    assert Lidar(holed, **lidar).scan(to_the_right)[1] == 20.0


def test_beams_pass_in_the_holes_alone(holed, oval):
    before, after = Lidar(oval, 271, max_range=25.0), Lidar(holed, 271, max_range=25.0)
    holes, s = hole_segments(holed.arrays), np.linspace(0.0, oval.length, 24, endpoint=False)
    d = oval.to_frenet(0.5 * (holes[:, :2] + holes[:, 2:]))[:, 1]
    measured = np.hypot(*(holes[:, 2:] - holes[:, :2]).T)
    assert measured[d > 0.0].sum() == pytest.approx(INNER[2] - INNER[1], abs=0.06)
    assert measured[d < 0.0].sum() > 2.0
    solid = _without(oval.arrays.walls, holes)
    passed, wrong = 0, 0
    for pose in oval.to_cartesian(np.column_stack([s, 0.4 * np.sin(s)])):
        old, new = before.scan(pose), after.scan(pose)
        at_hole, behind = (
            cast(walls, pose[0], pose[1], pose[2] + before.angles, 25.0) for walls in (holes, solid)
        )
        passed += np.count_nonzero(at_hole < behind)
        expected = np.where(at_hole < behind, behind, old)
        wrong += np.count_nonzero(np.abs(new - expected) > 1e-6)
    assert passed > 300
    assert wrong < 0.005 * passed  # beams along an edge, which the grid settles


def _without(walls, holes):
    """Walls less the parts in holes, cut into pieces of 1 cm."""
    parts = [
        np.concatenate([a + (b - a) * t[:-1, None], a + (b - a) * t[1:, None]], axis=1)
        for a, b in zip(walls[:, :2], walls[:, 2:], strict=True)
        for t in [np.linspace(0.0, 1.0, 2 + int(np.hypot(*(b - a)) / 0.01))]
    ]
    pieces = np.concatenate(parts)
    middle = 0.5 * (pieces[:, :2] + pieces[:, 2:])
    along = holes[:, 2:] - holes[:, :2]
    share = ((middle[:, None] - holes[:, :2]) * along).sum(-1) / (along**2).sum(-1)
    foot = holes[:, :2] + np.clip(share, 0.0, 1.0)[..., None] * along
    return pieces[np.hypot(*(middle[:, None] - foot).transpose(2, 0, 1)).min(axis=1) > 1e-6]


def test_for_cars_the_wall_has_no_hole(holed, oval):
    for name, value in oval.arrays._asdict().items():
        if name not in ("corners", "corners_start"):
            np.testing.assert_array_equal(getattr(holed.arrays, name), value)
    assert car_hits_wall(holed.arrays, 0.0, -2.9, 0.5 * np.pi, 0.29, 0.155, 6.0)
    assert holed.content_hash != oval.content_hash
    assert with_holes(oval, []) is oval
    again = with_holes(holed, [])
    assert again.content_hash == oval.content_hash
    other = with_holes(oval, [OUTER])
    assert with_holes(holed, [OUTER]).content_hash == other.content_hash != holed.content_hash
    np.testing.assert_array_equal(again.arrays.corners, oval.arrays.corners)


def test_all_of_both_walls_may_be_holes(oval):
    end = oval.length - 1e-9
    track = with_holes(oval, [("left", 0.0, end), ("right", 0.0, end)])
    assert (Lidar(track, 31, max_range=25.0).scan([0.0, -4.0, 0.3]) == 25.0).all()
    around, walls = (
        np.hypot(*(segments[:, 2:] - segments[:, :2]).T).sum()
        for segments in (hole_segments(track.arrays), oval.arrays.walls)
    )
    assert around == pytest.approx(walls)


def test_obstacles_stand_behind_holes(holed):
    behind = with_obstacles(holed, [[0.0, 0.0, 0.0, 0.4, 0.4]])  # in the infield
    pose = [0.0, -4.0, 0.5 * np.pi]
    assert Lidar(behind, beams=3, fov=0.1).scan(pose)[1] == pytest.approx(3.8, abs=0.02)
    refused("make holes before obstacles", with_holes, behind, [INNER])


def test_a_picture_shows_a_hole_as_dashes(holed, oval):
    car = np.zeros((1, 7))
    car[0, :2] = 0.0, -4.0
    frames = [Renderer(one, 400, 400, view="car_0").render(car) for one in (oval, holed)]
    rows, columns = np.nonzero((frames[0] != frames[1]).any(axis=2))
    assert len(rows) > 20
    scale = 400 / 9.0
    assert np.abs(columns - 200).max() < 1.1 * scale  # x from -1 to 1, y = -2.9
    assert np.abs(200 - 1.1 * scale - rows).max() < 4


def test_holes_are_part_of_a_map_folder(oval, tmp_path):
    occupied = oval.arrays.distance <= 0.0
    race = np.zeros((len(oval.line), 7))
    race[:, 1:4] = oval.line[:, [X, Y, PSI]]
    arrays = oval.arrays
    content = MapFolder(
        name="Holed",
        folder=tmp_path / "Holed",
        occupied=occupied,
        resolution=arrays.cell,
        origin=(arrays.origin_x, arrays.origin_y),
        centerline=np.asarray(oval.centerline),
        raceline=np.concatenate([race, race[:1]]),
        info={"holes": [list(INNER)]},
    )
    track = load_track(write_map(content))
    assert len(track.solid_hash) == 64
    assert with_holes(track, []).content_hash == track.solid_hash != track.content_hash
    assert Lidar(track, beams=3, fov=0.1).scan([0.0, -4.0, 0.5 * np.pi])[1] > 6.0
    assert len(hole_segments(track.arrays)) > 0
    info = tmp_path / "Holed" / "Holed_track.yaml"
    info.write_text("holes: [[left, 5, 500]]")
    refused(r"hold \['left', 5, 500\]; .*arc lengths", load_track, info.parent, error=MapError)


@pytest.mark.parametrize(
    "holes",
    [
        "left",
        5,
        [("middle", 1.0, 2.0)],
        [("left", 1.0)],
        [("left", 1.0, 1.0)],
        [("left", -1.0, 1.0)],
        [("right", 1.0, 1000.0)],
        [("right", np.nan, 1.0)],
        [("right", "1", 2.0)],
        [5.0],
        [INNER] * 1001,
    ],
)
def test_impossible_holes_are_refused(oval, holes):
    refused("holes (are|hold)", with_holes, oval, holes)
