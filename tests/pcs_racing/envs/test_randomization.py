"""Episodes that differ: circuits, cars, values drawn for the cars, and obstacles."""

import dataclasses
import re
import threading
import time

import numpy as np
import pytest
from faces import begun
from refusal import refused

from pcs_racing.base.errors import ConfigError
from pcs_racing.car.lidar import Lidar
from pcs_racing.car.vehicle import MU, SPEED_DELAY, VehicleParams
from pcs_racing.envs import random_circuits
from pcs_racing.envs.drive import DriveEnv, DriveHeadToHeadEnv, DriveVectorEnv
from pcs_racing.envs.duel import DuelEnv, DuelVectorEnv
from pcs_racing.envs.obstacles import Obstacles
from pcs_racing.envs.random_circuits import (
    CircuitBuilder,
    RandomCircuits,
    find_speeds,
    random_circuit,
)
from pcs_racing.race.config import KNOWN_RULES, PAPER
from pcs_racing.track.moving import BOX, MOTION

RANGES = {
    "mu": [0.6, 1.2],
    "m": [3.0, 4.5],
    "steer_delay": [0.0, 0.1],
    "steer_noise": [0.0, 0.02],
}
DRIVE = {"beams": 9, "duration": 1.0, "start_lines": 6, "time_step": 0.1}
DUEL = {"steps": (0.4,) * 3, "opponent": "random-moves"}


@pytest.fixture
def ovals(oval, monkeypatch):
    """Random circuits that cost nothing: the oval under the names of their numbers."""
    built = []

    def stand_in(settings, index):
        built.append(index)
        return dataclasses.replace(oval, name=f"random-{index}")

    monkeypatch.setattr(random_circuits, "random_circuit", stand_in)
    return built


@pytest.fixture(scope="module")
def wide(oval):
    """The oval, as another object with another name."""
    return dataclasses.replace(oval, name="wide")


@pytest.mark.parametrize(
    ("kind", "usual"),
    [
        (DriveVectorEnv, DRIVE),
        (DuelVectorEnv, DUEL),
    ],
)
def test_one_episode_may_differ_without_the_others(kind, usual, oval, wide):
    varied = {
        "track": [oval, wide],
        "randomize": RANGES,
        "obstacles": {"count": [0, 2], "passage": 0.8},
    }
    envs = kind(4, autoreset_mode="DISABLED", **usual, **varied)
    _, before = envs.reset(seed=1)
    _, after = envs.reset(options={"reset_mask": np.array([False, True, False, True])})
    for name in ("mu", "m"):
        assert (after[name][[0, 2]] == before[name][[0, 2]]).all()
        assert (after[name][[1, 3]] != before[name][[1, 3]]).all()
    for i, count in enumerate(after["obstacles"]):
        assert (envs.batch.randomization.track(i) in (oval, wide)) == (count == 0)
    assert set(before["obstacles"]) | set(after["obstacles"]) == {0, 1, 2}


def test_every_circuit_of_a_list_is_driven(oval, wide):
    envs = DriveVectorEnv(64, track=[oval, wide], opponent=None, start_lines=2)
    _, infos = envs.reset(seed=0)
    assert 20 <= infos["track"].sum() <= 44
    assert dict(envs.metadata["codes"]["track"]) == {0: "oval", 1: "wide"}
    assert envs.outcome()[0]["track"] in ("oval", "wide")


def test_random_circuits_follow_from_the_seed_whatever_the_threads_do(oval, ovals, monkeypatch):
    quick, source = random_circuits.random_circuit, RandomCircuits(episodes=2, count=1000)
    drawn = []
    for slow in (0.0, 0.01):

        def late(settings, index, slow=slow):
            time.sleep(slow * (index % 3))
            return quick(settings, index)

        monkeypatch.setattr(random_circuits, "random_circuit", late)
        envs = DriveVectorEnv(
            3, track=source, opponent=None, start_lines=2, autoreset_mode="DISABLED"
        )
        for _ in range(2):
            drawn.append([envs.reset(seed=5)[1]["track"].tolist()])
            drawn[-1] += [envs.reset()[1]["track"].tolist() for _ in range(5)]
    seen = drawn[0]
    assert drawn == [seen] * 4
    assert seen[0::2] == seen[1::2]  # two episodes on each
    assert len({tuple(numbers) for numbers in seen}) == 3
    single = DriveEnv(track=source, opponent=None, start_lines=2)
    for _ in range(2):  # a seed begins the series again
        numbers = [
            single.reset(seed=6)[1]["track"],
            *(single.reset()[1]["track"] for _ in range(5)),
        ]
        assert numbers == [n[1] for n in seen]
    assert single.outcome()["track"] == f"random-{seen[-1][1]}"


