import copy
import gc
import inspect
import pickle
import re
import subprocess
import sys
import warnings

import numpy as np
import pytest

from pcs_racing import GameConfig, InputError, PolicyArchive, UnknownNameError, load_archive, load_track, make_game
from pcs_racing.envs import registration
from pcs_racing.envs.duel import HeadToHeadEnv
from pcs_racing.envs.infos import Crash, Result
from pcs_racing.envs.parallel import AGENTS, ParallelState
from pcs_racing.game.observation import observation_table

with warnings.catch_warnings():  # PettingZoo's own tests import its old classic environments, which warn
    warnings.simplefilter("ignore")
    from pettingzoo.test import parallel_api_test

FAST = {"step_seconds": 1.0}
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
    "Version History",
]


@pytest.fixture
def env():
    return HeadToHeadEnv(**FAST)


def flat(value):
    """A nested answer of the environment as something that compares."""
    if isinstance(value, dict):
        return {key: flat(item) for key, item in value.items()}
    if isinstance(value, tuple):
        return tuple(flat(item) for item in value)
    return value.tolist() if isinstance(value, np.ndarray) else value


def episode(env, seed=None, choose=(0, 3)):
    """Everything that an episode returns, from the reset to its end."""
    rng = np.random.default_rng(seed)
    answers = [flat(env.reset(seed=seed))]
    while env.agents:
        actions = {agent: int(rng.integers(env.action_space(agent).n)) for agent in AGENTS} if choose is None else None
        answers.append(flat(env.step(actions or dict(zip(AGENTS, choose, strict=True)))))
    return answers


def begin_a_whole_game(env) -> None:
    """Reset to the first seed whose game lasts to the horizon, whatever the tuning of planners and archives."""
    for seed in range(100):
        if len(episode(env, seed, (2, 2))) == 1 + env.game.config.moves:
            env.reset(seed=seed)
            return
    pytest.fail("100 games, and all end in a crash")


def test_a_frame_has_the_size_that_is_documented():
    env = HeadToHeadEnv(render_mode="rgb_array", **FAST)
    env.reset(seed=0)
    assert env.render().shape == (640, 960, 3)
    env.close()


# Names and documentation


def test_registering_again_changes_nothing():
    registration.register_environments()  # a warning would be an error
    import gymnasium

    assert set(registration.GYMNASIUM_IDS) <= set(gymnasium.registry)


def test_the_code_behind_a_name_is_imported_when_it_is_needed():
    code = "import sys, pcs_racing; print(*[m for m in sys.modules if m.startswith('pcs_racing.envs.')])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["pcs_racing.envs.registration"]


def test_the_class_documents_itself(env):
    text = inspect.getdoc(HeadToHeadEnv)
    assert re.findall(r"^## (.*)$", text, re.MULTILINE) == HEADINGS
    assert observation_table(env.game.observation_elements, env.game.config.moves) in text
    for number, name in enumerate(env.game.move_names):
        assert f"{number} `{name}`" in " ".join(text.split())
    arguments = [name for name in inspect.signature(HeadToHeadEnv).parameters if name != "settings"]
    for name in [*arguments, *GameConfig.__dataclass_fields__]:
        assert f"`{name}`" in text, name
    assert (
        f"`{len(env.game.observation_elements)}" in text or f"{len(env.game.observation_elements)} by default" in text
    )


def test_spaces(env):
    elements = env.game.observation_elements
    box = env.observation_space("car_0")
    assert box.shape == (31,)
    assert box.dtype == np.float32
    np.testing.assert_array_equal(box.low, [element.low for element in elements])
    np.testing.assert_array_equal(box.high, [element.high for element in elements])
    assert env.action_space("car_1").n == 4
    assert env.state_space.shape == (62,)
    observations, _ = env.reset(seed=0)
    np.testing.assert_array_equal(env.state(), np.concatenate([observations[agent] for agent in AGENTS]))
    assert env.state_space.contains(env.state())


# Episodes


def test_an_episode_is_the_game(env):
    """What the agents get is what :class:`pcs_racing.RaceGame` says, step by step."""
    game = env.game
    for seed in range(5):
        _, infos = env.reset(seed=seed)
        state = game.reset(np.random.default_rng(seed).integers(2**63, size=1))
        assert infos["car_0"]["policy"] == state.policy[0, 0]
        compare_a_game(env, state)


