import dataclasses
import pickle

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from recorded_races import PYTHON
from refusal import refused
from same_arrays import assert_same

from pcs_racing import CONTEST, PAPER, InputError, load_rules, record_race
from pcs_racing.base.compilation import compiled
from pcs_racing.base.seeds import race_seeds
from pcs_racing.car.vehicle import BETA, VehicleParams, load_vehicle
from pcs_racing.planners.lattice import LATTICE
from pcs_racing.planners.planner import Parameter, Planner
from pcs_racing.race.conditions import RaceConditions, vehicle_rows
from pcs_racing.race.driving import advance, pad_parameters
from pcs_racing.race.races import (
    RaceSetup,
    draw_starts,
    run_races,
    start_lines,
    start_races,
    starts_of,
)
from pcs_racing.race.start_grid import Starts
from pcs_racing.race.state import ITTC, ITTC_SAMPLES
from pcs_racing.track.frenet import SPEED
from pcs_racing.track.track import Calibration

SHORT = load_rules("paper", duration=6.0)
NOISY = load_rules("contest", duration=6.0)


@compiled
def go_straight(track, theta, view, memory, scratch, path, command):
    command[0] = 0.0
    command[1] = theta[0]


STRAIGHT = Planner("straight", (Parameter("speed", 0.0, 9.0, 6.0, "m/s"),), control=go_straight)
STRAIGHT_IN_PYTHON = Planner(
    "straight-in-python",
    STRAIGHT.parameters,
    drive=lambda track, theta, view, memory: (0.0, theta[0]),
)


def lattice(**changes: float):
    return LATTICE.policy(changes)


def begin(track, config, egos, opponents, seed=0):
    """First part of ``run_races``: setup, state and parameters of a batch."""
    setup = RaceSetup(track, config, (egos[0].planner, opponents[0].planner))
    races = len(egos)
    state = start_races(setup, draw_starts(track, config, races, seed), race_seeds(seed, races))
    theta = np.stack(
        [pad_parameters(egos, setup.theta_size), pad_parameters(opponents, setup.theta_size)],
        axis=1,
    )
    return setup, state, theta


def test_the_seed_decides_a_race_and_its_times_to_collision_do_not(oval):
    setup, state, theta = begin(oval, NOISY, [lattice(pace=0.7)] * 3, [lattice()] * 3)
    bare = state.copy()
    advance(setup, state, theta, 400)
    advance(setup, bare, theta, 400, ittc=False)
    assert_same(bare, state, skip=("sums",))
    assert (state.sums[..., ITTC_SAMPLES] > 0).all()
    np.testing.assert_array_equal(bare.sums[..., [ITTC, ITTC_SAMPLES]], 0.0)
    np.testing.assert_array_equal(
        bare.sums[..., ITTC_SAMPLES + 1 :], state.sums[..., ITTC_SAMPLES + 1 :]
    )
    one, other = (run_races(oval, [lattice()] * 4, lattice(), NOISY, seed=seed) for seed in (1, 2))
    assert not np.array_equal(one.starts.s, other.starts.s)
    assert not np.array_equal(one.state.disturbance, other.state.disturbance)
    moved = run_races(oval, [lattice()] * 4, lattice(), NOISY, seed=2, starts=one.starts)
    assert not np.array_equal(one.state.cars, moved.state.cars)
    batch = draw_starts(oval, PAPER, 200, seed=3)
    one = starts_of(oval, PAPER, [137], seed=3)
    assert (one.s[0], one.side[0]) == (batch.s[137], batch.side[137])


