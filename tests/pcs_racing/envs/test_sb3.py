import warnings

import numpy as np
import pytest
from refusal import refused

from pcs_racing import UnknownNameError

sb3 = pytest.importorskip("stable_baselines3")

from pcs_racing.envs.duel import DuelEnv, DuelVectorEnv  # noqa: E402
from pcs_racing.envs.sb3 import SB3VecEnv, make_sb3_vec_env  # noqa: E402

SHORT = {"step_seconds": 0.5, "moves": 2}


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


def test_ends_are_told_apart():
    env = make_sb3_vec_env("drive", 3, opponent=None, duration=0.3)
    env.seed(5)
    env.reset()
    assert env.seed(5) == [5, 6, 7]
    first = env.reset()
    assert len(env.reset_infos) == 3
    for _ in range(3):
        seen, rewards, done, infos = env.step(np.zeros((3, 2), np.float32))
    assert done.all()
    assert rewards.dtype == np.float32
    for i, info in enumerate(infos):
        assert info["TimeLimit.truncated"] is True
        assert info["episode"]["l"] == 3
        assert info["episode"]["r"] == pytest.approx(info["progress"], abs=0.5)
        assert (info["terminal_observation"] != seen[i]).any()
    env.seed(5)
    np.testing.assert_array_equal(env.reset(), first)
    crash = make_sb3_vec_env("drive", 2, opponent=None)
    crash.reset()
    for _ in range(400):
        _, _, done, infos = crash.step(np.tile([1.0, 0.0], (2, 1)))
        if done.any():
            assert infos[int(np.argmax(done))]["TimeLimit.truncated"] is False
            return
    pytest.fail("a car that only turns left must end in a wall")


def test_a_trained_model_can_be_the_opponent():
    model = sb3.PPO("MlpPolicy", make_sb3_vec_env("duel", 2, **SHORT), seed=0, device="cpu")
    env = DuelEnv(opponent=model, **SHORT)
    _, info = env.reset(seed=0)
    assert env.outcome()["opponent"] == "PPO"
    *_, info = env.step(0)
    assert 0 <= info["opponent_move"] < env.action_space.n


def test_evaluation_needs_no_monitor():
    from stable_baselines3.common.evaluation import evaluate_policy

    env = make_sb3_vec_env("duel", 2, **SHORT)
    model = sb3.PPO("MlpPolicy", env, seed=0, device="cpu")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        mean, _ = evaluate_policy(model, env, 4)
    assert np.isfinite(mean)


def test_masks_are_asked_for_as_maskable_ppo_does():
    env = make_sb3_vec_env("duel", 3, **SHORT)
    env.reset()
    assert env.has_attr("action_masks")
    assert np.stack(env.env_method("action_masks")).shape == (3, 4)
    assert len(env.env_method("action_masks", indices=[1])) == 1
    match = make_sb3_vec_env("match-self-play", 4, archive="default", **SHORT)
    match.reset()
    assert np.stack(match.env_method("action_masks")).shape == (4, match.action_space.n)
    assert not make_sb3_vec_env("drive", 2, opponent=None).has_attr("nothing_like_it")


@pytest.mark.compare
def test_maskable_ppo_learns():
    contrib = pytest.importorskip("sb3_contrib", reason="sb3-contrib is not installed")
    env = make_sb3_vec_env("duel", 3, **SHORT)
    contrib.MaskablePPO("MlpPolicy", env, seed=0, n_steps=8, batch_size=8, device="cpu").learn(24)


def test_unknown_kinds_and_attributes_are_named():
    refused("'triathlon' is unknown", make_sb3_vec_env, "triathlon", error=UnknownNameError)
    env = make_sb3_vec_env("duel", 2, **SHORT)
    refused("'track' can't be set", env.set_attr, "track", "Pipkin")
    env.close()
    for wrong in (DuelEnv(**SHORT), DuelVectorEnv(2, **SHORT)):
        refused(f"envs .*{type(wrong).__name__}; .*'SAME_STEP'", SB3VecEnv, wrong)
    refused("threads is 0", SB3VecEnv, DuelVectorEnv(2, autoreset_mode="SAME_STEP", **SHORT), threads=0)


def test_methods_of_the_batch_and_its_frame():
    env = make_sb3_vec_env("drive", 2, opponent=None, render_mode="rgb_array")
    env.reset()
    assert [frame.shape for frame in env.get_images()] == [(640, 960, 3)] * 2
    assert env.env_method("get_state", indices=[0])[0].over.shape == (2,)
    refused("action masks", env.env_method, "action_masks", error=AttributeError)
    refused("no attribute 'nothing'", env.get_attr, "nothing", error=AttributeError)
    assert env.get_attr("num_envs", indices=0) == [2]
    assert env.env_is_wrapped(object) == [False] * 2
    assert make_sb3_vec_env("drive", 2, opponent=None).get_images() == [None, None]


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
        steps = [part.step(own) for part, own in zip(alone, (actions[:2], actions[2:]), strict=True)]
        np.testing.assert_array_equal(seen, np.concatenate([one[0] for one in steps]))
        np.testing.assert_array_equal(rewards, 0.5 * np.concatenate([one[1] for one in steps]).astype(np.float32))
        np.testing.assert_array_equal(done, np.concatenate([one[2] for one in steps]))
        assert [bool(info) for info in infos] == done.tolist()
        if kept is not None:
            again, ended = joined.get_state(), seen
            joined.set_state(kept)
            np.testing.assert_array_equal(joined.step(actions)[0], ended)
            joined.set_state(again)
    assert joined.has_attr("action_masks")
    joined.close()
