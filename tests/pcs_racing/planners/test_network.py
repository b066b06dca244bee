from itertools import pairwise

import numpy as np
import pytest
from refusal import refused

from pcs_racing.planners.network import (
    INPUTS,
    TOP_SPEED,
    network_inputs,
    network_planner,
    network_weight_count,
)
from pcs_racing.planners.view import OPP_D, OPP_V, OWN_D, OWN_V, STEER_MAX


def inputs(track, view) -> dict[str, float]:
    out = np.empty(len(INPUTS))
    network_inputs(track.arrays, view, out)
    return dict(zip(INPUTS, out, strict=True))


def layers(hidden, weights):
    """The weights as matrices (above, below + 1), biases in the last column."""
    sizes = [len(INPUTS), *hidden, 2]
    for below, above in pairwise(sizes):
        yield np.roll(weights[: (below + 1) * above].reshape(below + 1, above).T, -1, axis=1)
        weights = weights[(below + 1) * above :]


def forward(hidden, weights, x):
    """The network in numpy, for rows of inputs."""
    for matrix in layers(hidden, weights):
        x = np.tanh(x @ matrix[:, :-1].T + matrix[:, -1])
    return x


@pytest.mark.parametrize("hidden", [(), (5,), (16,), (7, 3, 20)])
def test_the_compiled_network_is_the_networks_formula(oval, view_at, hidden):
    rng = np.random.default_rng(len(hidden))
    weights = rng.normal(0.0, 0.5, network_weight_count(hidden))
    planner = network_planner("net", hidden, weights)
    view = view_at(oval, 5.0, 0.3, turned=0.1, gap=2.0, opp_d=-0.2, opp_speed=3.0)
    command, scratch = np.full(2, np.nan), np.full(planner.scratch_size, np.nan)
    planner.control(
        oval.arrays, planner.default, view, np.zeros(0), scratch, np.zeros((12, 4)), command
    )
    steer, speed = forward(hidden, weights, np.array(list(inputs(oval, view).values())))
    np.testing.assert_allclose(
        command, [view[STEER_MAX] * steer, 0.5 * TOP_SPEED * (1.0 + speed)], atol=1e-12
    )


def test_parameters_are_the_weights_and_must_fit():
    planner = network_planner("net", (3,), np.linspace(-1.0, 1.0, 59))
    assert network_weight_count((3,)) == (16 + 1) * 3 + (3 + 1) * 2 == len(planner.parameters)
    assert planner.parameter_names[0] == "layer0_bias_neuron0"
    assert planner.parameter_names[3] == "layer0_speed_neuron0"
    assert planner.parameter_names[-1] == "layer1_neuron2_neuron1"
    np.testing.assert_allclose(planner.default, np.linspace(-1.0, 1.0, 59))
    refused(r"weights of shape \(58,\)", network_planner, "net", (3,), np.zeros(58))
    refused("a weight of nan", network_planner, "net", (3,), np.full(59, np.nan))
    refused("a weight of 11", network_planner, "net", (3,), np.full(59, 11.0))
    refused(r"parameters of shape \(4,\)", network_planner("net", (3,)).policy, np.zeros(4))


def test_layers_have_whole_positive_widths_and_networks_a_size_limit():
    for hidden in [(0,), (-3,), (4, 0), (2.5,), (True,), ("8",)]:
        refused("network 'net' has a hidden layer of width", network_planner, "net", hidden)
    for hidden in [(100_000,), (3000, 3000)]:
        refused("100000 is the limit", network_planner, "net", hidden)


def test_inputs_are_of_order_one(oval, view_at):
    view = view_at(oval, 5.0, 0.3, speed=4.0, turned=0.1, gap=2.0, opp_d=-0.2, opp_speed=3.0)
    seen = inputs(oval, view)
    assert seen["speed"] == 0.5
    assert seen["distance"] == pytest.approx(0.3)
    assert seen["course"] == pytest.approx(0.1, abs=1e-3)
    assert seen["right"] == pytest.approx(0.5 * (1.1 + 0.3), abs=0.03)
    assert seen["left"] == pytest.approx(0.5 * (1.1 - 0.3), abs=0.03)
    assert seen["opponent_near"] == pytest.approx(0.75)
    assert seen["opponent_ahead"] == pytest.approx(0.75 * 0.5)
    assert seen["opponent_side"] == pytest.approx(0.75 * (view[OPP_D] - view[OWN_D]))
    assert seen["opponent_speed"] == pytest.approx(0.75 * (view[OPP_V] - view[OWN_V]) / 4.0)
    assert np.abs(list(seen.values())).max() < 1.5
    alone = inputs(oval, view_at(oval, 5.0, gap=20.0))
    assert [alone[name] for name in INPUTS if name.startswith("opponent")] == [0.0] * 4