def test_a_random_circuit_can_be_raced_on():
    settings = RandomCircuits(style="hull")
    track = random_circuit(settings, 3)
    assert 50.0 < track.length < 125.0
    assert set(track.calibration) == set(KNOWN_RULES)
    driven = find_speeds(track, dataclasses.replace(PAPER, name="own"))
    assert driven.calibration["paper"].speed_range > track.calibration["paper"].speed_range
    assert driven.calibration["contest"] == track.calibration["contest"]
    env = DuelEnv(track=track, archive="default", steps=(1.0,) * 2)
    for seed in range(3):
        env.reset(seed=seed)
        assert not env.batch.state.race.crashed.any()


def test_a_builder_forgets_the_circuits_that_nobody_needs(ovals, monkeypatch):
    monkeypatch.setattr(random_circuits, "KEPT", 1)
    builder = CircuitBuilder(RandomCircuits())
    for index in range(5):
        assert builder.get(index).name == f"random-{index}"
    builder.get(4)
    builder.get(0)
    assert ovals == [0, 1, 2, 3, 4, 0]
    builder.close()
    assert threading.active_count() < 50


def test_cars_are_what_the_argument_says(oval, tmp_path):
    (tmp_path / "car.yaml").write_text("mu: 0.5\nm: 5.0\n")
    env = DriveEnv(
        track=oval, vehicle=[{"mu": 0.7, "steer_max": 0.3}, tmp_path / "car.yaml"], start_lines=2
    )
    first, second = env.batch.setup.vehicles
    assert (first.mu, first.steer_max) == (0.7, 0.3)
    assert (second.mu, second.m) == (0.5, 5.0)
    game = DuelEnv(track=oval, vehicle=VehicleParams(mu=0.9), **DUEL).game
    assert [car.mu for car in game.setup.vehicles] == [0.9, 0.9]


def test_each_car_drives_with_its_own_draws(oval):
    """The infos have the own car first, and the value of a car without a draw."""
    drawn = {"each": {"mu": [0.6, 1.2]}, "car_1": {"speed_delay": {"choice": [0.08]}}}
    env = DriveHeadToHeadEnv(track=oval, start_lines=2, duration=1.0, randomize=drawn)
    _, infos = env.reset(seed=3)
    rows = env.batch.randomization.vehicles[0]
    assert rows[0, MU] != rows[1, MU]
    for car in range(2):
        info = infos[f"car_{car}"]
        assert info["mu"].tolist() == rows[[car, 1 - car], MU].tolist()
        assert info["speed_delay"].tolist() == [[0.0, 0.08], [0.08, 0.0]][car]
    assert rows[:, SPEED_DELAY].tolist() == [0.0, 4.0]
    moved = []
    for _ in range(6):
        env.step({agent: np.array([0.0, 1.0], np.float32) for agent in env.possible_agents})
        moved.append((env.batch.state.command[0, :, 1] > 7.9).tolist())
    assert moved == [[True, False]] * 4 + [[True, True]] * 2


def test_drawn_tyres_are_a_number_with_a_label(oval):
    env = DriveEnv(
        track=oval, opponent=None, start_lines=2, randomize={"tyres": {"choice": ["pacejka"]}}
    )
    _, info = env.reset(seed=0)
    assert (info["tyres"], env.outcome()["tyres"]) == (1.0, "pacejka")
    assert env.metadata["codes"]["tyres"] == {0: "linear", 1: "pacejka"}


def test_the_noise_of_the_lidar_is_drawn_for_each_episode(oval):
    drawn = {"lidar_noise": [0.01, 0.2]}
    envs = DriveVectorEnv(
        200, track=oval, opponent=None, beams=40, randomize=drawn, autoreset_mode="DISABLED"
    )
    seen, infos = envs.reset(seed=7)
    cars = envs.batch.state.cars[:, 0][:, [0, 1, 4]]
    error = seen[:, -40:] - Lidar(oval, 40).scan(cars)
    spread = np.sqrt((error**2).mean(axis=1))
    np.testing.assert_allclose(spread, infos["lidar_noise"], rtol=0.7)
    assert np.corrcoef(spread, infos["lidar_noise"])[0, 1] > 0.95


