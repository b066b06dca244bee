"""Contacts that do not end a race: cars that stand still or are put back, and counts of faults."""

import numpy as np
import pytest
from placed_cars import V, placed
from test_many_cars import of_cars

from pcs_racing import load_rules, load_track, racer, run_races
from pcs_racing.car.collision import Rectangle, car_hits_wall, rectangles_overlap
from pcs_racing.race.config import ROBORACER
from pcs_racing.race.driving import advance
from pcs_racing.race.races import RaceResult, winners
from pcs_racing.race.state import CAR_CRASH, NO_CRASH, WALL_CRASH
from pcs_racing.track.moving import moving_poses
from pcs_racing.track.obstacles import with_obstacles

HALF = 0.29, 0.155  # m, of a car


def touches(track, state):
    """Whether a car is in a wall, or in another one."""
    cars = [(*car[[0, 1, 4]], *HALF) for car in state.cars[0]]
    walls = [car_hits_wall(track.arrays, *car, state.frenet[0, i, 0]) for i, car in enumerate(cars)]
    pairs = [(a, b) for i, a in enumerate(cars) for b in cars[:i]]
    return any(walls) or any(rectangles_overlap(Rectangle(*a), Rectangle(*b)) for a, b in pairs)


def drive_until_fault(setup, state, theta):
    for _ in range(200):
        advance(setup, state, theta, 2)
        if state.fault.any():
            return
    raise AssertionError("nobody ran into anything")


@pytest.mark.parametrize("first", [0, 1])
def test_the_car_that_ran_into_another_stands_still_and_may_drive_on(oval, first):
    order = slice(None) if first == 0 else slice(None, None, -1)
    setup, state, theta = placed(
        oval, [(3.0, 0.0), (6.0, 0.0)][order], [5.0, 0.0][order], contact="stop"
    )
    drive_until_fault(setup, state, theta)
    assert state.cars[0, first, V] == 0.0
    assert state.fault[0].tolist() == [1, 0][order]
    assert state.contact[0].tolist() == [CAR_CRASH, CAR_CRASH]
    for _ in range(100):  # it pushes, and gets no further
        assert not touches(oval, state)
        advance(setup, state, theta, 2)
    assert state.frenet[0, first, 0] < 6.0 - 2 * HALF[0] + 1e-6
    assert state.fault[0, 1 - first] == 0
    faults = state.fault[0, first]
    assert faults <= 3  # to push is no new fault
    theta[0, first, 1] = -2.0
    advance(setup, state, theta, 100)
    assert state.frenet[0, first, 0] < 4.5
    assert state.contact[0, first] == NO_CRASH
    assert state.fault[0, first] == faults
    assert not state.crashed[0]
    assert state.tick[0] == 2 * round(state.tick[0] / 2) > 300


def test_a_wall_stops_a_car_and_cars_that_overlapped_may_part(oval):
    setup, state, theta = placed(oval, [(3.0, 0.0, 0.6), (20.0, 0.0)], [4.0, 0.0], contact="stop")
    drive_until_fault(setup, state, theta)
    assert (state.cars[0, 0, V], state.contact[0].tolist()) == (0.0, [WALL_CRASH, NO_CRASH])
    for _ in range(50):
        assert not touches(oval, state)
        advance(setup, state, theta, 2)
    theta[0, 0] = 0.0, -2.0
    before = state.frenet[0, 0, 1]
    advance(setup, state, theta, 100)
    assert state.frenet[0, 0, 1] < before - 0.5
    # The car behind stands, the one ahead drives off; neither is held, whichever was at fault.
    setup, state, theta = placed(oval, [(3.0, 0.0), (3.4, 0.0)], [0.0, 2.0], contact="stop")
    state.crash[:], state.fault[:] = 0, 0
    advance(setup, state, theta, 200)
    assert state.frenet[0, 1, 0] > 6.0
    assert state.fault[0].tolist() == [0, 0]


def test_the_car_at_fault_is_put_back_behind_the_other_where_there_is_room(oval):
    setup, state, theta = placed(
        oval, [(3.0, 0.2), (6.0, 0.3)], [5.0, 1.0], contact="restart", duration=6.0
    )
    drive_until_fault(setup, state, theta)
    assert state.frenet[0, 0] == pytest.approx([state.frenet[0, 1, 0] - 2.0, 0.0], abs=0.1)
    assert (state.cars[0, 0, V], state.cars[0, 1, V]) == (0.0, pytest.approx(1.0, abs=0.1))
    assert state.progress[0] == pytest.approx(state.frenet[0, :, 0], abs=1e-6)
    assert state.fault[0].tolist() == [1, 0]
    theta[0, 0, 1] = 0.5
    advance(setup, state, theta, 600)
    assert state.tick[0] == 600
    assert winners(setup.rules, state).tolist() == [1]
    # A third car is where the first would be put: it is put behind that one.
    places, speeds = [(6.0, 0.9), (9.0, 0.9), (6.9, 0.0)], [5.0, 0.0, 0.0]
    setup, state, theta = placed(oval, places, speeds, contact="restart")
    drive_until_fault(setup, state, theta)
    assert state.fault[0].tolist() == [1, 0, 0]
    assert state.frenet[0, 0, 0] == pytest.approx(5.0, abs=0.1)
    assert not touches(oval, state)


