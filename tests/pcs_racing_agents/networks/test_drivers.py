"""Trained drivers as folders."""

import pickle
import shutil

import numpy as np
import pytest
import yaml

from pcs_racing import InputError, get_planner, make_game
from pcs_racing.base.errors import UnknownNameError
from pcs_racing.planners.network import INPUTS
from pcs_racing_agents.agents import make
from pcs_racing_agents.networks import driver
from pcs_racing_agents.networks.layers import Layers
from pcs_racing_agents.networks.network_files import list_networks, shipped_folder
from pcs_racing_agents.tournament import cross_pairing, play_pairing

made_under_v0 = pytest.mark.xfail(
    reason="shipped archives, networks and figures were made under -v0; they are made again once all races have changed"
)


@pytest.fixture(scope="module")
def layers():
    rng = np.random.default_rng(1)
    shapes = [(6, len(INPUTS)), (2, 6)]
    return Layers(
        tuple(rng.normal(size=shape).astype(np.float32) for shape in shapes),
        tuple(rng.normal(size=shape[0]).astype(np.float32) for shape in shapes),
    )


@pytest.fixture
def folder(layers, tmp_path):
    return driver.save_driver(tmp_path / "mine", layers, name="mine", hold=4, training={"steps": 7})


def test_what_is_written_is_read(layers, folder):
    found, manifest = driver.read_driver(folder)
    for one, two in zip((*found.weights, *found.biases), (*layers.weights, *layers.biases), strict=True):
        np.testing.assert_array_equal(one, two)
    assert manifest["training"] == {"steps": 7}
    planner = driver.load_driver(folder)
    assert (planner.name, planner.parameters, planner.sight) == ("mine", (), 8.0)


def test_equal_drivers_are_compiled_once(layers, folder):
    assert driver.load_driver(folder).control is driver.driver_planner("other", layers, 4).control
    assert driver.load_driver(folder).control is not driver.driver_planner("mine", layers, 2).control


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"format": "pcs-racing network"}, "is no manifest of a driver"),
        ({"version": 2}, "has version 2; this release reads version 1"),
        ({"inputs": ["speed"]}, "made for other inputs"),
        ({"top_speed": 9.0}, "made for other inputs or another top speed"),
        ({"hidden": [7]}, r"has hidden layers \[6\]; .* says \[7\]"),
        ({"hidden": [6, 6]}, "it must hold layers.0.bias"),
        ({"hidden": "6"}, "hidden is '6'; it must be a list"),
        ({"hold": 3}, "holds its decisions for 3 steps"),
        ({"hold": "4"}, "holds its decisions for '4' steps"),
        ({"name": 3}, "name must be a text"),
        ({"extra": 3}, "unknown or missing extra"),
    ],
)
def test_manifests_that_do_not_fit_are_refused(folder, changes, message):
    file = folder / "driver.yaml"
    file.write_text(yaml.safe_dump({**yaml.safe_load(file.read_text()), **changes}))
    with pytest.raises(InputError, match=message):
        driver.load_driver(folder)


def test_files_that_are_no_driver_are_refused(folder, tmp_path):
    content = (folder / "weights.safetensors").read_bytes()
    (folder / "weights.safetensors").write_bytes(content[:-1] + bytes([content[-1] ^ 1]))
    with pytest.raises(InputError, match="its digest differs"):
        driver.load_driver(folder)
    (folder / "weights.safetensors").unlink()
    with pytest.raises(InputError, match=r"can't read .*weights\.safetensors"):
        driver.load_driver(folder)
    (folder / "driver.yaml").write_text("a: [1")
    with pytest.raises(InputError, match="is not valid YAML"):
        driver.load_driver(folder)
    with pytest.raises(UnknownNameError, match="unknown driver 'nobody': neither a folder nor one of those shipped"):
        driver.load_driver("nobody")
    with pytest.raises(InputError, match=r"can't read .*driver\.yaml"):
        driver.load_driver(tmp_path)


def test_the_shipped_driver_stands_beside_the_networks(folder, monkeypatch, tmp_path):
    shutil.copytree(folder, tmp_path / "ppo-drive")
    monkeypatch.setattr(driver, "shipped_folder", lambda: tmp_path)
    monkeypatch.delitem(vars(driver), "PPO_DRIVE", raising=False)
    assert driver.load_driver().name == "mine"
    assert driver.PPO_DRIVE is driver.PPO_DRIVE  # a planner is compared by identity
    with pytest.raises(AttributeError, match="no attribute 'OTHER'"):
        driver.OTHER  # noqa: B018
    del driver.PPO_DRIVE  # monkeypatch puts back what was there


def test_the_zoo_races_the_shipped_driver_or_another_one(folder):
    shipped, mine = make("ppo-drive"), make("ppo-drive", network=folder)
    assert shipped.planner is get_planner("ppo-drive")
    assert pickle.loads(pickle.dumps(shipped)).planner is shipped.planner
    assert mine.planner.name == "mine"
    assert len({shipped.content_hash, mine.content_hash, make("pure-pursuit").content_hash}) == 3
    with pytest.raises(UnknownNameError, match="unknown driver 'nobody'"):
        make("ppo-drive", network="nobody")


def test_drivers_with_other_weights_have_other_hashes(layers, tmp_path):
    """They are of one name and have no parameters: results of one must not be taken for the other's."""
    hashes = set()
    for factor in (1.0, 1.5):
        scaled = Layers(tuple(factor * weight for weight in layers.weights), layers.biases)
        place = driver.save_driver(tmp_path / f"{factor}", scaled, name="mine", hold=4, training={})
        hashes.add(make("ppo-drive", network=place).content_hash)
    assert len(hashes) == 2


@made_under_v0
def test_the_shipped_driver_drives_away_from_slower_cars_on_a_circuit_that_it_has_never_seen():
    game = make_game("Saltmere", "default", "contest", threads=1)
    pairing = cross_pairing(game, make("ppo-drive"), make("pure-pursuit"), egos=1, opponents=1, lines=4, seed=5)
    races = play_pairing(pairing)
    ahead = races.side == 0
    assert ahead.sum() == 4
    assert (races.lead[ahead] > 30.0).all()
    assert not races.crashed.any()


def test_drivers_are_not_taken_for_networks():
    assert not {path.parent.name for path in shipped_folder().glob("*/driver.yaml")} & set(list_networks())
