"""Model predictive contouring control: its program is a plan that the car can drive."""

import numpy as np
import pytest

from pcs_racing import load_track, parse_policy, run_races
from pcs_racing.planners.field import mpcc
from pcs_racing.planners.field.mpcc import MPCC, STEP, STEPS
from pcs_racing.planners.view import OWN_V
from pcs_racing.race.config import RaceConfig
from pcs_racing.race.races import RaceSetup, advance, draw_starts, start_races
from pcs_racing.testing import check_planner

DELTA, SPEED = 5, 6  # columns of a plan


def planned(memory):
    """Stages of the plan in a memory: position, heading, yaw rate, slip, steering and speed."""
    own = memory[mpcc._STAGES : mpcc._SENT]
    return own.reshape(STEPS + 1, -1)


def plan(track, view, changes=None):
    memory, theta = np.zeros(MPCC.memory_size), MPCC.policy(changes or {}).parameters
    command = MPCC.drive(track, theta, view, memory)
    return planned(memory), int(memory[mpcc._WAY]), command


def test_it_keeps_the_protocol():
    """One seed, one result, in any pieces and batch: the whole plan is in the race's memory."""
    check_planner(MPCC, load_track("Pipkin"), seconds=0.8)


def test_a_car_drives_as_planned():
    """Without noise the car is within 1 cm of the place that it planned a tenth of a second ago."""
    track, policy = load_track("Quillburg"), parse_policy("mpcc")
    config = RaceConfig(start="staggered", start_gap=40.0, speed_range=(0.7, 1.2))
    setup = RaceSetup(track, config, (MPCC, MPCC))
    state = start_races(setup, draw_starts(track, config, 1, 3), np.zeros(1, np.uint64))
    theta, strays = np.tile(policy.parameters, (1, 2, 1)), []
    for _ in range(30):
        advance(setup, state, theta, 2)
        stages = planned(state.memory[0, 0, 2:])
        advance(setup, state, theta, 8)
        strays.append(np.hypot(*(state.cars[0, 0, :2] - stages[2, :2])))
    assert max(strays) < 0.01


def test_a_plan_obeys_walls_profile_and_limits_of_the_car(view_at):
    track = load_track("Quillburg")
    view = view_at(track, 10.0, 0.1, speed=5.0)
    stages, way, command = plan(track, view)
    assert way == mpcc.FREE
    s, d = track.to_frenet(stages[:, :2]).T
    line = track.line[(s / track.arrays.ds).astype(int) % len(track.line)]
    assert (d < line[:, 8] - 0.155).all()
    assert (d > 0.155 - line[:, 7]).all()
    steps = np.diff(stages, axis=0)
    assert (np.abs(steps[:, DELTA]) < 1.001 * mpcc.STEERING * STEP).all()
    assert (steps[:, SPEED] < 1.001 * mpcc.ACCELERATION * STEP).all()
    # The speed's controller turns a difference of 1 m/s into 10 m/s^2.
    assert command[1] - view[OWN_V] == pytest.approx(0.1 * steps[0, SPEED] / STEP)


@pytest.mark.parametrize("opp_d", [-0.3, 0.3])
def test_it_passes_a_standing_car_where_there_is_room(opp_d, oval, view_at):
    view = view_at(oval, 3.0, gap=3.0, opp_d=opp_d, speed=3.0)
    stages, way, _ = plan(oval, view)
    assert way == (mpcc.LEFT if opp_d < 0.0 else mpcc.RIGHT)
    s, d = oval.to_frenet(stages[:, :2]).T
    beside = np.abs(s - 6.0) < 0.4
    assert beside.any()
    assert (np.abs(d[beside] - opp_d) > 0.31).all()


def test_it_stays_behind_a_car_that_leaves_no_room(oval, view_at):
    line = oval.arrays.line.copy()
    line[:, 7:9] = 0.4
    narrow = type("Narrow", (), {"arrays": oval.arrays._replace(line=line)})
    stages, way, _ = plan(narrow, view_at(oval, 3.0, gap=2.0, speed=3.0))
    assert way == mpcc.BEHIND
    assert oval.to_frenet(stages[:, :2])[:, 0].max() < 5.0 - 0.58
    assert stages[-1, SPEED] < 1.0


def test_a_race_without_the_solver_is_refused_in_one_line(monkeypatch):
    monkeypatch.setattr("pcs_racing.base.errors.find_spec", lambda name: None)
    message = r'planner \'mpcc\' raised .*clarabel is needed .* pip install "pcs-racing\[mapping\]"'
    with pytest.raises(ValueError, match=message):
        run_races(load_track("Pipkin"), [parse_policy("mpcc")], "lattice")
