import gc
import inspect
import re
import tracemalloc

import numpy as np
import pytest

from pcs_racing import InputError, Lidar, Planner, UnknownNameError, get_planner, load_race_config
from pcs_racing.envs.drive import DriveEnv, DriveVectorEnv
from pcs_racing.envs.infos import Crash

SHORT = load_race_config("contest", duration=3.0)


def follow_the_line(observation):
    """A driver that reads the observation by its documented order: back to the race line, a bit slower than it."""
    steer = 0.6 * -observation[7] - 0.35 * observation[6] + 0.33 * observation[12]
    return np.array([steer / 0.4189, 2.0 * 0.7 * observation[13] / 8.0 - 1.0], np.float32)


def episode(env, seed, steps=400, policy=follow_the_line):
    """Observations, rewards and the last info of an episode."""
    observation, info = env.reset(seed=seed)
    observations, rewards = [observation], []
    for _ in range(steps):
        observation, reward, terminated, truncated, info = env.step(policy(observation))
        observations.append(observation)
        rewards.append(reward)
        if terminated or truncated:
            break
    return np.array(observations), np.array(rewards), terminated, truncated, info


def test_a_driver_that_reads_the_observation_gets_around(oval):
    _, rewards, terminated, truncated, info = episode(DriveEnv(oval, opponent=None, duration=20.0), seed=2)
    assert truncated
    assert not terminated
    assert info["time"] == pytest.approx(20.0)
    assert info["progress"] > 50.0
    assert rewards.sum() == pytest.approx(info["progress"])


def test_the_end_in_a_wall_is_the_agents_fault_and_costs(oval):
    env = DriveEnv(oval, opponent=None, crash_penalty=25.0)
    _, rewards, terminated, truncated, info = episode(env, 0, policy=lambda seen: np.array([1.0, 0.5]))
    assert terminated
    assert not truncated
    assert (info["crash"], info["fault"], info["opponent_crash"]) == (Crash.WALL, 1, Crash.NONE)
    assert rewards[-1] < -20.0
    with pytest.raises(InputError, match="has ended"):
        env.step([0.0, 0.0])


def test_rivalry_makes_the_return_the_lead():
    env = DriveEnv(rivalry=1.0, crash_penalty=0.0, duration=4.0)
    _, rewards, _, _, info = episode(env, seed=5)
    start = env.reset(seed=5)[1]["lead"]
    assert rewards.sum() == pytest.approx(info["lead"] - start)


def test_every_element_keeps_to_its_bounds_and_says_what_it_is():
    env = DriveEnv(beams=4)
    names = [element.name for element in env.elements]
    assert len(set(names)) == len(names) == env.observation_space.shape[0]
    seen, *_ = episode(env, 1)
    assert all(env.observation_space.contains(one) for one in seen)
    # The table of the class's page is the space.
    rows = re.findall(
        r"^\| (\d+) \| ([\w ]+?)(?: \(\w+\))? \| (\S+) \| (\S+) \| (\S+) \|$", inspect.getdoc(DriveEnv), re.M
    )
    assert len(rows) >= 17
    for index, name, unit, low, high in rows:
        element = env.elements[int(index)]
        assert (element.name, element.unit) == (name, unit)
        assert (element.low, element.high) == pytest.approx((float(low), float(high)), abs=1e-3)


def test_the_observation_says_where_the_cars_are():
    env = DriveEnv(beams=9)
    env.reset(seed=4)
    for _ in range(8):
        seen, _, _, _, info = env.step([0.0, 0.2])
    at = {element.name: value for element, value in zip(env.elements, seen, strict=True)}
    own, other = env.batch.state.cars[0]
    d = env.track.to_frenet(own[:2])[1]
    turned = (other[:2] - own[:2]) @ np.array([[np.cos(own[4]), -np.sin(own[4])], [np.sin(own[4]), np.cos(own[4])]])
    assert at["speed"] == pytest.approx(own[3], rel=1e-6)
    assert at["offset"] == pytest.approx(d, abs=1e-5)
    assert [at["opponent x"], at["opponent y"]] == pytest.approx(list(turned), abs=1e-5)
    assert at["lead"] == pytest.approx(info["lead"], rel=1e-5)
    assert at["target speed"] == pytest.approx(0.6 * 8.0)
    scan = Lidar(env.track, 9).scan(own[[0, 1, 4]], other[[0, 1, 4]])
    np.testing.assert_allclose(seen[-9:], scan, rtol=1e-5)


