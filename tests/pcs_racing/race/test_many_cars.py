"""Races of one car, and of more than two: the same rules for all pairs, and nothing depends on a
car's number.
"""

import itertools
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from placed_cars import HOLD, STEER_AND_SPEED, placed, view_of
from refusal import refused
from replay_pages import race_in
from same_arrays import assert_same

from pcs_racing import load_rules, racer, record_race, run_races, save_replay
from pcs_racing.car.vehicle import VehicleParams
from pcs_racing.planners.planner import Planner
from pcs_racing.planners.view import VIEW
from pcs_racing.race.conditions import RaceConditions
from pcs_racing.race.driving import advance, pad_parameters
from pcs_racing.race.races import (
    RaceSetup,
    draw_starts,
    finishing_order,
    pair_scores,
    race_keys,
    run_field,
    start_lines,
    start_races,
    winners,
)
from pcs_racing.race.rendering import Renderer
from pcs_racing.race.start_grid import Starts
from pcs_racing.race.state import CAR_CRASH, ENDED_AT, LAPS, NO_CRASH, SUMS, empty_state, take

QUIET = load_rules("paper", duration=8.0, start="staggered", start_gap=1.4, start_spacing=0.45)
FIELD = [
    racer(text)
    for text in ("lattice:pace=0.3", "lattice:pace=0.8", "pure-pursuit", "lane-switcher:3")
]


def of_cars(state, cars):
    """All fields of a race for some cars, except fields that name cars by their numbers."""
    skipped = ("tick", "seed", "leader", "ahead")
    return {name: array[:, cars] for name, array in state._asdict().items() if name not in skipped}


def test_numbers_of_cars_do_not_matter_nor_does_a_car_far_away(oval):
    """Lattice cars that meet each other, in every order: the same race to the last bit."""
    places, paces = [(2.0, 0.3), (3.6, -0.3), (5.5, 0.2)], [0.9, 0.5, 0.1]
    policy = {pace: racer(f"lattice:pace={pace}") for pace in paces}
    ends = []
    for order in itertools.permutations(range(3)):
        planner = policy[0.9].planner
        setup, state, _ = placed(oval, [places[k] for k in order], [3.0] * 3, planner)
        advance(setup, state, np.array([[policy[paces[k]].parameters for k in order]]), 500)
        ends.append(of_cars(state, np.argsort(order)))
    for end in ends:
        assert_same(end, ends[0])
    assert ends[0]["sums"][..., list(SUMS).index("BLOCKING")].any()
    race, lattice = load_rules("contest"), racer("lattice").planner
    ends = []
    for count in (2, 3):
        places = [(2.0, 0.3), (3.6, -0.3), (22.0, 0.0)][:count]
        setup, state, _ = placed(
            oval, places, [3.0, 3.0, 0.0][:count], lattice, steering_noise=race.steering_noise
        )
        state.seed[:] = 5
        state.progress[0, 2:] = -5.0  # so far behind that it never leads
        theta = np.array(
            [[racer(f"lattice:pace={pace}").parameters for pace in (0.9, 0.2, 0.0)[:count]]]
        )
        advance(setup, state, theta, 200, ittc=False)
        ends.append(of_cars(state, [0, 1]))
    assert_same(ends[1], ends[0])
    assert ends[0]["disturbance"].all()


@pytest.mark.parametrize(("start", "gap"), [("staggered", 1.4), ("side-by-side", 0.0)])
def test_the_grid(oval, start, gap):
    """One behind the other on alternate sides, or rows of two; car 0 starts from each place."""
    rules = load_rules("paper", start=start, start_gap=gap)
    setup = RaceSetup(oval, rules, (HOLD,) * 5)
    state = start_races(setup, Starts(np.full(5, 8.0), np.arange(5)), np.zeros(5, np.uint64))
    behind = np.array([0, 1.4, 2.8, 4.2, 5.6]) if gap else np.array([0, 0, 2.0, 2.0, 4.0])
    for side in range(5):
        np.testing.assert_allclose(-state.progress[side], np.roll(behind, -side))
        np.testing.assert_allclose(
            8.0 - state.frenet[side, :, 0], np.roll(behind, -side), atol=0.05
        )
        assert (np.roll(np.sign(state.frenet[side, :, 1]), side) == [1, -1, 1, -1, 1]).all()


def test_a_driver_sees_the_nearest_car_along_the_track(oval):
    """Also across the start line; and alone without a near car."""
    length = oval.length
    for places, seen in (
        ([3.0, 8.0, 1.0], [2, 0, 0]),
        ([0.5, length - 0.5, 4.0], [1, 0, 0]),
        ([3.0], [None]),
    ):
        setup, state, _ = placed(oval, [(s, 0.0) for s in places])
        for car, other in enumerate(seen):
            found = dict(zip(VIEW, view_of(setup, state, 0, car), strict=True))
            if other is None:
                assert abs(found["OPP_X"] - found["X"]) > 1e5
                assert abs(found["GAP"]) == pytest.approx(0.5 * length)
            else:
                np.testing.assert_array_equal(
                    [found["OPP_X"], found["OPP_Y"]], state.cars[0, other, :2]
                )


