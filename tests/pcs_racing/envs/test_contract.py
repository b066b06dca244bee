"""Promises of all environments: checkers, names, seeds, batches, copies, frames, errors."""

import copy
import gc
import inspect
import itertools
import pickle
import re
import tracemalloc
import warnings

import gymnasium as gym
import numpy as np
import pettingzoo
import pytest
from faces import (
    AGENTS,
    ALL,
    ARCS,
    GAME,
    MANY,
    MIXTURE,
    PAIRS,
    SINGLE,
    VARIED,
    Counting,
    act,
    begun,
    by_lead,
    ends,
    flat,
    make,
    make_many,
    play,
)
from gymnasium.utils.env_checker import check_env
from refusal import refused

import pcs_racing
from pcs_racing import load_rules
from pcs_racing.envs import (
    GYMNASIUM_IDS,
    drive,
    drive_batch,
    duel,
    infos,
    line,
    register_environments,
)
from pcs_racing.envs.draws import PARAMETERS
from pcs_racing.envs.drive import DriveEnv, DriveHeadToHeadEnv
from pcs_racing.envs.duel import DuelEnv, HeadToHeadEnv
from pcs_racing.envs.infos import Crash, Result
from pcs_racing.envs.line import LineEnv, LineHeadToHeadEnv
from pcs_racing.race.state import CAR_CRASH, NO_CRASH, WALL_CRASH

# PettingZoo's own tests import its old classic environments, which warn
with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    from pettingzoo.test import (
        api_test,
        parallel_api_test,
        parallel_seed_test,
        render_test,
        seed_test,
    )

EVERY = pytest.mark.parametrize("kind", ALL, ids=lambda kind: kind.__name__)
VARIANTS = [
    *((kind, {}) for kind in ALL),
    *((kind, VARIED) for kind in ALL),
    (DriveEnv, {"opponent": None, "normalize": True}),
    (DriveEnv, {"opponent": ["lattice", "predictive-spliner", "lane-switcher"]}),
    (DuelEnv, {"opponent": Counting()}),
    (DuelEnv, {"opponent": MIXTURE}),
    (DriveHeadToHeadEnv, ARCS),
    (LineHeadToHeadEnv, {}),
]


# The checkers of the libraries, and names


@pytest.mark.parametrize(
    ("kind", "arguments"),
    [
        (DriveEnv, {"duration": 40.0}),
        (DriveEnv, {"opponent": None, "beams": 20, "rules": "paper"}),
        (DriveEnv, {"opponents": ["lattice:pace=0.3", "pure-pursuit", "lattice:pace=0.2"]}),
        (DriveEnv, {"normalize": True, "beams": 5}),
        (DuelEnv, {"opponent": "lane-switcher:3"}),
        (DuelEnv, {"opponent": MIXTURE}),
        (DriveEnv, ARCS),
        (LineEnv, {}),
    ],
)
def test_the_checkers_of_gymnasium_and_sb3_are_content(kind, arguments):
    env = make(kind, render_mode="rgb_array", **arguments)
    assert env.observation_space.shape == (len({element.name for element in env.elements}),)
    check_env(env, skip_render_check=True)
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    checker.check_env(env)


@pytest.mark.parametrize(
    ("name", "kind", "arguments"),
    [
        ("pcs_racing/Drive-v1", DriveEnv, {"opponent": None}),
        ("pcs_racing/Duel-v1", DuelEnv, GAME),
    ],
)
def test_it_is_made_by_name(name, kind, arguments):
    register_environments()  # again: a warning would be an error
    assert set(GYMNASIUM_IDS) <= set(gym.registry)
    assert isinstance(gym.make(name, **arguments).unwrapped, kind)
    envs = gym.make_vec(name, num_envs=3, **arguments)
    assert isinstance(envs, MANY[kind])
    assert envs.metadata["autoreset_mode"] is gym.vector.AutoresetMode.NEXT_STEP


STEERED = {"time_step": 0.1, "duration": 3.0}


