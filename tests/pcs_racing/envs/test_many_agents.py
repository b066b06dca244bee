"""Control level with one car or more than two: observations, rewards and infos."""

import numpy as np
import pytest
from faces import begun, follow_the_line, poses
from refusal import refused

from pcs_racing import InputError, load_rules
from pcs_racing.base.errors import ConfigError
from pcs_racing.car.lidar import Lidar
from pcs_racing.envs.drive import (
    DriveEnv,
    DriveHeadToHeadEnv,
    DriveHeadToHeadVectorEnv,
    DriveVectorEnv,
)
from pcs_racing.envs.infos import Crash, Result

X, Y, _, V, PSI = range(5)
DRIVERS = ["lattice:pace=0.3", "pure-pursuit", "lattice:pace=0.2"]
SHORT = {"rules": "contest", "duration": 1.0, "time_step": 0.1}


def named(env, observation):
    return dict(zip([element.name for element in env.elements], observation, strict=True))


def test_opponents_are_observed_the_nearest_first(oval):
    """Behind counts as ahead does, also over the start line; each has the same nine numbers."""
    one = DriveEnv(track=oval, opponents=DRIVERS)
    names = [element.name for element in one.elements]
    assert names[32:41] == [element.name for element in DriveEnv(track=oval).elements][32:]
    assert names[41:43] == ["opponent 2", "opponent 2 gap"]
    assert names[-1] == "lead 3"
    places = (1.0, 0.0, 1.0), (7.0, 0.5, 0.0), (oval.length - 1.0, -0.5, 2.0), (4.0, 0.0, 3.0)
    observation, _ = one.reset(options={"poses": poses(oval, *places)})
    seen = named(one, observation)
    order = {"": 2, " 2": 3, " 3": 1}
    for k, car in order.items():
        gap = places[car][0] - 1.0 if car != 2 else -2.0
        assert seen[f"opponent{k} gap"] == pytest.approx(gap, abs=0.05)
        assert seen[f"opponent{k} offset"] == pytest.approx(places[car][1], abs=0.05)
        pair = DriveEnv(track=oval).reset(options={"poses": poses(oval, places[0], places[car])})[0]
        start = names.index(f"opponent{k}")
        np.testing.assert_allclose(observation[start : start + 8], pair[32:40], atol=1e-6)
    assert [seen["lead"], seen["lead 2"], seen["lead 3"]] == pytest.approx(
        [2.0, -3.0, -6.0], abs=0.1
    )


def test_the_lidar_sees_all_cars(oval):
    one = DriveEnv(track=oval, opponents=DRIVERS[:2], beams=61)
    places = (3.0, 0.0, 0.0), (6.0, 0.6, 0.0), (5.0, -0.6, 0.0)
    observation, _ = one.reset(options={"poses": poses(oval, *places)})
    own, *others = one.batch.state.cars[0][:, [X, Y, PSI]]
    lidar = Lidar(oval, 61)
    scans = np.array([lidar.scan(own, other) for other in others])
    np.testing.assert_allclose(observation[-61:], scans.min(axis=0), rtol=1e-5)
    assert all((scan < lidar.scan(own) - 0.5).any() for scan in scans)


def test_agents_of_a_race_of_four(oval):
    """Rewards add up to zero, infos have each car's own facts, and the vector environment has the
    same numbers.
    """
    four, envs = (
        DriveHeadToHeadEnv(track=oval, cars=4, **SHORT),
        DriveHeadToHeadVectorEnv(8, track=oval, cars=4, **SHORT),
    )
    observations, _ = four.reset(seed=2)
    agents = ["car_0", "car_1", "car_2", "car_3"]
    assert four.agents == four.possible_agents == agents
    envs.reset(seed=2)
    commands = {agent: [0.0, 0.1 * car - 0.5] for car, agent in enumerate(agents)}
    for _ in range(3):
        observations, rewards, _, _, infos = four.step(commands)
        seen, paid, *_ = envs.step(np.tile([commands[agent] for agent in agents], (2, 1)))
    np.testing.assert_array_equal(seen[:4], [observations[agent] for agent in agents])
    np.testing.assert_array_equal(paid[:4], [rewards[agent] for agent in agents])
    assert sum(rewards.values()) == pytest.approx(0.0, abs=1e-9)
    progress = np.array([infos[agent]["progress"] for agent in agents])
    for car, agent in enumerate(agents):
        assert infos[agent]["lead"] == pytest.approx(progress[car] - np.delete(progress, car).max())
    np.testing.assert_array_equal(
        four.state(), np.concatenate([observations[agent] for agent in agents])
    )
    refused("a multiple of 4", DriveHeadToHeadVectorEnv, 6, track=oval, cars=4)


