import numpy as np
import pytest
from refusal import refused

from pcs_racing import PAPER, load_track, run_races
from pcs_racing.base.errors import UnknownNameError
from pcs_racing.planners import lane_switcher as switcher
from pcs_racing.planners.field.pure_pursuit import PURE_PURSUIT
from pcs_racing.planners.lane_switcher import LANE_SWITCHER
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
    memory = np.zeros(LANE_SWITCHER.memory_size) if memory is None else memory.copy()
    theta = LANE_SWITCHER.policy(parameters).parameters
    switcher.choose_lane(track.arrays, theta, view, memory)
    return memory


def test_variants_are_twenty_different_drivers_within_the_bounds():
    assert list(LANE_SWITCHER.variants) == VARIANTS
    theta = np.array([LANE_SWITCHER.policy(name).parameters for name in VARIANTS])
    assert len(np.unique(theta, axis=0)) == 20
    assert (np.ptp(theta, axis=0) > 0.2 * np.ptp(LANE_SWITCHER.bounds, axis=1)).all()
    assert (theta.min(axis=0) < LANE_SWITCHER.default).all()
    assert (theta.max(axis=0) > LANE_SWITCHER.default).all()
    count = LANE_SWITCHER.parameter_names.index("return_count")
    np.testing.assert_array_equal(theta[:, count], theta[:, count].round())
    # They are data: results name them, so they may never move.
    np.testing.assert_allclose(theta[0, [0, 1, 5]], [0.941, 0.777, 2.0])
    refused("no variant '20'", LANE_SWITCHER.policy, "20", error=UnknownNameError)


@pytest.mark.parametrize("name", list_tracks())
def test_all_variants_drive_shipped_circuits_alone(name, drive_alone):
    policies = [LANE_SWITCHER.policy(variant) for variant in VARIANTS]
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


def test_it_changes_lanes_where_it_is_blocked_and_drives_for_its_lane(oval, view_at):
    view = view_at(oval, STRAIGHT, gap=2.0, opp_d=0.0, opp_speed=2.0)
    memory = decide(oval, view)
    assert memory[switcher._LANE] == switcher.OVERTAKING
    assert decide(oval, view_at(oval, STRAIGHT, gap=2.0, opp_d=0.8))[switcher._LANE] == 0.0
    ends = []
    for weight in (-1.0, 1.5):
        path, scratch = np.zeros((PATH_POINTS, 4)), np.zeros(LANE_SWITCHER.scratch_size)
        theta = LANE_SWITCHER.policy({"lane_weight": weight}).parameters
        alone = view_at(oval, STRAIGHT, gap=20.0)
        LANE_SWITCHER.plan(oval.arrays, theta, alone, memory.copy(), scratch, path)
        ends.append(oval.to_frenet(path[-1, :2])[1])
    assert abs(ends[0]) < 0.1 < memory[switcher._SIDE] * ends[1]


def test_it_returns_when_the_race_line_was_free_long_enough(oval, view_at):
    memory = decide(oval, view_at(oval, STRAIGHT, gap=2.0, opp_speed=2.0))
    gone = view_at(oval, STRAIGHT, 0.7, gap=-3.0)
    lanes = []
    for _ in range(8):
        memory = decide(oval, gone, memory, {"return_count": 7.0})
        lanes.append(memory[switcher._LANE])
    assert lanes == [switcher.OVERTAKING] * 6 + [switcher.RACE_LINE] * 2
    assert memory[switcher._FREE_COUNT] == 8.0
    memory = decide(oval, view_at(oval, STRAIGHT, gap=2.0, opp_speed=2.0))
    aside = 0.7 * memory[switcher._SIDE]
    for _ in range(12):
        memory = decide(oval, view_at(oval, STRAIGHT, aside, gap=-0.2, opp_speed=4.0), memory)
    assert memory[switcher._LANE] == switcher.OVERTAKING


def test_it_overtakes_a_slow_car_and_seldom_crashes_with_the_lattice_planner(shipped):
    """A car at less than half of its speed scale, met at thirty places of every circuit."""
    slow = PURE_PURSUIT.policy({"pace": 0.0, "follow_distance": 0.0})
    config = Rules(start="rolling", start_gap=4.0, start_spacing=0.0, speed_range=(0.4, 0.9))
    overtakes, crashes, faults = [], [], []
    egos = [LANE_SWITCHER.policy(variant) for variant in VARIANTS]
    for track in shipped:
        starts = Starts(np.arange(30) / 30.0 * track.length, np.ones(30, np.int64))
        result = run_races(track, [LANE_SWITCHER.policy()] * 30, slow, config, starts=starts)
        overtakes += (result.state.overtakes[:, 0] > 0).tolist()
        crashes += result.crashed.tolist()
        faults += run_races(track, egos, LATTICE.policy(), PAPER).own_crash[:, 0].tolist()
    assert np.mean(overtakes) > 0.85
    assert np.mean(crashes) < 0.06
    assert np.mean(faults) < 0.08