@pytest.fixture(
    params=[
        ("head_to_head-v1", duel, {"steps": (1.0,) * 5}, 50),
        ("line_head_to_head-v0", line, {"duration": 3.0}, 60),
        ("drive_head_to_head-v0", drive, STEERED, 60),
        (
            "drive_head_to_head-v0",
            drive,
            {
                **STEERED,
                "rules": "contest",
                "beams": 9,
                "see_opponent": "in sight",
                "win_reward": 1.0,
            },
            60,
        ),
    ],
    ids=lambda case: case[0],
)
def two_agents(request, coarse_oval):
    """Name, module, arguments and cycles of an environment for two agents."""
    name, module, arguments, cycles = request.param
    return (
        name,
        module,
        {**({"track": coarse_oval} if module is drive else {}), **arguments},
        cycles,
    )


def test_the_checkers_of_pettingzoo_are_content(two_agents):
    _, module, arguments, cycles = two_agents
    parallel_api_test(module.parallel_env(**arguments), num_cycles=cycles)
    api_test(module.env(**arguments), num_cycles=cycles)
    parallel_seed_test(lambda: module.parallel_env(**arguments), num_cycles=min(cycles, 30))
    seed_test(lambda: module.env(**arguments), num_cycles=min(cycles, 30))
    if module is drive:
        parallel_api_test(drive.parallel_env(**arguments, cars=4), num_cycles=20)


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
    shorter = {"steps": (0.2,) * 3} if module is duel else {"duration": 0.3}
    render_test(
        lambda **more: module.env(**{**arguments, **shorter}, render_size=(160, 120), **more)
    )


def test_the_package_itself_offers_head_to_head():
    assert isinstance(pcs_racing.parallel_env(**GAME), duel.HeadToHeadEnv)
    assert isinstance(pcs_racing.env(**GAME), pettingzoo.AECEnv)


# Arguments and pages


@pytest.mark.parametrize(
    "kind", [*ALL, *(MANY[kind] for kind in ALL)], ids=lambda kind: kind.__name__
)
def test_an_editor_shows_the_arguments_of_the_configuration(kind):
    shown = dict(inspect.signature(kind).parameters)
    assert shown.keys() - set(kind.options_type.defaults()) <= {
        *("max_cycles", "num_envs", "autoreset_mode", "max_episode_steps", "threads")
    }
    assert shown.keys() >= {*kind.options_type.defaults(), "track", "opponent", "reward"}
    assert shown["track"].default == "Tarnfjord"


HEADINGS = [
    "Description",
    "Action Space",
    "Observation Space",
    "Rewards",
    "Starting State",
    "Episode End",
    "Information",
    "Arguments",
    "Vectorized environment",
]


@EVERY
def test_the_class_documents_itself(kind):
    """It has every heading, and says how many elements the default observation has."""
    size, text = len(kind().elements), inspect.getdoc(kind)
    assert re.findall(r"^## (.*)$", text, re.MULTILINE) == HEADINGS
    assert f"{size} elements" in text or f"{size} by default" in text


@pytest.mark.parametrize("kind", PAIRS)
def test_spaces_of_two_agents(kind):
    env = make(kind)
    box = env.observation_space("car_1")
    np.testing.assert_array_equal(
        box.low, np.array([element.low for element in env.elements], np.float32)
    )
    np.testing.assert_array_equal(
        box.high, np.array([element.high for element in env.elements], np.float32)
    )
    assert box.dtype == np.float32
    assert env.action_space("car_0") is env.action_space("car_0")
    assert env.action_space("car_0") is not env.action_space("car_1")  # each is seeded for itself
    refused("not begun", env.state)
    observations, _ = env.reset(seed=0)
    np.testing.assert_array_equal(
        env.state(), np.concatenate([observations[agent] for agent in AGENTS])
    )
    assert env.state_space.contains(env.state())
    assert env.metadata["is_parallelizable"]  # which PettingZoo's wrappers ask for


# Episodes


@EVERY
def test_the_same_seed_is_the_same_episodes(kind):
    first, second = make(kind), make(kind)
    second.reset(seed=99)
    assert play(first, 7) == play(second, 7)
    assert play(first) == play(second)  # and the one after it
    assert play(first, 7) != play(first, 8)


RACE = load_rules("contest", duration=3.0)
DRIVES = [
    {"rules": RACE, "duration": None, "beams": 12, "vehicle": {"lidar_noise": 0.05}},
    {
        "rules": RACE,
        "duration": None,
        "opponent": ["lattice:pace=0.1", "lattice:pace=0.9"],
        "time_step": 0.06,
    },
    {"rules": RACE, "duration": None, "opponent": None, "normalize": True},
]
TWO = {"opponent": ["lattice", "gap-follower:top_speed=4"]}
LONGER = {"steps": (1.0,) * 4}
DUELS = [
    {"opponent": one, **LONGER}
    for one in ("random-moves", MIXTURE, by_lead, Counting(), "lane-switcher:3")
]