@settings(max_examples=12)
@given(cut=st.integers(0, 300).map(lambda half: 2 * half), pieces=st.integers(1, 7))
def test_a_race_can_be_stopped_saved_and_continued_anywhere(oval, cut, pieces):
    """Also in the middle of a plan, and whether the rest is driven in one piece or in many."""
    egos, opponents = [lattice(pace=0.2), lattice()], [lattice(pace=0.9)] * 2
    setup, whole, theta = begin(oval, NOISY, egos, opponents, seed=4)
    stopped = whole.copy()
    advance(setup, whole, theta, NOISY.ticks)

    advance(setup, stopped, theta, cut)
    continued = pickle.loads(pickle.dumps(stopped))
    for _ in range(pieces):
        advance(setup, continued, theta, 2 * ((NOISY.ticks - cut) // (2 * pieces)))
    advance(setup, continued, theta, NOISY.ticks)  # past the end nothing moves
    assert_same(continued, whole)


def test_the_same_driver_compiled_and_in_python_drives_the_same_race_at_fifty_hertz(oval):
    starts = draw_starts(oval, NOISY, 3, seed=0)
    planners = (STRAIGHT, STRAIGHT_IN_PYTHON)
    races = [
        run_races(oval, [planner.policy()] * 3, lattice(), NOISY, starts=starts)
        for planner in planners
    ]
    assert_same(races[1].state, races[0].state, skip=("memory",))
    result = run_races(oval, PYTHON.policy(), PYTHON.policy({"pace": 0.5}), SHORT)
    assert not result.crashed.any()
    asked = result.state.memory[0, :, 2]  # after the two numbers of its command
    np.testing.assert_array_equal(asked, [6.0 * 50.0] * 2)


def test_each_car_has_its_own_vehicle_and_the_memory_that_its_steering_needs(oval):
    standing = load_rules("paper", duration=2.0, start_speed=0.0)
    strong, weak = VehicleParams(), VehicleParams(a_max=1.5)
    lead = run_races(oval, [lattice()] * 4, lattice(), standing, vehicle=(strong, weak)).lead
    assert (lead > 1.0).all()
    named = ["f1tenth", {"a_max": 1.5}]
    again = run_races(oval, [lattice()] * 4, lattice(), standing, vehicle=named).lead
    np.testing.assert_array_equal(again, lead)
    lead = run_races(oval, [lattice()] * 4, lattice(), standing, vehicle=(weak, strong)).lead
    assert (lead < -1.0).all()
    late, prompt = VehicleParams(steer_delay=0.1), VehicleParams()
    usual = RaceSetup(oval, SHORT, (LATTICE, LATTICE))
    for vehicles in ((late, prompt), (prompt, late)):
        assert dataclasses.replace(usual, vehicles=vehicles).memory_size == usual.memory_size + 5
    later = dataclasses.replace(usual, max_delays=VehicleParams(steer_delay=0.04, speed_delay=0.1))
    assert later.memory_size == usual.memory_size + 7
    starts, rows = draw_starts(oval, SHORT, 1, 0), vehicle_rows((prompt, late), 1)
    refused(
        "race 0: 5 commands of car 1 are delayed; the setup has room for 0",
        start_races, usual, starts, np.zeros(1, np.uint64), RaceConditions(rows),
    )  # fmt: skip
    vehicles = (VehicleParams(steer_delay=0.1, speed_delay=0.06), prompt)
    assert dataclasses.replace(usual, vehicles=vehicles).memory_size == usual.memory_size + 8


def test_planners_drive_within_the_grip_of_their_tyres(oval):
    """Without another setting, at the slowest and at the fastest pace."""
    for name in ("f1tenth-pacejka", "forzaeth-nuc2"):
        cars = (load_vehicle(name),) * 2
        for pace in (0.0, 1.0):
            result = run_races(
                oval, [lattice(pace=pace)] * 6, lattice(pace=pace), SHORT, vehicle=cars
            )
            assert not result.crashed.any()
            assert np.abs(result.state.cars[..., BETA]).max() < 0.2


@pytest.mark.parametrize(
    ("planner", "cars"),
    [
        ("lattice:pace=1", [{"steer_lag": 0.2}, {"speed_lag": 0.3}, {"steer_delay": 0.04}]),
        ("stanley", [{"steer_lag": 0.3}]),
        ("lane-switcher", [{"steer_lag": 0.3}]),
        ("lidar-ppo", [{"tyres": "pacejka"}, {"steer_lag": 0.1}]),
    ],
)
def test_planners_make_up_for_the_lags_of_their_car(oval, planner, cars):
    """They drive as far as with a perfect car; lags that they do not know make them crash."""
    apart = load_rules("contest", duration=12.0, start_gap=24.0, front_pace=(1.0, 1.0))
    found = []
    for car in ({}, *cars):
        result = run_races(oval, [planner] * 6, planner, apart, vehicle=car)
        assert not result.own_crash.any(), car
        found.append(result.state.progress.max(axis=1).mean())
        assert found[-1] / found[0] > (0.7 if "tyres" in car else 0.9), car


ROLLING = load_rules("contest", start="rolling")


@pytest.mark.parametrize("config", [PAPER, CONTEST, ROLLING], ids=lambda config: config.start)
def test_the_cars_stand_beside_or_behind_each_other_on_several_lines(oval, config):
    setup = RaceSetup(oval, config, (LATTICE, LATTICE))
    # On the straights, where distances along and across the track are those between the cars.
    starts = Starts(np.repeat([4.0, 6.0, 8.0, 28.0, 32.0], 2), np.tile([0, 1], 5))
    state = start_races(setup, starts, race_seeds(0, 10))
    s, d = np.moveaxis(state.frenet, -1, 0)
    rows = np.arange(10)
    first, second = (rows, starts.side), (rows, 1 - starts.side)
    np.testing.assert_allclose(d[first] - d[second], config.start_spacing, atol=1e-6)
    gap = np.mod(s[first] - s[second] + 1.0, oval.length) - 1.0
    np.testing.assert_allclose(gap, config.start_gap, atol=1e-6)
    np.testing.assert_allclose(state.progress[first], 0.0)
    np.testing.assert_allclose(state.progress[second], -config.start_gap)
    places = (state.frenet[..., 0] / oval.arrays.ds).astype(int) % len(oval.line)
    slowest = setup.speed_range[0] * oval.line[places, SPEED]
    speed = slowest if config.start == "rolling" else np.minimum(config.start_speed, slowest)
    np.testing.assert_allclose(state.cars[..., 3], speed, rtol=1e-3)
    starts = draw_starts(oval, config, 10, seed=0)
    assert len(np.unique(starts.s)) == 5
    np.testing.assert_array_equal(starts.side, [0, 1] * 5)
    np.testing.assert_array_equal(starts.s[::2], starts.s[1::2])  # each line from both sides


def test_the_speed_range_comes_from_the_rules_else_from_the_calibration_of_the_circuit(oval):
    planners = (LATTICE, LATTICE)
    assert RaceSetup(oval, PAPER, planners).speed_range == (0.8, 1.0)
    fixed = load_rules("paper", speed_range=(0.5, 0.6))
    assert RaceSetup(oval, fixed, planners).speed_range == (0.5, 0.6)
    # Rules of another name take the rules that is as noisy as they are.
    assert RaceSetup(oval, load_rules("paper", name="mine"), planners).speed_range == (
        0.8,
        1.0,
    )
    assert RaceSetup(oval, load_rules("contest", name="mine"), planners).speed_range == (
        0.9,
        1.14,
    )


def test_games_of_training_start_from_places_that_tables_do_not_use(oval):
    for config in (PAPER, CONTEST):
        train, test = (
            set(start_lines(oval, config, 0, split=split)) for split in ("train", "test")
        )
        assert train
        assert test
        assert not train & test
    refused("split is 'both'", start_lines, oval, PAPER, 0, split="both")
    places = {"left": ((2.0, 9.5),), "right": ((26.5, 26.5),)}
    lopsided = dataclasses.replace(
        oval, calibration={"paper": Calibration((0.8, 1.0), 0.9, places)}
    )
    train, test = (start_lines(lopsided, PAPER, 0, split=split) for split in ("train", "test"))
    assert len(train) == len(test) == PAPER.start_lines
    assert sorted(26.5 in lines for lines in (train, test)) == [False, True]
    assert not set(train) & set(test)


def test_starts_off_the_track_and_in_the_wall_are_refused(oval):
    for s, side, message in [
        (-0.1, 0, r"start line -0.1 m"),
        (1e6, 0, r"it must lie in \[0, 49"),
        (np.nan, 0, "start line nan m"),
        (1.0, 2, r"start sides .* 2"),
    ]:
        starts = Starts(np.array([1.0, s]), np.array([0, side]))
        refused(message, run_races, oval, [lattice()] * 2, lattice(), SHORT, starts=starts)
    wide = load_rules("paper", start_spacing=2.0)
    with pytest.raises(InputError, match=r"race 0: at start line 0\.00 m"):
        run_races(
            oval, lattice(), lattice(), wide, starts=Starts(np.zeros(1), np.zeros(1, np.int64))
        )
    refused("has no place", run_races, oval, lattice(), lattice(), wide)


LINE = Starts(np.zeros(1), np.zeros(1, np.int64))
BROKEN = Planner("broken", (), drive=lambda track, theta, view, memory: (np.nan, 1.0))
LOST = Planner("lost", (), drive=lambda track, theta, view, memory: {}["way"])
MUTE = Planner("mute", (), drive=lambda track, theta, view, memory: ("left", None))


def test_bad_arguments_are_refused(oval):
    for call, message in [
        (lambda oval, *_: draw_starts(oval, PAPER, 2, 1.5), "seed is 1.5"),
        (lambda *_: race_seeds(-1, 2), "seed is -1"),
        (
            lambda oval, *_: run_races(oval, [lattice()] * 2, [lattice()] * 3, SHORT),
            "2 egos but 3 opponents",
        ),
        (
            lambda oval, *_: run_races(oval, [lattice()] * 2, lattice(), SHORT, starts=LINE),
            "2 races but 1 starts",
        ),
        (
            lambda oval, *_: run_races(oval, BROKEN.policy(), lattice(), SHORT),
            "0, car 0: planner 'broken' returned",
        ),
        (
            lambda oval, *_: run_races(oval, lattice(), LOST.policy(), SHORT),
            "0, car 1: planner 'lost' raised KeyError",
        ),
        (
            lambda oval, *_: run_races(oval, lattice(), MUTE.policy(), SHORT),
            r"'mute' returned \('left', None\); it",
        ),
        (lambda *_: run_races("Pipkin", lattice(), lattice()), "'Pipkin'; it must be a Track"),
        (lambda *_: record_race("Pipkin", lattice(), lattice()), "'Pipkin'; it must be a Track"),
        (lambda _, setup, state, theta: advance(setup, state, theta, -2), "ticks is -2"),
        (lambda _, *run: advance(*run, 2, threads=0), "threads is 0"),
        (
            lambda _, setup, state, theta: advance(setup, state, theta[..., :3], 2),
            r"theta .*\(1, 2, 3\)",
        ),
        (
            lambda _, setup, state, theta: advance(setup, state, theta.astype(np.float32), 2),
            "type float32",
        ),
    ]:
        refused(message, call, oval, *begin(oval, SHORT, [lattice()], [lattice()]))
