"""An own reward: the same function, or subclass, gives the same bits in every environment."""

import copy
import pickle

import numpy as np
import pytest
from faces import MANY, USUAL, act, begun, make, make_many
from refusal import refused

from pcs_racing.base.errors import ConfigError
from pcs_racing.envs.drive import DriveEnv, DriveHeadToHeadEnv
from pcs_racing.envs.duel import DuelEnv, HeadToHeadEnv

PAIRED = {DriveEnv: DriveHeadToHeadEnv, DuelEnv: HeadToHeadEnv}
KINDS = {DriveEnv: "drive", DuelEnv: "duel"}


def race_of(state):
    """Races in a state of any level."""
    return getattr(state, "race", state)


def own_reward(step):
    """Progress, less a share of the actions, besides the usual reward."""
    players = step.reward.shape[1]
    before, after = (race_of(state).progress[:, :players] for state in (step.before, step.after))
    actions = step.actions.reshape(*step.reward.shape, -1)[..., 0]
    return (after - before) / 3.0 - 0.1 * np.abs(actions) + step.reward


class Own:
    def reward(self, step):
        return own_reward(step)


class OwnDrive(Own, DriveEnv):
    pass


class OwnDrives(Own, MANY[DriveEnv]):
    pass


@pytest.mark.parametrize("kind", KINDS)
def test_an_own_reward_has_the_same_bits_everywhere(kind):
    pytest.importorskip("stable_baselines3")
    from pcs_racing.envs.sb3 import SB3VecEnv, make_sb3_vec_env

    rival = {} if kind is DriveEnv else {"opponent": "lattice:pace=0.5"}
    given = {**rival, "reward": own_reward}
    one, many = make(kind, **given), make_many(kind, 2, **given)
    two = make(
        PAIRED[kind], **{"opponent": "lattice", **given}, **({"rivalry": 0.0} if not rival else {})
    )
    sb3 = [make_sb3_vec_env(KINDS[kind], 2, **{**USUAL[kind], **given})]
    others = [one]
    if kind is DriveEnv:
        others.append(OwnDrive(**USUAL[kind]))
        sb3.append(SB3VecEnv(OwnDrives(2, autoreset_mode="SAME_STEP", **USUAL[kind])))
    usual = make(kind, **rival)
    for env in (*others, many, two):
        env.reset(seed=3)
    _, before = usual.reset(seed=3)
    for env in sb3:
        env.seed(3)
        env.reset()
    for k in range(2):
        state = one.get_state()
        paid = one.step(act(one, k))[1]
        _, reward, _, _, after = usual.step(act(usual, k))
        gained = (after["progress"] - before["progress"]) / 3.0
        before = after
        assert paid == pytest.approx(gained - 0.1 * abs(np.ravel(act(usual, k))[0]) + reward)
        assert [env.step(act(env, k))[1] for env in others[1:]] == [paid] * (len(others) - 1)
        assert two.step(act(two, k))[1] == {"car_0": paid}
        expected = many.step(act(many, k))[1]
        assert expected[0] == paid
        for env in sb3:
            np.testing.assert_array_equal(env.step(act(many, k))[1], np.float32(expected))
        copied, pickled = copy.deepcopy(one), pickle.loads(pickle.dumps(one))
        for env in (one, copied, pickled):
            env.set_state(state)
            assert env.step(act(env, k))[1] == paid


@pytest.mark.parametrize("kind", PAIRED.values())
def test_an_own_reward_pays_both_agents(kind):
    two, many = make(kind, reward=own_reward), make_many(kind, 1, reward=own_reward)
    two.reset(seed=5)
    many.reset(seed=5)
    actions = act(two)
    paid = many.step(np.stack(list(actions.values())))[1]
    assert list(two.step(actions)[1].values()) == paid.tolist()


@pytest.mark.parametrize(
    ("own", "message"),
    [
        (
            lambda step: step.reward[:, 0],
            r"the reward has shape \(1,\) and type float64; .*\(1, 1\)",
        ),
        (lambda step: "much", "the reward has shape"),
        (
            lambda step: np.nan * step.reward,
            r"the reward of episode 0 is \[nan\]; it must be finite",
        ),
    ],
)
def test_an_impossible_reward_is_one_line(own, message):
    env = begun(make(DriveEnv, reward=own), seed=0)
    refused(message, env.step, act(env))
    refused("reward is 3; it must be a function", make, DriveEnv, reward=3, error=ConfigError)
    refused("OwnDrive has a method reward and the argument", OwnDrive, reward=own_reward)
    refused("reward is 5; it must be a method", type("Fixed", (DriveEnv,), {"reward": 5}))


def test_an_own_reward_gets_the_actions_that_the_race_clips():
    env = begun(make(DriveEnv, reward=lambda step: step.actions[..., 0]), seed=0)
    assert env.step(np.array([3.0, 0.0], np.float32))[1] == 1.0


def test_the_reward_of_a_finished_episode_does_not_count():
    def speed(step):
        time = (step.after.tick - step.before.tick)[:, None]
        with np.errstate(invalid="ignore"):
            return (step.after.progress - step.before.progress)[:, :1] / time

    envs = begun(make_many(DriveEnv, 2, reward=speed, duration=0.2, opponent=None), seed=0)
    rewards = [envs.step(act(envs))[1].tolist() for _ in range(4)]
    assert rewards[2] == [0.0, 0.0]
    assert all(np.isfinite(rewards).ravel())
