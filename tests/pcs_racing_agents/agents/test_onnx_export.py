"""An ONNX file computes the outputs of our network, in programs without our packages."""

import json
from types import SimpleNamespace

import numpy as np
import pytest
from refusal import refused

from pcs_racing import load_track
from pcs_racing.car.vehicle import F1TENTH
from pcs_racing.envs import DriveEnv, DuelEnv
from pcs_racing.planners import PATH_KAPPA, PATH_SPEED, VIEW, Lidar
from pcs_racing.planners.racers import racer
from pcs_racing.planners.scanning import BEAMS, FIELD_OF_VIEW, MAX_RANGE
from pcs_racing_agents.agents import PolicyOnCar, export_onnx, save_model
from pcs_racing_agents.agents.sb3_files import Sb3Policy, read_zip
from pcs_racing_agents.base.onnx_file import METADATA
from pcs_racing_agents.cli.main import main

pytest.importorskip("onnx")
runtime = pytest.importorskip("onnxruntime")


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(0)


def opened(model, folder) -> SimpleNamespace:
    """Export a model, and return a function of its inputs with its shapes and its description."""
    session = runtime.InferenceSession(export_onnx(model, folder / "network.onnx"))
    names = [one.name for one in session.get_outputs()]

    def outputs(**inputs):
        rows = {name: np.asarray(values, np.float32) for name, values in inputs.items()}
        return dict(zip(names, session.run(None, rows), strict=True))

    about = json.loads(session.get_modelmeta().custom_metadata_map[METADATA])
    described = about["inputs"].keys() | about.get("state", {}).keys()
    assert described == {one.name for one in session.get_inputs()}
    shapes = {one.name: one.shape[1:] for one in session.get_inputs()}
    return SimpleNamespace(outputs=outputs, about=about, shapes=shapes)


def close(found, expected) -> None:
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-5)


def test_ranges_become_the_commands_of_lidar_ppo(tmp_path, rng, monkeypatch):
    """The file holds the planner from the scan to the first command of its arc, and its memory."""
    track, network = load_track("Brackwater"), opened("lidar-ppo", tmp_path)
    monkeypatch.setattr(
        "pcs_racing_agents.agents.on_car.scans", lambda planner: False
    )  # as in a race
    on_car = PolicyOnCar("lidar-ppo", track)
    lidar = Lidar(track, beams=BEAMS, fov=FIELD_OF_VIEW, max_range=MAX_RANGE)
    memory = np.zeros((1, *network.shapes["memory"]))
    for k in range(30):
        s = rng.uniform(0.0, track.length)
        x, y, heading = track.to_cartesian([s, rng.uniform(-0.3, 0.3)])
        own = [x, y, rng.uniform(-0.4, 0.4), rng.uniform(0.0, 7.0), heading, rng.normal(), 0.0]
        x, y, heading = track.to_cartesian([(s + rng.uniform(1.0, 3.0)) % track.length, 0.0])
        ranges = lidar.scan(np.take(own, [0, 1, 4]), [x, y, heading])
        found = network.outputs(ranges=[ranges], own=[np.take(own, [3, 5, 2])], memory=memory)
        steering, speed = on_car.command(0.1 * k, own, [x, y, 0.0, 2.0, heading, 0.0, 0.0])
        close(found["next_memory"][0], on_car.memory)
        close(found["arc"][0], on_car.path[0, [PATH_KAPPA, PATH_SPEED]])
        assert found["command"][0, 1] == pytest.approx(speed, abs=1e-5)
        # The arc of the plan has twelve points, with straight lines between them.
        assert found["command"][0, 0] == pytest.approx(steering, abs=3e-3)
        memory = found["next_memory"]
    assert network.about["state"] == {"memory": "next_memory"}
    view = on_car.view
    for name, value in network.about["vehicle"].items():
        number = list(VIEW).index("WHEELBASE" if name == "wheelbase" else name.upper())
        assert value == pytest.approx(view[number], rel=1e-12), name


# Models of Stable-Baselines3


@pytest.fixture(scope="module")
def sb3():
    return pytest.importorskip("stable_baselines3")


def drawn(elements, rng) -> np.ndarray:
    """Draw observations within the bounds of their elements."""
    low, high = np.array([(one["low"], one["high"]) for one in elements]).T
    return rng.uniform(low, high, (50, len(low))).astype(np.float32)


