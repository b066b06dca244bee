"""Moving obstacles: paths between the walls, and the same box for lidars, contacts and planners."""

import numpy as np
import pytest
from hypothesis import given, strategies as st
from placed_cars import PSI, V, X, placed, view_of
from refusal import refused

from pcs_racing.car.collision import Rectangle, car_hits_wall, rectangles_overlap
from pcs_racing.car.lidar import Lidar
from pcs_racing.envs.drive import DriveEnv
from pcs_racing.envs.obstacles import Obstacles
from pcs_racing.planners import scanning, view as seen
from pcs_racing.race.driving import advance
from pcs_racing.race.state import WALL_CRASH
from pcs_racing.track.frenet import LEFT, RIGHT
from pcs_racing.track.loading import load_track
from pcs_racing.track.moving import moving_outlines, moving_poses
from pcs_racing.track.obstacles import with_obstacles

# On the lower straight of the oval, 6 m after the start of the line; 1 m/s, with a sway of .3 m.
BOX = [0.0, -4.0, 0.2, 0.4, 0.3, 1.0, 0.3]
CIRCLE = [0.0, -4.0, 0.0, 0.4, 0.0, 1.0, 0.0]


@pytest.fixture(scope="module")
def busy(oval):
    return with_obstacles(oval, [BOX])


def test_a_box_moves_along_the_line_and_sways_from_its_place(busy, oval):
    s0, d0 = oval.to_frenet(BOX[:2])
    for time in np.linspace(0.0, 45.0, 181):
        ((x, y, heading),) = moving_poses(busy.arrays, time)
        s, d = oval.to_frenet([x, y])
        assert s == pytest.approx((s0 + time) % oval.length, abs=1e-4)
        assert d == pytest.approx(d0 + 0.3 * np.sin(0.5 * np.pi * time), abs=0.02)
        along = oval.to_cartesian([s, d])[2]
        assert np.cos(heading - along - 0.2) == pytest.approx(1.0, abs=1e-4)
    assert with_obstacles(oval, [[*BOX[:5], 0.0, 0.0]]).arrays.moving.shape[0] == 0


@pytest.mark.parametrize("aside", [-1.0, 0.0, 0.9])
def test_it_stays_off_the_walls(oval, aside):
    box = [*oval.to_cartesian([3.0, aside])[:2], 0.0, 0.35, 0.32, 1.0, 0.8]
    track = with_obstacles(oval, [box])
    corners = [one for t in np.arange(0.0, 40.0, 0.1) for one in moving_outlines(track.arrays, t)]
    assert oval.wall_distance(np.concatenate(corners)).min() > 0.0
    s, d = oval.to_frenet(np.concatenate(corners)).T
    assert np.ptp(d) > 0.85  # it sways as far as there is room
    assert (d < np.interp(s, np.arange(len(oval.line)) * oval.arrays.ds, oval.line[:, LEFT])).all()


def test_planners_see_the_nearest_in_place_of_the_opponent(busy, oval):
    setup, state, _ = placed(busy, [(4.0, 0.0), (0.1, 0.0)], [2.0, 2.0])
    step = 1e-3
    for tick in (0, 150):
        state.tick[0] = tick
        now, later = (moving_poses(busy.arrays, tick * 0.01 + t)[0] for t in (0.0, step))
        view = view_of(setup, state, 0, 0)
        np.testing.assert_allclose(view[[seen.OPP_X, seen.OPP_Y, seen.OPP_PSI]], now)
        rate = (later[:2] - now[:2]) / step
        course = view[seen.OPP_PSI] + view[seen.OPP_BETA]
        moved = view[seen.OPP_V] * np.array([np.cos(course), np.sin(course)])
        np.testing.assert_allclose(moved, rate, atol=5e-3)
        d_dot = (oval.to_frenet(later[:2]) - oval.to_frenet(now[:2]))[1] / step
        assert view[seen.OPP_D_DOT] == pytest.approx(d_dot, abs=5e-3)
        assert view[[seen.OPP_LENGTH, seen.OPP_WIDTH]].tolist() == [0.4, 0.3]
        if tick == 0:
            assert view[seen.GAP] == pytest.approx(2.0, abs=0.01)
            behind = view_of(setup, state, 0, 1)  # for which car 0 is nearer
            assert behind[seen.OPP_X] == state.cars[0, 0, X]