def compare_a_game(env, state):
    game = env.game
    for moves in [(0, 3), (2, 1), (1, 1), (0, 2)]:
        if not env.agents:
            break
        observations, rewards, terminated, truncated, infos = env.step(dict(zip(AGENTS, moves, strict=True)))
        state = game.step(state, [moves])
        for car, agent in enumerate(AGENTS):
            np.testing.assert_array_equal(observations[agent], game.observation(state)[0, car])
            assert rewards[agent] == game.reward(state)[0, car]
            assert terminated[agent] == game.done(state)[0]
            assert not truncated[agent]
            assert infos[agent]["move"] == moves[car]
            assert infos[agent]["policy"] == state.policy[0, car]
            assert infos[agent]["lead"] == (state.race.lead[0] if car == 0 else -state.race.lead[0])
    assert env.agents == []
    assert {infos[agent]["result"] for agent in AGENTS} in ({Result.WIN, Result.LOSS}, {Result.TIE}, {Result.CRASH})


def test_rewards_add_up_to_zero(env):
    for seed in range(5):
        for _, rewards, terminated, *_ in episode(env, seed, None)[1:]:
            assert rewards["car_0"] + rewards["car_1"] == 0.0
            assert terminated["car_0"] == terminated["car_1"]


def test_a_crash_ends_the_game_and_says_whose_fault_it_was():
    env = HeadToHeadEnv(race="contest", step_seconds=8.0, utility="win")
    for seed in range(60):
        *_, last = episode(env, seed, (0, 0))
        infos = last[4]
        if infos["car_0"]["crash"] or infos["car_1"]["crash"]:
            break
    else:
        pytest.fail("no crash in 60 games")
    assert last[2] == {"car_0": True, "car_1": True}
    for agent, other in (AGENTS, AGENTS[::-1]):
        assert infos[agent]["crash"] in list(Crash)
        if infos[agent]["fault"] and not infos[other]["fault"]:
            assert infos[agent]["result"] == Result.LOSS
            assert last[1][agent] == -1.0
            assert infos[other]["result"] == Result.WIN


@pytest.mark.parametrize("race", ["paper", "contest"])
def test_the_same_seed_is_the_same_episode(race):
    first, second = (HeadToHeadEnv(race=race, **FAST) for _ in range(2))
    second.reset(seed=99)
    assert episode(first, 7, None) == episode(second, 7, None)
    assert episode(first, None) == episode(second, None)  # and the ones after it
    assert episode(first, 7) != episode(first, 8)


def test_max_cycles_truncates():
    env = HeadToHeadEnv(max_cycles=2, **FAST)
    games = (episode(env, seed) for seed in range(100))
    answers = next(answers for answers in games if not answers[-1][2]["car_0"])
    assert len(answers) == 3
    assert answers[-1][2] == {"car_0": False, "car_1": False}
    assert answers[-1][3] == {"car_0": True, "car_1": True}
    assert answers[-1][1] == {"car_0": 0.0, "car_1": 0.0}


def test_reset_options(env):
    policies = [2, 7]
    _, infos = env.reset(seed=0, options={"policies": policies, "start": (20.0, 1)})
    assert [infos[agent]["policy"] for agent in AGENTS] == policies
    state = env.batch.state
    begin = (state.race.frenet[0, 0, 0] - state.race.progress[0, 0]) % env.game.track.length
    assert begin == pytest.approx(20.0, abs=0.05)
    _, infos = env.reset(seed=0, options={"policies": (2, -1)})
    assert infos["car_0"]["policy"] == 2


def test_three_characteristics_and_several_step_sizes():
    default = load_archive("default")
    values = {key: getattr(default, key) for key in ("name", "planner", "parameter_names", "parameters")}
    third = np.linspace(-2.0, -1.0, len(default))[:, None]
    axes = (*default.characteristics, "smoothness")
    archive = PolicyArchive(**values, characteristics=axes, coordinates=np.hstack([default.coordinates, third]))
    env = HeadToHeadEnv(archive=archive, epsilon=(0.2, 0.5), stay=True, moves=2, **FAST)
    assert env.action_space("car_0").n == 13
    assert env.observation_space("car_0").shape == (3 * 8 + 1,)
    parallel_api_test(env, num_cycles=10)
    env.reset(seed=0)
    infos = env.step({"car_0": 12, "car_1": 4})[4]
    assert infos["car_0"]["move"] == 12
    assert env.outcome()["car_1"]["move"] == "smoothness + 0.2"