def test_a_crash_of_two_ends_the_race_of_all(oval):
    setup, state, theta = placed(oval, [(9.0, 0.0), (3.0, 0.0), (6.0, 0.0)], [1.0, 5.0, 0.0])
    advance(setup, state, theta, 200)
    assert state.crash[0].tolist() == [NO_CRASH, CAR_CRASH, CAR_CRASH]
    assert state.fault[0].tolist() == [0, 1, 0]
    assert state.tick[0] < 200


def test_a_race_has_one_to_eight_drivers(oval):
    refused("1 to 8", run_field, oval, FIELD * 3, QUIET)
    refused(r"\[2, 3\]", run_field, oval, [FIELD[:2], FIELD[:3]], QUIET)


@pytest.mark.parametrize("rule", ["nobody", "fault-loses"])
@pytest.mark.parametrize("cars", [1, 2, 3, 8])
def test_scores_winners_and_orders_are_those_of_their_definitions(cars, rule):
    """Race by race: last is a car at fault, before it who crashed, then who is behind by more than
    a centimetre.
    """
    rng, races = np.random.default_rng(cars), 60
    state = empty_state(races, 0, cars)
    state.progress[:] = rng.integers(-3, 4, (races, cars)) * 0.006
    state.crash[:] = np.where(
        rng.random((races, 1)) < 0.5, rng.integers(0, 3, (races, cars)), NO_CRASH
    )
    state.fault[:] = rng.integers(0, 2, (races, cars))  # also such that ended no race
    rules = load_rules("paper", crash_rule=rule)
    scores, won, orders = pair_scores(rules, state), winners(rules, state), finishing_order(state)
    for race in range(races):
        crash, fault, progress = state.crash[race], state.fault[race], state.progress[race]
        merit = [2 if crash[k] and fault[k] else 1 if crash[k] else 0 for k in range(cars)]
        assert orders[race].tolist() == sorted(range(cars), key=lambda k: (merit[k], -progress[k]))
        beaten = np.zeros((cars, cars), bool)
        for one, other in itertools.product(range(cars), repeat=2):
            ahead = progress[one] - progress[other]
            if merit[one] != merit[other]:
                beaten[one, other] = merit[one] < merit[other]
            else:
                beaten[one, other] = ahead > 0.01 and merit[one] < 2
        beaten &= not (rule == "nobody" and crash.any())
        np.testing.assert_array_equal(scores[race], 0.5 + 0.5 * (1.0 * beaten - beaten.T))
        best = [k for k in range(cars) if cars > 1 and beaten[k].sum() == cars - 1]
        assert won[race] == (best[0] if best else -1)


def test_conditions_of_single_races_are_taken_in_order_and_tracks_in_runs(oval):
    other, cars = replace(oval, name="other"), (VehicleParams(), VehicleParams(length=0.5))
    rows = np.arange(4 * 2 * 48.0).reshape(4, 2, 48)
    given = RaceConditions(rows, (oval, oval, other, oval))
    assert [(track.name, *ends) for track, *ends in given.runs(other, 4)] == [
        ("oval", 0, 2),
        ("other", 2, 3),
        ("oval", 3, 4),
    ]
    assert given.rows(cars, 4) is rows
    some = given.take([2, 0])
    np.testing.assert_array_equal(some.vehicles, rows[[2, 0]])
    assert some.tracks == (other, oval)
    for nothing in (RaceConditions(), RaceConditions().take([1])):
        assert nothing.runs(oval, 3) == [(oval, 0, 3)]
        np.testing.assert_array_equal(nothing.rows(cars, 3), [[car.as_row() for car in cars]] * 3)
    assert RaceConditions(None, ()).runs(oval, 0) == []
    refused(r"\(4, 2, 48\); for 3 races they must have \(3, 2, 48\)", given.rows, cars, 3)
    refused("4 tracks for 3 races", given.runs, oval, 3)


