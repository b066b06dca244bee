"""Measurements of a car: its pose with errors, other cars late and lost, scans as they are."""

import os
import subprocess
import sys
from hashlib import sha256
from pathlib import Path

import numpy as np
import pytest
from placed_cars import HOLD, placed, view_of
from refusal import refused
from repository import REPOSITORY

from pcs_racing import load_rules, racer, run_races
from pcs_racing.base.errors import ConfigError
from pcs_racing.base.seeds import normal_noise
from pcs_racing.car.vehicle import V, VehicleParams
from pcs_racing.envs.drive import DriveEnv
from pcs_racing.envs.models import model_policy
from pcs_racing.planners.scanning import BEAMS, SCAN_SIZE, scan
from pcs_racing.planners.view import VIEW
from pcs_racing.race.driving import advance
from pcs_racing.race.races import RaceSetup, start_races
from pcs_racing.race.start_grid import Starts
from pcs_racing.race.state import take
from pcs_racing.race.steering import disturbed_speed
from pcs_racing.track.loading import load_track

PLACES = ((3.0, 0.2), (5.0, -0.3))
OF_THE_OPPONENT = [name for name in VIEW if name.startswith("OPP_")]


def see(setup, state, car=0):
    return dict(zip(VIEW, view_of(setup, state, 0, car), strict=True))


def views(track, car, ticks, seed=1):
    """Views of two standing cars by car 0, at so many moments: each number as an array."""
    setup, state, _ = placed(track, PLACES, vehicles=(car, VehicleParams()))
    state.seed[:] = seed
    found = []
    for tick in ticks:
        state.tick[:] = tick
        found.append(view_of(setup, state, 0, 0))
    return dict(zip(VIEW, np.array(found).T, strict=True))


def turned(angle):
    return np.mod(angle + np.pi, 2.0 * np.pi) - np.pi


def test_a_car_without_errors_sees_what_is_there(coarse_oval):
    seen = views(coarse_oval, VehicleParams(), [0, 2, 400])
    for name in ("X", "Y", "PSI", "S", "D", "OPP_X", "OPP_Y", "OPP_PSI"):
        np.testing.assert_array_equal(seen[name], seen[f"TRUE_{name}"])
    assert (seen["SCAN_KEY"] == 0.0).all()


def test_noise_of_the_pose_is_new_at_each_command_and_moves_the_place_on_the_line(coarse_oval):
    car = VehicleParams(pose_noise=0.1, heading_noise=0.02)
    seen, exact = (views(coarse_oval, one, range(0, 4000, 2)) for one in (car, VehicleParams()))
    errors = np.array([seen[name] - exact[name] for name in ("X", "Y")])
    errors = np.array([*errors, turned(seen["PSI"] - exact["PSI"])])
    np.testing.assert_allclose(errors.std(axis=1), [0.1, 0.1, 0.02], rtol=0.06)
    assert (np.abs(errors.mean(axis=1)) < [0.01, 0.01, 0.002]).all()
    assert np.abs(np.corrcoef(errors) - np.eye(3)).max() < 0.08
    assert max(abs(np.corrcoef(e[1:], e[:-1])[0, 1]) for e in errors) < 0.08
    frenet = coarse_oval.to_frenet(np.stack([seen["X"], seen["Y"]], axis=1))
    np.testing.assert_allclose(np.stack([seen["S"], seen["D"]], axis=1), frenet, atol=1e-9)
    np.testing.assert_allclose(seen["GAP"], exact["GAP"] - (seen["S"] - exact["S"]), atol=1e-9)
    changed = {"X", "Y", "PSI", "S", "D", "GAP"}
    for name in set(VIEW) - changed:  # speed, yaw rate, the opponent and the truth
        np.testing.assert_array_equal(seen[name], exact[name], name)


def test_a_bias_lasts_for_the_race_and_a_drift_turns_within_seconds(coarse_oval):
    def errors(car, ticks, seed):
        seen = views(coarse_oval, car, ticks, seed)
        return np.stack([seen["X"] - seen["TRUE_X"], seen["Y"] - seen["TRUE_Y"]])

    biased, drifting = VehicleParams(pose_bias=0.2), VehicleParams(pose_drift=0.2)
    constant = np.array([errors(biased, [0, 500, 3998], seed) for seed in range(300)])
    assert np.ptp(constant, axis=2).max() < 1e-12
    assert constant[..., 0].std() == pytest.approx(0.2, rel=0.1)
    slow = np.array([errors(drifting, [2, 4, 102, 1602], seed) for seed in range(300)])
    np.testing.assert_allclose(slow.std(axis=(0, 1)), 0.2, rtol=0.1)
    assert np.abs(slow[..., 1] - slow[..., 0]).max() < 0.01
    one, two = (np.corrcoef(slow[..., 0].ravel(), slow[..., k].ravel())[0, 1] for k in (2, 3))
    assert one > 0.8
    assert abs(two) < 0.15
    turn = views(coarse_oval, VehicleParams(heading_bias=0.05), [0, 2])
    assert len(set(turn["PSI"])) == 1
    assert turn["PSI"][0] != turn["TRUE_PSI"][0]