def test_drawn_obstacles_leave_room_and_keep_away_from_the_start(oval):
    settings = Obstacles(count=(2, 2), apart=6.0, passage=1.0)
    for seed in range(20):
        boxes = settings.draw(oval, [5.0], np.random.default_rng(seed))
        assert boxes.shape == (2, len(BOX) + len(MOTION))
        frenet = oval.to_frenet(boxes[:, :2])
        between = np.abs(np.diff(frenet[:, 0]))[0]
        assert 5.99 < between < oval.length - 5.99
        assert not ((frenet[:, 0] > 2.01) & (frenet[:, 0] < 12.99)).any()
        reach = 0.5 * np.hypot(*boxes[:, 3:5].T)
        assert (1.1 + np.abs(frenet[:, 1]) - reach > 0.93).all()


@pytest.mark.parametrize(
    ("settings", "found"),
    [({"count": 20}, r"[3-9] of 20"), ({"count": 1, "size": 2.0}, r"0 of 1 .*size \[2.0, 2.0\]")],
)
def test_obstacles_without_room_are_counted(oval, settings, found, capsys):
    boxes = Obstacles(**settings).draw(oval, [5.0], np.random.default_rng(0))
    assert re.search(f"room for {found}", (err := capsys.readouterr().err))
    assert f"room for {len(boxes)} of" in err


@pytest.mark.parametrize(("shape", "share"), [("box", 0.0), ("both", 0.5), ("circle", 1.0)])
def test_drawn_obstacles_are_boxes_or_circles(oval, shape, share):
    settings = Obstacles(count=(2, 2), passage=0.8, shape=shape)
    drawn = [settings.draw(oval, [0.0], np.random.default_rng(i)) for i in range(40)]
    is_round = np.concatenate(drawn)[:, 4] == 0.0
    assert is_round.mean() == pytest.approx(share, abs=0.2)


def test_a_car_crashes_into_a_given_obstacle_that_its_lidar_saw(oval):
    env = DriveEnv(track=oval, opponent=None, beams=11, time_step=0.02)
    poses = [[-4.0, -4.0, 0.0, 4.0], [4.0, 4.0, 3.1, 0.0]]
    observation, _ = env.reset(
        seed=0, options={"poses": poses, "obstacles": [[0.0, -4.0, 0.0, 0.4, 0.4]]}
    )
    assert observation[-6] == pytest.approx(3.8, abs=0.03)  # the beam straight ahead
    terminated = False
    while not terminated:
        _, _, terminated, truncated, info = env.step([0.0, 0.0])
        assert not truncated
    assert info["crash"] == 1
    assert info["fault"] == 1
    assert env.batch.state.cars[0, 0, 0] + 4.0 == pytest.approx(4.0 - 0.2 - 0.29, abs=0.12)
    observation, _ = env.reset(seed=0, options={"poses": poses})
    assert observation[-6] > 6.0


def test_a_car_never_starts_in_an_obstacle(oval):
    """An impossible reset changes nothing that is driven."""
    env = begun(DriveEnv(track=oval, opponent=None, beams=3), seed=0)
    env.step([0.1, 0.0])
    before = env.batch.state.copy()
    poses = [[0.0, -4.0, 0.0], [4.0, 4.0, 3.1]]
    refused(
        "in one of the obstacles",
        env.reset,
        options={"poses": poses, "obstacles": [[0.2, -4.0, 0.0, 0.4, 0.4]]},
    )
    for mine, own in zip(env.batch.state, before, strict=True):
        np.testing.assert_array_equal(mine, own)


def test_drawn_cars_fit_on_the_grid(oval):
    for kind in (DriveEnv, DuelEnv):
        refused(
            "randomize draws cars of up to 1.5 x 0.58 m; on the grid of track 'oval'",
            kind,
            track=oval,
            randomize={"each": {"width": [0.3, 1.5]}},
            error=ConfigError,
        )
    env = DriveEnv(track=oval, randomize={"length": [0.5, 0.8]})
    env.reset(seed=1, options={"poses": [[0.0, -4.0, 0.0], [4.0, 4.0, 3.1]]})
    close = [[0.0, -4.0, 0.0], [0.585, -4.0, 0.0]]  # apart for the undrawn cars
    refused(
        "episode 0: a car starts in a wall or in another car", env.reset, options={"poses": close}
    )


def test_a_drawn_mass_with_an_impossible_inertia_is_refused_at_once(oval):
    arguments = {"vehicle": {"inertia": 1e6}, "randomize": {"m": [3.0, 100.0]}}
    for kind in (DriveEnv, DuelEnv):
        refused(
            "randomize: at an end of the draws inertia is",
            kind,
            track=oval,
            **arguments,
            error=ConfigError,
        )


@pytest.mark.parametrize(
    "changes",
    [{"shortest": 70.0, "longest": 60.0}, {"style": "square"}, {"episodes": 0}, {"width": 1.0}],
)
def test_impossible_random_circuits_are_refused(changes):
    with pytest.raises(ConfigError):
        RandomCircuits(**changes)
