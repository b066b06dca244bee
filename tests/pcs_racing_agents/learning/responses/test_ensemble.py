from itertools import pairwise

import numpy as np
import pytest
from refusal import refused

from pcs_racing.base.dense import DenseLayers
from pcs_racing.base.errors import InputError
from pcs_racing.game.identity import GameIdentity
from pcs_racing_agents.learning.responses import merge_networks
from pcs_racing_agents.networks import RegretNetwork

GAME = GameIdentity(("a", "b", "c"), ("left", "right"), (0.35,), "toy", "0" * 64, "paper")


def network(seed: int, hidden: tuple[int, ...] = (5, 4), clipped: bool = False) -> RegretNetwork:
    rng = np.random.default_rng(seed)
    sizes = [3, *hidden, 2]
    return RegretNetwork(
        name=f"net-{seed}",
        identity=GAME,
        target="advantage",
        clipped=clipped,
        layers=DenseLayers(
            tuple(rng.normal(size=(b, a)) for a, b in pairwise(sizes)), tuple(rng.normal(size=b) for b in sizes[1:])
        ),
        mean=rng.normal(size=3).astype(np.float32),
        scale=rng.uniform(0.5, 2.0, 3).astype(np.float32),
    )


@pytest.mark.parametrize("hidden", [(), (6,), (5, 4), (4, 3, 5)])
def test_the_merged_network_puts_out_the_mean(hidden):
    members = [network(seed, hidden) for seed in range(3)]
    x = np.random.default_rng(9).normal(size=(20, 3))
    merged = merge_networks(members, "merged")
    np.testing.assert_allclose(merged(x), np.mean([m(x) for m in members], axis=0), atol=2e-5)


def test_members_may_differ_in_width_but_not_in_kind():
    merge_networks([network(0, (5, 4)), network(1, (2, 7))], "merged")
    refused("different numbers of layers", merge_networks, [network(0), network(1, (5,))], "merged")
    with pytest.raises(InputError, match="networks 'net-0' and 'net-1' differ in clipped"):
        merge_networks([network(0), network(1, clipped=True)], "merged")
    refused("give at least one", merge_networks, [], "merged")
    refused("mean of clipped networks", merge_networks, [network(0, clipped=True), network(1, clipped=True)], "merged")
