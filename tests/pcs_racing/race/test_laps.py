"""Races by laps: their end, the times of their laps, and the order of their cars."""

from itertools import pairwise

import numpy as np
import pytest
from placed_cars import HOLD, STEER_AND_SPEED, placed
from same_arrays import assert_same

from pcs_racing import load_race_config, racer, run_races
from pcs_racing.base.seeds import race_seeds
from pcs_racing.planners.planner import Planner
from pcs_racing.race.driving import advance, pad_parameters
from pcs_racing.race.races import RaceSetup, draw_starts, finishing_order, start_races, winners
from pcs_racing.race.recording import record_race
from pcs_racing.race.state import ENDED_AT, LAPS, empty_state

DRIVERS = ("lattice:pace=0.5", "pure-pursuit")
HOLD_IN_PYTHON = Planner(
    "hold-in-python", STEER_AND_SPEED, drive=lambda track, theta, view, memory: theta
)


def ends_of_laps(progress, length):
    """Times when progress, known every 0.02 s, first passes each multiple of a length."""
    ends = []
    for k, (before, now) in enumerate(pairwise(progress), start=1):
        line = length * (len(ends) + 1)
        if before < line <= now:
            ends.append(0.02 * (k - (now - line) / (now - before)))
    return ends


@pytest.mark.parametrize(
    ("preset", "changes"), [("paper", {"laps": 2}), ("contest", {"laps": 3, "contact": "restart"})]
)
def test_a_race_of_n_laps_has_n_lap_times_that_add_up_to_its_time(oval, preset, changes):
    rules, races = load_race_config(preset, **changes), 4
    drivers = [racer(name) for name in DRIVERS]
    setup = RaceSetup(oval, rules, tuple(driver.planner for driver in drivers))
    state = start_races(setup, draw_starts(oval, rules, races, seed=1), race_seeds(1, races))
    theta = np.tile(pad_parameters(drivers, setup.theta_size), (races, 1, 1))
    progress = [state.progress.copy()]
    while not state.over.all():
        advance(setup, state, theta, 2)
        progress.append(state.progress.copy())
    for race, car in np.ndindex(races, 2):
        times = np.diff(ends_of_laps(np.array(progress)[:, race, car], oval.length), prepend=0.0)
        rest = np.full(rules.laps - len(times), np.nan)
        found = state.lap_times[race, car]
        np.testing.assert_allclose(found, np.append(times, rest), atol=1e-9)
        assert state.lap_count[race, car] == len(times)
    finish = state.lap_times.sum(axis=2)[np.arange(races), winners(rules, state)]
    time = 0.01 * state.tick
    assert (~state.crashed).all()
    assert ((time - 0.02 < finish) & (finish < time + 1e-9)).all()
    # Driven in one piece, and beyond its end, it is the same.
    assert_same(run_races(oval, [DRIVERS[0]] * races, DRIVERS[1], rules, seed=1).state, state)


@pytest.mark.parametrize("planner", [HOLD, HOLD_IN_PYTHON])
def test_the_first_car_over_the_line_ends_the_race_of_all(oval, planner):
    """At 5 m/s, from 95 cm before the line."""
    places = [(oval.length - 0.95, 0.0), (oval.length - 3.0, 0.0)]
    setup, state, theta = placed(oval, places, [5.0, 5.0], planner, laps=1)
    advance(setup, state, theta, 100)
    assert state.tick.tolist() == [20]
    assert (state.over.tolist(), state.crashed.tolist()) == ([True], [False])
    assert state.lap_times[0, 0] == pytest.approx([0.19], abs=0.02)
    assert np.isnan(state.lap_times[0, 1]).all()


def test_the_duration_caps_a_race_with_laps(oval):
    result = run_races(oval, *DRIVERS, load_race_config("paper", laps=9, duration=2.0))
    assert result.time.tolist() == [2.0]
    assert result.lap_times.shape == (1, 2, 9)
    assert np.isnan(result.lap_times).all()
    assert result.winner[0] == int(result.lead[0] < 0.0)


def test_cars_that_drove_all_laps_come_first_in_the_order_of_their_times():
    """Car 2 was faster over the line than car 1, which is further by now; car 0 and car 3, by a
    millimetre, were not there yet.
    """
    rules, state = load_race_config("contest", laps=2), empty_state(1, 0, 4, laps=2)
    state.laps[0, :, LAPS] = [1, 2, 2, 1]
    state.laps[0, :, ENDED_AT] = [9.0, 20.015, 20.01, 9.0]
    state.progress[0] = [79.0, 80.2, 80.1, 79.999]
    assert finishing_order(state).tolist() == [[2, 1, 3, 0]]
    assert winners(rules, state).tolist() == [2]
    state.crash[0, 2], state.fault[0, 2] = 1, 1
    assert finishing_order(state).tolist() == [[1, 3, 0, 2]]
    assert winners(rules, state).tolist() == [1]
    state.laps[0, 1, LAPS], state.progress[0, 1] = 1, 79.998  # a tie by the way driven
    assert winners(rules, state).tolist() == [-1]


def test_a_recording_has_the_laps_among_its_events(oval):
    rules = load_race_config("paper", laps=2)
    replay, result = record_race(oval, *DRIVERS, rules), run_races(oval, *DRIVERS, rules)
    laps = [event for event in replay.events if event.kind == "lap"]
    count = result.state.lap_count[0]
    assert sorted(event.car for event in laps) == [0] * count[0] + [1] * count[1]
    first, last = laps[0], laps[-1]
    time = result.lap_times[0, first.car, 0]
    assert (first.time, first.text) == (pytest.approx(time), f"ends lap 1 in {time:.2f} s")
    assert last.car == result.winner[0]
    assert replay.outcome.endswith(f"after 2 laps, {last.time:.2f} s")
    np.testing.assert_array_equal(replay.progress[-1], result.state.progress[0])
