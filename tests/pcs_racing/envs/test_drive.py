"""Steering: observations, rewards and opponents of agents, and how the races of two
end.
"""

import numpy as np
import pytest
from faces import AGENTS, begun, flat, poses
from refusal import refused

from pcs_racing import load_rules
from pcs_racing.envs.drive import DriveEnv, DriveHeadToHeadEnv, DriveVectorEnv
from pcs_racing.envs.infos import Crash, Result


def test_threads_share_a_step_that_is_long_enough():
    for count, threads, arguments, expected in [
        (64, 4, {}, 1),
        (1024, 4, {}, 4),
        (1024, 2, {}, 2),
        (128, 4, {"beams": 1080}, 4),
        (64, 4, {"time_step": 0.2}, 2),
    ]:
        envs = DriveVectorEnv(
            count, threads=threads, opponent=None, **{"time_step": 0.02, **arguments}
        )
        assert envs.batch.threads == expected
        envs.close()
        assert envs.batch.threads == 1


@pytest.mark.parametrize("normalized", [True, False])
def test_a_car_before_a_wall_gets_away_where_it_has_a_reverse_gear(oval, normalized):
    rules, moved = load_rules("paper", contact="stop"), []
    for speed in (0.0, -2.0):
        env = DriveEnv(
            track=oval,
            opponent=None,
            rules=rules,
            min_speed=speed,
            top_speed=6.0,
            normalized=normalized,
        )
        _, info = env.reset(seed=1, options={"poses": poses(oval, (4.0, 0.0, 0.0))[:1]})
        while not info["crash"]:
            *_, info = env.step(env.action_space.high)
        stood = info["progress"]
        contacts = []
        for _ in range(12):
            seen, *_, info = env.step([0.0, -1.0 if normalized else speed])
            contacts.append(info["crash"])
        assert seen[5] == env.elements[5].low == speed  # the target speed
        moved.append(stood - info["progress"])
    assert moved[0] == pytest.approx(0.0, abs=0.05)
    assert moved[1] > 1.0
    assert Crash.NONE in contacts


SLOW = {agent: np.array([0.0, -0.6], np.float32) for agent in AGENTS}
OPPOSITE = (3.0, 28.0)  # arc lengths in the middle of the two straights of the oval


def make(track, **options):
    return DriveHeadToHeadEnv(track=track, **{"time_step": 0.1, **options})


def both(*actions):
    """Actions of the two agents."""
    return dict(zip(AGENTS, (np.array(action, np.float32) for action in actions), strict=True))


def test_swapping_the_cars_swaps_all_that_the_agents_get(coarse_oval):
    """Bit for bit, until one of them drives into the other."""
    quiet = load_rules("contest", steering_noise=0.0)
    options = {"beams": 31, "see_opponent": "in sight", "win_reward": 3.0, "rules": quiet}
    envs = [make(coarse_oval, **options) for _ in range(2)]
    places = poses(coarse_oval, (2.0, 0.1, 3.0), (5.0, -0.1, 1.0))
    starts = zip(envs, (places, places[::-1]), strict=True)
    first, second = (env.reset(seed=4, options={"poses": these})[0] for env, these in starts)
    for step in range(40):
        for agent, other in (AGENTS, AGENTS[::-1]):
            np.testing.assert_array_equal(first[agent], second[other])
        if not envs[0].agents:
            break
        commands = (0.02 * np.cos(step), 0.4), (0.02 * np.sin(step), -0.6)
        answers = envs[0].step(both(*commands)), envs[1].step(both(*commands[::-1]))
        for one, two in zip(*map(flat, answers), strict=True):
            assert one == {agent: two[other] for agent, other in (AGENTS, AGENTS[::-1])}
        first, second = answers[0][0], answers[1][0]
    infos = answers[0][4]
    assert infos["car_0"]["crash"] == infos["car_1"]["crash"] == Crash.CAR
    assert (infos["car_0"]["fault"], infos["car_1"]["fault"]) == (1, 0)
    assert answers[0][1]["car_0"] < -10.0


def test_the_noise_of_the_two_lidars_differs(coarse_oval):
    noises = []
    for noise in (0.0, 0.2):
        env = make(coarse_oval, beams=60, vehicle={"lidar_noise": noise})
        observations, _ = env.reset(
            seed=1, options={"poses": poses(coarse_oval, (3.0, 0.0, 0.0), (8.0, 0.0, 0.0))}
        )
        noises.append(np.array([observations[agent][-60:] for agent in AGENTS]))
    added = noises[1] - noises[0]
    assert added.std(axis=1) == pytest.approx([0.2, 0.2], rel=0.3)
    assert abs(np.corrcoef(added)[0, 1]) < 0.4