@pytest.mark.parametrize("cars", [2, 3])
@pytest.mark.parametrize("delays", [(0.1, 0.0, 0.0), (0.02, 0.06, 0.04)])
def test_others_are_seen_late_by_exactly_the_delay(coarse_oval, cars, delays):
    """From the start on, with late commands as well, and not by a car without a delay."""
    late = dict(zip(("opponent_delay", "steer_delay", "speed_delay"), delays, strict=True))
    vehicles = (VehicleParams(**late), *(VehicleParams(),) * (cars - 1))
    places = [(3.0 + 3.0 * k, 0.0) for k in range(cars)]
    setup, state, theta = placed(coarse_oval, places, [2.0, 1.0, 1.5][:cars], vehicles=vehicles)
    steps = round(delays[0] / 0.02)
    then, progress = [], []
    for step in range(14):
        prompt = see(setup, state, 1)
        setup_exact = RaceSetup(setup.track, setup.rules, setup.planners)
        then.append(see(setup_exact, state, 0))
        progress.append(state.progress[0, 1])
        seen, before = see(setup, state, 0), then[max(step - steps, 0)]
        for name in OF_THE_OPPONENT:
            assert seen[name] == before[name], name
        assert seen["GAP"] == progress[max(step - steps, 0)] - state.progress[0, 0]
        assert seen["TRUE_OPP_X"] == then[-1]["OPP_X"]
        assert prompt["OPP_X"] == prompt["TRUE_OPP_X"]
        advance(setup, state, theta, 2, threads=1)


def test_an_opponent_is_lost_for_a_share_of_the_time_in_intervals(coarse_oval):
    car = VehicleParams(opponent_lost=0.3, opponent_lost_time=0.2)
    ticks = np.arange(0, 60_000, 2)
    seen = views(coarse_oval, car, ticks)
    lost = seen["OPP_D"] > 1e5
    assert lost.mean() == pytest.approx(0.3, abs=0.03)
    changes = ticks[1:][lost[1:] != lost[:-1]]
    assert len(changes) > 500
    assert (changes % 20 == 0).all()
    nobody = see(*placed(coarse_oval, PLACES[:1])[:2])
    for name in (*OF_THE_OPPONENT, "GAP"):
        assert set(seen[name][lost]) == {nobody[name]}, name
    always = views(coarse_oval, VehicleParams(opponent_lost=1.0), ticks[:50])
    assert (always["OPP_D"] > 1e5).all()


def test_a_lidar_sees_the_opponent_where_it_is_now_from_where_the_car_is(coarse_oval):
    blind = VehicleParams(opponent_lost=1.0, opponent_delay=0.1, pose_bias=0.5, heading_bias=0.3)
    ranges = []
    for car in (blind, VehicleParams()):
        setup, state, theta = placed(
            coarse_oval, PLACES, [1.0, 3.0], vehicles=(car, VehicleParams())
        )
        advance(setup, state, theta, 20, threads=1)
        scratch = np.zeros(SCAN_SIZE)
        scan(coarse_oval.arrays, view_of(setup, state, 0, 0), scratch)
        ranges.append(scratch[-BEAMS:].copy())
    np.testing.assert_array_equal(*ranges)


@pytest.mark.parametrize("name", ["gap-follower", "disparity-extender"])
def test_planners_without_a_map_do_not_notice_errors_of_localisation_and_tracker(oval, name):
    blind = VehicleParams(opponent_lost=0.5, opponent_delay=0.1, pose_noise=0.2, heading_noise=0.1)
    rules = load_rules("paper", duration=3.0)
    ends = [
        run_races(oval, name, name, rules, vehicle=car, threads=1).state.cars
        for car in (blind, VehicleParams())
    ]
    np.testing.assert_array_equal(*ends)


def test_a_car_that_is_stopped_stays_where_it_is_and_not_where_it_believes_to_be(coarse_oval):
    """The contact, at the wall, is settled by exact poses."""
    lost = VehicleParams(pose_bias=3.0)
    ends = []
    for car in (lost, VehicleParams()):
        setup, state, theta = placed(
            coarse_oval,
            [(3.0, 0.7, 1.2), (9.0, 0.0)],
            [3.0, 0.0],
            vehicles=(car,) * 2,
            contact="stop",
        )
        advance(setup, state, theta, 60, threads=1)
        assert state.fault[0, 0] == 1
        ends.append(state.cars[0, 0])
    np.testing.assert_array_equal(*ends)


