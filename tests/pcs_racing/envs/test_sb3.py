import copy
import pickle
import warnings

import gymnasium as gym
import numpy as np
import pytest
from faces import flat
from refusal import refused

from pcs_racing.base.errors import UnknownNameError

sb3 = pytest.importorskip("stable_baselines3")

from stable_baselines3.common.monitor import Monitor  # noqa: E402
from stable_baselines3.common.vec_env import DummyVecEnv  # noqa: E402

from pcs_racing.envs.drive import DriveEnv, DriveVectorEnv  # noqa: E402
from pcs_racing.envs.duel import DuelEnv, DuelVectorEnv  # noqa: E402
from pcs_racing.envs.infos import Result  # noqa: E402
from pcs_racing.envs.sb3 import SB3VecEnv, make_sb3_vec_env  # noqa: E402

SHORT = {"steps": (0.5,) * 3}


def learn(kind, **arguments):
    """A tiny PPO; everything that its weights were made of is in them."""
    env = make_sb3_vec_env(kind, 4, **arguments)
    model = sb3.PPO("MlpPolicy", env, seed=0, n_steps=16, batch_size=32, n_epochs=2, device="cpu")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        model.learn(128)
    assert all(np.isfinite(info["r"]) for info in model.ep_info_buffer)
    return np.concatenate([value.numpy().ravel() for value in model.policy.state_dict().values()])


@pytest.mark.parametrize(
    ("kind", "arguments"),
    [
        ("duel", SHORT),
        ("self-play", SHORT),
        ("pcs_racing/Drive-v1", {"opponent": None, "duration": 1.0}),
        ("drive-self-play", {"cars": 4, "time_step": 0.1, "duration": 1.0}),
    ],
)
def test_ppo_learns_without_a_warning_and_repeatably(kind, arguments):
    np.testing.assert_array_equal(learn(kind, **arguments), learn(kind, **arguments))


@pytest.mark.parametrize(
    ("libraries", "logged", "shown"),
    [(("tqdm", "rich"), False, True), (("tensorboard",), True, False)],
    ids=["progress bar", "curves"],
)
def test_the_extra_has_what_a_training_shows(tmp_path, libraries, logged, shown):
    for library in libraries:
        pytest.importorskip(library, reason=f"{library} is not installed")
    log = tmp_path / "log" if logged else None
    env = make_sb3_vec_env("duel", 2, **SHORT)
    model = sb3.PPO("MlpPolicy", env, n_steps=2, batch_size=4, tensorboard_log=log)
    model.learn(4, progress_bar=shown)
    assert log is None or [*log.rglob("events.*")]


def test_a_trained_model_can_be_the_opponent():
    model = sb3.PPO("MlpPolicy", make_sb3_vec_env("duel", 2, **SHORT), seed=0, device="cpu")
    env = DuelEnv(opponent=model, **SHORT)
    _, info = env.reset(seed=0)
    assert env.outcome()["opponent"] == "PPO"
    *_, info = env.step(0)
    assert 0 <= info["opponent_move"] < env.action_space.n


@pytest.mark.compare
def test_maskable_ppo_learns():
    contrib = pytest.importorskip("sb3_contrib", reason="sb3-contrib is not installed")
    env = make_sb3_vec_env("duel", 3, **SHORT)
    contrib.MaskablePPO("MlpPolicy", env, seed=0, n_steps=8, batch_size=8, device="cpu").learn(24)


def test_unknown_kinds_and_attributes_are_named():
    refused("'triathlon' is unknown", make_sb3_vec_env, "triathlon", error=UnknownNameError)
    env = make_sb3_vec_env("duel", 2, **SHORT)
    env.close()
    for wrong in (DuelEnv(**SHORT), DuelVectorEnv(2, **SHORT)):
        refused(f"envs .*{type(wrong).__name__}; .*'SAME_STEP'", SB3VecEnv, wrong)
    refused(
        "threads is 0", SB3VecEnv, DuelVectorEnv(2, autoreset_mode="SAME_STEP", **SHORT), threads=0
    )


