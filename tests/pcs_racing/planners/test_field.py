"""The drivers of the field: each follows the race line or the gap alone, and passes or follows as
its paper says.
"""

import itertools

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from pcs_racing import CONTEST, PAPER, load_track, racer, run_races
from pcs_racing.planners import line as line
from pcs_racing.planners.field.bimatrix import MOVES, solve
from pcs_racing.planners.field.disparity_extender import extend_disparities
from pcs_racing.planners.field.follow_the_gap import longest_gap, smooth
from pcs_racing.planners.field.predictive_spliner import (
    _D,
    _SEEN,
    AHEAD,
    BINS,
    MEMORY,
    Process,
    remember,
    smooth_ahead,
)
from pcs_racing.planners.field.pure_pursuit import PURE_PURSUIT
from pcs_racing.planners.field.spliner import SCRATCH, SPLINER, lay_spline, spline_at
from pcs_racing.planners.registry import get_planner
from pcs_racing.planners.scanning import BEAMS, STEP
from pcs_racing.planners.view import OWN_D, OWN_S, PATH_POINTS, TIME
from pcs_racing.race.config import Rules
from pcs_racing.race.races import RaceSetup
from pcs_racing.race.start_grid import Starts
from pcs_racing.testing import check_planner
from pcs_racing.track.frenet import SPEED
from pcs_racing.track.maps import list_tracks

PASSING = (
    "bimatrix-game",
    "iterated-best-response",
    "mppi",
    "predictive-spliner",
    "spliner",
)
MAPPED = (*PASSING, "stanley")
LIDAR = ("disparity-extender", "follow-the-gap", "lidar-ppo")


def python(function):
    """The Python function of a compiled one."""
    return getattr(function, "py_func", function)


@pytest.mark.parametrize(
    ("name", "circuit"), [*zip(MAPPED, itertools.cycle(("Kestrelheim", "Quillburg")))]
)
def test_it_follows_the_race_line_alone(name, circuit, drive_alone):
    track = load_track(circuit)
    result = drive_alone(track, [racer(name)], speed_range=(0.7, 1.2))
    assert not result.crashed.any()
    # As fast as the profile of its scale, but for the start in the middle of the track.
    scale = 0.95 * len(track.line) / (1.0 / track.line[:, 6]).sum()
    assert (result.state.progress[0] - [0.0, -50.0] > 0.8 * scale * 40.0 - 50.0).all()


@pytest.mark.parametrize(
    ("name", "circuit"), [*zip(LIDAR, itertools.cycle(("Kestrelheim", "Pipkin")))]
)
def test_it_drives_by_its_lidar_alone(name, circuit, drive_alone):
    result = drive_alone(load_track(circuit), [racer(name)])
    assert not result.crashed.any()
    assert (result.state.progress[0] > 2.5 * 40.0 - 50.0).all()


def behind_a_slow_car(name, share=0.6, races=10):
    """Races of a driver behind one on the race line with a share of its speed."""
    track = load_track("Tarnfjord")
    config = Rules(
        start="rolling", start_gap=4.0, start_spacing=0.0, speed_range=(1.1 * share, 1.1)
    )
    starts = Starts(np.arange(races) / races * track.length, np.ones(races, np.int64))
    planner = get_planner(name)
    ego = planner.policy({"pace": 1.0} if "pace" in planner.parameter_names else {})
    return run_races(
        track,
        [ego] * races,
        racer("pure-pursuit:pace=0,follow_distance=0"),
        config,
        starts=starts,
    )


@pytest.mark.parametrize("name", [*PASSING, "lidar-ppo"])
def test_it_passes_a_slow_car(name):
    result = behind_a_slow_car(name)
    assert np.mean(result.state.overtakes[:, 0] > 0) >= 0.7
    assert np.mean(result.own_crash[:, 0]) <= 0.3


def test_stanley_follows_a_slow_car_like_pure_pursuit():
    for name in ("stanley", "pure-pursuit"):
        result = behind_a_slow_car(name)
        assert (result.state.overtakes[:, 0] == 0).all()
        assert np.mean(result.own_crash[:, 0]) <= 0.2


@pytest.mark.parametrize("name", [*MAPPED, *LIDAR])
def test_it_keeps_the_protocol(name):
    """It depends on nothing but its arguments: one seed, one result, in any pieces and batch."""
    check_planner(get_planner(name), load_track("Pipkin"), seconds=2.0)