def test_opponents_drive_the_last_cars(oval):
    mixed = begun(
        DriveHeadToHeadEnv(
            track=oval, cars=3, opponents=["lattice"], render_mode="rgb_array", **SHORT
        ),
        seed=1,
    )
    assert mixed.possible_agents == ["car_0", "car_1"]
    mixed.step({agent: [0.0, -1.0] for agent in mixed.agents})
    assert mixed.render().shape == (640, 960, 3)
    assert mixed.batch.state.path[0, :, 0, 0].nonzero()[0].tolist() == [2]


def test_a_win_is_paid_to_the_first_of_all(oval):
    four = DriveHeadToHeadEnv(
        track=oval, cars=4, progress_reward=0.0, win_reward=2.0, **{**SHORT, "duration": 0.2}
    )
    four.reset(options={"poses": poses(oval, *((s, 0.0, 0.0) for s in (3.0, 9.0, 6.0, 1.0)))})
    stand = {agent: [0.0, -1.0] for agent in four.agents}
    four.step(stand)
    _, rewards, ended, late, infos = four.step(stand)
    assert list(rewards.values()) == [-2.0, 2.0, -2.0, -2.0]
    assert all(ended.values())  # not cut off: the last moment is worth something
    assert not any(late.values())
    assert [infos[agent]["result"] for agent in rewards] == [
        Result.LOSS,
        Result.WIN,
        Result.LOSS,
        Result.LOSS,
    ]


@pytest.mark.parametrize("contact", ["stop", "restart"])
def test_a_contact_need_not_end_an_episode(oval, contact):
    """Every fault is paid for once, in its step, and costs once; the infos count them."""
    rules = load_rules("paper", contact=contact, duration=6.0)
    three = DriveHeadToHeadEnv(
        track=oval, cars=3, rules=rules, progress_reward=0.0, crash_penalty=7.0, time_step=0.1
    )
    three.reset(options={"poses": poses(oval, (3.0, 0.0, 5.0), (6.0, 0.0, 0.0), (20.0, 0.0, 0.0))})
    paid, cost, crashes = np.zeros(3), np.zeros(3), set()
    for _ in range(20):
        answer = three.step({"car_0": [0.0, 0.25], "car_1": [0.0, -1.0], "car_2": [0.0, -1.0]})
        paid += list(answer[1].values())
        cost += [info["cost"] for info in answer[4].values()]
        crashes.add(answer[4]["car_0"]["crash"])
        assert three.agents
    faults = [answer[4][agent]["fault"] for agent in three.agents]
    assert faults[0] >= 1
    assert faults[1:] == [0, 0]
    assert paid.tolist() == [-7.0 * faults[0], 0.0, 0.0]
    assert cost.tolist() == faults
    assert crashes >= {Crash.CAR}


@pytest.mark.parametrize(
    ("kind", "arguments", "error", "message"),
    [
        (DriveEnv, {"opponents": ["lattice"] * 8}, ConfigError, "at most 7"),
        (
            DriveEnv,
            {"opponent": "pure-pursuit", "opponents": ["lattice"]},
            ConfigError,
            "one of the two",
        ),
        (
            DriveEnv,
            {"opponents": ["lattice", ["lattice", "lattice:pace=0.3"]]},
            InputError,
            "each is one planner",
        ),
        (DriveEnv, {"opponents": ["lattice", "random-moves"]}, InputError, "none makes moves"),
        (
            DriveEnv,
            {"opponents": DRIVERS, "vehicle": [{}, {}]},
            ConfigError,
            "lists 2 cars; give one for all, or 4",
        ),
        (DriveEnv, {"opponent": np.float32(2.0)}, InputError, "can't race"),
        (DriveHeadToHeadEnv, {"opponents": "lattice"}, InputError, "opponents is 'lattice'"),
        (DriveHeadToHeadEnv, {"cars": 9}, InputError, "cars is 9"),
        (
            DriveHeadToHeadEnv,
            {"cars": 2, "opponents": DRIVERS[:2]},
            InputError,
            "leave a car to an agent",
        ),
    ],
)
def test_what_is_refused(oval, kind, arguments, error, message):
    with pytest.raises(error, match=message):
        kind(track=oval, **arguments)