@pytest.mark.parametrize(
    ("kind", "arguments", "count", "steps", "min_ends"),
    [
        *((DriveEnv, arguments, 12, 60, 12) for arguments in DRIVES),
        *((DuelEnv, arguments, 6, 7, 6) for arguments in DUELS),
        (DriveHeadToHeadEnv, DRIVES[0], 10, 40, 10),
        (HeadToHeadEnv, LONGER, 4, 7, 4),
        *((kind, VARIED, 5, 12, 5) for kind in ALL),
        (DriveEnv, {**ARCS, **TWO, "duration": 3.0}, 6, 40, 6),
        (LineEnv, {**TWO, "duration": 3.0}, 6, 40, 6),
        (LineHeadToHeadEnv, {}, 4, 12, 4),
    ],
)
def test_vector_and_scalar_environment_agree_to_the_last_bit(
    kind, arguments, count, steps, min_ends, monkeypatch
):
    monkeypatch.setattr(drive_batch, "US_OF_A_THREAD", 10.0)  # two threads for short steps, too
    envs = make_many(kind, count, threads=2, autoreset_mode="SAME_STEP", **arguments)
    assert kind is not DriveEnv or envs.batch.threads == 2
    single = [make(kind, **arguments) for _ in range(count)]
    seen, info = envs.reset(seed=11)
    alone = [sides(env, *env.reset(seed=11 + i)) for i, env in enumerate(single)]
    np.testing.assert_array_equal(seen, np.concatenate([first for first, _ in alone]))
    assert info["opponent"].tolist() == [facts["opponent"] for _, told in alone for facts in told]
    rng = np.random.default_rng(0)
    ended = 0
    for _ in range(steps):
        if isinstance(envs.action_space, gym.spaces.Box):
            actions = rng.uniform(-0.5, 1.0, envs.action_space.shape).astype(np.float32)
        else:
            actions = rng.integers(0, envs.single_action_space.n, envs.num_envs)
        batch, rewards, terminated, truncated, info = envs.step(actions)
        for i, env in enumerate(single):
            rows = range(i * envs.players, (i + 1) * envs.players)
            own = (
                dict(zip(AGENTS, actions[list(rows)], strict=True))
                if hasattr(env, "possible_agents")
                else actions[i]
            )
            answer = env.step(own)
            seen, paid, end, late, told = sides(env, *answer)
            expected = (values[list(rows)].tolist() for values in (rewards, terminated, truncated))
            assert (paid, end, late) == tuple(expected)
            if ends(answer):
                ended += 1
                np.testing.assert_array_equal(np.stack(info["final_obs"][list(rows)]), seen)
                compare_infos(info["final_info"], rows, told)
                seen, told = sides(env, *env.reset())
            np.testing.assert_array_equal(batch[list(rows)], seen)
            compare_infos(info, rows, told)
    assert ended >= min_ends


def sides(env, *answer):
    """An answer of an environment: each part lists the values of all agents."""
    return tuple(
        list(part.values()) if hasattr(env, "possible_agents") else [part] for part in answer
    )


def compare_infos(info, rows, told):
    for row, facts in zip(rows, told, strict=True):
        for name, value in facts.items():
            np.testing.assert_array_equal(info[name][row], value)


