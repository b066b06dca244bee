"""Policies of Stable-Baselines3 are read without running their code; those that drive race wherever
a policy does.
"""

import zipfile
from types import SimpleNamespace

import numpy as np
import pytest
from refusal import refused

from pcs_racing import load_race_config, load_track, parse_policy, run_races
from pcs_racing.envs.drive import DriveEnv
from pcs_racing.envs.duel import DuelEnv
from pcs_racing_agents.agents import as_agent, make
from pcs_racing_agents.agents.game_spec import make_game_spec
from pcs_racing_agents.agents.sb3_files import (
    _read_scale,
    actor_of,
    load_model,
    load_sb3_policy,
    plain_model,
    save_model,
)
from pcs_racing_agents.agents.zoo import load_entrant

sb3, torch, gym = (
    pytest.importorskip(name) for name in ("stable_baselines3", "torch", "gymnasium")
)
vec = sb3.common.vec_env
RIVAL = "lattice:pace=0.3"
ROWS = np.random.default_rng(0).uniform(-1.0, 1.0, (50, 46)).astype(np.float32)


@pytest.mark.parametrize("activation", [torch.nn.Tanh, torch.nn.ReLU])
def test_moves_are_those_of_the_model(tmp_path, activation, monkeypatch):
    class Spaces(gym.Env):
        observation_space = gym.spaces.Box(-5.0, 5.0, (46,), np.float32)
        action_space = gym.spaces.Discrete(7)

    kwargs = {"activation_fn": activation, "net_arch": [9, 7]}
    model = sb3.PPO("MlpPolicy", Spaces(), seed=3, policy_kwargs=kwargs, device="cpu")
    for weights in model.policy.parameters():  # biases among them, which begin with 0
        torch.nn.init.uniform_(weights, -1.0, 1.0)
    model.save(tmp_path / "mine.zip")
    policy, expected = (
        load_sb3_policy(tmp_path / "mine.zip"),
        model.predict(ROWS, deterministic=True)[0],
    )
    np.testing.assert_array_equal(policy.predict(ROWS)[0], expected)
    assert len(set(expected.tolist())) > 1
    backwards = dict(reversed(model.policy.state_dict().items()))
    assert actor_of("mine", backwards, policy.activation).content_hash == policy.content_hash
    refused("of 46 numbers; here they have 45", policy.predict, ROWS[:, 1:])
    with torch.no_grad():
        model.policy.action_net.bias[1] = float("nan")
    model.save(tmp_path / "broken.zip")
    refused("a weight is not finite", load_sb3_policy, tmp_path / "broken.zip")
    kept = zipfile.ZipFile(tmp_path / "mine.zip").read("policy.pth")
    for settings, weights in (
        (b"[]", kept),
        (b'{"a": NaN}', kept),
        (b"[" * 10**6, kept),
        (b"{}", b""),
    ):
        with zipfile.ZipFile(tmp_path / "other.zip", "w") as file:
            file.writestr("data", settings)
            file.writestr("policy.pth", weights)
        refused(
            r"other\.zip is no file of Stable-Baselines3", load_sb3_policy, tmp_path / "other.zip"
        )
    short = {
        key: value for key, value in model.policy.state_dict().items() if key != "action_net.bias"
    }
    refused("no weights or biases: 'action_net.bias'", actor_of, "short", short, None)
    (tmp_path / "other.zip").write_bytes(b"not a zip")
    refused(r"other\.zip", load_sb3_policy, tmp_path / "other.zip")
    monkeypatch.setattr("pcs_racing.base.errors.find_spec", lambda name: None)
    with pytest.raises(ModuleNotFoundError, match="torch is needed"):
        load_sb3_policy(tmp_path / "mine.zip")


