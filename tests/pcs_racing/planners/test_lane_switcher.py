import numpy as np
import pytest
from refusal import refused

from pcs_racing import PAPER, load_track, run_races
from pcs_racing.base.errors import UnknownNameError
from pcs_racing.planners import lane_switcher as switcher
from pcs_racing.planners.field.pure_pursuit import PURE_PURSUIT
from pcs_racing.planners.lattice import LATTICE
from pcs_racing.planners.line import WALL_MARGIN
from pcs_racing.planners.view import PATH_POINTS
from pcs_racing.race.config import Rules
from pcs_racing.race.start_grid import Starts
from pcs_racing.track.frenet import LEFT, RIGHT
from pcs_racing.track.maps import list_tracks

STRAIGHT = 3.0  # an arc length on the oval's first straight, with 9 m to go
VARIANTS = [str(i) for i in range(20)]


def decide(track, view, memory=None, parameters=None):
    """Memory after one decision."""
    memory = np.zeros(switcher.LANE_SWITCHER.memory_size) if memory is None else memory.copy()
    theta = switcher.LANE_SWITCHER.policy(parameters).parameters
    switcher.LANE_SWITCHER.plan(
        track.arrays, theta, view, memory, np.zeros(0), np.zeros((PATH_POINTS, 4))
    )
    return memory


def command(track, view, memory, parameters=None):
    """Steering angle and speed, and the memory after it."""
    memory, written = memory.copy(), np.full(2, np.nan)
    theta = switcher.LANE_SWITCHER.policy(parameters).parameters
    switcher.LANE_SWITCHER.control(
        track.arrays, theta, view, memory, np.zeros(0), np.zeros((PATH_POINTS, 4)), written
    )
    return written, memory


def test_variants_are_twenty_different_drivers_within_the_bounds():
    assert list(switcher.LANE_SWITCHER.variants) == VARIANTS
    theta = np.array([switcher.LANE_SWITCHER.policy(name).parameters for name in VARIANTS])
    assert len(np.unique(theta, axis=0)) == 20
    assert (np.ptp(theta, axis=0) > 0.25 * np.ptp(switcher.LANE_SWITCHER.bounds, axis=1)).all()
    assert (theta.min(axis=0) < switcher.LANE_SWITCHER.default).all()
    assert (theta.max(axis=0) > switcher.LANE_SWITCHER.default).all()
    count = switcher.LANE_SWITCHER.parameter_names.index("return_count")
    np.testing.assert_array_equal(theta[:, count], theta[:, count].round())
    # They are data: results name them, so they may never move.
    np.testing.assert_allclose(theta[0, [0, 2, 9]], [0.811, 1.254, 4.0])
    refused("no variant '20'", switcher.LANE_SWITCHER.policy, "20", error=UnknownNameError)


@pytest.mark.parametrize("name", list_tracks())
def test_all_variants_drive_shipped_circuits_alone(name, drive_alone):
    policies = [switcher.LANE_SWITCHER.policy(variant) for variant in VARIANTS]
    result = drive_alone(load_track(name), policies, duration=60.0)
    crashed = [variant for variant, crash in zip(VARIANTS, result.crashed, strict=True) if crash]
    assert not crashed


# The ranges are those that calibration finds for the rules "paper", in some 10 s each.


@pytest.mark.parametrize("name", list_tracks())
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_the_overtaking_lane_is_smooth_and_keeps_off_the_walls(name, side):
    track = load_track(name)
    s = np.arange(0.0, track.length, 0.1)
    offset = np.array([switcher.lane_offset(track.arrays, at, side) for at in s])
    assert (offset >= 0.0).all()
    assert (offset <= switcher.MAX_OFFSET).all()
    room = track.line[(s / track.arrays.ds).astype(int), LEFT if side > 0.0 else RIGHT]
    assert (offset <= np.maximum(room - WALL_MARGIN, 0.0) + 1e-9).all()
    assert np.quantile(offset, 0.75) > 0.4
    slope = np.abs(np.diff(offset, append=offset[0])) / 0.1
    assert np.quantile(slope, 0.95) < 0.7


def test_it_changes_lanes_where_it_is_blocked_and_closes_up_no_faster_than_it_crosses(
    oval, view_at
):
    memory = decide(oval, view_at(oval, STRAIGHT, gap=2.0, opp_d=0.0, opp_speed=2.0))
    assert memory[switcher._LANE] == switcher.OVERTAKING
    written, _ = command(oval, view_at(oval, STRAIGHT, gap=2.0, opp_speed=2.0), memory)
    assert np.sign(written[0]) == memory[switcher._SIDE]
    view = view_at(oval, STRAIGHT, gap=2.0, opp_speed=2.0)
    before = decide(oval, view)
    _, after = command(oval, view, before)  # the next one follows 0.02 s later
    assert after[switcher._PLACE] - before[switcher._PLACE] == pytest.approx(
        0.02 * 1.2 * before[switcher._SIDE]
    )
    changing = decide(oval, view_at(oval, STRAIGHT, gap=2.0, opp_speed=2.0))
    near, far = (
        decide(oval, view_at(oval, STRAIGHT, gap=gap, opp_speed=2.0), changing)[switcher._MAX_SPEED]
        for gap in (1.0, 2.0)
    )
    assert 2.0 < near < far < 4.0
    across = decide(
        oval,
        view_at(oval, STRAIGHT, 0.6 * changing[switcher._SIDE], gap=1.0, opp_speed=2.0),
        changing,
    )
    assert across[switcher._MAX_SPEED] < 0.0


