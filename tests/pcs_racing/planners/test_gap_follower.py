import numpy as np
import pytest
from hypothesis import given, strategies as st

from pcs_racing import load_track
from pcs_racing.car.lidar import Lidar
from pcs_racing.planners.field import gap_follower as gaps
from pcs_racing.planners.view import OWN_BETA, PATH_POINTS, TRUE_PSI
from pcs_racing.track.maps import list_tracks

ANGLES = np.linspace(-0.5 * gaps.FIELD_OF_VIEW, 0.5 * gaps.FIELD_OF_VIEW, gaps.BEAMS)


def path(track, view, parameters=None):
    """The path, and the ranges that the planner left in its scratch."""
    written = np.full((PATH_POINTS, 4), np.nan)
    scratch = np.full(gaps.GAP_FOLLOWER.scratch_size, np.nan)
    theta = gaps.GAP_FOLLOWER.policy(parameters).parameters
    gaps.GAP_FOLLOWER.plan(track.arrays, theta, view, np.zeros(0), scratch, written)
    return written, scratch[-2 * gaps.BEAMS : -gaps.BEAMS]


def free(ranges, bubble):
    found = np.empty(gaps.BEAMS)
    gaps.free_distances(np.asarray(ranges, dtype=float), bubble, found)
    return found


@given(st.integers(0, 2**32 - 1), st.floats(0.05, 5.0), st.floats(0.2, 0.45))
def test_the_free_distance_keeps_out_of_every_bubble(seed, nearest, bubble):
    ranges = np.random.default_rng(seed).uniform(nearest, 12.0, gaps.BEAMS)
    found = free(ranges, bubble)
    assert (found >= 0.0).all()
    assert (found <= ranges).all()
    direction = np.stack([np.cos(ANGLES), np.sin(ANGLES)], axis=-1)
    hits = (ranges[:, None] * direction)[ranges > bubble]
    for share in (0.25, 0.5, 0.75, 0.999):
        points = share * found[:, None] * direction
        assert (
            np.hypot(*(points[found > 0.0, None] - hits[None]).T).min(initial=np.inf)
            > bubble - 1e-6
        )
    # Out of a bubble that the car is in already, only away from its middle.
    for k in np.flatnonzero(ranges <= bubble):
        assert not found[np.abs(ANGLES - ANGLES[k]) < 0.5 * np.pi - 0.05].any()


def test_a_post_blocks_what_its_bubble_covers_and_the_middle_of_the_widest_gap_is_found():
    ranges = np.full(gaps.BEAMS, 10.0)
    post = gaps.BEAMS // 2
    ranges[post] = 2.0
    found = free(ranges, 0.3)
    covered = np.abs(ANGLES - ANGLES[post]) < np.arcsin(0.3 / 2.0)
    assert (found[covered] < 2.0).all()
    assert found[post] == pytest.approx(1.7)
    # The others are only limited by the points far away, which have bubbles of their own.
    assert (found[~covered] > 9.0).all()
    found = np.full(gaps.BEAMS, 1.0)
    found[60:81] = 5.0
    found[70] = 6.0
    angle, longest = gaps.widest_gap(found, 0.8)
    assert angle == pytest.approx(ANGLES[70])
    assert longest == 6.0
    # Nothing but free: straight on.
    angle, longest = gaps.widest_gap(np.full(gaps.BEAMS, 12.0), 0.8)
    assert angle == pytest.approx(0.0, abs=1e-9)


def test_it_sees_what_the_lidar_sees(oval, view_at):
    lidar = Lidar(oval, beams=gaps.BEAMS, fov=gaps.FIELD_OF_VIEW, max_range=gaps.MAX_RANGE)
    view = view_at(oval, 3.0, 0.2, turned=0.1, gap=1.5, opp_d=-0.3)
    x, y, psi = oval.to_cartesian([3.0, 0.2])
    opponent = oval.to_cartesian([4.5, -0.3])
    expected = lidar.scan([x, y, psi + 0.1], opponents=opponent)
    np.testing.assert_allclose(path(oval, view)[1], expected, rtol=0, atol=1e-9)
    view[TRUE_PSI] -= 0.05  # of a car that slides, the points along its course
    view[OWN_BETA] += 0.05
    np.testing.assert_allclose(path(oval, view)[1], expected, rtol=0, atol=1e-9)


def test_the_path_is_an_arc_along_the_course_and_slow_in_front_of_what_it_sees(oval, view_at):
    view = view_at(oval, 3.0, 0.2, turned=0.2)
    written, _ = path(oval, view)
    x, y, psi = oval.to_cartesian([3.0, 0.2])
    np.testing.assert_allclose(written[0, :2], [x, y], atol=1e-9)
    steps = np.diff(written[:, :2], axis=0)
    headings = np.unwrap(np.arctan2(steps[:, 1], steps[:, 0]))
    np.testing.assert_allclose(np.diff(headings) / np.hypot(*steps[0]), written[0, 3], rtol=1e-2)
    assert headings[0] - psi - 0.2 == pytest.approx(0.5 * (headings[1] - headings[0]), abs=1e-6)
    assert written[0, 3] < 0.0  # turned to the left on a straight, it steers back to the right
    free_road = path(oval, view_at(oval, 3.0))[0][0, 2]
    behind = path(oval, view_at(oval, 3.0, gap=1.2))[0][0, 2]
    assert behind < 0.6 * free_road
    assert path(oval, view_at(oval, 3.0), {"top_speed": 2.5})[0][0, 2] == 2.5


@pytest.mark.parametrize("opp_d", [-0.5, 0.5])
def test_it_avoids_an_opponent_that_it_sees(oval, view_at, opp_d):
    written, _ = path(oval, view_at(oval, 3.0, gap=2.0, opp_d=opp_d))
    assert np.sign(written[0, 3]) == -np.sign(opp_d)


@pytest.mark.parametrize("name", list_tracks())
def test_it_drives_shipped_circuits_by_its_lidar_alone(name, drive_alone):
    track = load_track(name)
    result = drive_alone(track, [gaps.GAP_FOLLOWER.policy()], duration=60.0)
    assert not result.crashed.any()
    driven = result.state.progress[0] + [0.0, min(0.5 * track.length, 50.0)]
    assert (driven > track.length).all()
    assert (driven > 3.0 * 60.0).all()  # at more than 3 m/s
