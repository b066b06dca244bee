"""Sets of networks as folders."""

import numpy as np
import pytest
import yaml
from refusal import refused
from zoo_games import untrained

from pcs_racing.base.errors import UnknownNameError
from pcs_racing_agents.networks import (
    NetworkSet,
    list_networks,
    load_network_set,
    save_network,
    save_network_set,
)


@pytest.fixture
def known(spec) -> NetworkSet:
    networks = tuple(untrained(spec, "advantage", seed) for seed in (1, 2))
    return NetworkSet("two", networks, np.array([3.0, 1.0]), "argmax", {"rounds": 2})


def test_a_set_comes_back_as_it_was_and_others_are_refused(known, tmp_path):
    folder = save_network_set(known, tmp_path / "set")
    back = load_network_set(folder)
    assert (back.name, back.decision, back.training) == ("two", "argmax", {"rounds": 2})
    np.testing.assert_array_equal(back.weights, [0.75, 0.25])
    for own, other in zip(known.networks, back.networks, strict=True):
        np.testing.assert_array_equal(own.layers.weights[0], other.layers.weights[0])
    assert load_network_set(back) is back
    assert "set" not in list_networks()
    refused("0 networks", NetworkSet, "none", (), np.zeros(0), "argmax")
    refused("weights", NetworkSet, "odd", known.networks, np.array([1.0, -1.0]), "argmax")
    refused("'nowhere'", load_network_set, "nowhere", error=UnknownNameError)


def test_a_set_is_replaced_as_a_whole_and_another_network_in_it_is_refused(known, spec, tmp_path):
    save_network_set(known, tmp_path / "set")
    one = NetworkSet("one", known.networks[:1], np.ones(1), "argmax")
    assert len(load_network_set(save_network_set(one, tmp_path / "set")).networks) == 1
    folder = save_network_set(known, tmp_path / "set")
    save_network(untrained(spec, "advantage", 9), folder / "01")
    refused("a digest differs", load_network_set, folder)


@pytest.mark.parametrize(
    ("change", "value"),
    [
        ({"weights": [1.0]}, r"weights has shape \(1,\)"),
        ({"weights": ["a", "b"]}, "weights"),
        ({"networks": 3}, "networks is 3"),
        ({"digests": ["0"]}, "digest differs"),
        ({"networks": ["00", "../01"]}, "../01"),
        ({"decision": 3}, "3"),
        ({"training": []}, r"\[\]"),
        ({"weights": [0.0, 0.0]}, "not all of them 0"),
    ],
)
def test_a_damaged_set_is_one_clear_error(known, tmp_path, change, value):
    file = save_network_set(known, tmp_path) / "set.yaml"
    file.write_text(yaml.safe_dump({**yaml.safe_load(file.read_text()), **change}))
    refused(value, load_network_set, tmp_path)
