"""Lidar planners with networks: their folders, and the network that corrects a planner."""

import numpy as np
import pytest
import yaml
from random_layers import random_layers
from refusal import refused

from pcs_racing.base.errors import UnknownNameError
from pcs_racing.planners.field import lidar_networks as networks
from pcs_racing.planners.field import residual
from pcs_racing.planners.field.potential_field import POTENTIAL_FIELD
from pcs_racing.planners.registry import get_planner
from pcs_racing.planners.view import PATH_POINTS, WHEELBASE


def pairs(network: str) -> list:
    found = [random_layers(*sizes, seed=i) for i, sizes in enumerate(networks.LAYERS[network])]
    return [(layer.weights[0], layer.biases[0]) for layer in found]


@pytest.fixture
def folder(tmp_path):
    return networks.save_lidar_planner(
        tmp_path / "mine", "ppo", pairs("ppo"), name="mine", training={"rounds": 7}
    )


@pytest.mark.parametrize("network", sorted(networks.LAYERS))
def test_what_is_written_is_read(tmp_path, network):
    folder = networks.save_lidar_planner(
        tmp_path / "mine", network, pairs(network), name="mine", training={}
    )
    name, kind, flat = networks.read_lidar_planner(folder)
    assert (name, kind) == ("mine", network)
    np.testing.assert_array_equal(flat, networks.flat_weights(pairs(network)))
    planner = networks.load_lidar_planner(folder)
    assert planner.plan is networks.load_lidar_planner(folder).plan  # compiled once
    assert "speed_share" in planner.parameter_names


def test_a_network_corrects_the_potential_field(oval, view_at):
    layers, view = pairs("residual"), view_at(oval, 3.0, speed=4.0, gap=2.0, opp_d=0.3)
    scratch, out = np.zeros(residual.SCRATCH), np.zeros(residual.SEEN)
    field, none, full = np.zeros((3, PATH_POINTS, 4))
    plan = residual.frozen_plan(networks.flat_weights(layers).tobytes())
    for share, path in ((0.0, none), (1.0, full)):
        plan(oval.arrays, np.array([share, 1.0]), view, out, scratch, path)
    POTENTIAL_FIELD.plan(oval.arrays, POTENTIAL_FIELD.default, view, out, scratch, field)
    np.testing.assert_array_equal(none, field)
    steering, speed = residual.observe(oval.arrays, view, scratch, out)
    for weight, bias in layers:
        out = np.tanh(weight @ out + bias)
    kappa = np.tan(steering + residual.STEERING * out[0]) / view[WHEELBASE]
    np.testing.assert_allclose(full[0, 2:], [speed + residual.SPEED * out[1], kappa], rtol=1e-5)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"format": "pcs-racing driver"}, "no manifest of a lidar driver"),
        ({"beams": 108}, "beams 271"),
        ({"name": 3}, "name must be a text"),
        ({"training": "long"}, "training a mapping"),
        ({"network": "residual"}, "a network 'residual' has float32 weights"),
        ({"network": ["ppo"]}, r"network is \['ppo'\]; it must be one of residual, ppo"),
    ],
)
def test_manifests_that_do_not_fit_are_refused(folder, changes, message):
    file = folder / "manifest.yaml"
    file.write_text(yaml.safe_dump({**yaml.safe_load(file.read_text()), **changes}))
    refused(message, networks.load_lidar_planner, folder)


def test_weights_that_do_not_fit_are_refused(tmp_path):
    layers = pairs("ppo")
    for weight in (
        np.full_like(layers[2][0], np.nan),
        np.full_like(layers[2][0], 101.0),
        layers[2][0][:, :-1],
    ):
        wrong = [*layers[:2], (weight, layers[2][1])]
        refused(
            "has float32 weights",
            networks.save_lidar_planner,
            tmp_path / "x",
            "ppo",
            wrong,
            name="x",
            training={},
        )
    assert not (tmp_path / "x").exists()
    refused(
        "unknown lidar driver 'nobody'",
        networks.load_lidar_planner,
        "nobody",
        error=UnknownNameError,
    )


def test_the_shipped_ones_are_read_when_they_are_first_asked_for():
    assert get_planner("lidar-ppo") is networks.LIDAR_PPO
    assert get_planner("residual") is networks.RESIDUAL
    with pytest.raises(AttributeError, match="no attribute 'OTHER'"):
        networks.OTHER  # noqa: B018