@pytest.mark.parametrize("obstacle", [BOX, CIRCLE])
def test_the_lidar_of_a_race_measures_it_where_it_is(oval, obstacle):
    env = DriveEnv(track=oval, opponent=None, beams=181, look_ahead=(), see_opponent="never")
    pose = [-3.0, -4.1, 0.1]
    first, _ = env.reset(seed=0, options={"poses": [pose], "obstacles": [obstacle]})
    later = env.step([0.0, -1.0])[0]
    for time, observation in ((0.0, first), (0.1, later)):
        (x, y, heading) = moving_poses(env.batch.track.arrays, time)[0]
        still = with_obstacles(oval, [[x, y, heading, *obstacle[3:5]]])
        own = env.batch.state.cars[0, 0, [0, 1, PSI]] if time else pose
        expected = Lidar(still, 181).scan(own)
        assert np.count_nonzero(np.abs(observation[-181:] - expected) > 0.03) <= 2
        without = Lidar(oval, 181).scan(own)
        assert np.count_nonzero(np.abs(observation[-181:] - without) > 0.03) >= 4


def test_lidar_planners_see_all_of_them(oval):
    boxes = [BOX, [2.0, -3.4, 0.0, 0.3, 0.2, 0.5, 0.0], [4.0, -4.4, 0.0, 0.3, 0.0, 0.5, 0.0]]
    setup, state, _ = placed(with_obstacles(oval, boxes), [(3.0, -0.5)])
    state.tick[0] = 100
    scratch = np.zeros(scanning.SCAN_SIZE)
    scanning.scan(setup.track.arrays, view_of(setup, state, 0, 0), scratch)
    poses = moving_poses(setup.track.arrays, 1.0)
    still = with_obstacles(
        oval, [[*pose, *box[3:5]] for pose, box in zip(poses, boxes, strict=True)]
    )
    lidar = Lidar(still, scanning.BEAMS, scanning.FIELD_OF_VIEW, scanning.MAX_RANGE)
    expected = lidar.scan(state.cars[0, 0, [0, 1, PSI]])
    wrong = np.abs(scratch[-scanning.BEAMS :] - expected) > 0.03
    assert np.count_nonzero(wrong) <= 6  # two for each silhouette


@pytest.mark.parametrize("obstacle", [BOX, CIRCLE])
def test_a_car_that_it_runs_into_has_crashed_as_into_a_wall(oval, obstacle):
    track = with_obstacles(oval, [[*obstacle[:6], 0.0]])
    setup, state, theta = placed(track, [(9.0, 0.0)])
    advance(setup, state, theta, 400)
    assert state.crash[0, 0] == WALL_CRASH
    assert state.fault[0, 0] == 1
    reach = 0.2 if obstacle is CIRCLE else 0.5 * (0.4 * np.cos(0.2) + 0.3 * np.sin(0.2))
    assert state.tick[0] * 0.01 == pytest.approx(3.0 - 0.29 - reach, abs=0.03)


@pytest.mark.parametrize("contact", ["stop", "restart"])
def test_a_contact_is_one_fault_where_races_go_on(oval, contact):
    track = with_obstacles(oval, [[*BOX[:6], 0.0]])
    setup, state, theta = placed(track, [(9.0, 0.0), (20.0, 0.0)], contact=contact)
    advance(setup, state, theta, 500)
    assert state.fault[0].tolist() == [1, 0]
    assert state.cars[0, 0, V] == 0.0


