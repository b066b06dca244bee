"""What all environments promise, whatever is raced in them: checkers, names, batches, repetition, copies."""

import copy
import pickle
import warnings

import gymnasium as gym
import numpy as np
import pettingzoo
import pytest
from gymnasium.utils.env_checker import check_env

import pcs_racing
from pcs_racing import load_race_config
from pcs_racing.envs import drive, drive_batch, duel, match
from pcs_racing.envs.drive import DriveEnv, DriveVectorEnv
from pcs_racing.envs.duel import DuelEnv, DuelVectorEnv, SelfPlayVectorEnv
from pcs_racing.envs.match import MatchEnv, MatchVectorEnv
from pcs_racing.envs.registration import register_environments
from pcs_racing.game.match_observation import decode_match

with warnings.catch_warnings():  # PettingZoo's own tests import its old classic environments, which warn
    warnings.simplefilter("ignore")
    from pettingzoo.test import api_test, parallel_api_test, parallel_seed_test, render_test, seed_test

RACE = load_race_config("contest", duration=3.0)
GAME = {"step_seconds": 1.0, "moves": 3}
MIXTURE = [(1, "random-moves"), (2, "never-switch"), (1.0, "always-restraint+")]
VECTOR = {DriveEnv: DriveVectorEnv, DuelEnv: DuelVectorEnv, MatchEnv: MatchVectorEnv}


class Counting:
    """An opponent that remembers: its k-th move in a game is move k."""

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        assert (state is None) == bool(episode_start[0])
        count = 0 if state is None else state
        return np.full(len(observation), count % 4), count + 1


class Counts:
    """A chooser that takes policy 0 before the first race, 1 before the second, and so on."""

    def choose(self, observation):
        return (decode_match(observation, 3, 2).driven > 0.0).sum(axis=1)


def by_lead(observation, generator):
    return int(observation[4] < 0.0) + 2 * int(generator.integers(2))


def complete(kind, arguments, short):
    """Arguments of an environment, with short races of the test's own archive for matches."""
    return {**short, **arguments} if kind is MatchEnv else arguments


# Gymnasium


@pytest.mark.parametrize(
    ("kind", "arguments"),
    [
        (DriveEnv, {}),
        (DriveEnv, {"opponent": None, "beams": 20, "lidar_noise": 0.02}),
        (DriveEnv, {"normalize": True, "beams": 5, "race": "contest"}),
        (DuelEnv, {"opponent": "random-moves", **GAME}),
        (DuelEnv, {"opponent": "lane-switcher:3", **GAME}),
        (DuelEnv, {"opponent": MIXTURE, **GAME}),
        (MatchEnv, {"opponent": "random-moves"}),
        (MatchEnv, {"opponent": "random-moves", "race_moves": True}),
    ],
)
def test_the_checkers_of_gymnasium_and_sb3_are_content(kind, arguments, short):
    env = kind(render_mode="rgb_array", **complete(kind, arguments, short))
    check_env(env, skip_render_check=True)
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    checker.check_env(env)


@pytest.mark.parametrize(
    ("name", "kind", "arguments"),
    [
        ("pcs_racing/Drive-v1", DriveEnv, {"opponent": None}),
        ("pcs_racing/Duel-v1", DuelEnv, GAME),
        ("pcs_racing/Match-v0", MatchEnv, {}),
    ],
)
def test_it_is_made_by_name(name, kind, arguments, short):
    register_environments()
    arguments = complete(kind, arguments, short)
    assert isinstance(gym.make(name, **arguments).unwrapped, kind)
    envs = gym.make_vec(name, num_envs=3, **arguments)
    assert isinstance(envs, VECTOR[kind])
    assert envs.metadata["autoreset_mode"] is gym.vector.AutoresetMode.NEXT_STEP


DRIVES = [
    {"race": RACE, "beams": 12, "lidar_noise": 0.05},
    {"race": RACE, "opponent": ["lattice:pace=0.1", "lattice:pace=0.9"], "time_step": 0.06},
    {"race": RACE, "opponent": None, "normalize": True},
]
DUELS = [
    {"opponent": opponent, "race": "contest", **GAME}
    for opponent in ("random-moves", MIXTURE, by_lead, Counting(), "lane-switcher:3")
]
MATCHES = [
    {"opponent": opponent, "race_moves": race_moves}
    for opponent in ("random-moves", by_lead, Counts(), ["never-switch", "random-moves"])
    for race_moves in (False, True)
]


