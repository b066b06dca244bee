import copy
import hashlib
import pickle
from pathlib import Path

import numpy as np
import pytest
import yaml
from refusal import refused
from safetensors.numpy import load as load_tensors, save as save_tensors
from toy_networks import MOVES, identity, plain_network, random_network
from zoo_games import untrained

from pcs_racing import InputError, load_rules, make_game
from pcs_racing.base.errors import UnknownNameError
from pcs_racing_agents.networks import (
    NetworkSet,
    RegretNetwork,
    list_networks,
    load_network,
    load_network_set,
    save_network_set,
)
from pcs_racing_agents.networks.network_files import NETWORK_FORMAT, save_network


@pytest.fixture
def network() -> RegretNetwork:
    return random_network()


def by_formula(network: RegretNetwork, x: np.ndarray) -> np.ndarray:
    x = (np.asarray(x, np.float64) - network.mean) / network.scale
    for i, (weight, bias) in enumerate(
        zip(network.layers.weights, network.layers.biases, strict=True)
    ):
        x = x @ weight.T.astype(np.float64) + bias
        x = np.maximum(x, 0.0) if i < len(network.layers.weights) - 1 or network.clipped else x
    return x


def observations(*shape, inputs=7, seed=0) -> np.ndarray:
    return np.random.default_rng(seed).normal(0.0, 2.0, (*shape, inputs)).astype(np.float32)


@pytest.mark.parametrize("hidden", [(), (5,), (64, 64), (3, 50, 7)])
@pytest.mark.parametrize("clipped", [False, True])
def test_values_are_those_of_the_formula(hidden, clipped):
    network = random_network(hidden=hidden, clipped=clipped)
    x = observations(3, 20)
    values = network(x)
    assert values.shape == (3, 20, 4)
    assert values.dtype == np.float32
    np.testing.assert_allclose(values, by_formula(network, x), rtol=1e-4, atol=1e-4)
    assert (values >= 0.0).all() == clipped


def values_network(*rows: list[float], clipped: bool) -> RegretNetwork:
    """A network that answers the i-th unit vector with the i-th row."""
    return plain_network(np.array(rows).T, clipped=clipped)


def test_bad_observations_are_refused_and_of_others_the_highest_value_before_clipping_chosen(
    network,
):
    refused(r"\(2, 6\); network 'toy' .*\(\.\.\., 7\)", network, np.zeros((2, 6)))
    refused(r"shape \(\)", network, 1.0)
    refused("NaN or infinity", network, [0.0, 0.0, np.nan, 0.0, 0.0, 0.0, 0.0])
    refused("NaN or infinity", values_network, [1e300] * 4, clipped=False)  # beyond float32
    assert network(np.zeros((0, 7))).shape == (0, 4)
    network = values_network(
        [1.0, 3.0, 2.0, -5.0], [-3.0, -4.0, -1.0, -2.0], [0.0, 0.0, 0.0, 0.0], clipped=True
    )
    np.testing.assert_array_equal(network(np.eye(3)), [[1.0, 3.0, 2.0, 0.0], [0.0] * 4, [0.0] * 4])
    np.testing.assert_array_equal(network.choose(np.eye(3)), [1, 2, 0])


def test_an_impossible_network_is_one_clear_error():
    for changes, message in [
        ({"name": ""}, "name is ''"),
        ({"identity": identity(8)}, "has 7 inputs"),
        ({"identity": identity(7, MOVES[:3])}, "puts out 4 values"),
        ({"scale": np.zeros(7)}, "scale is 0"),
        ({"mean": np.full(7, np.inf)}, "mean holds inf"),
        ({"mean": np.zeros(6)}, r"mean has shape \(6,\)"),
        ({"training": {"loss": [1]}}, r"training holds 'loss': \[1\]"),
    ]:
        refused(message, random_network, **changes)


def test_a_network_never_changes_and_shipped_ones_are_sound(network):
    for array in (*network.layers.weights, *network.layers.biases, network.mean, network.scale):
        refused("read-only", array.fill, 0.0, error=ValueError)
    with pytest.raises(TypeError):
        network.training["rows"] = 3
    for other in (pickle.loads(pickle.dumps(network)), copy.deepcopy(network)):
        np.testing.assert_array_equal(other(np.ones(7)), network(np.ones(7)))
    assert (
        repr(network) == "<RegretNetwork 'toy': 7-16-16-4, advantage, archive 'toy', rules 'paper'>"
    )
    assert list_networks() == sorted(
        path.parent.name for path in NETWORK_FORMAT.shipped.glob("*/manifest.yaml")
    )
    for name in list_networks():
        network = load_network(name)
        assert network.name == name
        assert network.training
        assert np.isfinite(network(np.zeros(len(network.elements)))).all()