@pytest.mark.parametrize(
    ("kind", "arguments"),
    [
        ("PPO", {"normalize": True, "beams": 9}),
        ("SAC", {"normalized": False, "see_opponent": "never"}),
    ],
)
def test_a_control_policy(tmp_path, rng, sb3, kind, arguments):
    env = DriveEnv(track="Pipkin", opponent=None, time_step=0.02, top_speed=6.0, **arguments)
    more = {"buffer_size": 9} if kind == "SAC" else {}
    model = getattr(sb3, kind)("MlpPolicy", env, seed=1, device="cpu", **more)
    network = opened(model, tmp_path)
    elements = network.about["inputs"]["observation"]
    rows = drawn(elements, rng)
    low, high = np.array([(one["low"], one["high"]) for one in elements]).T
    seen = 2.0 * (rows - low) / (high - low) - 1.0 if "normalize" in arguments else rows
    command = model.predict(seen.astype(np.float32), deterministic=True)[0]
    if kind == "PPO":
        command = np.array([F1TENTH.steer_max, 3.0]) * command + [0.0, 3.0]
    close(network.outputs(observation=rows)["command"], command)
    assert network.about["period"] == 0.02
    again = opened(save_model(tmp_path / "model", model), tmp_path)
    assert again.about["inputs"] == network.about["inputs"]
    close(again.outputs(observation=rows)["command"], command)


def test_the_scale_of_a_training_is_part_of_the_file(tmp_path, rng, sb3):
    vec = sb3.common.vec_env
    env = DriveEnv(track="Pipkin", opponent=None)
    scaled = vec.VecNormalize(vec.DummyVecEnv([lambda: env]), clip_obs=1.5)
    model = sb3.PPO("MlpPolicy", scaled, n_steps=4, batch_size=4, seed=1, device="cpu")
    network = opened(model, tmp_path)
    rows = drawn(network.about["inputs"]["observation"], rng)
    scaled.obs_rms.update(rows[:30])
    action = model.predict(scaled.normalize_obs(rows), deterministic=True)[0]
    command = np.array([F1TENTH.steer_max, 4.0]) * action + [0.0, 4.0]
    for trained in (model, racer(save_model(tmp_path / "model", model))):
        close(opened(trained, tmp_path).outputs(observation=rows)["command"], command)


def test_a_policy_of_moves(tmp_path, rng, sb3):
    env = DuelEnv(track="Pipkin", steps=(0.5,) * 3)
    model = sb3.PPO("MlpPolicy", env, seed=1, device="cpu")
    network = opened(model, tmp_path)
    assert [one["name"] for one in network.about["inputs"]["observation"]] == [
        one.name for one in env.elements
    ]
    rows = rng.normal(size=(50, *env.observation_space.shape)).astype(np.float32)
    moves = model.predict(rows, deterministic=True)[0]
    np.testing.assert_array_equal(network.outputs(observation=rows)["move"], moves)
    model.save(tmp_path / "moves.zip")
    again = opened(tmp_path / "moves.zip", tmp_path)
    np.testing.assert_array_equal(again.outputs(observation=rows)["move"], moves)
    assert read_zip(tmp_path / "moves.zip")[0].moves


# The command, and its refusals


def test_the_command_writes_a_file_and_refuses_early(tmp_path, capsys):
    file = tmp_path / "lidar.onnx"
    assert main(["export", "lidar-ppo", "--out", str(file)]) == 0
    assert capsys.readouterr().out == f"written: {file}\n"
    for words, said in {
        f"export lidar-ppo --out {tmp_path / 'file.zip'}": "its name must end in .onnx",
        f"export lidar-pp --out {file}": "no network 'lidar-pp'; did you mean 'lidar-ppo'?",
        f"export line-ppo --out {file}": "there is no network 'line-ppo'",
        f"export lattice --out {file}": "there is no network 'lattice'",
        f"export {tmp_path / 'model.zip'} --out {file}": "model.zip",
    }.items():
        assert main(words.split()) == 2
        assert said in capsys.readouterr().err
    assert [one.name for one in tmp_path.iterdir()] == ["lidar.onnx"]


def test_a_file_that_answers_otherwise_than_its_policy_is_not_written(tmp_path, monkeypatch, sb3):
    model = sb3.PPO("MlpPolicy", DuelEnv(track="Pipkin"), seed=1, device="cpu")
    model.save(tmp_path / "a.zip")
    zeros = lambda self, rows: (np.zeros(len(rows), np.int64), None)  # noqa: E731
    monkeypatch.setattr(Sb3Policy, "predict", zeros)
    refused("would answer move otherwise", export_onnx, tmp_path / "a.zip", tmp_path / "a.onnx")
    assert not (tmp_path / "a.onnx").exists()


def test_what_has_no_network_is_refused(tmp_path):
    refused("a float is no model of Stable-Baselines3", export_onnx, 1.0, tmp_path / "a.onnx")
    (tmp_path / "manifest.yaml").write_text("format: pcs-racing archive\n", encoding="utf-8")
    refused(
        "is a folder of 'archive'; it must be of lidar", export_onnx, tmp_path, tmp_path / "a.onnx"
    )