def test_commands_take_effect_every_hundredth_of_a_second(oval):
    """Two steps of 0.01 s are one of 0.02 s, the noise of steering included; another command
    between them counts.
    """
    given = {"rules": "contest", "opponent": "lattice"}
    slow, fast, other = (
        begun(DriveEnv(track=oval, time_step=step, **given), seed=4) for step in (0.02, 0.01, 0.01)
    )
    for k in range(20):
        action = [0.5 - 0.05 * k, 0.1]
        *_, info = slow.step(action)
        for each, second in ((fast, action), (other, [-1.0, 1.0])):
            each.step(action)
            *_, half = each.step(second)
        np.testing.assert_array_equal(fast.batch.state.cars, slow.batch.state.cars)
    assert info["poses"][0] != pytest.approx(half["poses"][0], abs=1e-3)


def test_actions_in_units_and_the_own_pose(oval):
    units = begun(
        DriveEnv(track=oval, opponent=None, normalized=False, own_pose=True, top_speed=6.0), seed=1
    )
    plain = begun(DriveEnv(track=oval, opponent=None, top_speed=6.0), seed=1)
    np.testing.assert_allclose(
        [units.action_space.low, units.action_space.high], [[-0.4189, 0.0], [0.4189, 6.0]]
    )
    for _ in range(5):
        seen, *_, info = units.step([0.2, 1.5])
        other, *_ = plain.step([0.2 / 0.4189, -0.5])
    np.testing.assert_allclose(np.delete(seen, [8, 9, 10]), other, atol=1e-6)
    assert named(units, seen)["heading"] == pytest.approx(info["poses"][0, 2], abs=1e-5)
    np.testing.assert_allclose(seen[8:10], info["poses"][0, :2], rtol=1e-5)
    np.testing.assert_allclose(info["velocities"][0], seen[[0, 2, 3]], atol=1e-5)


@pytest.mark.parametrize("laps", [1, 2])
def test_a_race_of_so_many_laps_has_as_many_and_their_times(oval, laps):
    one, many = (kind(track=oval, opponent=None, laps=laps) for kind in (DriveEnv, DriveVectorEnv))
    other = DriveEnv(track=oval, opponent=None, rules=load_rules("paper", laps=laps))
    seen, _ = one.reset(seed=1)
    many.reset(seed=1)
    other.reset(seed=1)
    over, ends = False, []
    while not over:
        action = follow_the_line(seen)
        seen, _, over, late, info = one.step(action)
        assert not late
        *_, batch = many.step(action[None])
        assert all(batch[name][0] == info[name] for name in ("laps", "lap_time", "best_lap"))
        np.testing.assert_array_equal(batch["lap_times"][0], info["lap_times"])
        _, _, *same, told = other.step(action)
        assert (same, told["time"]) == ([over, late], info["time"])
        if info["laps"] > len(ends):
            ends.append(info["time"])
            other.set_state(one.get_state())
    assert one.outcome()["laps"] == info["laps"] == laps
    times = np.diff(ends, prepend=0.0)
    assert info["progress"] == pytest.approx(laps * oval.length, abs=1.0)
    np.testing.assert_array_equal(told["lap_times"], info["lap_times"])
    assert info["lap_times"] == pytest.approx(times, abs=0.1)
    assert 0.0 <= info["time"] - info["lap_times"].sum() < 0.02
    assert info["lap_time"] == pytest.approx(times[-1], abs=0.1)
    assert info["best_lap"] == pytest.approx(times.min(), abs=0.1)
