"""How vector environments begin anew, and what Gymnasium's own wrappers make of them."""

import re

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import wrappers
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers import vector as vector_wrappers

import pcs_racing  # noqa: F401
from pcs_racing import InputError, UnknownNameError
from pcs_racing.envs import infos
from pcs_racing.envs.drive import DriveEnv, DriveHeadToHeadEnv, DriveVectorEnv
from pcs_racing.envs.duel import DuelEnv, DuelVectorEnv, HeadToHeadEnv, SelfPlayVectorEnv
from pcs_racing.envs.infos import Crash, Result
from pcs_racing.envs.match import HeadToHeadMatchEnv, MatchEnv
from pcs_racing.race.state import CAR_CRASH, NO_CRASH, WALL_CRASH

DUEL = {"step_seconds": 0.2, "moves": 2}
DRIVE = {"opponent": None, "duration": 0.3}
IDS = {"pcs_racing/Duel-v1": DUEL, "pcs_racing/Drive-v1": DRIVE, "pcs_racing/Match-v0": DUEL}


def action(envs):
    return np.zeros(envs.action_space.shape, envs.action_space.dtype)


@pytest.mark.parametrize("name", IDS)
@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_a_vector_environment_begins_anew_as_gymnasiums_own_does(name, mode):
    """The same observations, rewards and ends as SyncVectorEnv around the environment for one agent."""
    ours = gym.make_vec(name, num_envs=3, autoreset_mode=mode, **IDS[name])
    theirs = gym.make_vec(name, 3, vectorization_mode="sync", vector_kwargs={"autoreset_mode": mode}, **IDS[name])
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
            with pytest.raises(InputError, match=f"environment {np.flatnonzero(over)[0]} has ended"):
                ours.step(action(ours))
            options = {"reset_mask": over}
            mine, own = ours.reset(options=dict(options))[0], theirs.reset(options=dict(options))[0]
            np.testing.assert_array_equal(mine, own)
    assert ends >= 3


def test_the_default_is_gymnasiums_and_others_are_refused():
    for kind in (DuelVectorEnv, DriveVectorEnv, SelfPlayVectorEnv):
        assert kind(2).autoreset_mode is AutoresetMode.NEXT_STEP
        with pytest.raises(InputError, match="autoreset_mode is 'Sometimes'"):
            kind(2, autoreset_mode="Sometimes")
    assert DuelVectorEnv(2, autoreset_mode="SameStep").autoreset_mode is AutoresetMode.SAME_STEP


@pytest.mark.parametrize("mode", ["NEXT_STEP", "SAME_STEP"])
def test_both_cars_of_a_game_begin_anew_together(mode):
    envs = SelfPlayVectorEnv(4, autoreset_mode=mode, **DUEL)
    envs.reset(seed=1)
    for _ in range(7):
        _, rewards, terminated, _, info = envs.step(np.array([0, 1, 2, 3]))
        np.testing.assert_array_equal(terminated[::2], terminated[1::2])
        np.testing.assert_array_equal(rewards[::2], -rewards[1::2])
        np.testing.assert_array_equal(info["time"][::2], info["time"][1::2])


def test_max_episode_steps_truncates():
    envs = gym.make_vec("pcs_racing/Drive-v1", num_envs=2, opponent=None, max_episode_steps=3)
    envs.reset(seed=0)
    late = [envs.step(action(envs))[3].tolist() for _ in range(7)]
    assert late == [[False] * 2, [False] * 2, [True] * 2, [False] * 2, [False] * 2, [False] * 2, [True] * 2]
    with pytest.raises(InputError, match="max_episode_steps is 0"):
        DuelVectorEnv(2, max_episode_steps=0)


