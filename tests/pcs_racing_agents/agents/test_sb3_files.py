"""Policies of Stable-Baselines3 are read without running their code, and race as they predict."""

import json
import zipfile

import numpy as np
import pytest
from refusal import refused

from pcs_racing import load_rules, load_track, make_game, racer, run_races
from pcs_racing.envs.drive import DriveEnv
from pcs_racing.envs.duel import DuelEnv
from pcs_racing.game.players import competitor
from pcs_racing_agents.agents.sb3_files import (
    SCALE_FILE,
    PolicyTraits,
    _read_scale,
    actor_of,
    read_zip,
    save_model,
)

sb3, torch, gym = (
    pytest.importorskip(name) for name in ("stable_baselines3", "torch", "gymnasium")
)
vec = sb3.common.vec_env
RIVAL = "lattice:pace=0.3"
FLATTEN = sb3.common.torch_layers.FlattenExtractor
SMALL = {"n_steps": 4, "batch_size": 4}
KINDS = [
    ("PPO", SMALL),
    ("PPO", {**SMALL, "policy_kwargs": {"activation_fn": torch.nn.ReLU, "net_arch": [9, 7]}}),
    ("PPO", {**SMALL, "use_sde": True, "policy_kwargs": {"squash_output": True}}),
    ("A2C", {"use_sde": True}),
    ("SAC", {"buffer_size": 9}),
    ("SAC", {"buffer_size": 9, "policy_kwargs": {"net_arch": [8]}}),
    ("TD3", {"buffer_size": 9, "policy_kwargs": {"net_arch": [5, 6, 7]}}),
    ("DDPG", {"buffer_size": 9}),
    ("PPO", {**SMALL, "policy_kwargs": {"net_arch": []}}),
    ("PPO", {**SMALL, "policy_kwargs": {"net_arch": {"pi": [19, 3], "vf": [4]}}}),
    ("PPO", {**SMALL, "policy_kwargs": {"share_features_extractor": False}}),
    ("PPO", {**SMALL, "policy_kwargs": {"features_extractor_class": FLATTEN}}),
    ("A2C", {"use_sde": True, "policy_kwargs": {"squash_output": True}}),
    ("SAC", {"buffer_size": 9, "policy_kwargs": {"activation_fn": torch.nn.Tanh}}),
]


class Half(FLATTEN):
    """An extractor of features of one's own."""

    def forward(self, observations):
        return 0.5 * super().forward(observations)


class ReLU(torch.nn.Module):
    """An activation function of one's own, with the name of another one."""

    def forward(self, values):
        return values * torch.sigmoid(values)


def drive(**arguments):
    return DriveEnv(track="Pipkin", opponent=None, beams=5, **arguments)


def duel(**arguments):
    return DuelEnv(steps=(0.5,) * 3, **arguments)


def trained(kind, env, **more):
    """Return a model with weights that no training left near 0."""
    model = getattr(sb3, kind)("MlpPolicy", env, seed=3, device="cpu", **more)
    for weights in model.policy.parameters():  # biases among them, which begin with 0
        torch.nn.init.uniform_(weights, -0.2, 0.2)
    return model


def seen_in(env, count=50):
    rng = np.random.default_rng(0)
    box = env.observation_space
    low, high = np.clip(box.low, -3, 3), np.clip(box.high, -3, 3)
    return rng.uniform(low, high, (count, len(low))).astype(np.float32)


@pytest.mark.parametrize(("kind", "more"), KINDS)
@pytest.mark.parametrize("normalized", [True, False])
def test_a_zip_of_drive_commands_as_the_model_predicts(tmp_path, kind, more, normalized):
    env = drive(normalized=normalized, time_step=0.2, vehicle={"mu": 0.9})
    model, rows = trained(kind, env, **more), seen_in(env)
    model.save(tmp_path / "mine.zip")
    driver = racer(tmp_path / "mine.zip").planner.drive
    assert (driver.hold, driver.options.beams, driver.options.vehicle[0].mu) == (20, 5, 0.9)
    shares = np.clip(driver._answers(rows), -1.0, 1.0)
    low, high = (env.action_space.low, env.action_space.high)
    own = low + 0.5 * (high - low) * (shares + 1.0)
    np.testing.assert_allclose(own, model.predict(rows, deterministic=True)[0], atol=1e-5)