@pytest.mark.parametrize("activation", ["Tanh", "ReLU"])
@pytest.mark.parametrize("hidden", [(5,), (9, 7), (4, 8, 6)])
def test_layers_are_applied_one_after_the_other(activation, hidden):
    """As in a few lines of numpy, for every kind of actor."""
    rng, sizes = np.random.default_rng(0), (46, *hidden, 3)
    weights = [
        rng.normal(0.0, 0.3, pair).astype(np.float32)
        for pair in zip(sizes[1:], sizes[:-1], strict=True)
    ]
    biases = [rng.normal(0.0, 0.3, size).astype(np.float32) for size in sizes[1:]]
    expected = ROWS
    for k, (weight, bias) in enumerate(zip(weights, biases, strict=True)):
        expected = expected @ weight.T + bias
        if k < len(hidden):
            expected = np.tanh(expected) if activation == "Tanh" else np.maximum(expected, 0.0)
    inner = [2 * k for k in range(len(hidden))]
    for names, more, moves, squash in [
        ([*(f"mlp_extractor.policy_net.{k}" for k in inner), "action_net"], {}, True, False),
        (
            [*(f"mlp_extractor.policy_net.{k}" for k in inner), "action_net"],
            {"log_std": 0},
            False,
            False,
        ),
        ([*(f"actor.latent_pi.{k}" for k in inner), "actor.mu"], {}, False, True),
        ([f"actor.mu.{k}" for k in [*inner, 2 * len(hidden)]], {}, False, True),
    ]:
        state = {}
        for name, weight, bias in zip(names, weights, biases, strict=True):
            state |= {f"{name}.weight": torch.tensor(weight), f"{name}.bias": torch.tensor(bias)}
        policy = actor_of("folder/mine.zip", {**state, **more}, activation)
        assert (policy.name, policy.moves, policy.squash) == ("mine", moves, squash)
        assert actor_of("mine", state, None).activation == (
            "Tanh" if names[0].startswith("mlp") else "ReLU"
        )
        found = policy.predict(ROWS)[0]
        if moves:
            np.testing.assert_array_equal(found, expected.argmax(axis=1))
        else:
            np.testing.assert_allclose(found, np.tanh(expected) if squash else expected, atol=1e-4)
        np.testing.assert_array_equal(policy.predict(ROWS[3])[0], found[3])
    model = SimpleNamespace(policy=SimpleNamespace(state_dict=lambda: state), get_env=lambda: None)
    assert plain_model(model, "mine").activation == "ReLU"
    model.policy_kwargs = {"features_extractor_class": object}
    assert plain_model(model, "mine") is model
    refused("the activation is Sigmoid", actor_of, "mine", state, "Sigmoid")
    refused(
        "no actor of fully connected layers", actor_of, "mine", {**state, "lstm.weight": 0}, None
    )


def test_a_scale_is_read_with_its_bounds(tmp_path):
    good = {"mean": [0.0, 9e8], "spread": [1e-8, 9e8], "clip": 0.5}
    scale = _read_scale(tmp_path, good, 2)
    assert [np.asarray(part).tolist() for part in scale] == list(good.values())
    seen = scale(np.float32([[1e-9, 0.0], [1.0, 0.0]]))
    np.testing.assert_allclose(seen, [[0.1, -0.5], [0.5, -0.5]], rtol=1e-6)
    assert seen.dtype == np.float32
    for key, value in [
        ("mean", [0.0]),
        ("mean", [0.0, -1e9]),
        ("spread", [0.0, 1.0]),
        ("spread", [1.0, 1e9]),
        ("spread", [-1.0, 1.0]),
        ("clip", 0.0),
        ("clip", [1.0]),
        ("mean", ["a", 0.0]),
    ]:
        refused(
            "scale must hold mean and spread, 2 numbers",
            _read_scale,
            tmp_path,
            {**good, key: value},
            2,
        )


class Shaped(gym.RewardWrapper):
    """A wrapper of rewards alone."""

    def reward(self, reward):
        return 2.0 * reward