WRAPPERS = {
    "ClipAction": {},
    "ClipReward": {"min_reward": -1.0, "max_reward": 1.0},
    "DictInfoToList": {},
    "DtypeObservation": {"dtype": np.float32},
    "FlattenObservation": {},
    "NormalizeObservation": {},
    "NormalizeReward": {},
    "RecordEpisodeStatistics": {},
    "RescaleAction": {"min_action": np.float32(-0.5), "max_action": np.float32(0.5)},
    "RescaleObservation": {"min_obs": np.float32(-1.0), "max_obs": np.float32(1.0)},
    "ReshapeObservation": {"shape": (-1,)},
    "TransformAction": {"func": lambda actions: actions},
    "TransformObservation": {"func": lambda seen: 2.0 * seen},
    "TransformReward": {"func": lambda rewards: 2.0 * rewards},
    "VectorizeTransformAction": {"wrapper": wrappers.TransformAction, "func": lambda a: a, "action_space": None},
    "VectorizeTransformObservation": {
        "wrapper": wrappers.TransformObservation,
        "func": lambda seen: seen,
        "observation_space": None,
    },
    "VectorizeTransformReward": {"wrapper": wrappers.TransformReward, "func": lambda reward: reward},
    "NumpyToTorch": {},
}
NEEDS = {"NumpyToTorch": ("torch", "array_api_compat")}
ELSEWHERE = {
    "RecordVideo",  # below
    "HumanRendering",  # opens a window with opencv
    "ArrayConversion",  # the base of NumpyToTorch
    "JaxToNumpy",
    "JaxToTorch",  # environments of jax
    "FilterObservation",  # of dictionaries
    "GrayscaleObservation",  # of pictures
    "ResizeObservation",
}
CONTINUOUS = {"ClipAction", "RescaleAction"}


def test_every_wrapper_of_gymnasium_is_tried_or_named():
    assert set(vector_wrappers.__all__) <= set(WRAPPERS) | ELSEWHERE


@pytest.mark.parametrize("name", IDS)
@pytest.mark.parametrize("wrapper", WRAPPERS)
def test_the_wrappers_of_gymnasium_run(name, wrapper):
    for library in NEEDS.get(wrapper, ()):
        pytest.importorskip(library)
    if wrapper in CONTINUOUS and "Drive" not in name:
        pytest.skip("for actions that are no moves")
    envs = gym.make_vec(name, num_envs=2, **IDS[name])
    options = dict(WRAPPERS[wrapper])
    if wrapper == "ReshapeObservation":
        options["shape"] = envs.single_observation_space.shape
    if wrapper == "VectorizeTransformAction":
        options["action_space"] = envs.single_action_space
    if wrapper == "VectorizeTransformObservation":
        options["observation_space"] = envs.single_observation_space
    if wrapper == "TransformObservation":
        options["observation_space"] = None
    wrapped = getattr(vector_wrappers, wrapper)(envs, **options)
    first, _ = wrapped.reset(seed=1)
    assert len(first) == 2
    for _ in range(6):
        made = action(envs)
        if wrapper == "NumpyToTorch":
            import torch

            made = torch.as_tensor(made)
        seen, rewards, terminated, truncated, _ = wrapped.step(made)
        assert len(seen) == len(rewards) == len(terminated) == len(truncated) == 2
    wrapped.close()


@pytest.mark.parametrize("name", IDS)
def test_videos_are_recorded(name, tmp_path):
    pytest.importorskip("moviepy")
    envs = gym.make_vec(name, num_envs=2, render_mode="rgb_array", render_size=(96, 64), **IDS[name])
    envs = vector_wrappers.RecordVideo(envs, str(tmp_path), episode_trigger=lambda episode: True)
    envs.reset(seed=0)
    for _ in range(6):
        envs.step(action(envs))
    envs.close()
    assert list(tmp_path.glob("*.mp4"))


@pytest.mark.parametrize("name", IDS)
def test_each_environment_has_its_frame(name):
    envs = gym.make_vec(name, num_envs=2, render_mode="rgb_array", render_size=(96, 64), **IDS[name])
    envs.reset(seed=0)
    frames = envs.render()
    assert [frame.shape for frame in frames] == [(64, 96, 3)] * 2
    assert (frames[0] != frames[1]).any()