@pytest.mark.parametrize(
    ("kind", "arguments", "count", "steps", "least_ends"),
    [
        *((DriveEnv, arguments, 37, 60, 38) for arguments in DRIVES),
        *((DuelEnv, arguments, 6, 7, 6) for arguments in DUELS),
        *((MatchEnv, arguments, 4, 8, 4) for arguments in MATCHES),
    ],
)
def test_vector_and_scalar_environment_agree_to_the_last_bit(
    kind, arguments, count, steps, least_ends, short, monkeypatch
):
    monkeypatch.setattr(drive_batch, "WORTH_A_THREAD", 10.0)  # two threads for short steps, too
    arguments = complete(kind, arguments, short)
    envs = VECTOR[kind](count, threads=2, autoreset_mode="SAME_STEP", **arguments)
    assert kind is not DriveEnv or envs.batch.threads == 2
    single = [kind(**arguments) for _ in range(count)]
    batch, info = envs.reset(seed=11)
    alone = [env.reset(seed=11 + i) for i, env in enumerate(single)]
    np.testing.assert_array_equal(batch, [seen for seen, _ in alone])
    assert info["opponent"].tolist() == [facts["opponent"] for _, facts in alone]
    rng = np.random.default_rng(0)
    ends = 0
    for _ in range(steps):
        if kind is DriveEnv:
            actions = rng.uniform(-0.5, 1.0, (count, 2)).astype(np.float32)
        else:
            actions = rng.integers(0, envs.single_action_space.n, count)
        batch, rewards, terminated, truncated, info = envs.step(actions)
        for i, env in enumerate(single):
            seen, reward, end, late, facts = env.step(actions[i])
            assert (reward, end, late) == (rewards[i], terminated[i], truncated[i])
            if end or late:
                ends += 1
                np.testing.assert_array_equal(info["final_obs"][i], seen)
                for name, value in facts.items():
                    np.testing.assert_array_equal(info["final_info"][name][i], value)
                seen, facts = env.reset()
            np.testing.assert_array_equal(batch[i], seen)
            for name, value in facts.items():
                np.testing.assert_array_equal(info[name][i], value)
    assert ends >= least_ends


@pytest.mark.parametrize(
    ("kind", "arguments"),
    [
        (DriveEnv, {"race": "contest"}),
        (DriveEnv, {"opponent": None, "beams": 7, "lidar_noise": 0.1, "race": "contest"}),
        (DuelEnv, {"opponent": MIXTURE, "race": "contest", **GAME}),
        (MatchEnv, {"opponent": "random-moves", "race_moves": True}),
    ],
)
def test_whole_episodes_repeat(kind, arguments, short):
    def episode(seed):
        env = kind(**complete(kind, arguments, short))
        rng = np.random.default_rng(1)
        rows = [env.reset(seed=seed)[0]]
        while True:
            action = np.clip(rng.normal(0.0, 0.1, 2), -1, 1) if kind is DriveEnv else int(rng.integers(3))
            seen, reward, terminated, truncated, _ = env.step(action)
            rows += [seen, np.array([reward, terminated, truncated])]
            if terminated or truncated:
                return rows

    first, second, other = episode(9), episode(9), episode(10)
    for left, right in zip(first, second, strict=True):
        np.testing.assert_array_equal(left, right)
    assert len(first) != len(other) or any((a != b).any() for a, b in zip(first, other, strict=True))