@pytest.mark.parametrize(
    ("places", "reach", "visible"),
    [
        ((3.0, 7.0), 30.0, True),
        ((3.0, 7.0), 3.0, False),
        (OPPOSITE, 30.0, False),
        ((3.0, 7.0), 4.2, True),
    ],
)
def test_the_opponent_is_hidden_by_walls_and_distance(coarse_oval, places, reach, visible):
    env = make(coarse_oval, see_opponent="in sight", max_range=reach)
    always = make(coarse_oval)
    options = {"poses": poses(coarse_oval, *((s, 0.0, 1.0) for s in places))}
    observations, everything = (each.reset(options=options)[0] for each in (env, always))
    for agent in AGENTS:
        np.testing.assert_array_equal(observations[agent][:32], everything[agent][:32])
        if visible:
            np.testing.assert_array_equal(observations[agent], everything[agent])
        else:
            assert (observations[agent][32:] == 0.0).all()
        assert everything[agent][32] == 1.0


def test_each_part_of_the_observation_can_be_left_out(coarse_oval):
    """The rest is unchanged."""
    parts = {
        "own_state": (False, range(8)),
        "look_ahead": ((), range(8, 32)),
        "see_opponent": ("never", range(32, 41)),
        "time_left": (False, range(41, 42)),
        "beams": (0, range(42, 48)),
    }
    options = {"time_left": True, "beams": 6, "duration": 2.0}
    start = {"poses": poses(coarse_oval, (3.0, 0.2, 2.0), (6.0, -0.3, 1.0))}
    whole = begun(make(coarse_oval, **options), options=start)
    expected, *_ = whole.step(SLOW)
    assert expected["car_0"][41] == pytest.approx(0.95)
    for name, (off, indices) in parts.items():
        env = begun(make(coarse_oval, **{**options, name: off}), options=start)
        found, *_ = env.step(SLOW)
        for agent in AGENTS:
            np.testing.assert_array_equal(
                found[agent], np.delete(expected[agent], list(indices)), err_msg=name
            )
        kept = [element.name for i, element in enumerate(whole.elements) if i not in indices]
        assert [element.name for element in env.elements] == kept


@pytest.mark.parametrize(
    ("race", "penalties", "results"),
    [
        ("paper", (-7.0, 0.0), (Result.CRASH, Result.CRASH)),
        ("contest", (-12.0, 5.0), (Result.LOSS, Result.WIN)),
    ],
)
def test_a_crash_costs_the_car_to_blame_and_decides_as_the_rules_say(
    coarse_oval, race, penalties, results
):
    race = load_rules(race, steering_noise=0.0)
    env = make(coarse_oval, rules=race, progress_reward=0.0, crash_penalty=7.0, win_reward=5.0)
    for car in range(2):
        env.reset(options={"poses": poses(coarse_oval, (3.0, 0.0, 4.0), (28.0, 0.0, 4.0))})
        turn, go = (1.0, 0.0), (0.0, -1.0)
        while env.agents:
            _, rewards, terminated, truncated, infos = env.step(
                both(*((turn, go) if car == 0 else (go, turn)))
            )
        guilty, other = AGENTS[car], AGENTS[1 - car]
        assert (rewards[guilty], rewards[other]) == penalties
        assert (infos[guilty]["result"], infos[other]["result"]) == results
        assert (infos[guilty]["crash"], infos[other]["crash"]) == (Crash.WALL, Crash.NONE)
        assert infos[other]["opponent_crash"] == Crash.WALL
        assert (infos[guilty]["fault"], infos[other]["fault"]) == (1, 0)
        assert (infos[guilty]["cost"], infos[other]["cost"]) == (1.0, 0.0)
        assert terminated == dict.fromkeys(AGENTS, True)
        assert truncated == dict.fromkeys(AGENTS, False)


# Where the cars stand after a reset


def test_cars_start_where_the_options_say(coarse_oval):
    env = DriveEnv(track=coarse_oval, opponent="lattice")
    env.reset(seed=0, options={"start": (5.0, 1)})
    races = env.batch.state
    assert (races.frenet[0, 0, 0] - races.progress[0, 0]) % env.track.length == pytest.approx(
        5.0, abs=0.05
    )
    poses = np.array([[*env.track.to_cartesian([[s, 0.0]])[0]] for s in (10.0, 6.0)])
    env.reset(seed=0, options={"poses": np.column_stack([poses, [3.0, 2.0]])})
    np.testing.assert_allclose(env.batch.state.cars[0][:, [0, 1]], poses[:, :2])
    np.testing.assert_allclose(env.batch.state.cars[0][:, 3], [3.0, 2.0])
    assert env.batch.info(0)["lead"] == pytest.approx(4.0, abs=0.1)
    assert env.step([0.0, -1.0])[1] > 0.0
    for place in ([6.1, 0.0], [3.0, 1.1]):  # in the other car, in a wall
        wrong = env.track.to_cartesian([[6.0, 0.0], place])
        refused("episode 0: .* a car overlaps a wall or", env.reset, options={"poses": wrong})
    env = DriveEnv(track=coarse_oval, opponent=None)
    env.reset(options={"poses": wrong[:1]})
    assert not env.batch.state.crashed.any()
    refused("episode 0", env.reset, options={"poses": wrong[1:]})