class Logs(gym.Wrapper):
    """A wrapper that overrides nothing of a step."""

    note = "kept"


class Turned(gym.Wrapper):
    """An unknown wrapper that changes actions."""

    def step(self, action):
        return self.env.step(-np.asarray(action))


class Blind(DriveEnv):
    """An environment that changes observations itself."""

    def step(self, action):
        seen, *rest = super().step(action)
        return 0.0 * seen, *rest


class Seen(vec.VecEnvWrapper):
    """An unknown wrapper of Stable-Baselines3 that changes observations."""

    def reset(self):
        return -self.venv.reset()

    def step_wait(self):
        seen, *rest = self.venv.step_wait()
        return -seen, *rest


def wrapped(one=lambda env: env, many=lambda envs: envs, make_env=DriveEnv, others=0):
    """A model that trained in environments of which the last one is wrapped, or all together."""

    def plain():
        return make_env(track="Pipkin", opponent=None, beams=5)

    envs = vec.DummyVecEnv([*([plain] * others), lambda: one(plain())])
    return sb3.PPO("MlpPolicy", many(envs), n_steps=4, batch_size=4, device="cpu", seed=0)


W = gym.wrappers


@pytest.mark.parametrize(
    ("name", "arguments"),
    [
        (
            "TransformAction",
            {"one": lambda env: W.TransformAction(env, np.negative, env.action_space)},
        ),
        (
            "RescaleAction",
            {"one": lambda env: W.RescaleAction(env, np.float32(-2.0), np.float32(2.0))},
        ),
        ("StickyAction", {"one": lambda env: W.StickyAction(env, 0.5)}),
        (
            "TransformObservation",
            {
                "one": lambda env: W.TransformObservation(env, np.negative, env.observation_space),
                "others": 1,
            },
        ),
        ("NormalizeObservation", {"one": lambda env: W.TimeLimit(W.NormalizeObservation(env), 9)}),
        ("Turned", {"one": Turned}),
        ("Blind", {"make_env": Blind}),
        ("Seen", {"many": Seen}),
        ("VecFrameStack", {"many": lambda envs: vec.VecFrameStack(envs, 2)}),
        ("VecFrameStack", {"many": lambda envs: vec.VecFrameStack(vec.VecNormalize(envs), 2)}),
        ("VecFrameStack", {"many": lambda envs: vec.VecNormalize(vec.VecFrameStack(envs, 2))}),
        ("VecNormalize", {"many": lambda envs: vec.VecNormalize(vec.VecNormalize(envs))}),
    ],
)
def test_what_a_model_would_lose_is_refused_and_named(tmp_path, name, arguments):
    model = wrapped(**arguments)
    refused(f"was trained behind {name}; ", save_model, tmp_path / "model", model)
    assert not list(tmp_path.iterdir())
    for race in (as_agent, lambda model: DriveEnv(track="Pipkin", opponent=model)):
        refused(r"was trained behind \w+; ", race, model)


@pytest.mark.parametrize(
    "arguments",
    [
        {
            "one": lambda env: W.ClipAction(
                W.TimeLimit(W.OrderEnforcing(W.PassiveEnvChecker(env)), 9)
            ),
            "others": 1,
        },
        {
            "one": lambda env: Shaped(
                Logs(W.NormalizeReward(W.TransformReward(W.RecordEpisodeStatistics(env), abs)))
            )
        },
        {
            "many": lambda envs: vec.VecNormalize(
                vec.VecCheckNan(vec.VecMonitor(envs)), norm_obs=False
            )
        },
        {"many": lambda envs: vec.VecCheckNan(vec.VecNormalize(envs))},
    ],
)
def test_what_changes_neither_observations_nor_actions_may_be_around(tmp_path, arguments):
    model = wrapped(**arguments)
    assert load_model(save_model(tmp_path / "model", model)).planner.drive.options.beams == 5