# The environment as a value


@pytest.mark.parametrize(
    "keep", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))], ids=["deepcopy", "pickle"]
)
def test_a_copy_goes_on_alike_and_alone(env, keep):
    begin_a_whole_game(env)
    env.step({"car_0": 2, "car_1": 2})
    twin = keep(env)
    moves = {"car_0": 2, "car_1": 2}
    answer = flat(env.step(moves))
    assert flat(twin.step(moves)) == answer
    # Each has a random stream of its own: drawing from one does not move the other.
    episodes = [episode(env) for _ in range(3)]
    assert [episode(twin) for _ in range(3)] == episodes


def test_a_moment_can_be_restored(env):
    begin_a_whole_game(env)
    env.step({"car_0": 2, "car_1": 2})
    moment = env.get_state()
    future = [flat(env.step({"car_0": 2, "car_1": 2})) for k in range(3)]
    after = episode(env)
    other = HeadToHeadEnv(**FAST)
    for target, value in ((env, moment), (other, moment), (other, pickle.loads(pickle.dumps(moment)))):
        target.set_state(value)
        assert [flat(target.step({"car_0": 2, "car_1": 2})) for k in range(3)] == future
        assert episode(target) == after
    fresh = HeadToHeadEnv(**FAST)
    fresh.set_state(HeadToHeadEnv(**FAST).get_state())
    with pytest.raises(InputError, match="call reset"):
        fresh.step({"car_0": 0, "car_1": 0})


def other_game(state, game):
    return state._replace(batch=(game, *state.batch[1:]))


@pytest.mark.parametrize(
    ("harm", "message"),
    [
        (lambda state: "yesterday", "of type str"),
        (lambda state: other_game(state, HeadToHeadEnv(moves=2, **FAST).game.reset(1)), "own has shape .1, 2, 3, 2."),
        (lambda state: other_game(state, state.batch[0]._replace(policy=np.array([[0, 99]]))), r"policies \[0, 99\]"),
        (lambda state: state._replace(generator={"bit_generator": "dice"}), "random generator"),
    ],
)
def test_an_impossible_moment_is_one_clear_error_and_changes_nothing(env, harm, message):
    env.reset(seed=3)
    before = env.get_state()
    with pytest.raises(InputError, match=message):
        env.set_state(harm(before))
    assert isinstance(before, ParallelState)
    twin = HeadToHeadEnv(**FAST)
    twin.set_state(before)
    assert flat(env.step({"car_0": 1, "car_1": 1})) == flat(twin.step({"car_0": 1, "car_1": 1}))


def test_two_environments_on_different_maps_do_not_disturb_each_other():
    alone = [episode(HeadToHeadEnv(track, **FAST), 1) for track in ("Tarnfjord", "Pipkin")]
    pair = [HeadToHeadEnv(track, **FAST) for track in ("Tarnfjord", "Pipkin")]
    together = [[flat(env.reset(seed=1))] for env in pair]
    for _ in range(4):
        for env, answers in zip(pair, together, strict=True):
            if env.agents:
                answers.append(flat(env.step({"car_0": 0, "car_1": 3})))
    assert together == alone


def test_many_resets_leave_nothing_behind():
    env = HeadToHeadEnv("Pipkin", step_seconds=0.2)
    for k in range(20):
        env.reset(seed=k)
    gc.collect()
    before = len(gc.get_objects())
    for k in range(1000):
        env.reset(seed=k)
        env.step({"car_0": 0, "car_1": 0})
    gc.collect()
    assert len(gc.get_objects()) - before < 100


# Pictures