def test_it_returns_when_the_race_line_was_free_long_enough_and_not_into_a_car(oval, view_at):
    memory = decide(oval, view_at(oval, STRAIGHT, gap=2.0, opp_speed=2.0))
    gone = view_at(oval, STRAIGHT, 0.7, gap=-3.0)
    lanes = []
    for _ in range(8):
        memory = decide(oval, gone, memory)
        lanes.append(memory[switcher._LANE])
    assert lanes == [switcher.OVERTAKING] * 6 + [switcher.RACE_LINE] * 2
    assert memory[switcher._FREE_COUNT] == 8.0
    memory = decide(oval, view_at(oval, STRAIGHT, gap=2.0, opp_speed=2.0))
    for _ in range(12):
        memory = decide(
            oval,
            view_at(oval, STRAIGHT, 0.7 * memory[switcher._SIDE], gap=-0.2, opp_speed=4.0),
            memory,
        )
    assert memory[switcher._LANE] == switcher.OVERTAKING
    memory = decide(oval, view_at(oval, STRAIGHT, 0.6, gap=0.1, opp_d=0.1, opp_speed=4.0))
    assert memory[switcher._LANE] == switcher.OWN_PLACE
    memory = decide(oval, view_at(oval, STRAIGHT, 0.6, gap=-2.0, opp_d=0.1, opp_speed=4.0), memory)
    assert memory[switcher._LANE] == switcher.RACE_LINE


def test_steering_is_proportional_with_a_derivative_part_and_clipped(oval, view_at):
    parameters = {"gain_slow": 0.7, "gain_fast": 0.5, "lookahead_slow": 0.5, "lookahead_fast": 1.5}
    speed, offset = 3.5, 0.02
    memory = np.zeros(switcher.LANE_SWITCHER.memory_size)
    begun = decide(oval, view_at(oval, STRAIGHT, offset, speed=speed), memory)
    begun[2] = 0.0  # steer for the race line itself
    (steer, _), after = command(
        oval, view_at(oval, STRAIGHT, offset, speed=speed), begun, parameters
    )
    error = -2.0 * offset / (1.0 + offset**2)  # the look-ahead at half of 7 m/s is 1 m
    assert steer == pytest.approx(0.6 * error, rel=1e-3)
    later = view_at(oval, STRAIGHT, 0.5 * offset, speed=speed)
    later[0] = 0.02
    (damped, _), _ = command(oval, later, after, {**parameters, "derivative": 2.0})
    change = -2.0 * 0.5 * offset - error
    assert damped == pytest.approx(0.6 * -2.0 * 0.5 * offset + 2.0 * change, abs=2e-4)
    for d, sign in ((0.6, -1.0), (-0.6, 1.0)):
        begun = decide(oval, view_at(oval, STRAIGHT, d, speed=1.0))
        begun[2] = 0.0
        assert (
            command(oval, view_at(oval, STRAIGHT, d, speed=1.0), begun)[0][0]
            == sign * switcher.STEER_LIMIT
        )


def test_it_overtakes_a_slow_car_and_seldom_crashes_with_the_lattice_planner(shipped):
    """A car at less than half of its speed scale, met at thirty places of every circuit."""
    fast = switcher.LANE_SWITCHER.policy({"other_lane_factor": 0.9, "follow_factor": 1.0})
    slow = PURE_PURSUIT.policy({"pace": 0.0, "follow_distance": 0.0})
    config = Rules(start="rolling", start_gap=4.0, start_spacing=0.0, speed_range=(0.4, 0.9))
    overtakes, crashes = [], []
    for track in shipped:
        starts = Starts(np.arange(30) / 30.0 * track.length, np.ones(30, np.int64))
        result = run_races(track, [fast] * 30, slow, config, starts=starts)
        overtakes += (result.state.overtakes[:, 0] > 0).tolist()
        crashes += result.crashed.tolist()
    assert np.mean(overtakes) > 0.85
    assert np.mean(crashes) < 0.08
    egos = [switcher.LANE_SWITCHER.policy(variant) for variant in VARIANTS]
    faults = [run_races(track, egos, LATTICE.policy(), PAPER).own_crash[:, 0] for track in shipped]
    assert np.mean(faults) < 0.2