def test_drawn_ones_keep_apart_and_leave_a_passage(oval):
    settings = Obstacles(count=4, moving=2, apart=3.0, passage=0.8, sway=(0.0, 0.2), size=0.3)
    found = 0
    for seed in range(12):
        boxes = settings.draw(oval, [5.0], np.random.default_rng(seed))
        track = with_obstacles(oval, boxes)
        moves = boxes[:, 5] > 0.0
        found += np.count_nonzero(moves)
        assert len(set(boxes[moves, 5])) <= 1  # equally fast
        for time in np.arange(0.0, 40.0, 0.5):
            now = moving_poses(track.arrays, time)
            s, d = oval.to_frenet(now[:, :2]).T
            line = oval.line[(s / oval.arrays.ds).astype(int) % len(oval.line)]
            free = np.maximum(line[:, LEFT] - d, line[:, RIGHT] + d) - 0.5 * np.hypot(0.3, 0.3)
            assert (free > 0.78).all()
            every = np.concatenate([now[:, :2], boxes[~moves, :2]])
            apart = np.hypot(*(every[:, None] - every).transpose(2, 0, 1))
            assert (
                apart[np.triu_indices(len(every), 1)].min(initial=9.0) > np.hypot(0.3, 0.3) - 0.01
            )
    assert found >= 16


def test_drawn_ones_touch_neither_walls_nor_standing_ones():
    track = load_track("Pipkin")
    for seed in range(6):
        boxes = Obstacles(count=6, moving=2, shape="roboracer").draw(
            track, [0.0, 1.0], np.random.default_rng(seed)
        )
        busy = with_obstacles(track, boxes)
        times = np.arange(0.0, 120.0, 0.2)
        corners = np.concatenate([one for t in times for one in moving_outlines(busy.arrays, t)])
        assert busy.wall_distance(corners).min() > 0.0


def test_without_moving_ones_a_seed_draws_as_before(oval):
    some = Obstacles(count=3, shape="both").draw(oval, [0.0], np.random.default_rng(3))
    other = Obstacles(count=3, shape="both", speed=2.0, sway=1.0)
    np.testing.assert_array_equal(some, other.draw(oval, [0.0], np.random.default_rng(3)))
    assert (some[:, 5:] == 0.0).all()
    boxes = Obstacles(count=3, shape="roboracer").draw(oval, [0.0], np.random.default_rng(3))
    assert (boxes[:, 3:5] == [0.35, 0.32]).all()


# on the lower straight of the oval, whose race line runs through (x, -4)
STANDING = [0.0, -4.0, 0.3, 0.6, 0.4]


@pytest.fixture(scope="module")
def blocked(oval):
    return with_obstacles(oval, [STANDING])


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
                np.array([j + 0.5, i + 0.5]) * arrays.cell + (arrays.origin_x, arrays.origin_y),
                STANDING,
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
    near = STANDING[2]
    ahead = 3.0 - 0.3 / np.cos(near)  # where the x axis enters the box through its short side
    assert after[90] == pytest.approx(ahead, abs=0.02)
    seen = np.flatnonzero(np.abs(after - before) > 0.05)
    assert seen.min() >= 75
    assert seen.max() <= 105
    np.testing.assert_allclose(after[:70], before[:70], atol=0.02)


@given(x=st.floats(-1.5, 1.5), y=st.floats(-4.6, -3.4), heading=st.floats(0.0, 6.28))
def test_a_car_hits_a_box_when_the_two_rectangles_overlap(blocked, x, y, heading):
    for scale in (0.9, 1.1):  # exact contacts are a matter of the field's cells
        box = Rectangle(*STANDING[:3], 0.5 * scale * STANDING[3], 0.5 * scale * STANDING[4])
        overlap = rectangles_overlap(Rectangle(x, y, heading, 0.29, 0.155), box)
        if overlap == (scale < 1.0):
            s, _ = blocked.to_frenet([x, y])
            assert car_hits_wall(blocked.arrays, x, y, heading, 0.29, 0.155, s) == overlap


ROUND = [0.0, -4.0, 0.0, 0.5, 0.0]


def test_a_circle_is_round_for_the_distance_field_and_the_lidar(oval):
    round_one = with_obstacles(oval, [ROUND])
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
    both = with_obstacles(oval, [ROUND, [4.0, -4.0, 0.0, 0.2, 0.3]])
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
        [STANDING] * 101,
        "boxes",
        [["x"] * 5],
        [[*STANDING, 1.0, 0.0], STANDING],
        [[*BOX[:5], 100.0, 0.0]],
        [[*BOX[:5], 0.0, -50.0]],
        [[*BOX[:5], np.nan, 0.0]],
        [BOX[:6]],
    ]:
        refused("obstacle", with_obstacles, oval, boxes)