CASES = [
    (
        "drive",
        DriveEnv,
        {"opponent": "lattice", "duration": 0.5, "track": ["Pipkin", "Tarnfjord"], "obstacles": 2},
    ),
    ("drive", DriveEnv, {"opponent": None, "laps": 1, "randomize": {"each": {"mu": [0.6, 1.2]}}}),
    ("duel", DuelEnv, SHORT),
]


def both(kind, scalar, arguments, seed=7, count=3):
    """The batch, and the same environments one by one as Stable-Baselines3 has them; both have
    begun.
    """
    one_by_one = DummyVecEnv([lambda: Monitor(scalar(**arguments)) for _ in range(count)])
    pair = make_sb3_vec_env(kind, count, **arguments), one_by_one
    seen = [env.seed(seed) and env.reset() for env in pair]
    np.testing.assert_array_equal(*seen)
    return pair


def same_infos(ours, theirs):
    for own, other in zip(ours, theirs, strict=True):
        assert isinstance(own, dict)
        ends = [info.pop("episode", {"r": 0.0, "l": 0, "t": 0.0}) for info in (own, other)]
        assert ends[0]["l"] == ends[1]["l"]
        assert ends[0]["r"] == pytest.approx(ends[1]["r"], abs=1e-5)
        assert ends[0].keys() == ends[1].keys()
        assert own.keys() == other.keys()
        assert [type(own[name]) for name in own] == [type(other[name]) for name in own]
        assert flat(own) == flat({name: other[name] for name in own})


@pytest.mark.parametrize(("kind", "scalar", "arguments"), CASES)
def test_a_batch_answers_as_the_same_environments_one_by_one(kind, scalar, arguments):
    """Over whole episodes; and infos that were kept stay as they were."""
    envs, ended, kept = both(kind, scalar, arguments), 0, []
    same_infos(*(env.reset_infos for env in envs))
    for step in range(400):
        # Hard left into a wall, or another move for each environment.
        discrete = not envs[0].action_space.shape
        actions = (
            (np.arange(3) + step) % envs[0].action_space.n
            if discrete
            else np.tile([0.8, 0.2], (3, 1))
        )
        ours, theirs = (env.step(actions) for env in envs)
        for own, other in zip(ours[:3], theirs[:3], strict=True):
            assert own.dtype == other.dtype
            np.testing.assert_array_equal(own, other)
        same_infos(copy.deepcopy(ours[3]), theirs[3])
        kept.append((ours[3], flat(copy.deepcopy(ours[3]))))
        ended += int(ours[2].sum())
        if ended >= 5:
            break
    assert ended >= 5
    assert [flat(pickle.loads(pickle.dumps(infos))) for infos, _ in kept] == [
        before for _, before in kept
    ]
    same_infos(*(env.reset_infos for env in envs))


@pytest.mark.parametrize(("kind", "scalar", "arguments"), CASES)
def test_options_hold_for_one_reset_of_each_environment(kind, scalar, arguments):
    pair = envs = both(kind, scalar, arguments)
    start, other = {"start": (20.0, 1)}, {"start": (30.0, 0)}
    for options in (
        start,
        [start, {}, other],
        [{}, {"obstacles": []}, start],
        {},
    ):
        for seed in (5, None):
            for env in envs:
                if seed is not None:
                    env.seed(seed)
                env.set_options(options)
            np.testing.assert_array_equal(*(env.reset() for env in envs))
            np.testing.assert_array_equal(*(env.reset() for env in envs))  # without options again
            same_infos(*(env.reset_infos for env in envs))
    fresh = (
        make_sb3_vec_env(kind, 3, **arguments),
        DummyVecEnv([lambda: scalar(**arguments) for _ in range(3)]),
    )
    seen = []
    for env in fresh:  # at the first reset as well
        env.seed(3)
        env.set_options([{}, start, {}])
        seen.append(env.reset())
    np.testing.assert_array_equal(*seen)
    for wrong, message in (
        ({"speed": 3.0}, "reset option 'speed' is unknown"),
        ({"reset_mask": np.ones(3, bool)}, "reset option 'reset_mask' is unknown"),
        ([start, {}, {"start": (20.0, 9)}], "option 'start' is"),
        ([start, {}, {"obstacles": [[0.0, -4.0, 0.0, 50.0, 0.3]]}], "obstacle"),
        ([start, {}], "options list 2 dicts; give one for each of 3"),
        (["start", {}, {}], "options are 'start'"),
    ):
        before = flat(pair[0].get_state())
        pair[0].seed(11)
        pair[0].set_options(wrong)
        refused(message, pair[0].reset)
        assert flat(pair[0].get_state()) == before