@pytest.mark.parametrize("cars", [1, 2, 3])
def test_races_take_lines_and_places_in_turn(oval, cars):
    rules, places = load_rules("paper", start_lines=4), max(2, cars)
    starts = draw_starts(oval, rules, 30, 5, cars=cars)
    lines = start_lines(oval, rules, np.random.SeedSequence(5, spawn_key=(0,)))
    assert len(lines) == 4
    assert starts.s.tolist() == [lines[(i // places) % 4] for i in range(30)]
    assert starts.side.tolist() == [i % places for i in range(30)]


def test_passes_and_times_to_collision_count_every_pair(oval):
    setup, state, theta = placed(oval, [(3.0, 0.5), (6.0, 0.5), (9.0, -0.5)])
    for progress in (
        [0.0, 2.0, 4.0],
        [3.0, 2.0, 4.0],
        [5.0, 2.0, 4.0],
        [5.0, 4.7, 4.0],
        [5.0, 6.0, 4.0],
    ):
        state.progress[0] = progress
        advance(setup, state, theta, 2)
    assert state.overtakes[0].tolist() == [2, 2, 0]
    assert state.leader[0] == 1
    # At 2 m/s towards a car at rest 1.2 m ahead, nearer than the walls: the mean after 0.05 and
    # 0.1 s.
    column, times = list(SUMS).index("ITTC"), []
    for count in (2, 3):
        setup, state, theta = placed(
            oval, [(2.0, 0.0), (22.0, 0.0), (3.2, 0.0)][:count], [2.0, 0.0, 0.0][:count]
        )
        advance(setup, state, theta, 10)
        times.append(state.sums[0, 0, column] / 2)
    assert times[1] == pytest.approx((1.2 - 0.15 - 0.29) / 2.0, abs=0.02)
    assert times[0] > times[1] + 0.3


def test_a_recorded_race_of_three_is_the_race_and_shows_all(oval, tmp_path):
    rules = load_rules("contest", duration=4.0, contact="restart")
    replay = record_race(oval, FIELD[0], FIELD[1:3], rules, seed=2, index=1)
    ends = run_field(oval, [[driver] * 2 for driver in FIELD[:3]], rules, seed=2).state
    np.testing.assert_array_equal(replay.cars[-1], ends.cars[1])
    again = race_in(save_replay(replay, tmp_path / "race.html").read_text())
    np.testing.assert_allclose(again["cars"], replay.cars[..., :5], atol=1e-3)
    assert again["car_names"] == list(replay.car_names)
    # A car more is a colour more in the frame.
    frame = Renderer(replay, view="both").render(replay.cars[0], names=replay.car_names)
    without = Renderer(replay, view="both").render(replay.cars[0])
    assert (frame != without).any()
    bodies = [np.array(colour) for colour in ((27, 111, 216), (224, 135, 0), (34, 150, 79))]
    assert all(
        (np.abs(without.astype(int) - colour).max(axis=2) < 12).sum() > 10 for colour in bodies
    )


def test_the_planners_of_each_car_may_differ_between_the_races(oval):
    """Four cars; each race as with these planners in all races, in one call or two."""
    names = ["lattice", "pure-pursuit", "stanley", "gap-follower"]
    policies = [racer(name) for name in names]
    planners = tuple(policy.planner for policy in policies)
    races, cars = 4, 4
    own = np.array([[planners[(race + car) % 4] for car in range(cars)] for race in range(races)])
    setup = RaceSetup(oval, QUIET, planners, substitutes=planners)
    starts = draw_starts(oval, QUIET, races, 1, cars=cars)
    begun = start_races(setup, starts, np.arange(races, dtype=np.uint64))
    theta = np.zeros((races, cars, setup.theta_size))
    for race, car in np.ndindex(races, cars):
        parameters = policies[(race + car) % 4].parameters
        theta[race, car, : len(parameters)] = parameters
    mixed = begun.copy()
    for ticks in (150, 50):
        advance(setup, mixed, theta, ticks, conditions=RaceConditions(planners=own))
    for race in range(races):
        alone = take(begun, [race])
        same = replace(setup, planners=tuple(own[race]))
        advance(same, alone, theta[race : race + 1].copy(), 200)
        assert_same(alone._asdict(), take(mixed, [race])._asdict())
    refused(
        r"planners have shape \(4, 4\); for 3 races they must have \(3, 4\)",
        RaceConditions(planners=own).shares,
        planners,
        3,
    )


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
    ("rules", "changes"), [("paper", {"laps": 2}), ("contest", {"laps": 3, "contact": "restart"})]
)
def test_a_race_of_n_laps_has_n_lap_times_that_add_up_to_its_time(oval, rules, changes):
    rules, races = load_rules(rules, **changes), 4
    drivers = [racer(name) for name in DRIVERS]
    setup = RaceSetup(oval, rules, tuple(driver.planner for driver in drivers))
    state = start_races(
        setup, draw_starts(oval, rules, races, seed=1), race_keys(rules, 1, np.arange(races))
    )
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
    result = run_races(oval, *DRIVERS, load_rules("paper", laps=9, duration=2.0))
    assert result.time.tolist() == [2.0]
    assert result.lap_times.shape == (1, 2, 9)
    assert np.isnan(result.lap_times).all()
    assert result.winner[0] == int(result.lead[0] < 0.0)


def test_cars_that_drove_all_laps_come_first_in_the_order_of_their_times():
    """Car 2 was faster over the line than car 1, which is further by now; car 0 and car 3, by a
    millimetre, were not there yet.
    """
    rules, state = load_rules("contest", laps=2), empty_state(1, 0, 4, laps=2)
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
    rules = load_rules("paper", laps=2)
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