def test_a_path_eases_from_the_car_onto_its_lane(oval, view_at):
    view = view_at(oval, 3.0, 0.5)
    lane = np.zeros(line.LANE_SIZE)
    lane[: line.LANE_POINTS] = 0.3
    path = np.full((PATH_POINTS, 4), np.nan)
    line.ease_onto(oval.arrays, view, 1.0, 3.0, lane, path)
    sd = oval.to_frenet(path[:, :2])
    np.testing.assert_allclose(
        sd[:, 0], 3.0 + line.lane_step(view) * np.arange(PATH_POINTS), atol=1e-6
    )
    assert 0.3 < sd[0, 1] <= 0.5
    assert sd[-1, 1] == pytest.approx(0.3, abs=0.02)
    assert (path[:, 2] == 3.0).all()
    steps = np.diff(path[:, :2], axis=0)
    headings = np.unwrap(np.arctan2(steps[:, 1], steps[:, 0]))
    bends = np.diff(headings) / np.hypot(*(0.5 * (steps[1:] + steps[:-1])).T)
    np.testing.assert_allclose(path[1:-1, 3], bends, atol=0.06)


def test_a_lane_is_moved_off_a_wall_that_the_race_line_touches(view_at):
    track = load_track("Saltmere")
    near = int(np.argmin(track.line[:, 8]))  # free width to the left
    view = view_at(track, near * track.arrays.ds - line.ANCHOR_STEP)
    lane = np.zeros(line.LANE_SIZE)
    line.ease_onto(track.arrays, view, 1.0, 5.0, lane, np.zeros((PATH_POINTS, 4)))
    assert -0.2 < lane[: line.LANE_POINTS].min() < -0.05


def test_a_lane_through_places_is_remembered(oval, view_at):
    view = view_at(oval, 3.0)
    along, lane, memory = (
        np.linspace(0.5, 6.0, 12),
        np.zeros(line.LANE_SIZE),
        np.zeros(line.LANE_SIZE),
    )
    line.lay_lane(view, 0.1, along, 0.1 + 0.05 * along, lane)
    laid = 0.1 + 0.05 * line.lane_step(view) * np.arange(line.LANE_POINTS)
    np.testing.assert_allclose(lane[: line.LANE_POINTS], laid, atol=1e-9)
    assert line.kept_lane(oval.arrays, memory, 3.5) == (0.0, 0.0)
    line.keep_lane(view, lane, memory)
    assert line.kept_lane(oval.arrays, memory, view[OWN_S] + 1.0) == pytest.approx((0.15, 0.05))


def test_trailing_keeps_the_gap(oval, view_at):
    theta = SPLINER.policy({"trailing_gap": 1.5, "trailing_p": 0.5, "trailing_d": 0.2}).parameters
    speeds = [
        line.trailing_speed(theta, view_at(oval, 3.0, gap=gap, opp_speed=3.0, speed=v), gap)
        for gap, v in ((1.5, 3.0), (3.5, 3.0), (1.5, 4.0))
    ]
    assert speeds == pytest.approx([3.0, 4.0, 2.8])


def test_the_spline_is_the_natural_cubic_one_without_its_undershoots():
    scratch = np.zeros(SCRATCH)
    python(lay_spline)(SPLINER.default, 1.2, scratch)
    knots = 1.2 * np.array([-4.0, -3.0, -1.5, 0.0, 2.0, 3.0, 4.0])
    expected = CubicSpline(knots, [0, 0, 0, 1, 0, 0, 0], bc_type="natural")
    for x in np.linspace(-5.5, 5.5, 111):
        inside = knots[0] < x < knots[-1]
        wanted = min(max(float(expected(x)), 0.0), 1.0) if inside else 0.0
        assert python(spline_at)(x, scratch) == pytest.approx(wanted, abs=1e-9)


def test_the_spliner_passes_on_the_side_with_more_room(oval, view_at):
    theta = SPLINER.policy({"sector_kappa": 0.5}).parameters  # of this circuit the bends are near
    for opp_d in (-0.25, 0.25):
        memory, path = np.zeros(1), np.zeros((PATH_POINTS, 4))
        view = view_at(oval, 3.0, gap=1.5, opp_d=opp_d, opp_speed=2.0)
        SPLINER.plan(oval.arrays, theta, view, memory, np.zeros(SPLINER.scratch_size), path)
        assert memory[0] == -np.sign(opp_d)
        assert np.sign(oval.to_frenet(path[-1, :2])[1]) == -np.sign(opp_d)


