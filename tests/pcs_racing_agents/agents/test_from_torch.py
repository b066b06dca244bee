"""Torch modules as agents."""

import gymnasium as gym
import numpy as np
import pytest
from refusal import refused

from pcs_racing.game.players import competitor
from pcs_racing_agents.agents.agent import competitor_hash
from pcs_racing_agents.agents.from_torch import TorchPolicy

torch = pytest.importorskip("torch")


def linear(seed):
    torch.manual_seed(seed)
    return torch.nn.Sequential(torch.nn.Linear(5, 3), torch.nn.Dropout(0.5))


def test_the_move_with_the_largest_output_is_made_and_what_is_no_network_refused():
    module = linear(0)
    weight, bias = module[0].weight.detach().numpy(), module[0].bias.detach().numpy()
    seen = np.random.default_rng(0).normal(size=(20, 5)).astype(np.float32)
    policy = TorchPolicy(module, "mine")
    # the dropout is off
    np.testing.assert_array_equal(policy.act(seen), (seen @ weight.T + bias).argmax(axis=1))
    broken = linear(0)
    with torch.no_grad():
        broken[0].bias[1] = float("nan")
    refused("module is a str", TorchPolicy, "text")
    refused("'0.bias' .* NaN", TorchPolicy, broken)
    seen = np.zeros((4, 5), np.float32)
    refused(r"\(1, 5\)", TorchPolicy(Summed()).act, seen)


def test_models_are_told_apart_by_their_weights_and_others_are_refused(models, game):
    assert competitor_hash(TorchPolicy(linear(0))) == competitor_hash(
        TorchPolicy(linear(0), "other name")
    )
    assert competitor_hash(TorchPolicy(linear(0))) != competitor_hash(TorchPolicy(linear(1)))
    digests = {
        competitor_hash(competitor(model, game, name=name))
        for model in models
        for name in ("a", "b")
    }
    assert len(digests) == 2


class Summed(torch.nn.Module):
    def forward(self, seen):
        return seen.sum(dim=0, keepdim=True)


@pytest.fixture(scope="module")
def models(oval, spec):
    """Untrained models with ReLUs and with SB3's default, tanh."""
    PPO = pytest.importorskip("stable_baselines3").PPO

    env = gym.make(
        "pcs_racing/Duel-v1", track=oval, archive=spec.archive, step_seconds=0.8, stay=True
    )
    relu = {"activation_fn": torch.nn.ReLU, "net_arch": [24, 16]}
    return [
        PPO("MlpPolicy", env, seed=0, policy_kwargs=kwargs, device="cpu") for kwargs in (relu, None)
    ]