@pytest.mark.parametrize(
    ("name", "steps", "changes"),
    [
        ("pcs_racing/Drive-v1", 400, {}),
        ("pcs_racing/Drive-v1", 600, {"duration": 60.0}),
        ("pcs_racing/Drive-v1", 2000, {"time_step": 0.02}),
        ("pcs_racing/Duel-v1", 4, {}),
        ("pcs_racing/Duel-v1", 6, {"moves": 6}),
    ],
)
def test_the_specification_says_how_long_an_episode_is(name, steps, changes):
    env = wrappers.TimeAwareObservation(gym.make(name, **changes), normalize_time=True)
    assert env.spec.max_episode_steps == steps
    assert gym.make_vec(name, num_envs=2, **changes).spec.max_episode_steps == steps
    env.reset(seed=0)
    seen, *_ = env.step(env.action_space.sample())
    assert seen[-1] == pytest.approx(1.0 / steps)


# Arguments and options


@pytest.mark.parametrize("kind", [DriveEnv, DriveVectorEnv, DuelEnv, DuelVectorEnv, SelfPlayVectorEnv, HeadToHeadEnv])
def test_an_unknown_argument_is_a_type_error_as_pythons(kind):
    with pytest.raises(TypeError, match=r"'trak'; did you mean 'track'\?"):
        kind(trak="Pipkin") if kind is not SelfPlayVectorEnv else kind(2, trak="Pipkin")
    with pytest.raises(InputError, match=re.escape(f"{kind.__name__}()")):
        kind(viw="both")


@pytest.mark.parametrize("kind", [DriveEnv, DriveVectorEnv, DuelEnv, DuelVectorEnv, HeadToHeadEnv])
def test_unknown_reset_options_are_refused(kind):
    env = kind()
    with pytest.raises(UnknownNameError, match=r"reset option 'trak' is unknown; did you mean 'track'\?"):
        env.reset(seed=0, options={"trak": "Pipkin"})
    with pytest.raises(InputError, match="options are"):
        env.reset(seed=0, options=[1])


def test_cars_start_where_the_options_say(coarse_oval):
    env = DriveEnv(coarse_oval, "lattice")
    env.reset(seed=0, options={"start": (5.0, 1)})
    races = env.batch.state
    assert (races.frenet[0, 0, 0] - races.progress[0, 0]) % env.track.length == pytest.approx(5.0, abs=0.05)
    poses = np.array([[*env.track.to_cartesian([[s, 0.0]])[0]] for s in (10.0, 6.0)])
    env.reset(seed=0, options={"poses": np.column_stack([poses, [3.0, 2.0]])})
    np.testing.assert_allclose(env.batch.state.cars[0][:, [0, 1]], poses[:, :2])
    np.testing.assert_allclose(env.batch.state.cars[0][:, 3], [3.0, 2.0])
    assert env.batch.info(0)["lead"] == pytest.approx(4.0, abs=0.1)
    assert env.step([0.0, -1.0])[1] > 0.0
    envs = DriveVectorEnv(2, track=coarse_oval)
    envs.reset(seed=0, options={"start": [(5.0, 0), (8.0, 1)]})
    begin = envs.batch.state.frenet[:, 0, 0] - envs.batch.state.progress[:, 0]
    assert begin % envs.track.length == pytest.approx([5.0, 8.0], abs=0.05)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"start": (5.0, 2)}, "'start' is"),
        ({"start": "here"}, "'start' is"),
        ({"start": (1e6, 0)}, "not on track"),
        ({"poses": [[0.0, 0.0]]}, "'poses' is"),
        ({"poses": [[1e3, 0.0, 0.0], [0.0, 1e3, 0.0]]}, "stands in a wall"),
        ({"poses": np.zeros((2, 4)) - 1.0}, "reset option"),
        ({"start": (5.0, 0), "poses": np.zeros((2, 3))}, "give one of the two"),
        ({"state": "yesterday"}, "state is a str"),
        ({"track": "Nowhere"}, "Nowhere"),
        ({"opponent": "nobody"}, "nobody"),
    ],
)
def test_an_impossible_start_is_one_clear_error_and_changes_nothing(coarse_oval, options, message):
    env = DriveEnv(coarse_oval, "lattice")
    env.reset(seed=0)
    before = env.batch.state.copy()
    with pytest.raises(InputError, match=message):
        env.reset(options=options)
    np.testing.assert_array_equal(env.batch.state.cars, before.cars)


