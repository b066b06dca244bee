import numpy as np
import pytest

from pcs_racing import CONTEST, PAPER, load_track
from pcs_racing.planners.field.pure_pursuit import PURE_PURSUIT
from pcs_racing.planners.view import OWN_D, PATH_POINTS, TIME
from pcs_racing.race.config import RaceConfig
from pcs_racing.race.races import RaceSetup, run_races
from pcs_racing.race.start_grid import Starts
from pcs_racing.track.frenet import SPEED
from pcs_racing.track.maps import list_tracks


def path(track, view, parameters=None):
    written = np.full((PATH_POINTS, 4), np.nan)
    PURE_PURSUIT.plan(
        track.arrays,
        PURE_PURSUIT.policy(parameters).parameters,
        view,
        np.zeros(0),
        np.zeros(0),
        written,
    )
    return written


def test_the_path_eases_from_the_car_and_its_course_onto_the_race_line(oval, view_at):
    view = view_at(oval, 3.0, 0.5, speed=4.0)
    written = path(oval, view)
    sd = oval.to_frenet(written[:, :2])
    np.testing.assert_allclose(sd[0], [3.0, 0.5], atol=1e-6)
    np.testing.assert_allclose(sd[-1], [3.0 + 1.5 + 0.2 * 4.0, 0.0], atol=1e-3)
    assert (np.diff(sd[:, 1]) <= 1e-9).all()
    # It starts along the car's course and ends along the line.
    assert abs(sd[1, 1] - 0.5) < 0.02
    assert abs(sd[-2, 1]) < 0.02
    written = path(oval, view_at(oval, 3.0, 0.3, turned=0.3))
    sd = oval.to_frenet(written[:2, :2])
    assert np.arctan2(sd[1, 1] - sd[0, 1], sd[1, 0] - sd[0, 0]) == pytest.approx(0.3, abs=0.1)


def test_the_path_has_the_curvature_of_its_points_and_the_pace_of_the_profile(oval, view_at):
    written = path(oval, view_at(oval, 3.0, 0.4, turned=-0.1, speed=5.0))
    steps = np.diff(written[:, :2], axis=0)
    headings = np.unwrap(np.arctan2(steps[:, 1], steps[:, 0]))
    bends = np.diff(headings) / np.hypot(*(0.5 * (steps[1:] + steps[:-1])).T)
    np.testing.assert_allclose(written[1:-1, 3], bends, atol=0.06)
    view = view_at(oval, 3.0)
    low, high = RaceSetup(oval, PAPER, (PURE_PURSUIT, PURE_PURSUIT)).speed_range
    profile = oval.line[
        np.round(oval.to_frenet(path(oval, view)[:, :2])[:, 0] / oval.arrays.ds - 0.5).astype(int),
        SPEED,
    ]
    for pace in (0.0, 0.5, 1.0):
        expected = (low + pace * (high - low)) * profile
        np.testing.assert_allclose(path(oval, view, {"pace": pace})[:, 2], expected, rtol=0.05)


def test_it_slows_down_behind_an_opponent_and_leaves_the_line_to_one_that_is_nearer_to_it(
    oval, view_at
):
    free = path(oval, view_at(oval, 3.0))[:, 2]
    close = view_at(oval, 3.0, gap=1.0, opp_speed=2.0)
    assert (path(oval, close)[:, 2] <= 2.0).all()
    np.testing.assert_array_equal(path(oval, close, {"follow_distance": 0.0})[:, 2], free)
    beside_the_line = view_at(oval, 3.0, gap=1.0, opp_d=0.7, opp_speed=2.0)
    np.testing.assert_array_equal(path(oval, beside_the_line)[:, 2], free)
    yields = path(oval, view_at(oval, 3.0, 0.6, gap=0.1, opp_d=0.1, opp_speed=4.0))
    assert oval.to_frenet(yields[-1, :2])[1] == pytest.approx(0.6, abs=1e-3)
    goes = path(oval, view_at(oval, 3.0, 0.1, gap=0.1, opp_d=0.6, opp_speed=4.0))
    assert oval.to_frenet(goes[-1, :2])[1] == pytest.approx(0.0, abs=1e-3)


@pytest.mark.parametrize("name", list_tracks())
def test_it_drives_shipped_circuits_at_any_pace(name, drive_alone):
    track = load_track(name)
    policies = [PURE_PURSUIT.policy({"pace": pace}) for pace in (0.0, 0.5, 1.0)]
    result = drive_alone(track, policies, speed_range=(0.7, 0.95))
    assert not result.crashed.any()
    progress = result.state.progress[:, 0]
    assert (np.diff(progress) > 10.0).all()


def test_it_keeps_to_the_line_and_two_of_them_sort_themselves_out_at_the_start(views):
    track = load_track("Larkmoor")
    config = RaceConfig(duration=20.0, start="staggered", start_gap=50.0, start_spacing=0.0)
    seen = views(
        track, PURE_PURSUIT.policy(), config, Starts(np.array([60.0]), np.zeros(1, np.int64))
    )
    settled = seen[:, TIME] > 3.0  # the start is in the middle of the track
    assert settled.sum() > 100
    assert np.abs(seen[settled, OWN_D]).max() < 0.1
    for config in (PAPER, CONTEST):
        crashes = [
            run_races(
                load_track(name), [PURE_PURSUIT.policy()] * 10, PURE_PURSUIT.policy(), config
            ).crashed
            for name in list_tracks()
        ]
        # They start in bends, too, and know no way round each other.
        assert np.mean(crashes) < 0.35
