"""Laps and their times, from the start line's crossings."""

import numpy as np
import pytest

from pcs_racing import RaceSetup, Starts, advance, load_race_config, parse_policy, run_races, start_races
from pcs_racing.race.driving import pad_parameters
from pcs_racing.race.progress import count_crossing
from pcs_racing.race.rates import DT
from pcs_racing.race.state import empty_state

RULES = load_race_config("paper", duration=30.0)


def test_laps_are_those_that_progress_tells(oval):
    """Crossings of s = 0 found by interpolating progress every 0.02 s give the same times."""
    drivers = [parse_policy("pure-pursuit:pace=0.9"), parse_policy("pure-pursuit:pace=0.2")]
    setup = RaceSetup(oval, RULES, (drivers[0].planner, drivers[1].planner))
    state = start_races(setup, Starts(np.array([oval.length - 6.0]), np.array([0])), np.zeros(1, np.uint64))
    theta = pad_parameters(drivers, setup.theta_size)[None]
    begin = state.frenet[0, :, 0].copy()
    begin[begin > 0.5 * oval.length] -= oval.length
    times, way = [0.0], [begin]
    while state.tick[0] < RULES.ticks and not state.crashed[0]:
        advance(setup, state, theta, 2, threads=1)
        times.append(float(state.tick[0]) * DT)
        way.append(begin + state.progress[0])
    way = np.array(way)
    for car in range(2):
        marks = np.arange(0.0, way[:, car].max(), oval.length)
        crossed = np.interp(marks, way[:, car], times)
        laps = np.diff(crossed)
        assert state.lap_count[0, car] == len(laps)
        if len(laps):
            assert state.lap_time[0, car] == pytest.approx(laps[-1], abs=1e-3)
            assert state.best_lap[0, car] == pytest.approx(laps.min(), abs=1e-3)
        else:
            assert state.lap_time[0, car] == state.best_lap[0, car] == -1.0
    assert state.lap_count[0, 0] >= 2


def test_results_of_races_hold_them(oval):
    policies = parse_policy("pure-pursuit:pace=0.9"), parse_policy("pure-pursuit:pace=0.7")
    result = run_races(oval, *policies, RULES, starts=Starts(np.array([3.0, 3.0]), np.array([0, 1])))
    assert result.laps.shape == result.lap_time.shape == result.best_lap.shape == (2, 2)
    fast = result.best_lap[:, 0]
    assert (result.laps[:, 0] >= 1).all()
    assert ((fast > 0.0) & (fast <= result.lap_time[:, 0])).all()


def test_who_rolls_back_over_the_line_has_driven_no_lap():
    state, length = empty_state(1, 0), 100.0
    for tick, driven in ((0, 0.5), (10, -0.5), (20, 0.5), (5000, 0.5), (5010, -0.5), (5020, 0.5), (9000, 0.5)):
        count_crossing(length, length - 0.25 if driven > 0 else 0.25, driven, tick, state.laps, 0, 0)
    assert state.lap_count.tolist() == [[2, 0]]
    assert state.lap_time[0, 0] == pytest.approx(40.0)
    assert state.best_lap[0, 0] == pytest.approx(40.0)
