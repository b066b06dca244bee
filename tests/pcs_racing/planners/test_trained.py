"""Trained drivers: planners with constant weights, as folders."""

from dataclasses import replace

import numpy as np
import pytest
import yaml
from random_layers import random_layers
from refusal import refused

from pcs_racing.base.dense import DenseLayers
from pcs_racing.base.errors import UnknownNameError
from pcs_racing.planners import trained
from pcs_racing.planners.network import INPUTS, network_planner
from pcs_racing.planners.trained import load_trained, read_trained, save_trained, trained_planner
from pcs_racing.planners.view import TIME, VIEW_SIZE


def layers(*hidden: int) -> DenseLayers:
    return random_layers(len(INPUTS), *hidden, 2, seed=1)


@pytest.fixture
def folder(tmp_path):
    return save_trained(tmp_path / "mine", layers(6), name="mine", hold=4, training={"steps": 7})


def test_what_is_written_is_read_and_compiled_once(folder):
    found, manifest = read_trained(folder)
    np.testing.assert_array_equal(found.flat(), layers(6).flat())
    assert manifest["training"] == {"steps": 7}
    planner = load_trained(folder)
    assert (planner.name, planner.parameters, planner.sight) == ("mine", (), 8.0)
    assert load_trained(folder).control is trained_planner("other", layers(6), 4).control
    assert load_trained(folder).control is not trained_planner("mine", layers(6), 2).control


@pytest.mark.parametrize("hidden", [(), (6,), (5, 3)])
def test_a_decision_is_that_of_the_network_planner_and_holds(oval, view_at, hidden):
    own = layers(*hidden)
    driver, plain = trained_planner("mine", own, 4), network_planner("plain", hidden, own.flat())
    memory, commands = np.zeros(driver.memory_size), []
    for time, speed in ((0.0, 3.0), (0.02, 4.0), (0.04, 4.0)):
        view = view_at(oval, 5.0, 0.3, speed=speed)
        view[TIME] = time
        for planner, theta in ((driver, np.zeros(0)), (plain, plain.default)):
            command = np.full(2, np.nan)
            planner.control(
                oval.arrays, theta, view, memory, np.empty(64), np.zeros((12, 4)), command
            )
            commands.append(command)
    assert view.shape == (VIEW_SIZE,)
    held, faster = commands[::2], commands[1::2]
    np.testing.assert_array_equal(held[0], faster[0])
    np.testing.assert_array_equal(held[1], held[0])  # half of the time that a decision holds
    np.testing.assert_array_equal(held[2], faster[2])
    assert (faster[1] != faster[0]).any()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"format": "pcs-racing network"}, "manifest of a driver"),
        ({"version": 2}, "has version 2"),
        ({"inputs": ["speed"]}, "made for other inputs"),
        ({"top_speed": 9.0}, "other inputs"),
        ({"hidden": [7]}, r"hidden layers \[6\]; .*\[7\]"),
        ({"hidden": [6, 6]}, "unknown or missing layers.2.bias"),
        ({"hidden": "6"}, "hidden is '6'"),
        ({"hold": 3}, "for 3 steps"),
        ({"hold": "4"}, "for '4' steps"),
        ({"name": 3}, "name must be a text"),
        ({"extra": 3}, "unknown or missing extra"),
    ],
)
def test_manifests_that_do_not_fit_are_refused(folder, changes, message):
    file = folder / "manifest.yaml"
    file.write_text(yaml.safe_dump({**yaml.safe_load(file.read_text()), **changes}))
    refused(message, load_trained, folder)


def test_files_and_layers_that_are_no_driver_are_refused(folder, tmp_path):
    content = (folder / "weights.safetensors").read_bytes()
    (folder / "weights.safetensors").write_bytes(content[:-1] + bytes([content[-1] ^ 1]))
    refused("its digest differs", load_trained, folder)
    with pytest.raises(
        UnknownNameError, match="unknown driver 'nobody': neither a folder nor one of those shipped"
    ):
        load_trained("nobody")
    refused(r"can't read .*manifest\.yaml", load_trained, tmp_path)
    sound = layers(8)
    refused(
        "16 inputs and 8 outputs",
        trained_planner,
        "d",
        DenseLayers(sound.weights[:1], sound.biases[:1]),
        2,
    )
    refused(
        "a weight of 11",
        trained_planner,
        "d",
        DenseLayers(sound.weights, (sound.biases[0], np.full(2, 11))),
        2,
    )
    refused("for 3 steps", trained_planner, "d", sound, 3)


def test_the_shipped_driver_is_read_when_it_is_first_asked_for(folder, monkeypatch):
    monkeypatch.setattr(trained, "NAME", "mine")
    monkeypatch.setattr(
        trained, "PLANNER_FORMAT", replace(trained.PLANNER_FORMAT, shipped=folder.parent)
    )
    monkeypatch.delitem(vars(trained), "PPO_DRIVE", raising=False)
    assert trained.PPO_DRIVE.name == "mine"
    assert trained.PPO_DRIVE is trained.PPO_DRIVE  # a planner is compared by identity
    with pytest.raises(AttributeError, match="no attribute 'OTHER'"):
        trained.OTHER  # noqa: B018
    del trained.PPO_DRIVE  # monkeypatch puts back what was there
