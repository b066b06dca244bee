"""How a learner explores, and what its environments answer when they are asked one by one."""

from dataclasses import replace

import numpy as np
import pytest

from pcs_racing import InputError, load_race_config, load_track, parse_policy
from pcs_racing.planners.network import INPUTS
from pcs_racing_agents.learning.ppo.drives import Drives
from pcs_racing_agents.learning.ppo.learner import make_learner, own_randomness


@pytest.fixture
def part():
    rules = load_race_config("contest", duration=2.0)
    return Drives(4, load_track("Pipkin"), rules, [parse_policy("lattice")])


@pytest.mark.parametrize("hidden", [(8,), ()])
def test_noise_may_last_for_some_steps(drive_settings, part, hidden):
    """With ``noise_steps`` it is drawn anew for a rollout's steps together, and about as large as without."""
    import torch

    settings = replace(drive_settings, noise=0.1, noise_steps=5, hidden=hidden)
    with own_randomness():
        policy = make_learner(settings, [part], 3, "tanh", 10.0).model.policy
        # Outputs of the layer before the last are about a half in size.
        seen = torch.as_tensor(np.random.default_rng(0).choice([-0.55, 0.55], (4, len(INPUTS))).astype(np.float32))
        mean = policy.forward(seen, deterministic=True)[0]
        tried = []
        for _ in range(200):
            policy.reset_noise(4)
            first, again = policy.forward(seen)[0], policy.forward(seen)[0]
            assert torch.equal(first, again)
            tried.append((first - mean).detach().numpy())
    np.testing.assert_allclose(np.std(tried), 0.1 * 0.55 / 0.5, rtol=0.1)
    assert len({row.tobytes() for row in tried}) == 200


def test_environments_of_a_part_are_not_asked_one_by_one(drive_settings, part):
    with own_randomness():
        envs = make_learner(drive_settings, [part], 3, "tanh", 10.0).model.env
    assert envs.get_attr("render_mode") == [None] * 4
    assert envs.get_images() == [None] * 4
    assert envs.env_is_wrapped(object) == [False] * 4
    with pytest.raises(AttributeError, match="no attribute 'track'"):
        envs.get_attr("track")
    with pytest.raises(InputError, match="'track' can't be set for single environments"):
        envs.set_attr("track", "Pipkin")
    with pytest.raises(AttributeError, match="no method 'action_masks'"):
        envs.env_method("action_masks")
