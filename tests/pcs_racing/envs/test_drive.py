"""One agent steers: what it is paid, and against whom it may race."""

import numpy as np
import pytest
from faces import follow_the_line

from pcs_racing import Planner, get_planner
from pcs_racing.envs.drive import DriveEnv, DriveVectorEnv


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


def test_python_drivers_and_policy_objects_may_be_the_opponent(oval):
    planner = Planner("crawler", (), drive=lambda track, theta, view, memory: (0.0, 0.5))
    env = DriveEnv(oval, planner.policy(), duration=1.0)
    _, rewards, _, _, info = episode(env, 1)
    assert env.outcome()["opponent"] == "crawler"
    assert info["lead"] > 1.0
    assert rewards.sum() > 1.0
    policy = get_planner("lattice").policy({"pace": 0.2})
    by_text = episode(DriveEnv(opponent="lattice:pace=0.2"), 6)[0]
    np.testing.assert_array_equal(episode(DriveEnv(opponent=policy), 6)[0], by_text)
