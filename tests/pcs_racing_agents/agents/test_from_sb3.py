import gymnasium as gym
import numpy as np
import pytest

from pcs_racing import InputError
from pcs_racing.game.identity import game_identity
from pcs_racing_agents.agents import as_competitor
from pcs_racing_agents.agents.agent import competitor_hash
from pcs_racing_agents.agents.from_torch import network_from_sb3
from pcs_racing_agents.agents.zoo import build


@pytest.fixture(scope="module")
def models(oval, setting):
    """Untrained models with ReLUs and with SB3's default, tanh."""
    torch = pytest.importorskip("torch")
    PPO = pytest.importorskip("stable_baselines3").PPO

    env = gym.make("pcs_racing/Duel-v1", track=oval, archive=setting.archive, step_seconds=0.8, stay=True)
    relu = {"activation_fn": torch.nn.ReLU, "net_arch": [24, 16]}
    return [PPO("MlpPolicy", env, seed=0, policy_kwargs=kwargs, device="cpu") for kwargs in (relu, None)]


def test_a_model_decides_alike_as_our_own_network(models, game, setting, seen):
    model, rows = models[0], np.concatenate(seen)
    network = network_from_sb3(model, game_identity(game), training={"steps": 0})
    assert network.hidden == (24, 16)
    agent = build("ppo", setting, network=network)
    np.testing.assert_array_equal(agent.predict(rows)[0], model.predict(rows, deterministic=True)[0])

    torch = pytest.importorskip("torch")

    with torch.no_grad():
        chances = model.policy.get_distribution(torch.as_tensor(rows)).distribution.probs.numpy()
    drawn = build("ppo", setting, network=network, decision="softmax")
    np.testing.assert_allclose(drawn.probabilities(rows), chances, atol=1e-5)


def test_models_are_told_apart_by_their_weights(models):
    digests = {competitor_hash(as_competitor(model, name)) for model in models for name in ("a", "b")}
    assert len(digests) == 2


def test_other_models_are_refused(models, game):
    with pytest.raises(InputError, match=r"layer 1 .*Tanh"):
        network_from_sb3(models[1], game_identity(game))
    with pytest.raises(InputError, match="str has no actor"):
        network_from_sb3("model", game_identity(game))