def test_an_observation_has_the_measured_pose_and_the_late_and_lost_opponent(coarse_oval):
    def steps(**car):
        env = DriveEnv(
            track=coarse_oval,
            opponent=HOLD.policy({"speed": 2.0}),
            vehicle=[car, {}],
            own_pose=True,
            time_step=0.02,
            look_ahead=(0.0,),
            beams=5,
            start_lines=1,
        )
        names = [element.name for element in env.elements]
        rows = [env.reset(seed=3)[0]]
        for _ in range(60):
            rows.append(env.step([0.1, -0.5])[0])
        return dict(zip(names, np.array(rows).T, strict=True))

    exact = steps()
    noisy = steps(pose_noise=0.05, heading_noise=0.02)
    for name, sd in (("x", 0.05), ("y", 0.05), ("heading", 0.02)):
        assert turned(noisy[name] - exact[name]).std() == pytest.approx(sd, rel=0.35), name
    places = coarse_oval.to_frenet(np.stack([noisy["x"], noisy["y"]], axis=1).astype(float))
    np.testing.assert_allclose(noisy["offset"], places[:, 1], atol=1e-5)
    for name in ("speed", "steering", "yaw rate", "slip", "beam 0", "beam 4"):
        np.testing.assert_array_equal(noisy[name], exact[name], name)
    late = steps(opponent_delay=0.1)
    there = late["opponent offset"] + late["offset"]
    then = exact["opponent offset"] + exact["offset"]
    np.testing.assert_allclose(there[5:], then[:-5], atol=1e-6)
    np.testing.assert_allclose(there[:5], then[0], atol=1e-6)
    lost = steps(opponent_lost=0.5, opponent_lost_time=0.1)
    assert 10 < (lost["opponent"] == 0.0).sum() < 50
    for name in ("opponent gap", "opponent x", "opponent vx", "lead"):
        hidden = lost["opponent"] == 0.0
        np.testing.assert_array_equal(lost[name], np.where(hidden, 0.0, exact[name]), name)


IMPERFECT = VehicleParams(
    steer_delay=0.04, opponent_delay=0.06, opponent_lost=0.2, opponent_lost_time=0.1,
    pose_noise=0.03, pose_drift=0.05, pose_bias=0.02, heading_noise=0.01, heading_drift=0.01,
    heading_bias=0.01, lidar_x=0.1, lidar_noise=0.02, lidar_lost=0.1, lidar_step=0.01,
)  # fmt: skip


def race(track, pieces=1, rows=(0, 1, 2)):
    """End of some races of a planner with a map against one without."""
    drivers = [racer("pure-pursuit"), racer("gap-follower")]
    rules = load_rules("contest", start_spacing=0.5, speed_range=(0.6, 0.9))
    setup = RaceSetup(track, rules, tuple(one.planner for one in drivers), (IMPERFECT,) * 2)
    starts = Starts(np.array([0.0, 3.0, 6.0]), np.array([0, 1, 0]))
    state = take(start_races(setup, starts, np.arange(3, dtype=np.uint64) + 9), rows)
    theta = np.zeros((len(rows), 2, setup.theta_size))
    for car, driver in enumerate(drivers):
        theta[:, car, : len(driver.parameters)] = driver.parameters
    for _ in range(pieces):
        state = state.copy()
        advance(setup, state, theta, 24 // pieces, threads=1)
    return state


def digest(state):
    return sha256(b"".join(np.ascontiguousarray(part).tobytes() for part in state)).hexdigest()


def test_the_bits_depend_neither_on_the_batch_nor_on_stops_nor_on_compilation(coarse_oval):
    whole = race(coarse_oval)
    assert np.ptp(whole.memory) > 0.0
    assert digest(race(coarse_oval, pieces=12)) == digest(whole)
    for row in range(3):
        alone = race(coarse_oval, rows=(row,))
        for part, all_parts in zip(alone, whole, strict=True):
            np.testing.assert_array_equal(part[0], all_parts[row])
    code = "import test_sensing as t; print(t.digest(t.race(t.load_track('Pipkin'), 1, (0,))))"
    here = Path(__file__).parent
    path = os.pathsep.join(map(str, (REPOSITORY, REPOSITORY / "tests", here)))
    plain = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", code],
        env={**os.environ, "NUMBA_DISABLE_JIT": "1", "PYTHONPATH": path},
        capture_output=True,
        text=True,
        check=True,
    )
    assert plain.stdout.split()[-1] == digest(race(load_track("Pipkin"), 1, (0,)))


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("pose_noise", -0.1),
        ("heading_drift", 1.1),
        ("opponent_delay", 0.03),
        ("opponent_delay", 0.52),
        ("opponent_lost", 1.5),
        ("opponent_lost_time", 0.0),
        ("lidar_lost", np.nan),
        ("lidar_x", "ahead"),
    ],
)
def test_impossible_sensors_are_refused(field, value):
    refused(f"{field} is .*it must be", VehicleParams, error=ConfigError, **{field: value})