def test_the_players_of_a_race_share_its_options_and_no_batch_begins_alone():
    env = make_sb3_vec_env("self-play", 4, **SHORT)
    env.set_options([{"start": (20.0, 1)}, {}, {"start": (30.0, 0)}, {"start": (30.0, 0)}])
    first = env.reset()
    assert not np.array_equal(first[0], first[2])
    env.set_options([{}, {"start": (20.0, 1)}, {}, {}])
    refused("options of environment 1 differ from the options of its race", env.reset)
    parts = [
        DriveVectorEnv(1, opponent=None, track=name, autoreset_mode="SAME_STEP")
        for name in ("Pipkin", "Tarnfjord")
    ]
    joined = SB3VecEnv(parts)
    joined.reset()
    joined.step(np.zeros((2, 2)))
    before = flat(joined.get_state())
    for options in ([{"start": (3.0, 0)}, {"start": (20.0, 9)}], [{}, {"start": "here"}]):
        joined.set_options(options)
        refused("option 'start'", joined.reset)
        assert flat(joined.get_state()) == before
    for k, wrong in ((0, "yesterday"), (1, np.zeros(3)), (2, np.zeros(2))):
        state = list(joined.get_state())
        state[k] = wrong
        refused("the state", joined.set_state, tuple(state))
    assert flat(joined.get_state()) == before


@pytest.mark.parametrize(("kind", "scalar", "arguments"), CASES)
def test_attributes_and_methods_are_of_one_environment(kind, scalar, arguments):
    ours, theirs = both(
        kind, scalar, arguments | {"render_mode": "rgb_array", "render_size": (96, 64)}
    )
    for indices in (None, 1, [2, 0]):
        for name in ("observation_space", "action_space", "render_mode", "elements"):
            assert ours.get_attr(name, indices) == theirs.get_attr(name, indices), name
        assert [one.name for one in ours.get_attr("track", indices)] == [
            one.name for one in theirs.get_attr("track", indices)
        ]
        methods = ["outcome", "render", *(["action_masks"] if kind != "drive" else [])]
        for name in methods:
            assert flat(ours.env_method(name, indices=indices)) == flat(
                theirs.env_method(name, indices=indices)
            ), name
        for wrapper in (Monitor, gym.Wrapper, gym.wrappers.TimeLimit):
            assert ours.env_is_wrapped(wrapper, indices) == theirs.env_is_wrapped(wrapper, indices)
    assert [one.outcome() for one in ours.get_attr("unwrapped")] == ours.env_method("outcome")
    np.testing.assert_array_equal(ours.get_images(), theirs.get_images())
    for env in (ours, theirs):
        assert env.has_attr("action_masks") == (kind != "drive")
        assert not env.has_attr("nothing_like_it")
        env.set_attr("note", "a", indices=[0, 2])
        env.set_attr("note", "b", indices=1)
        assert env.get_attr("note") == ["a", "b", "a"]
        env.set_attr("other", 1, indices=0)
        assert not env.has_attr("other")
    for name in ("reset", "step", "get_state", "nothing"):
        refused(f"no attribute '{name}'", ours.env_method, name, indices=[0], error=AttributeError)
    for name in ("render_mode", "track", "outcome", "_row"):
        refused(f"'{name}' can't be set|{name} is an argument", ours.set_attr, name, 1)
    refused(r"opponent is an .* set_opponent_weights", ours.set_attr, "opponent", "lattice")
    assert make_sb3_vec_env("drive", 2, opponent=None).get_images() == [None, None]