def test_frames_of_the_last_step(monkeypatch):
    env = HeadToHeadEnv(render_mode="rgb_array", render_size=(120, 80), **FAST)
    env.reset(seed=0)
    assert len(list(env.frames())) == 25  # of the step that the players only watch
    before = env.render()
    env.step({"car_0": 0, "car_1": 1})
    frames = list(env.frames())
    assert len(frames) == env.metadata["render_fps"] == 25  # a second
    assert all(frame.shape == (80, 120, 3) and frame.dtype == np.uint8 for frame in frames)
    assert not np.array_equal(frames[0], before)
    state = env.batch.state.race
    list(env.frames())
    np.testing.assert_array_equal(env.batch.state.race.cars, state.cars)  # looking changes nothing
    env.close()
    assert HeadToHeadEnv(**FAST).render() is None


# Bad input


@pytest.mark.parametrize(
    ("actions", "message"),
    [
        ({"car_0": 0, "car_1": 4}, r"environment 1: move 4 .*aggressiveness"),
        ({"car_0": -1, "car_1": 0}, "environment 0: move -1"),
        ({"car_0": 0.0, "car_1": 0}, "type float64"),
        ({"car_0": float("nan"), "car_1": 0}, "type float64"),
        ({"car_0": True, "car_1": 0}, "type bool"),
        ({"car_0": [0], "car_1": 0}, "whole numbers"),
        ({"car_0": None, "car_1": 0}, "type object"),
        ({"car_0": 0}, "car_0, car_1"),
        ([0, 1], "car_0, car_1"),
    ],
)
def test_an_impossible_action_is_one_clear_error(env, actions, message):
    env.reset(seed=0)
    before = env.state()
    with pytest.raises(InputError, match=message):
        env.step(actions)
    np.testing.assert_array_equal(env.state(), before)
    env.step({"car_0": np.int64(0), "car_1": np.array(1)})  # numpy's whole numbers will do


def test_steps_at_the_wrong_time_are_one_clear_error(env):
    with pytest.raises(InputError, match="not begun"):
        env.step({"car_0": 0, "car_1": 0})
    with pytest.raises(InputError, match="not begun"):
        env.state()
    episode(env, 0)
    with pytest.raises(InputError, match="the episode is over"):
        env.step({"car_0": 0, "car_1": 0})


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"track": "Nowhere"}, "unknown track 'Nowhere'"),
        ({"archive": "nothing"}, "unknown archive 'nothing'"),
        ({"race": "rally"}, "race settings 'rally' are unknown"),
        ({"characteristics": ("charm",)}, "characteristic 'charm' is unknown"),
        ({"render_mode": "ascii"}, "render_mode is 'ascii'"),
        ({"view": "moon"}, "view is 'moon'"),
        ({"max_cycles": 0}, "max_cycles is 0"),
        ({"epsilon": float("nan")}, "epsilon is nan"),
        ({"speeed": 1}, "unexpected keyword argument 'speeed'"),
    ],
)
def test_an_impossible_argument_is_one_clear_error(arguments, message):
    with pytest.raises(InputError, match=message):
        HeadToHeadEnv(**arguments)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"seed": -1}, "seed is -1"),
        ({"seed": 0.5}, r"seed is 0\.5"),
        ({"options": [1]}, "options are"),
        ({"options": {"policies": [1]}}, "policies has shape"),
        ({"options": {"policies": [0, 99]}}, "game 0, car 1: policy 99"),
        ({"options": {"start": (np.nan, 0)}}, "option 'start' is"),
        ({"options": {"start": (20.0, 2)}}, "option 'start' is"),
        ({"options": {"start": "here"}}, "option 'start' is"),
        ({"options": {"start": (1e9, 0)}}, r"start line 1000000000.0 m"),
    ],
)
def test_an_impossible_reset_is_one_clear_error(env, arguments, message):
    env.reset(seed=0)
    before = env.state()
    with pytest.raises(InputError, match=message):
        env.reset(**arguments)
    np.testing.assert_array_equal(env.state(), before)


def test_unknown_agents_are_one_clear_error(env):
    with pytest.raises(InputError, match="agent 'car_2' is unknown"):
        env.action_space("car_2")


def test_the_game_behind_is_shared_by_copies(env):
    """Copying an environment does not copy its track."""
    assert copy.deepcopy(env).game is env.game
    assert make_game(load_track("Tarnfjord")).track is env.game.track
    assert issubclass(UnknownNameError, InputError)