def test_environments_that_differ_have_no_arguments_in_common(tmp_path):
    envs = vec.DummyVecEnv(
        [
            lambda step=step: DriveEnv(track="Pipkin", opponent=None, time_step=step)
            for step in (0.1, 0.2)
        ]
    )
    model = sb3.PPO("MlpPolicy", envs, n_steps=4, batch_size=4, device="cpu")
    refused(
        "differ in time_step; give one of them as env= or like=",
        save_model,
        tmp_path / "model",
        model,
    )
    save_model(
        tmp_path / "model", model, env=DriveEnv(track="Pipkin", opponent=None, time_step=0.2)
    )
    assert load_model(tmp_path / "model.zip").planner.drive.hold == 20
    turned = wrapped(Turned, make_env=lambda *_, **__: DuelEnv(step_seconds=0.5, moves=2))
    for opponent in (turned, [(1.0, turned)]):
        refused("was trained behind Turned", DuelEnv, opponent=opponent, step_seconds=0.5, moves=2)


@pytest.mark.parametrize(
    ("kind", "more"), [("PPO", {}), ("SAC", {"buffer_size": 9}), ("TD3", {"buffer_size": 9})]
)
def test_a_model_that_drives_races_from_its_file_as_itself(tmp_path, kind, more):
    track, config = load_track("Pipkin"), load_race_config("paper", duration=2.0)
    env = DriveEnv(track=track, opponent=RIVAL, beams=5, time_step=0.2, vehicle={"mu": 0.9})
    model = getattr(sb3, kind)("MlpPolicy", env, seed=1, device="cpu", **more)
    file = str(save_model(tmp_path / "model", model))
    kept, named = load_model(file).planner.drive, as_agent(model, "mine")
    answer = np.clip(kept.model.predict(ROWS)[0], -1.0, 1.0)
    np.testing.assert_allclose(answer, model.predict(ROWS, deterministic=True)[0], atol=1e-5)
    assert (kept.hold, kept.options.beams, kept.options.vehicle[0].mu) == (20, 5, 0.9)
    assert load_entrant(file, make_game_spec("default", "paper")).planner.drive.hold == 20
    assert make(file).planner.drive.content_hash == named.planner.drive.content_hash
    ends = [
        run_races(track, one, parse_policy(RIVAL), config, seed=2)
        for one in (load_model(file), *named.policies)
    ]
    np.testing.assert_array_equal(ends[0].state.cars, ends[1].state.cars)
    for opponent in (file, model):
        rival = DriveEnv(track=track, opponent=opponent, race=config)
        rival.reset(seed=1)
        rival.step([0.0, -1.0])
        assert rival.batch.state.memory[0, 1, :2].any()
    scaled = sb3.common.vec_env.VecNormalize(
        sb3.common.vec_env.DummyVecEnv([lambda: env]), clip_obs=1.5
    )
    scaled.obs_rms.update(3.0 * ROWS[:, : env.observation_space.shape[0]] + 1.0)
    model.set_env(scaled)
    refused("behind VecNormalize; only save_model", as_agent, model, "mine")
    seen, kept = (
        env.reset(seed=3)[0][None],
        load_model(save_model(tmp_path / "model", model)).planner.drive,
    )
    expected = np.clip(model.predict(scaled.normalize_obs(seen), deterministic=True)[0], -1.0, 1.0)
    np.testing.assert_allclose(np.clip(kept.model.predict(seen)[0], -1.0, 1.0), expected, atol=1e-5)
    assert kept.content_hash != named.planner.drive.content_hash
    for harm, said in (("clip: 1.5", "clip: -1"), ("scale:", "scales:"), ("spread:", "spreads:")):
        (tmp_path / "model.yaml").write_text(
            (tmp_path / "model.yaml").read_text().replace(harm, said)
        )
        refused("scale", load_model, file)
    (tmp_path / "model.yaml").unlink()
    refused(r"model\.yaml with the arguments", load_model, file)