def test_alone_means_alone():
    seen, *_ = episode(DriveEnv(opponent=None), 3, steps=30)
    assert (seen[:, 32:41] == 0.0).all()


def test_threads_share_a_step_that_is_long_enough():
    for count, threads, arguments, expected in [
        (64, 4, {}, 1),
        (1024, 4, {}, 4),
        (1024, 2, {}, 2),
        (128, 4, {"beams": 1080}, 4),
        (64, 4, {"time_step": 0.2}, 2),
    ]:
        envs = DriveVectorEnv(count, threads=threads, opponent=None, **{"time_step": 0.02, **arguments})
        assert envs.batch.threads == expected
        envs.close()
        assert envs.batch.threads == 1


def test_a_python_driver_may_be_the_opponent(oval):
    planner = Planner("crawler", (), drive=lambda track, theta, view, memory: (0.0, 0.5))
    env = DriveEnv(oval, planner.policy(), duration=1.0)
    _, rewards, _, _, info = episode(env, 1)
    assert env.outcome()["opponent"] == "crawler"
    assert info["lead"] > 1.0
    assert rewards.sum() > 1.0


def test_two_tracks_in_one_process_do_not_disturb_each_other(oval):
    alone = episode(DriveEnv(oval, opponent=None), 1, steps=20)[0]
    one, two = DriveEnv(oval, opponent=None), DriveEnv("Pipkin", opponent=None)
    seen, _ = one.reset(seed=1)
    two.reset(seed=2)
    for expected in alone:
        np.testing.assert_array_equal(seen, expected)
        seen, *_ = one.step(follow_the_line(seen))
        two.step([0.0, -0.5])


def test_resets_leak_nothing():
    envs = DriveVectorEnv(4, beams=8, threads=1)
    env = DriveEnv()

    def turn():
        env.reset()
        env.step([0.0, 0.0])
        envs.reset()
        envs.step(np.zeros((4, 2)))

    for _ in range(50):
        turn()
    gc.collect()
    tracemalloc.start()
    before = tracemalloc.get_traced_memory()[0]
    for _ in range(200):
        turn()
    gc.collect()
    grown = tracemalloc.get_traced_memory()[0] - before
    tracemalloc.stop()
    assert grown < 300_000  # 1,000 resets: less than a single observation each; free lists fill up at first


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"time_step": 0.03}, "time_step is 0.03"),
        ({"time_step": float("nan")}, "time_step is nan"),
        ({"beams": -1}, "beams is -1"),
        ({"beams": 2.5}, "beams is 2.5"),
        ({"top_speed": 0.0}, "top_speed is 0.0"),
        ({"look_ahead": (0.0,) * 101}, "look_ahead"),
        ({"look_ahead": (), "own_state": False, "see_opponent": "never"}, "nothing is observed"),
        ({"see_opponent": "sometimes"}, "see_opponent is .sometimes."),
        ({"crash_penalty": -1.0}, "crash_penalty is -1.0"),
        ({"opponent": 3}, "3 is not a competitor"),
        ({"opponent": []}, "opponent is an empty list"),
        ({"opponent": ["lattice", "pure-pursuit"]}, "drive with planners"),
        ({"duration": 0.05}, "duration"),
        ({"race": 5}, "race"),
        ({"render_mode": "ansi"}, "render_mode is 'ansi'"),
        ({"view": "top"}, "view is 'top'"),
    ],
)
def test_impossible_arguments_are_named(arguments, message):
    for kind in (DriveEnv, DriveVectorEnv):
        with pytest.raises(InputError, match=message):
            kind(**arguments)


def test_unknown_names_are_named():
    with pytest.raises(UnknownNameError, match="nowhere"):
        DriveEnv("nowhere")
    with pytest.raises(UnknownNameError, match="nobody"):
        DriveEnv(opponent="nobody")
    with pytest.raises(InputError, match="num_envs is 0"):
        DriveVectorEnv(0)