@pytest.mark.parametrize("many", [False, True], ids=["one", "many"])
@pytest.mark.parametrize(("kind", "arguments"), VARIANTS)
def test_a_moment_can_be_kept_copied_and_pickled(kind, arguments, many):
    """After any steps of the environment, and in another one."""
    env, other = (
        make_many(kind, 3, **arguments) if many else make(kind, **arguments) for _ in range(2)
    )
    env.reset(seed=2)
    env.step(act(env, 0))
    other.reset(seed=77)
    others = [copy.deepcopy(env), pickle.loads(pickle.dumps(env)), other]
    state = env.get_state()
    other.set_state(pickle.loads(pickle.dumps(state)))
    if arguments is not VARIED:  # whose obstacles make a track of its own
        assert all(one.track is env.track for one in (others[0], other))  # a copy shares it
    expected = flat(env.step(act(env, 1)))
    for one in others:
        assert flat(one.step(act(one, 1))) == expected
    expected = flat(env.reset())  # the random stream went along, as a copy
    for one in others:
        assert flat(one.reset()) == expected
    if not many:
        other.reset(seed=5)
        other.reset(options={"state": state})
        env.set_state(state)
        assert flat(other.step(act(other, 2))) == flat(env.step(act(env, 2)))
        refused(
            "'state' was given with others or a seed", env.reset, seed=2, options={"state": state}
        )
    fresh = make(kind, **arguments)
    fresh.set_state(make(kind, **arguments).get_state())
    refused("call reset", fresh.step, act(fresh))


@pytest.mark.parametrize(("single", "pair"), list(zip(SINGLE, PAIRS, strict=True)))
def test_an_opponent_in_place_of_the_second_agent_makes_it_the_environment_of_one(single, pair):
    arguments = (
        {"opponent": "pure-pursuit", "rivalry": 1.0}
        if single is DriveEnv
        else {"opponent": "lattice:pace=0.5"}
    )
    one, two = make(single, **arguments), make(pair, **arguments)
    expected, found = play(one, 6), play(two, 6)
    assert two.possible_agents == ["car_0"]
    assert found == [[{"car_0": part} for part in answer] for answer in expected]
    np.testing.assert_array_equal(two.state()[: len(expected[-1][0])], np.float32(expected[-1][0]))


@EVERY
def test_steps_at_the_wrong_time_are_refused(kind):
    env = make(kind)
    for wanted in ("not begun", "has ended"):
        refused(wanted, env.step, act(env))
        play(env, 1)
    envs = make_many(kind, 2)
    refused("not begun", envs.step, act(envs))


@pytest.mark.parametrize("kind", PAIRS)
def test_a_step_of_no_agents_after_the_end_returns_nothing(kind):
    env = make(kind)
    refused("not begun", env.step, {})
    play(env, 1)
    assert env.step({}) == ({}, {}, {}, {}, {})


@pytest.mark.parametrize("kind", PAIRS)
def test_max_cycles_truncates_and_decides_nothing(kind):
    env = (
        make(kind, max_cycles=2, rules="paper", steps=(8.0,) * 5)
        if kind is HeadToHeadEnv
        else make(kind, max_cycles=2)
    )
    games = (play(env, seed) for seed in range(100))
    answers = next(answers for answers in games if not answers[-1][2]["car_0"])
    assert len(answers) == 3
    assert answers[-1][2:4] == [dict.fromkeys(AGENTS, False), dict.fromkeys(AGENTS, True)]
    assert answers[-1][4]["car_0"]["result"] == Result.RUNNING
    assert env.agents == []
    whole = play(make(kind), 1)
    # an episode that ends in that step is not cut off
    assert play(make(kind, max_cycles=len(whole) - 1), 1) == whole


@pytest.mark.parametrize("kind", [DriveEnv, HeadToHeadEnv])
def test_resets_leave_nothing_behind(kind):
    env = make(kind, **({} if kind is DriveEnv else {"steps": (0.1,) * 5}))

    def turn():
        env.reset()
        env.step(act(env))

    for _ in range(30):
        turn()
    gc.collect()
    tracemalloc.start()
    before = tracemalloc.get_traced_memory()[0]
    for _ in range(50):
        turn()
    gc.collect()
    grown = tracemalloc.get_traced_memory()[0] - before
    tracemalloc.stop()
    assert grown < 100_000  # less than two small observations each; free lists fill up at first


# Infos


