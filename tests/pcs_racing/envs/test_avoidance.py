"""RoboRacer's test of obstacle avoidance: laps of one car between boxes that stand and move."""

import gymnasium as gym
import numpy as np
from gymnasium.utils.env_checker import check_env

import pcs_racing
from pcs_racing import game
from pcs_racing.envs.infos import Result

NAME = "pcs_racing/Avoidance-v0"


def drive(env, text, seed):
    """Drive an episode with a policy in the car; return the last info."""
    policy = pcs_racing.racer(text)
    env.reset(seed=seed)
    batch = env.unwrapped.batch
    setup = game.RaceSetup(batch.track, batch.setup.rules, (policy.planner,))
    theta = game.pad_parameters([policy], setup.theta_size)[None]
    kept, over = (np.zeros((1, 1, setup.memory_size)), batch.state.path.copy()), False
    while not over:
        copy = batch.state.copy()._replace(memory=kept[0], path=kept[1])
        game.advance(setup, copy, theta, game.CONTROL_EVERY, threads=1, ittc=False)
        kept = copy.memory, copy.path
        action = np.clip(copy.command[0, 0], env.action_space.low, env.action_space.high)
        *_, terminated, truncated, info = env.step(action.astype(np.float32))
        over = terminated or truncated
    return info


def test_the_task_is_an_environment_of_its_own():
    env = gym.make(NAME, duration=0.5)
    check_env(env.unwrapped, skip_render_check=True)
    _, info = env.reset(seed=1)
    assert info["obstacles"] == 6
    boxes = env.unwrapped.batch.randomization.boxes[0]
    assert (boxes[:, 3:5] == [0.35, 0.32]).all()
    assert np.count_nonzero(boxes[:, 5]) == 2
    many = gym.make_vec(NAME, num_envs=2, duration=0.5, laps=5)
    observations, infos = many.reset(seed=1)
    np.testing.assert_array_equal(observations[0], env.reset(seed=1)[0])
    assert infos["lap_times"].shape == (2, 5)


def test_an_episode_ends_with_all_laps_or_with_the_first_contact():
    env = gym.make(
        NAME,
        track="Pipkin",
        laps=2,
        time_step=game.CONTROL_EVERY * game.DT,
        normalized=False,
        top_speed=12.0,
    )
    info = drive(env, "gap-follower", seed=4)
    assert (info["result"], info["crash"], info["cost"]) == (Result.WIN, 0, 0.0)
    assert np.isfinite(info["lap_times"]).all()
    info = drive(env, "pure-pursuit", seed=4)
    assert (info["result"], info["crash"], info["cost"]) == (Result.CRASH, 1, 1.0)


def test_a_car_without_all_laps_loses_at_the_end_of_the_time():
    env = gym.make(NAME, track="Pipkin", duration=0.2)
    env.reset(seed=1)
    late = False
    while not late:
        *_, late, info = env.step(np.array([0.0, -1.0], np.float32))
    assert (info["laps"], info["result"]) == (0, Result.LOSS)
    assert env.unwrapped.outcome()["result"] == "loss"
