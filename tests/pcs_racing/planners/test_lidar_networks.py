"""Lidar drivers with networks: their layers and folders, and what they see and lay."""

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
from pcs_racing.planners.scanning import WORK
from pcs_racing.planners.view import OWN_PSI, OWN_X, OWN_Y, PATH_POINTS, VIEW_SIZE, WHEELBASE


def pairs(network: str) -> list:
    found = [random_layers(*sizes, seed=i) for i, sizes in enumerate(networks.LAYERS[network])]
    return [(layer.weights[0], layer.biases[0]) for layer in found]


@pytest.fixture
def folder(tmp_path):
    return networks.save_lidar_planner(
        tmp_path / "mine", "gru", pairs("gru"), name="mine", training={"rounds": 7}
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


def test_the_convolutional_network_is_its_formula():
    layers, seen = pairs("cnn"), np.random.default_rng(1).normal(size=networks.SEEN)
    work = np.zeros(networks.SCRATCH)
    networks.answer_cnn(networks.flat_weights(layers), seen, np.zeros(0), work)
    x = seen[: networks.BEAMS]
    for (weight, bias), step in zip(layers, (3, 16, 24), strict=False):
        windows = np.lib.stride_tricks.sliding_window_view(x, weight.shape[1])[::step]
        x = np.maximum(windows @ weight.T + bias, 0.0).ravel()
    (hidden, hidden_bias), (last, last_bias) = layers[3:]
    expected = (
        last @ np.maximum(hidden @ np.concatenate([x, seen[networks.BEAMS :]]) + hidden_bias, 0.0)
        + last_bias
    )
    np.testing.assert_allclose(work[:4], expected, rtol=1e-5, atol=1e-6)


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


def test_a_car_is_seen_on_its_side_from_right_to_left_and_the_pace_as_a_speed_scale(oval, view_at):
    seen, middles = np.zeros(networks.SEEN), []
    for opp_d in (-0.3, 0.3):
        view = view_at(oval, 3.0, speed=4.0, gap=2.0, opp_d=opp_d)
        networks.observe(oval.arrays, view, 0.5, np.zeros(WORK), seen)
        ranges = networks.MAX_RANGE * (0.5 * (seen[: networks.BEAMS] + 1.0)) ** 2
        middles.append(np.flatnonzero(ranges[50:85] < 2.2).mean() + 50)
        low, high = view[[VIEW_SIZE - 2, VIEW_SIZE - 1]]
        assert seen[networks.BEAMS :] == pytest.approx(
            [0.5, 0.0, 0.0, 4.0 * (0.5 * (low + high) - 1.0)]
        )
    assert middles[0] < networks.BEAMS // 2 < middles[1]


def test_outputs_are_laid_as_a_path_in_the_frame_of_the_car(oval, view_at):
    view, path = view_at(oval, 3.0, speed=4.0), np.zeros((PATH_POINTS, 4))
    networks.lay_path(view, np.array([0.5, 1.0, 0.0, 1.0]), 0.5, path)
    heading = np.array([np.cos(view[OWN_PSI]), np.sin(view[OWN_PSI])])
    moved = path[:, :2] - view[[OWN_X, OWN_Y]]
    x, y = moved @ heading, moved @ [-heading[1], heading[0]]
    np.testing.assert_allclose(y, 0.05 * x + 0.1 * x * x, atol=1e-9)
    assert path[0, 3] == pytest.approx(0.2 / (1.0 + 0.05**2) ** 1.5)
    assert path[[3, 7], 2] == pytest.approx([3.0, 4.0])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"format": "pcs-racing driver"}, "no manifest of a lidar driver"),
        ({"beams": 108}, "beams 135"),
        ({"name": 3}, "name must be a text"),
        ({"training": "long"}, "training a mapping"),
        ({"network": "cnn"}, "a network 'cnn' has float32 weights"),
        ({"network": ["gru"]}, r"network is \['gru'\]; it must be one of cnn, gru, residual"),
    ],
)
def test_manifests_that_do_not_fit_are_refused(folder, changes, message):
    file = folder / "manifest.yaml"
    file.write_text(yaml.safe_dump({**yaml.safe_load(file.read_text()), **changes}))
    refused(message, networks.load_lidar_planner, folder)


def test_weights_that_do_not_fit_are_refused(tmp_path):
    layers = pairs("gru")
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
            "gru",
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
    assert get_planner("lidar-cnn") is networks.LIDAR_CNN
    assert get_planner("lidar-gru") is networks.LIDAR_GRU
    assert get_planner("lidar-ppo") is networks.LIDAR_PPO
    assert get_planner("residual") is networks.RESIDUAL
    with pytest.raises(AttributeError, match="no attribute 'OTHER'"):
        networks.OTHER  # noqa: B018


def test_recurrent_units_move_on_by_their_gates():
    from_inputs, from_state = random_layers(5, 9, seed=3), random_layers(3, 9, seed=4)
    flat = np.concatenate([from_inputs.flat(), from_state.flat()]).astype(float)
    rng = np.random.default_rng(5)
    x, state = rng.normal(size=5), rng.normal(size=3)
    a = (from_inputs.weights[0] @ x + from_inputs.biases[0]).reshape(3, 3)
    b = (from_state.weights[0] @ state + from_state.biases[0]).reshape(3, 3)
    reset, keep = 1.0 / (1.0 + np.exp(-(a + b)[:2]))
    expected = (1.0 - keep) * np.tanh(a[2] + reset * b[2]) + keep * state
    networks.recur(flat, 5, 3, x, state, np.zeros(18))
    np.testing.assert_allclose(state, expected, rtol=1e-6)