def test_impossible_actions_are_refused_and_change_nothing():
    env = DriveEnv(opponent=None)
    with pytest.raises(InputError, match="not begun"):
        env.step([0.0, 0.0])
    env.reset(seed=0)
    before = env.batch.state.copy()
    for action, message in (
        ([np.nan, 0.0], "nan"),
        ([0.0, np.inf], "inf"),
        ([0.0], "shape"),
        ("left", "numbers"),
        (None, "shape|finite"),
    ):
        with pytest.raises(InputError, match=message):
            env.step(action)
    np.testing.assert_array_equal(env.batch.state.cars, before.cars)
    envs = DriveVectorEnv(3, opponent=None)
    with pytest.raises(InputError, match="not begun"):
        envs.step(np.zeros((3, 2)))
    envs.reset(seed=0)
    actions = np.zeros((3, 2))
    actions[2, 1] = np.nan
    with pytest.raises(InputError, match="environment 2"):
        envs.step(actions)
    with pytest.raises(InputError, match=re.escape("(3, 2)")):
        envs.step(np.zeros((2, 2)))
    with pytest.raises(InputError, match="seed of environment 1"):
        envs.reset(seed=[0, -1, 2])
    with pytest.raises(InputError, match="2 seeds for 3"):
        envs.reset(seed=[0, 1])


def test_a_frame_shows_the_race():
    env = DriveEnv(render_mode="rgb_array")
    with pytest.raises(InputError, match="call reset"):
        env.render()
    env.reset(seed=0)
    first = env.render()
    assert first.dtype == np.uint8
    assert first.shape == (640, 960, 3)
    for colour in [(21, 89, 176), (148, 89, 0)]:  # of the names of both cars
        assert (np.abs(first.astype(int) - colour).sum(axis=-1) < 9).sum() > 20
    for _ in range(5):
        env.step([0.0, 0.5])
    assert (env.render() != first).any()
    env.close()
    with pytest.raises(InputError, match="render_mode is None"):
        DriveEnv(opponent=None).render()


def test_a_policy_object_drives_as_its_text_does():
    policy = get_planner("lattice").policy({"pace": 0.2})
    by_text = episode(DriveEnv(opponent="lattice:pace=0.2"), 6)[0]
    np.testing.assert_array_equal(episode(DriveEnv(opponent=policy), 6)[0], by_text)


def test_a_frame_of_each_of_many_races():
    envs = DriveVectorEnv(2, opponent=None, render_mode="rgb_array")
    with pytest.raises(InputError, match="call reset"):
        envs.render()
    envs.reset(seed=0)
    alone = DriveEnv(opponent=None, render_mode="rgb_array")
    frames = envs.render()
    assert len(frames) == 2
    for seed, frame in enumerate(frames):
        alone.reset(seed=seed)
        np.testing.assert_array_equal(frame, alone.render())
    envs.close()
    with pytest.raises(InputError, match="render_mode is None"):
        DriveVectorEnv(2, opponent=None).render()


def test_a_window_follows_the_race(monkeypatch):
    pytest.importorskip("pygame")
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    shown = []
    monkeypatch.setattr("pcs_racing.race.rendering.Renderer._show", lambda self, frame: shown.append(frame))
    for env in (DriveEnv(opponent=None, render_mode="human"), DriveVectorEnv(2, opponent=None, render_mode="human")):
        shown.clear()
        env.reset(seed=0)
        env.step(np.full(env.action_space.shape, 0.3))
        assert len(shown) == 2
        assert (shown[0] != shown[1]).any()
        env.close()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"threads": 0}, "threads is 0"),
        ({"threads": True}, "threads is True"),
        ({"normalize": "yes"}, "normalize is 'yes'"),
        ({"opponent": ["lattice", 7]}, "7 is not a competitor"),
        ({"num_envs": 100_000, "beams": 10_000}, "100000 environments"),
    ],
)
def test_impossible_batches_are_refused(arguments, message):
    with pytest.raises(InputError, match=message):
        DriveVectorEnv(**arguments)


def test_states_of_something_else_are_refused():
    envs = DriveVectorEnv(2, opponent=["lattice", "lattice:pace=0"])
    envs.reset(seed=0)
    state = envs.get_state()
    for wrong, message in (
        ("yesterday", "state is a str; it must be what get_state returned"),
        (
            state._replace(batch=(state.batch[0], np.array([0, 2]), *state.batch[2:])),
            r"opponents array\(\[0, 2\]\) are not among the 2",
        ),
        (DriveVectorEnv(3, opponent=None).get_state(), "not one of 2 races with these planners"),
    ):
        with pytest.raises(InputError, match=message):
            envs.set_state(wrong)
    np.testing.assert_array_equal(envs.batch.state.cars, state.batch[0].cars)  # nothing was changed
    with pytest.raises(InputError, match="state is a NoneType"):
        DriveEnv(opponent=None).set_state(None)
    with pytest.raises(InputError, match=r"seed is 1\.5"):
        envs.reset(seed=1.5)