def test_a_monitor_around_the_batch_and_the_callbacks_of_sb3_find_what_they_look_for():
    from stable_baselines3.common.callbacks import EvalCallback, StopTrainingOnMaxEpisodes
    from stable_baselines3.common.vec_env import VecMonitor

    env, other = (make_sb3_vec_env("drive", 2, opponent=None, duration=0.5) for _ in range(2))
    # as around Stable-Baselines3's own
    with pytest.warns(UserWarning, match="already wrapped with a `Monitor`"):
        env = VecMonitor(env, info_keywords=("progress", "result"))
    callbacks = [
        StopTrainingOnMaxEpisodes(100),
        EvalCallback(env, eval_freq=8, n_eval_episodes=2, verbose=0),
    ]
    model = sb3.PPO("MlpPolicy", env, n_steps=8, batch_size=16, device="cpu", seed=0).learn(
        32, callback=callbacks
    )
    assert all(
        info["progress"] > 0.0 and info["result"] != Result.RUNNING for info in model.ep_info_buffer
    )
    assert len(model.ep_info_buffer) >= 4
    # a replay buffer reads every info
    sb3.SAC("MlpPolicy", other, learning_starts=4, device="cpu", seed=0).learn(16)


@pytest.mark.parametrize("threads", [1, 2])
def test_several_batches_are_one_environment(threads):
    """As each alone with its seed, one after the other or side by side, rewards scaled."""

    def parts():
        modes = {"autoreset_mode": "SAME_STEP", **SHORT}
        return [DuelVectorEnv(2, **modes), DuelVectorEnv(3, opponent="never-switch", **modes)]

    joined, alone = SB3VecEnv(parts(), seeds=[7, 40], reward_scale=0.5, threads=threads), parts()
    seen = joined.reset()
    firsts = [part.reset(seed=seed)[0] for part, seed in zip(alone, (7, 40), strict=True)]
    np.testing.assert_array_equal(seen, np.concatenate(firsts))
    actions = np.array([0, 1, 2, 3, 0])
    for step in range(3):
        kept = joined.get_state() if step == 1 else None
        seen, rewards, done, infos = joined.step(actions)
        steps = [
            part.step(own) for part, own in zip(alone, (actions[:2], actions[2:]), strict=True)
        ]
        np.testing.assert_array_equal(seen, np.concatenate([one[0] for one in steps]))
        np.testing.assert_array_equal(
            rewards, 0.5 * np.concatenate([one[1] for one in steps]).astype(np.float32)
        )
        np.testing.assert_array_equal(done, np.concatenate([one[2] for one in steps]))
        assert ["episode" in info for info in infos] == done.tolist()
        if kept is not None:
            again, ended = joined.get_state(), seen
            joined.set_state(kept)
            np.testing.assert_array_equal(joined.step(actions)[0], ended)
            joined.set_state(again)
    assert joined.has_attr("action_masks")
    joined.close()


def test_an_info_of_each_step_is_filled_where_it_is_read():
    env = make_sb3_vec_env("drive", 2, opponent=None)
    env.reset()
    info, other = env.step(np.zeros((2, 2), np.float32))[3]
    assert info.get("episode") is None
    assert dict.__len__(info) == 0  # of the dictionary below: nothing was read so far
    assert info["time"] == pytest.approx(0.1)
    assert info.get("progress") > 0.0
    assert {**other} == dict(other) == other.copy() == other
    assert list(other) == list(other.keys()) == [name for name, _ in other.items()]
    assert "poses" in other
    assert type(pickle.loads(pickle.dumps(info))) is dict
    info["note"] = 1
    assert info.pop("note") == 1


def test_weights_of_the_opponents_hold_for_all_batches():
    env = make_sb3_vec_env("drive", 20, opponent=["lattice", "pure-pursuit"])
    env.set_opponent_weights([1e-9, 1.0])
    env.reset()
    assert {info["opponent"] for info in env.reset_infos} == {1}
    refused("they must be 2 numbers from 1e-12 to 1e", env.set_opponent_weights, [1.0])