@pytest.mark.parametrize("clipped", [False, True])
def test_a_network_reads_back_exactly(tmp_path, clipped):
    network = random_network(clipped=clipped, hidden=(9,))
    again = load_network(save_network(network, tmp_path / "deep" / "net"))
    for key in ("name", "identity", "target", "clipped", "hidden", "training"):
        assert getattr(again, key) == getattr(network, key), key
    np.testing.assert_array_equal(again(observations(50)), network(observations(50)))
    assert load_network(network) is network
    before = {file.name: file.read_bytes() for file in (tmp_path / "deep" / "net").iterdir()}
    assert set(before) == {"weights.safetensors", "manifest.yaml"}
    save_network(again, tmp_path / "copy")
    assert {file.name: file.read_bytes() for file in (tmp_path / "copy").iterdir()} == before


def edit(folder: Path, **changes) -> None:
    file = folder / "manifest.yaml"
    manifest = {**yaml.safe_load(file.read_text()), **changes}
    file.write_text(
        yaml.safe_dump({key: value for key, value in manifest.items() if value != "gone"})
    )


def other_weights(folder: Path, change) -> None:
    content = save_tensors(change(load_tensors((folder / "weights.safetensors").read_bytes())))
    (folder / "weights.safetensors").write_bytes(content)
    edit(folder, weights_sha256=hashlib.sha256(content).hexdigest())


@pytest.mark.parametrize(
    ("harm", "message"),
    [
        (lambda f: (f / "weights.safetensors").write_bytes(b"abc"), "its digest differs"),
        (lambda f: edit(f, clipped="yes"), "clipped is 'yes'"),
        (lambda f: edit(f, moves=[1, 2, 3, 4]), "moves is .*list of names"),
        (lambda f: edit(f, training=[]), "training is ..; it must hold texts and numbers by name"),
        (lambda f: edit(f, elements=["a"]), "has 7 inputs"),
        (lambda f: edit(f, elements=["a"] * 7), "elements .*each once"),
        *[(lambda f, e=e: edit(f, epsilon=e), "epsilon is") for e in ([-1.0], [0.5, 0.5], [])],
        (
            lambda f: other_weights(f, lambda t: {**t, "input.mean": np.full(7, np.nan, "f")}),
            "mean holds nan",
        ),
    ],
)
def test_a_damaged_network_is_one_clear_error(tmp_path, network, harm, message):
    harm(save_network(network, tmp_path))
    with pytest.raises(InputError, match=message) as caught:
        load_network(tmp_path)
    assert "\n" not in str(caught.value) or "YAML" in message


@pytest.fixture(scope="module")
def game():
    return make_game("Pipkin", epsilon=0.35)


def made_for(game, **changes) -> RegretNetwork:
    known = game.identity._replace(**changes)
    return plain_network(np.zeros((len(known.moves), len(known.elements))), identity=known)


def test_a_network_of_the_game_fits(game):
    made_for(game).check_fits(game)
    # the move that it does not know comes last
    made_for(game).check_fits(make_game("Pipkin", epsilon=0.35, stay=True))
    rules = load_rules("contest", front_pace=(1.0, 1.0), steps=(8.0,) * 5, epsilon=0.35)
    made_for(game).check_fits(make_game("Tarnfjord", rules=rules, stay=False))
    state = game.reset(games=2)
    assert made_for(game).choose(game.observation(state)).shape == (2, 2)


def test_a_network_of_another_game_is_one_clear_error(game):
    for made, played, message in [
        ({}, {"steps": (8.0,) * 4}, "games of 4 moves"),
        (
            {},
            {"characteristics": ("restraint", "aggressiveness")},
            "'own_aggressiveness_0' at place 0",
        ),
        ({}, {"epsilon": 0.7}, r"epsilon 0.35"),
        ({}, {"epsilon": (0.2, 0.4)}, r"values moves 4 \(.*\)"),
        ({"archive": "x", "archive_sha256": "abc"}, {}, r"made for archive 'x' \(sha256 abc\)"),
        ({"moves": (*MOVES, "fly")}, {}, "values moves 5"),
    ]:
        made_for(game, archive="renamed").check_fits(game)
        refused(
            message,
            made_for(game, **made).check_fits,
            make_game("Pipkin", **({"epsilon": 0.35} | played)),
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
