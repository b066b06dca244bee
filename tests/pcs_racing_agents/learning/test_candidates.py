"""Policies that score candidates: first the lattice, line-ppo with its weights, always racers."""

import pickle

import numpy as np
import pytest
from refusal import refused

from pcs_racing import load_track, racer, run_races
from pcs_racing.envs import LineVectorEnv, make_sb3_vec_env, split_observation
from pcs_racing.planners.line_ppo import (
    LATTICE_SIZE,
    flat_weights,
    network_policy,
    read_line_planner,
    tensors_of,
)

torch = pytest.importorskip("torch")
stable = pytest.importorskip("stable_baselines3")
contrib = pytest.importorskip("sb3_contrib")

from pcs_racing_agents.agents import export_onnx, save_model  # noqa: E402
from pcs_racing_agents.learning import (  # noqa: E402
    CandidateNetwork,
    CandidatePolicy,
    MaskableCandidatePolicy,
)

SMALL = {"n_steps": 8, "batch_size": 16, "n_epochs": 1, "seed": 0, "device": "cpu"}
KINDS = {
    "plain": (stable.PPO, CandidatePolicy),
    "masked": (contrib.MaskablePPO, MaskableCandidatePolicy),
}


@pytest.fixture(scope="module")
def models():
    env = make_sb3_vec_env("line", 4, track="Pipkin", style={"pace": 1.0, "risk": (0.0, 0.1)})
    return {
        name: algorithm(policy, env, **SMALL).learn(64)
        for name, (algorithm, policy) in KINDS.items()
    }


def test_it_begins_as_the_lattice():
    seen, infos = LineVectorEnv(16).reset(seed=1)
    with torch.no_grad():
        logits = CandidateNetwork()(torch.from_numpy(seen)).numpy()
    cost = split_observation(seen)["candidates"][..., -1]
    np.testing.assert_array_equal(logits > -1e8, infos["action_mask"] == 1)
    cheapest = np.where(cost < 0.0, np.inf, cost).argmin(axis=1)
    np.testing.assert_array_equal(logits.argmax(axis=1), cheapest)


def test_with_the_weights_of_line_ppo_it_drives_as_line_ppo():
    numbers, network = read_line_planner("line-ppo")[1][LATTICE_SIZE:], CandidateNetwork()
    network.load("line-ppo")
    np.testing.assert_array_equal(flat_weights(tensors_of(numbers)), numbers)
    learned = {key: torch.tensor(one).requires_grad_() for key, one in network.tensors().items()}
    policy = network_policy(learned, style={"risk": 0.5})
    both = [policy, racer("line-ppo:risk=0.5")]
    result = run_races(load_track("Pipkin"), both, "lattice", "contest", seed=3)
    same = run_races(load_track("Pipkin"), both[::-1], "lattice", "contest", seed=3)
    np.testing.assert_array_equal(result.state.cars, same.state.cars)


@pytest.mark.parametrize("kind", KINDS)
def test_a_model_and_its_zip_race_in_the_style_of_the_training(models, kind, tmp_path):
    save_model(tmp_path / "model.zip", models[kind])
    for made in (racer(models[kind]), racer(str(tmp_path / "model.zip"))):
        own = models[kind].policy.action_net.tensors()
        policy = network_policy(own, style={"pace": 1.0, "risk": 0.1})
        np.testing.assert_allclose(made.parameters, policy.parameters, atol=1e-12)
    assert np.isfinite(run_races(load_track("Pipkin"), [made] * 2, "lattice", "contest").lead).all()
    loaded = KINDS[kind][0].load(tmp_path / "model.zip")
    np.testing.assert_array_equal(racer(loaded).parameters, made.parameters)


def test_other_spaces_policies_and_files_are_refused_by_one_line(models, tmp_path):
    refused(
        "it learns in pcs_racing/Line-v0",
        stable.PPO,
        CandidatePolicy,
        make_sb3_vec_env("duel", 2),
        **SMALL,
    )
    plain = stable.PPO("MlpPolicy", models["plain"].get_env(), **SMALL)
    plain.save(tmp_path / "plain.zip")
    for given in (plain, str(tmp_path / "plain.zip")):
        refused("another policy than CandidatePolicy", racer, given)
    refused("no ONNX file", export_onnx, models["plain"], tmp_path / "model.onnx")
    models["plain"].save(tmp_path / "model.zip")
    bold = make_sb3_vec_env("line", 2, track="Pipkin", style={"risk": 1.0})
    moved = stable.PPO.load(tmp_path / "model.zip", env=bold)
    refused("set model.observation_space", racer, moved)
    moved.observation_space = bold.observation_space
    assert racer(moved).parameters[0] == 1.0
    own = SMALL | {"policy_kwargs": {"net_arch": [32]}}
    refused("net_arch is .* has its own", stable.PPO, CandidatePolicy, bold, **own)
    refused("is for MaskablePPO; PPO has", stable.PPO, MaskableCandidatePolicy, bold, **SMALL)
    for tensors, style in ((None, None), ({}, 3), ({"score.bias": "x"}, None), ({3: 1}, None)):
        refused("line-network: ", network_policy, tensors, style=style)


def test_a_frozen_copy_is_replaced_for_later_races():
    first, later = (
        network_policy(network.tensors()) for network in (CandidateNetwork(), CandidateNetwork())
    )
    envs = LineVectorEnv(2, opponent=[first, "lattice"], track="Pipkin")
    envs.set_opponent(0, later)
    envs.set_opponent_weights([1.0, 1e-9])
    for one in (envs, pickle.loads(pickle.dumps(envs))):  # a copy has the later opponent, too
        one.reset(seed=1)
        np.testing.assert_array_equal(one.batch.theta[:, 1], [later.parameters] * 2)
    envs.set_opponent(0, pickle.loads(pickle.dumps(first)))
    refused("index is 2", envs.set_opponent, 2, later)
    refused("only another policy of .* can replace it", envs.set_opponent, 1, later)