@pytest.mark.parametrize(
    ("kind", "arguments"),
    [
        (DriveEnv, {"race": RACE, "beams": 3, "lidar_noise": 0.1}),
        (DriveVectorEnv, {"num_envs": 5, "race": RACE, "beams": 3, "lidar_noise": 0.1}),
        (DuelEnv, {"opponent": Counting(), **GAME}),
        (DuelVectorEnv, {"num_envs": 3, **GAME}),
        (SelfPlayVectorEnv, {"num_envs": 4, **GAME}),
        *((MatchEnv, {"opponent": "random-moves", "race_moves": moves}) for moves in (False, True)),
        *(
            (MatchVectorEnv, {"num_envs": 3, "opponent": "random-moves", "race_moves": moves})
            for moves in (False, True)
        ),
    ],
)
def test_a_moment_can_be_kept_copied_and_pickled(kind, arguments, short):
    if kind in (MatchEnv, MatchVectorEnv):
        arguments = {**short, **arguments}
    env = kind(**arguments)
    shape = env.action_space.shape
    first, later = (np.full(shape, 0.1), np.full(shape, -0.2)) if "beams" in arguments else [np.full(shape, 1)] * 2
    env.reset(seed=1)
    env.step(first)
    others = [copy.deepcopy(env), pickle.loads(pickle.dumps(env)), kind(**arguments)]
    others[2].reset(seed=77)
    others[2].set_state(pickle.loads(pickle.dumps(env.get_state())))
    for _ in range(5 if "beams" in arguments else 1):
        expected = env.step(later)
        for other in others:
            for left, right in zip(other.step(later)[:4], expected[:4], strict=True):
                np.testing.assert_array_equal(left, right)
    expected = env.reset()[0]  # the random stream went along, as a copy
    for other in others:
        np.testing.assert_array_equal(other.reset()[0], expected)


# PettingZoo, warnings being errors

STEERED = {"time_step": 0.1, "duration": 3.0}


@pytest.fixture(
    params=[
        ("head_to_head-v1", duel, GAME | {"moves": 4}, 50),
        ("head_to_head_match-v0", match, {}, 10),
        ("head_to_head_match-v0", match, {"race_moves": True}, 10),
        ("drive_head_to_head-v0", drive, STEERED, 60),
        (
            "drive_head_to_head-v0",
            drive,
            {**STEERED, "race": "contest", "beams": 9, "see_opponent": "in sight", "win_reward": 1.0},
            60,
        ),
    ],
    ids=lambda case: case[0],
)
def two_agents(request, short, coarse_oval):
    """Name, module, arguments and cycles of an environment for two agents."""
    name, module, arguments, cycles = request.param
    given = {duel: {}, match: short, drive: {"track": coarse_oval}}[module]
    return name, module, {**given, **arguments}, cycles


def test_the_checkers_of_pettingzoo_are_content(two_agents):
    _, module, arguments, cycles = two_agents
    parallel_api_test(module.parallel_env(**arguments), num_cycles=cycles)
    api_test(module.env(**arguments), num_cycles=cycles)
    parallel_seed_test(lambda: module.parallel_env(**arguments), num_cycles=min(cycles, 30))
    seed_test(lambda: module.env(**arguments), num_cycles=min(cycles, 30))


@pytest.mark.parametrize("kind", ["parallel", "aec"])
def test_two_agents_are_made_by_name(kind, two_agents):
    if not hasattr(pettingzoo, "make"):
        pytest.skip("this release of PettingZoo has no registry")
    name, _, arguments, _ = two_agents
    env = pettingzoo.make(kind, f"pcs_racing/{name}", **arguments, max_cycles=3)
    assert env.unwrapped.possible_agents == ["car_0", "car_1"]
    assert isinstance(env, pettingzoo.ParallelEnv if kind == "parallel" else pettingzoo.AECEnv)
    assert str(env) == name.replace("-", "_")


def test_two_agents_are_rendered(two_agents, monkeypatch):
    pytest.importorskip("pygame", reason="the extra 'window' is not installed")
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    _, module, arguments, _ = two_agents
    monkeypatch.setitem(type(module.parallel_env(**arguments)).metadata, "render_fps", 1000.0)
    shorter = {"duration": 0.3} if module is drive else {}
    render_test(lambda **more: module.env(**{**arguments, **shorter}, render_size=(160, 120), **more))


def test_the_package_itself_offers_head_to_head():
    assert isinstance(pcs_racing.parallel_env(**GAME), duel.HeadToHeadEnv)
    assert isinstance(pcs_racing.env(**GAME), pettingzoo.AECEnv)
