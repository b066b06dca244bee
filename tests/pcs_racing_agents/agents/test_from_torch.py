"""Torch modules as competitors."""

import numpy as np
import pytest

from pcs_racing import InputError
from pcs_racing_agents.agents.agent import competitor_hash
from pcs_racing_agents.agents.from_torch import TorchPolicy

torch = pytest.importorskip("torch")


def linear(seed):
    torch.manual_seed(seed)
    return torch.nn.Sequential(torch.nn.Linear(5, 3), torch.nn.Dropout(0.5))


def test_the_move_with_the_largest_output_is_made():
    module = linear(0)
    weight, bias = module[0].weight.detach().numpy(), module[0].bias.detach().numpy()
    seen = np.random.default_rng(0).normal(size=(20, 5)).astype(np.float32)
    policy = TorchPolicy(module, "mine")
    moves, state = policy.predict(seen)
    np.testing.assert_array_equal(moves, (seen @ weight.T + bias).argmax(axis=1))  # the dropout is off
    assert state is None
    assert policy.predict(seen[3])[0].shape == ()
    assert policy.predict(seen[3])[0] == moves[3]


def test_its_weights_tell_it_from_others():
    assert competitor_hash(TorchPolicy(linear(0))) == competitor_hash(TorchPolicy(linear(0), "other name"))
    assert competitor_hash(TorchPolicy(linear(0))) != competitor_hash(TorchPolicy(linear(1)))


def test_what_is_no_network_of_moves_is_refused():
    broken = linear(0)
    with torch.no_grad():
        broken[0].bias[1] = float("nan")
    for wrong in ("text", broken):
        with pytest.raises(InputError):
            TorchPolicy(wrong)
    seen = np.zeros((4, 5), np.float32)
    with pytest.raises(InputError, match=r"\(1, 5\)"):
        TorchPolicy(Summed()).predict(seen)


class Summed(torch.nn.Module):
    def forward(self, seen):
        return seen.sum(dim=0, keepdim=True)