def test_a_car_in_a_wall_is_put_back_on_the_line_and_of_two_at_fault_the_one_ahead_stays(oval):
    setup, state, theta = placed(
        oval, [(3.0, 0.0, 0.6), (20.0, 0.0)], [4.0, 0.0], contact="restart"
    )
    before = None
    while not state.fault.any():
        before = state.frenet[0, 0].copy()
        advance(setup, state, theta, 2)
    assert before[1] > 0.5
    assert state.frenet[0, 0] == pytest.approx([before[0], 0.0], abs=0.15)
    assert (state.cars[0, 0, V], state.fault[0].tolist()) == (0.0, [1, 0])
    # They drive towards each other, as fast; then both face forward on the line.
    setup, state, theta = placed(
        oval, [(3.0, 0.2), (6.0, 0.2, np.pi)], [3.0, 3.0], contact="restart"
    )
    drive_until_fault(setup, state, theta)
    assert state.fault[0].tolist() == [1, 1]
    assert state.frenet[0, 1] == pytest.approx([4.8, 0.0], abs=0.15)
    assert state.frenet[0, 1, 0] - state.frenet[0, 0, 0] == pytest.approx(2.0, abs=0.1)
    assert (state.cars[0, :, V] == 0.0).all()


def test_a_car_is_put_back_behind_an_oncoming_obstacle(oval):
    box = [0.0, -4.0, 0.0, 0.4, 0.3, -0.5, 0.0]
    setup, state, theta = placed(
        with_obstacles(oval, [box]), [(3.0, 0.0), (20.0, 0.0)], [3.0, 0.0], contact="restart"
    )
    drive_until_fault(setup, state, theta)
    place = 6.0 - 0.5 * state.tick[0] * 0.01
    assert state.frenet[0, 0] == pytest.approx([place - 0.2 - HALF[0] - 2.0, 0.0], abs=0.15)
    theta[0, 0, 1] = 0.0
    for _ in range(300):  # the obstacle comes up to the car, which is put back 2 m again
        advance(setup, state, theta, 2)
        ((x, y, heading),) = moving_poses(setup.track.arrays, state.tick[0] * 0.01)
        own = Rectangle(*state.cars[0, 0, [0, 1, 4]], *HALF)
        assert not rectangles_overlap(own, Rectangle(x, y, heading, 0.2, 0.15))


@pytest.mark.parametrize("contact", ["stop", "restart"])
def test_without_a_contact_a_race_is_the_same(oval, contact):
    drivers = [racer(f"lattice:pace={pace}") for pace in (0.2, 0.4)]
    rules = [load_rules("contest", duration=4.0, contact=mode) for mode in ("end", contact)]
    end, other = (run_races(oval, *drivers, one, seed=1) for one in rules)
    assert not end.crashed[0]
    for name, array in of_cars(end.state, [0, 1]).items():
        np.testing.assert_array_equal(getattr(other.state, name), array, err_msg=name)


@pytest.mark.parametrize(("limit", "faults"), [(3, 3), (0, 4)])
def test_a_car_with_too_many_faults_is_out_and_has_lost(oval, limit, faults):
    """It drives into the wall again and again, far ahead of the other car, which stood in its way
    once.
    """
    rules = {
        "contact": "restart",
        "crash_rule": "fault-loses",
        "most_faults": limit,
        "duration": 60.0,
    }
    setup, state, theta = placed(oval, [(20.0, 0.0), (3.0, 0.0)], [4.0, 0.0], **rules)
    theta[0, 0] = 0.2, 4.0
    state.fault[0, 1] = 1
    advance(setup, state, theta, 6000)
    assert state.fault[0].tolist()[0] >= faults
    assert state.crashed[0] == (limit > 0)
    if limit:
        assert state.fault[0].tolist() == [limit, 1]
        assert state.crash[0].tolist() == [WALL_CRASH, NO_CRASH]
        assert state.tick[0] < 6000
        result = RaceResult(setup.rules, state, None)
        assert (result.winner.tolist(), result.own_crash.tolist()) == ([1], [[True, False]])


def test_the_roboracer_rules_start_abreast_from_rest_and_restart():
    drivers = [racer(text) for text in ("spliner", "follow-the-gap")]
    result = run_races(load_track("Brackwater"), [drivers[0]] * 6, drivers[1], ROBORACER, seed=2)
    assert result.starts.side.tolist() == [0, 1, 0, 1, 0, 1]
    assert (result.state.fault[result.crashed].max(axis=1) == 3).all()
    assert (result.state.tick[~result.crashed] == 4000).all()
    assert (result.winner >= 0).all()
