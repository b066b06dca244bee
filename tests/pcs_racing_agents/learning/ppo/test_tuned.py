"""Tuned settings of PPO: every environment has them, and they are what rl_zoo3 expects."""

from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest
from refusal import refused

from pcs_racing.base.errors import ConfigError, UnknownNameError
from pcs_racing.envs import GYMNASIUM_IDS, PETTINGZOO_IDS
from pcs_racing_agents.learning.ppo.tuned import learning_rate, tuned_environments, tuned_ppo


def test_every_environment_has_settings_and_others_are_refused():
    assert set(tuned_environments()) == {*GYMNASIUM_IDS, *PETTINGZOO_IDS}
    refused("Match-v0", tuned_ppo, "pcs_racing/Match-v1", error=UnknownNameError)
    falling = learning_rate("lin_1e-3")
    assert [falling(1.0), falling(0.5), falling(0.0)] == [1e-3, 5e-4, 0.0]
    assert learning_rate(0.01) == 0.01
    for value in ["lin_", "cos_1e-3", "1e-3", "lin_-1", "lin_nan"]:
        refused("learning_rate is", learning_rate, value, error=ConfigError)


@pytest.mark.parametrize("name", tuned_environments())
def test_models_are_made_and_act(name):
    pytest.importorskip("stable_baselines3")
    tuned = tuned_ppo(name)
    small = {**tuned.settings, "n_steps": 4, "batch_size": 8}
    model = replace(tuned, num_envs=2, settings=small).make_model(seed=3)
    assert model.n_envs == 2
    assert (model.get_vec_normalize_env() is not None) == tuned.normalize
    assert model.lr_schedule(1.0) == pytest.approx(
        float(tuned.settings["learning_rate"].removeprefix("lin_"))
    )
    seen = model.get_env().reset()
    assert np.isfinite(seen).all()
    seen, rewards, _, _ = model.get_env().step(model.predict(seen)[0])
    assert np.isfinite(rewards).all()


@pytest.mark.parametrize("name", sorted(GYMNASIUM_IDS))
def test_gymnasium_makes_the_task_that_rl_zoo3_reads(name):
    tuned = tuned_ppo(name)
    env = gym.make(name, **tuned.arguments)
    assert env.observation_space == tuned.make_envs(1).observation_space
    env.close()