@pytest.mark.parametrize(
    ("kind", "more"), [("PPO", SMALL), ("A2C", {}), ("DQN", {"buffer_size": 9})]
)
def test_a_zip_of_duel_moves_as_the_model_predicts(tmp_path, kind, more):
    env = duel()
    model, rows = trained(kind, env, **more), seen_in(env)
    model.save(tmp_path / "mine.zip")
    agent = competitor(tmp_path / "mine.zip", env.game)
    expected = model.predict(rows, deterministic=True)[0]
    np.testing.assert_array_equal(agent.model.predict(rows)[0], expected)
    assert len(set(expected.tolist())) > 1
    other = make_game("Tarnfjord", steps=(8.0,) * 4)
    refused("made for games of 2 moves; the game has 3", racer, tmp_path / "mine.zip", other)
    refused("is an agent", racer, tmp_path / "mine.zip")


@pytest.mark.parametrize(
    ("kind", "more", "message"),
    [
        ("PPO", {"policy_kwargs": {"activation_fn": torch.nn.ELU}}, "the activation is ELU"),
        ("SAC", {"use_sde": True, "buffer_size": 9}, "trained with use_sde, which clips its mean"),
        ("PPO", {"policy_kwargs": {"activation_fn": ReLU}}, r"the activation is .*test_sb3_files"),
        ("PPO", {"policy_kwargs": {"features_extractor_class": Half}}, "a feature extractor"),
    ],
)
def test_a_policy_that_is_not_plain_layers_is_refused_by_its_cause(tmp_path, kind, more, message):
    model = trained(kind, drive(), **more)
    model.save(tmp_path / "mine.zip")
    refused(message, racer, tmp_path / "mine.zip")
    refused(message, save_model, tmp_path / "other.zip", model)
    assert not (tmp_path / "other.zip").exists()
    assert racer(model).planner.drive.model is model  # the model itself races


def test_damaged_files_are_one_line_each(tmp_path, monkeypatch):
    model = trained("PPO", drive(), **SMALL)
    model.save(tmp_path / "mine.zip")
    with torch.no_grad():
        model.policy.action_net.bias[1] = float("nan")
    model.save(tmp_path / "broken.zip")
    refused("hold NaN or infinity", racer, tmp_path / "broken.zip")
    kept = zipfile.ZipFile(tmp_path / "mine.zip")
    weights, settings = kept.read("policy.pth"), json.loads(kept.read("data"))
    other = tmp_path / "other.zip"
    for data, content in (
        (b"[]", weights),
        (b'{"a": NaN}', weights),
        (b"[" * 10**6, weights),
        (b"{}", b""),
    ):
        _write(other, data, content)
        refused(r"other\.zip is no file of Stable-Baselines3", racer, other)
    other.write_bytes(b"not a zip")
    refused(r"other\.zip", racer, other)
    for origin, message in [
        ("{", "it must be drive, duel or line"),
        ('{"environment": "boat"}', "it must be drive, duel or line"),
        ('{"environment": "duel"}', "actions of steering and speed"),
        ('{"environment": "drive", "beam": 3}', "'beam' is unknown"),
        ('{"environment": "drive", "beams": 7}', r"the observation_space \(46,\)"),
    ]:
        settings["observation_space"]["pcs_racing"] = origin
        _write(other, json.dumps(settings).encode(), weights)
        refused(message, racer, other)
    del settings["observation_space"]["pcs_racing"]
    _write(other, json.dumps(settings).encode(), weights)
    refused("does not name the environment of its training; give it with --like", racer, other)
    assert racer(other, like="drive:beams=5,time_step=0.05").planner.drive.hold == 5
    assert racer(other, like=drive()).planner.drive.options.beams == 5
    refused("'beams' is not of the form name=value", racer, other, like="drive:beams")
    (tmp_path / "vec_normalize.pkl").write_bytes(b"")
    refused(r"near vec_normalize\.pkl, a VecNormalize", racer, other)
    monkeypatch.setattr("pcs_racing.base.errors.find_spec", lambda name: None)
    with pytest.raises(ModuleNotFoundError, match="torch is needed"):
        racer(tmp_path / "mine.zip")