def test_the_process_of_the_predictive_spliner_is_that_of_its_kernel():
    """Against the textbook's formula with dense matrices."""
    memory, mean, work = np.zeros(MEMORY), np.zeros(AHEAD), np.zeros(AHEAD)
    rng = np.random.default_rng(0)
    seen = np.sort(rng.choice(np.arange(1, AHEAD), 20, replace=False))
    first = BINS - 10  # the bins go on beyond the end of the lap
    for k in seen:
        python(remember)(memory, (first + k) % BINS, rng.normal(), 1.0)
    assert memory[_SEEN:].sum() == 20
    keep, noise, now, prior = 0.8, 0.1, 0.4, 0.2
    python(smooth_ahead)(memory, first, _D, Process(keep, noise, now, prior), mean, work)
    at = np.concatenate([[0], seen])
    values = np.concatenate([[now], memory[_D + (first + seen) % BINS]])
    kernel = keep ** np.abs(np.subtract.outer(np.arange(AHEAD), at)).astype(float)
    covariance = kernel[at] + np.diag([0.0] + [noise] * 20)
    np.testing.assert_allclose(
        mean, prior + kernel @ np.linalg.solve(covariance, values - prior), atol=1e-9
    )


def test_the_game_is_solved_for_the_leaders_equilibrium():
    """Against all replies to all moves, in a game of random payoffs."""
    own, opponent = np.random.default_rng(2).normal(size=(2, MOVES, MOVES))
    replies = opponent.argmax(axis=1)
    leader = own[np.arange(MOVES), replies].argmax()
    follower = own[:, opponent[own.argmax(axis=0), np.arange(MOVES)].argmax()].argmax()
    flat = own.ravel(), opponent.ravel()
    assert (solve(*flat, True), solve(*flat, False)) == (leader, follower)


def test_a_disparity_is_extended_by_half_a_car_to_its_far_side():
    ranges, extended = np.full(BEAMS, 8.0), np.zeros(BEAMS)
    ranges[:100] = 2.0
    extend_disparities(ranges, 0.3, 0.3, extended)
    covered = int(np.ceil(np.arctan(0.3 / 2.0) / STEP))
    assert (extended[: 100 + covered] == 2.0).all()
    assert (extended[100 + covered :] == 8.0).all()
    extend_disparities(ranges, 7.0, 0.3, extended)
    np.testing.assert_array_equal(extended, ranges)


def test_ranges_are_cut_off_and_averaged_and_the_longest_gap_is_found():
    ranges, out = np.random.default_rng(1).uniform(0.5, 12.0, BEAMS), np.zeros(BEAMS)
    smooth(ranges, 10.0, 2.5 * STEP, out)
    cut = np.minimum(ranges, 10.0)
    expected = [cut[max(k - 2, 0) : k + 3].mean() for k in range(BEAMS)]
    np.testing.assert_allclose(out, expected)
    out[:] = 1.0
    out[[40, 41, 200]] = 0.0
    assert longest_gap(out) == (42, 200)


@pytest.mark.parametrize("opp_d", [-0.2, 0.2])
# decisions of lidar-ppo follow from more than one scan
@pytest.mark.parametrize("name", LIDAR[:-1])
def test_a_lidar_driver_steers_away_from_a_car(name, opp_d, oval, view_at):
    planner, path = get_planner(name), np.zeros((PATH_POINTS, 4))
    view = view_at(oval, 3.0, gap=2.0, opp_d=opp_d)
    memory = np.zeros(planner.memory_size)
    planner.plan(oval.arrays, planner.default, view, memory, np.zeros(planner.scratch_size), path)
    assert np.sign(path[0, 3]) == -np.sign(opp_d)
    assert view[OWN_D] == pytest.approx(0.0, abs=1e-6)


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


def test_the_path_has_the_pace_of_the_profile(oval, view_at):
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
    config = Rules(duration=20.0, start="staggered", start_gap=50.0, start_spacing=0.0)
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