@pytest.mark.parametrize("kind", [DriveEnv, DuelEnv, lambda **given: DuelVectorEnv(2, **given), HeadToHeadEnv])
def test_track_and_opponent_can_change_with_a_reset(kind):
    opponent = "lattice:pace=0.2"
    env = kind(opponent="lattice:pace=0.9")
    env.reset(seed=3)
    changed, _ = env.reset(seed=3, options={"track": "Pipkin", "opponent": opponent})
    fresh, _ = kind(track="Pipkin", opponent=opponent).reset(seed=3)
    again, _ = env.reset(seed=3)  # from then on
    for one, two in ((changed, fresh), (again, fresh)):
        np.testing.assert_equal(one, two)


@pytest.mark.parametrize("kind", [DriveEnv, DuelEnv, HeadToHeadEnv])
def test_a_reset_can_continue_from_a_state(kind):
    env = kind()
    first, _ = env.reset(seed=1)
    state = env.get_state()
    env.reset(seed=2)
    np.testing.assert_equal(env.reset(options={"state": state})[0], first)
    with pytest.raises(InputError, match="'state' was given with others or a seed"):
        env.reset(seed=2, options={"state": state})


def test_policies_of_a_duel_can_be_given():
    env = DuelEnv(**DUEL)
    assert env.reset(seed=0, options={"policies": (3, 5)})[1]["policy"] == 3
    assert env.batch.state.policy.tolist() == [[3, 5]]


# Infos


def test_codes_are_those_of_the_race():
    assert (Crash.NONE, Crash.WALL, Crash.CAR) == (NO_CRASH, WALL_CRASH, CAR_CRASH)


KINDS = [
    (DriveEnv, {}),
    (DuelEnv, DUEL),
    (MatchEnv, DUEL),
    (HeadToHeadEnv, DUEL),
    (HeadToHeadMatchEnv, DUEL),
    (DriveHeadToHeadEnv, {}),
]


def start(kind, arguments):
    """Info and outcome at the start of an episode, of one agent."""
    env = kind(**arguments)
    _, info = env.reset(seed=0)
    outcome = env.outcome()
    return (env, info["car_1"], outcome["car_1"]) if hasattr(env, "agents") else (env, info, outcome)


@pytest.mark.parametrize(("kind", "arguments"), KINDS)
def test_every_environment_speaks_of_the_same_things_by_the_same_names(kind, arguments):
    """Those of the table of :mod:`pcs_racing.envs.infos`; and it takes the same names of arguments."""
    table = set(re.findall(r"`(\w+)`(?=[^|]*\|[^|]*\|$)", infos.__doc__, re.M))
    looks = {"render_mode": "rgb_array", "view": "track", "render_size": (96, 64)}
    varied = {"track": ["Pipkin", "Tarnfjord"], "vehicle": {"mu": 0.9}, "randomize": {"friction": [0.9, 1.0]}}
    _, info, _ = start(kind, {**arguments, **varied, **looks, "obstacles": 1, "race": "contest"})
    assert set(info) <= table
    shared = {"time", "progress", "lead", "crash", "opponent_crash", "fault", "overtakes", "result", "opponent", "laps"}
    assert shared | {"track", "obstacles", "friction"} <= set(info)


@pytest.mark.parametrize(("kind", "arguments"), KINDS)
def test_infos_are_numbers_and_the_outcome_is_words(kind, arguments):
    env, info, outcome = start(kind, arguments)
    for name, value in info.items():
        assert np.asarray(value).dtype.kind in "if", name
    codes = env.metadata["codes"]
    assert codes["crash"] == {0: "none", 1: "wall", 2: "car"}
    assert set(outcome) == set(info) - {"action_mask"}
    assert outcome["crash"] == "none"
    assert all(isinstance(outcome[name], str) and outcome[name] for name in codes)
    if "result" in info:
        assert info["result"] == Result.RUNNING
        assert outcome["result"] == "running"