TOP = 8.0  # m/s, of the actions


def in_force(env, asked, seed=0):
    """Steering angles and speeds that a car follows after each of some commands, and its speeds."""
    env.reset(seed=seed)
    commands, speeds = [], []
    for steer, speed in asked:
        speeds.append(env.batch.state.cars[0, 0, V])
        env.step([steer / 0.4189, 2.0 * speed / TOP - 1.0])
        commands.append(env.batch.state.command[0, 0].copy())
    return np.array(commands), np.array(speeds)


@pytest.mark.parametrize("delays", [(0.0, 0.04), (0.06, 0.04), (0.02, 0.1)])
def test_speed_and_steering_are_late_by_their_own_delays(oval, delays):
    """Until the first command arrives, the car steers straight and keeps its speed."""
    asked = np.random.default_rng(1).uniform([-0.3, 1.0], [0.3, 6.0], (20, 2))
    late = {"steer_delay": delays[0], "speed_delay": delays[1]}
    env = DriveEnv(track=oval, opponent=None, vehicle=late, time_step=0.02, top_speed=TOP)
    commands, speeds = in_force(env, asked)
    steer, speed = (round(delay / 0.02) for delay in delays)
    np.testing.assert_allclose(commands[steer:, 0], asked[: 20 - steer, 0], atol=1e-6)
    assert not commands[:steer, 0].any()
    np.testing.assert_allclose(commands[speed:, 1], asked[: 20 - speed, 1], atol=1e-6)
    np.testing.assert_allclose(commands[:speed, 1], speeds[:speed])
    np.testing.assert_allclose(speeds[: speed + 1], speeds[0])


def test_a_late_command_waits_for_its_period_when_actions_come_more_often(oval):
    asked = np.random.default_rng(2).uniform([-0.3, 1.0], [0.3, 6.0], (20, 2))
    late = {"speed_delay": 0.04}
    env = DriveEnv(track=oval, opponent=None, vehicle=late, time_step=0.01, top_speed=TOP)
    commands, _ = in_force(env, asked)
    np.testing.assert_allclose(commands[4::2, 1], asked[0:-4:2, 1], atol=1e-6)
    np.testing.assert_array_equal(commands[5::2, 1], commands[4:-1:2, 1])
    np.testing.assert_allclose(commands[:, 0], asked[:, 0], atol=1e-6)  # prompt


def test_the_noise_of_the_speed_is_drawn_for_each_command_and_car(oval):
    asked = np.tile([0.0, 1.0], (300, 1))
    env = DriveEnv(
        track=oval,
        opponent=None,
        vehicle={"speed_noise": 0.3},
        time_step=0.01,
        top_speed=TOP,
        rules="contest",
    )
    commands, _ = in_force(env, asked)
    noise = commands[:, 1] - 1.0
    np.testing.assert_allclose(noise[0::2], noise[1::2], atol=1e-12)
    assert noise.std() == pytest.approx(0.3, rel=0.15)
    assert abs(np.corrcoef(noise[0:-2:2], noise[2::2])[0, 1]) < 0.2
    assert abs(np.corrcoef(noise[0::2], commands[0::2, 0])[0, 1]) < 0.2  # of the steering
    again, _ = in_force(env, asked)
    np.testing.assert_array_equal(again, commands)
    row, seed = VehicleParams(speed_noise=0.3).as_row(), np.uint64(9)
    drawn = [disturbed_speed(4.0, row, seed, car, tick) for car in (0, 1) for tick in range(4)]
    assert drawn[0::2] == drawn[1::2]
    assert len(set(drawn)) == 4
    assert drawn[0] != 4.0 + 0.3 * normal_noise(seed, 0, 0)
    assert disturbed_speed(4.0, VehicleParams().as_row(), seed, 0, 0) == 4.0


def test_a_model_that_decides_between_two_commands_keeps_the_noise_of_the_last_one(oval):
    steady = model_policy(lambda seen: 0.0 * seen[:, :2] - 0.8, name="steady", time_step=0.05)
    env = DriveEnv(track=oval, opponent=steady, vehicle=[{}, {"speed_noise": 0.3}], time_step=0.01)
    env.reset(seed=4)
    state, row = env.batch.state, env.batch.randomization.vehicles[0, 1]
    for tick in range(12):
        env.step([0.0, -0.8])
        speed = disturbed_speed(state.memory[0, 1, 1], row, state.seed[0], 1, tick)
        assert state.command[0, 1, 1] == speed
        assert state.command[0, 1, 1] != state.memory[0, 1, 1]
