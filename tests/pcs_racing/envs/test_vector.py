"""Resets of vector environments, and Gymnasium's own wrappers around them."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import wrappers
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers import vector as vector_wrappers
from refusal import refused

import pcs_racing  # noqa: F401
from pcs_racing import InputError
from pcs_racing.envs.drive import DriveEnv, DriveVectorEnv

DUEL = {"steps": (0.2,) * 3}
DRIVE = {"opponent": None, "duration": 0.3}
IDS = {"pcs_racing/Duel-v1": DUEL, "pcs_racing/Drive-v1": DRIVE}


def action(envs):
    return np.zeros(envs.action_space.shape, envs.action_space.dtype)


@pytest.mark.parametrize("name", IDS)
@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_a_vector_environment_begins_anew_as_gymnasiums_own_does(name, mode):
    """The same observations, rewards and ends as SyncVectorEnv around the environment for one
    agent.
    """
    ours = gym.make_vec(name, num_envs=3, autoreset_mode=mode, **IDS[name])
    theirs = gym.make_vec(
        name, 3, vectorization_mode="sync", vector_kwargs={"autoreset_mode": mode}, **IDS[name]
    )
    assert ours.metadata["autoreset_mode"] is mode
    assert ours.unwrapped.autoreset_mode is mode
    np.testing.assert_array_equal(ours.reset(seed=4)[0], theirs.reset(seed=4)[0])
    ends = 0
    for _ in range(8):
        seen, expected = ours.step(action(ours)), theirs.step(action(theirs))
        for mine, own in zip(seen[:4], expected[:4], strict=True):
            np.testing.assert_array_equal(mine, own)
        over = seen[2] | seen[3]
        ends += int(over.sum())
        assert ("final_obs" in seen[4]) == (mode is AutoresetMode.SAME_STEP and bool(over.any()))
        if mode is AutoresetMode.SAME_STEP and over.any():
            np.testing.assert_array_equal(seen[4]["_final_obs"], expected[4]["_final_obs"])
            for i in np.flatnonzero(over):
                np.testing.assert_array_equal(seen[4]["final_obs"][i], expected[4]["final_obs"][i])
                assert seen[4]["final_info"]["lead"][i] == expected[4]["final_info"]["lead"][i]
        if mode is AutoresetMode.DISABLED and over.any():
            with pytest.raises(
                InputError, match=f"environment {np.flatnonzero(over)[0]} has ended"
            ):
                ours.step(action(ours))
            options = {"reset_mask": over}
            mine, own = ours.reset(options=dict(options))[0], theirs.reset(options=dict(options))[0]
            np.testing.assert_array_equal(mine, own)
    assert ends >= 3


@pytest.mark.parametrize("mode", ["NEXT_STEP", "SAME_STEP", "DISABLED"])
def test_a_reset_in_mid_episode_restarts_the_count_of_steps_there_and_nowhere_else(mode):
    envs = DriveVectorEnv(3, opponent=None, max_episode_steps=3, autoreset_mode=mode)
    envs.reset(seed=0)
    for _ in range(2):
        envs.step(action(envs))
    state = envs.get_state()
    begun = envs.reset(options={"reset_mask": np.array([False, True, False])})[1]
    np.testing.assert_allclose(begun["time"], [0.2, 0.0, 0.2])
    late = [True, False, True]
    assert envs.step(action(envs))[3].tolist() == late
    if mode == "DISABLED":
        envs.reset(options={"reset_mask": np.array(late)})
    late = [envs.step(action(envs))[3].tolist() for _ in range(2)]
    assert late == [[False] * 3, [False, True, False]]
    envs.set_state(state)
    assert envs.step(action(envs))[3].all()
    envs.reset(seed=1)
    assert envs.get_state().steps.tolist() == [0, 0, 0]


def test_each_episode_may_have_options_of_its_own():
    """As the environments for one agent, with the same seeds; the same dict for several begins them
    in one call.
    """
    envs, single = DriveVectorEnv(3, opponent=None), DriveEnv(opponent=None)
    here, there = {"start": (20.0, 0)}, {"obstacles": []}
    for options in ([here, there, here], [{}, here, {}]):
        seen, _ = envs.reset(seed=[4, 5, 6], options=options)
        for i, own in enumerate(options):
            np.testing.assert_array_equal(seen[i], single.reset(seed=4 + i, options=own)[0])
    for wrong, message in (
        ([here], "options list 1 dicts; give one for each of 3 episodes"),
        ([{"track": "Pipkin"}, {}, {}], "'track' is unknown"),
        ([here, {"reset_mask": np.ones(3, bool)}, here], "'reset_mask' is unknown"),
    ):
        refused(message, envs.reset, options=wrong)


def test_the_generators_of_a_batch_are_those_of_the_environments_for_one_agent():
    envs, single = DriveVectorEnv(2, opponent=None), DriveEnv(opponent=None)
    envs.reset(seed=6)
    for seed, own in zip((6, 7), envs.np_random, strict=True):
        single.reset(seed=seed)
        assert single.np_random_seed == seed
        assert own.bit_generator.state == single.np_random.bit_generator.state


WRAPPERS = {
    "DictInfoToList": {},
    "NormalizeObservation": {},
    "RecordEpisodeStatistics": {},
    "TransformReward": {"func": lambda rewards: 2.0 * rewards},
}


@pytest.mark.parametrize("name", IDS)
@pytest.mark.parametrize("wrapper", WRAPPERS)
def test_wrappers_of_gymnasium_run(name, wrapper):
    """One of each kind: infos, observations, counts of episodes, rewards."""
    envs = getattr(vector_wrappers, wrapper)(
        gym.make_vec(name, num_envs=2, **IDS[name]), **WRAPPERS[wrapper]
    )
    envs.reset(seed=1)
    for _ in range(6):
        seen, rewards, terminated, truncated, _ = envs.step(action(envs))
        assert len(seen) == len(rewards) == len(terminated) == len(truncated) == 2
    envs.close()


@pytest.mark.parametrize(
    ("name", "steps", "changes"),
    [
        ("pcs_racing/Drive-v1", 400, {}),
        ("pcs_racing/Drive-v1", 600, {"duration": 60.0}),
        ("pcs_racing/Drive-v1", 2000, {"time_step": 0.02}),
        ("pcs_racing/Duel-v1", 4, {}),
        ("pcs_racing/Duel-v1", 6, {"steps": (8.0,) * 7}),
    ],
)
def test_the_specification_says_how_long_an_episode_is(name, steps, changes):
    env = wrappers.TimeAwareObservation(gym.make(name, **changes), normalize_time=True)
    assert env.spec.max_episode_steps == steps
    assert gym.make_vec(name, num_envs=2, **changes).spec.max_episode_steps == steps
    env.reset(seed=0)
    seen, *_ = env.step(env.action_space.sample())
    assert seen[-1] == pytest.approx(1.0 / steps)