@EVERY
def test_every_environment_speaks_of_the_same_things_by_the_same_names(kind):
    """Infos of the table of :mod:`pcs_racing.envs.infos`, as numbers; the outcome says the same in
    words.
    """
    table = set(re.findall(r"`(\w+)`(?=[^|]*\|[^|]*\|$)", infos.__doc__, re.M))
    env = make(kind, **VARIED)
    _, info = env.reset(seed=0)
    outcome = env.outcome()
    if kind in PAIRS:
        assert info["car_0"].keys() == info["car_1"].keys()
        assert info["car_0"]["mu"] == info["car_1"]["mu"]
        assert (info["car_0"]["steer_lag"] == info["car_1"]["steer_lag"][::-1]).all()
        assert info["car_1"]["opponent"] == -1
        info, outcome = info["car_1"], outcome["car_1"]
    shared = {
        "time",
        "progress",
        "lead",
        "crash",
        "opponent_crash",
        "fault",
        "cost",
        "overtakes",
        "result",
        "opponent",
        "laps",
    }
    assert (
        shared | {"track", "obstacles", "mu", "steer_lag"} <= set(info) <= table | set(PARAMETERS)
    )
    for name, value in info.items():
        assert np.asarray(value).dtype.kind in "if", name
    codes = env.metadata["codes"]
    expected = {NO_CRASH: "none", WALL_CRASH: "wall", CAR_CRASH: "car"}
    assert codes["crash"] == {0: "none", 1: "wall", 2: "car"} == expected
    assert (Crash.NONE, Crash.WALL, Crash.CAR) == (0, 1, 2)
    arrays = {name for name, value in info.items() if isinstance(value, np.ndarray)}
    assert {"steer_lag", "speed_delay"} <= arrays
    assert set(outcome) == set(info) - arrays
    assert all(isinstance(outcome[name], str) and outcome[name] for name in set(codes) - arrays)
    assert (info["result"], outcome["result"], outcome["crash"]) == (
        Result.RUNNING,
        "running",
        "none",
    )


@pytest.mark.parametrize("kind", SINGLE)
def test_a_step_with_an_own_fault_costs_one(kind):
    """Also in a batch, and from a kept moment on."""
    rules = load_rules("contest", contact="restart", steering_noise=0.15)
    longer = {"duration": 30.0} if kind is DriveEnv else {"steps": (6.0,) * 5}
    one, other = (make(kind, rules=rules, **longer) for _ in range(2))
    many = make_many(kind, 2, rules=rules, **longer)
    _, info = one.reset(seed=3)
    _, infos = many.reset(seed=3)
    known, costs, over = info["fault"], [info["cost"]], False
    while not over:
        *_, over, late, info = one.step(act(one))
        *_, infos = many.step([act(one)] * 2)
        costs.append(info["cost"])
        assert info["cost"] == infos["cost"][0] == float(info["fault"] > known)
        other.set_state(one.get_state())
        assert other.outcome()["cost"] == info["cost"]
        known, over = info["fault"], over or late
    assert costs[0] == 0.0
    assert sum(costs) > 0.0
    assert one.reset()[1]["cost"] == 0.0


# Frames


@EVERY
def test_a_frame_shows_the_race(kind):
    looks = {"render_mode": "rgb_array", "render_size": (240, 160)}
    env, envs = make(kind, **looks), make_many(kind, 2, **looks)
    for one in (env, envs):
        refused("call reset", one.render)
        one.reset(seed=0)
    first, frames = env.render(), envs.render()
    assert (first.dtype, first.shape) == (np.uint8, (160, 240, 3))
    for colour in [(21, 89, 176), (148, 89, 0)]:  # of the names of both cars
        assert (np.abs(first.astype(int) - colour).sum(axis=-1) < 9).sum() > 10
    np.testing.assert_array_equal(frames[0], first)
    assert len(frames) == 2 * envs.players
    for k in range(2):
        env.step(act(env, k))
    assert (env.render() != first).any()
    env.close()
    plain = begun(make(kind), seed=0)
    if kind in PAIRS:
        assert plain.render() is None
    else:
        refused("render_mode is None", plain.render)


@pytest.mark.parametrize(("kind", "in_a_step"), [(DriveEnv, 1), (DuelEnv, 4)])
def test_a_window_follows_the_race(kind, in_a_step, monkeypatch):
    """A frame for each 0.16 s of a step of half a second."""
    pytest.importorskip("pygame")
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    shown = []
    monkeypatch.setattr(
        "pcs_racing.race.rendering.Window.show", lambda self, frame: shown.append(frame)
    )
    for env in (make(kind, render_mode="human"), make_many(kind, 1, render_mode="human")):
        shown.clear()
        env.reset(seed=0)
        env.step(act(env))
        assert len(shown) == 1 + in_a_step  # the start, then the step
        assert all((one != other).any() for one, other in itertools.pairwise(shown))
        env.close()