def _write(file, settings, weights):
    with zipfile.ZipFile(file, "w") as made:
        made.writestr("data", settings)
        made.writestr("policy.pth", weights)


def test_an_actor_is_found_by_the_module_of_its_policy():
    model = trained("PPO", drive(), **SMALL)
    state, traits = (
        model.policy.state_dict(),
        PolicyTraits("stable_baselines3.common.policies", None, False, False, False),
    )
    backwards = dict(reversed(state.items()))
    digest = actor_of("mine", state, traits).content_hash
    assert actor_of("mine", backwards, traits).content_hash == digest
    short = {key: value for key, value in state.items() if key != "action_net.bias"}
    refused("no weights or biases: 'action_net.bias'", actor_of, "short", short, traits)
    refused(
        "has an LSTM, which keeps a state", actor_of, "mine", {**state, "lstm.weight": 0}, traits
    )
    refused("has a policy class of mine", actor_of, "mine", state, traits._replace(module="mine"))
    policy = actor_of("mine", state, traits)
    refused("of 46 numbers; here they have 45", policy.predict, np.zeros((1, 45)))


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
    """A model that trained in environments with a wrapper around the last one, or around all."""

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
    for race in (racer, lambda model: DriveEnv(track="Pipkin", opponent=model)):
        if "VecNormalize" not in name:
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
    assert racer(save_model(tmp_path / "model", model)).planner.drive.options.beams == 5


def test_environments_that_differ_have_no_arguments_in_common():
    envs = vec.DummyVecEnv([lambda step=step: drive(time_step=step) for step in (0.1, 0.2)])
    model = sb3.PPO("MlpPolicy", envs, n_steps=4, batch_size=4, device="cpu")
    refused("differ; give one of them as like=", racer, model)
    turned = wrapped(Turned, make_env=lambda *_, **__: duel())
    for opponent in (turned, [(1.0, turned)]):
        refused("was trained behind Turned", duel, opponent=opponent)


def test_a_model_races_from_its_file_as_itself_also_behind_a_scale(tmp_path):
    track, config = load_track("Pipkin"), load_rules("paper", duration=2.0)
    env = DriveEnv(track=track, opponent=RIVAL, beams=5, time_step=0.2)
    model = trained("SAC", env, buffer_size=9)
    file = save_model(tmp_path / "model", model)
    ends = [run_races(track, one, RIVAL, config, seed=2) for one in (file, model)]
    np.testing.assert_array_equal(ends[0].state.cars, ends[1].state.cars)
    assert racer(file).planner.drive.content_hash == racer(model).planner.drive.content_hash
    for opponent in (str(file), model):
        rival = DriveEnv(track=track, opponent=opponent, rules=config)
        rival.reset(seed=1)
        rival.step([0.0, -1.0])
        assert rival.batch.state.memory[0, 1, :2].any()
    scaled = vec.VecNormalize(vec.DummyVecEnv([lambda: env]), clip_obs=1.5)
    scaled.obs_rms.update(3.0 * seen_in(env) + 1.0)
    model.set_env(scaled)
    seen = env.reset(seed=3)[0][None]
    expected = np.clip(model.predict(scaled.normalize_obs(seen), deterministic=True)[0], -1.0, 1.0)
    kept = [racer(one).planner.drive for one in (save_model(tmp_path / "model", model), model)]
    for one in kept:
        np.testing.assert_allclose(one._answers(seen), expected, atol=1e-5)
    policy, _ = read_zip(file)
    assert policy.scale.clip == 1.5
    with zipfile.ZipFile(file, "a") as damaged, pytest.warns(UserWarning, match="Duplicate"):
        damaged.writestr(SCALE_FILE, json.dumps({"mean": [0.0], "spread": [1.0], "clip": 1.0}))
    refused("scale must hold mean and spread", racer, file)
