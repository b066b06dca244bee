from itertools import pairwise

import numpy as np
import pytest

from pcs_racing import InputError, RaceConfig, RaceSetup, Starts, advance, load_track
from pcs_racing.base.dense import DenseLayers
from pcs_racing.planners.network import INPUTS, TOP_SPEED, driver_weight_count, network_inputs, network_planner
from pcs_racing.planners.pure_pursuit import PURE_PURSUIT
from pcs_racing.planners.view import OPP_D, OPP_V, OWN_D, OWN_V, STEER_MAX, VIEW_SIZE
from pcs_racing.race.kernel import fill_view
from pcs_racing.race.races import start_races


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
    weights = rng.normal(0.0, 0.5, driver_weight_count(hidden))
    planner = network_planner("net", hidden, weights)
    view = view_at(oval, 5.0, 0.3, turned=0.1, gap=2.0, opp_d=-0.2, opp_speed=3.0)
    command, scratch = np.full(2, np.nan), np.full(planner.scratch_size, np.nan)
    planner.control(oval.arrays, planner.default, view, np.zeros(0), scratch, np.zeros((12, 4)), command)
    steer, speed = forward(hidden, weights, np.array(list(inputs(oval, view).values())))
    np.testing.assert_allclose(command, [view[STEER_MAX] * steer, 0.5 * TOP_SPEED * (1.0 + speed)], atol=1e-12)


def test_parameters_are_the_weights():
    planner = network_planner("net", (3,), np.linspace(-1.0, 1.0, 59))
    assert driver_weight_count((3,)) == (16 + 1) * 3 + (3 + 1) * 2 == len(planner.parameters)
    assert planner.parameter_names[0] == "layer0_bias_neuron0"
    assert planner.parameter_names[3] == "layer0_speed_neuron0"
    assert planner.parameter_names[-1] == "layer1_neuron2_neuron1"
    np.testing.assert_allclose(planner.default, np.linspace(-1.0, 1.0, 59))


@pytest.mark.parametrize("hidden", [(0,), (-3,), (4, 0), (2.5,), (True,), ("8",)])
def test_layers_have_whole_positive_widths(hidden):
    with pytest.raises(InputError, match="network 'net' has a hidden layer of width"):
        network_planner("net", hidden)


@pytest.mark.parametrize("hidden", [(100_000,), (3000, 3000)])
def test_networks_have_a_size_limit(hidden):
    with pytest.raises(InputError, match="100000 is the limit"):
        network_planner("net", hidden)


def test_weights_must_fit():
    with pytest.raises(InputError, match=r"weights of shape \(58,\)"):
        network_planner("net", (3,), np.zeros(58))
    with pytest.raises(InputError, match="a weight of nan"):
        network_planner("net", (3,), np.full(59, np.nan))
    with pytest.raises(InputError, match="a weight of 11"):
        network_planner("net", (3,), np.full(59, 11.0))
    with pytest.raises(InputError, match=r"parameters of shape \(4,\)"):
        network_planner("net", (3,)).policy(np.zeros(4))


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


def lessons(track, races=12, seconds=12.0):
    """What pure pursuit sees while its steering is disturbed, and what it answers to it."""
    config = RaceConfig(
        duration=seconds,
        start="staggered",
        start_gap=min(0.5 * track.length, 50.0),
        start_spacing=0.0,
        steering_noise=0.05,
        speed_range=(0.75, 0.95),  # slow enough for the fastest command of a network
    )
    setup = RaceSetup(track, config, (PURE_PURSUIT, PURE_PURSUIT))
    starts = Starts(np.linspace(0.0, track.length, races, endpoint=False), np.zeros(races, np.int64))
    state = start_races(setup, starts, np.arange(races, dtype=np.uint64))
    theta = np.tile(PURE_PURSUIT.policy({"pace": 0.0}).parameters, (races, 2, 1))
    vehicles = np.stack([vehicle.as_row() for vehicle in setup.vehicles])
    view, seen, done = np.zeros(VIEW_SIZE), [], []
    for _ in range(round(seconds * 10.0)):
        x = np.empty((races, 2, len(INPUTS)))
        for race in range(races):
            for car in range(2):
                fill_view(track.arrays, state, race, car, vehicles, setup.settings, view)
                network_inputs(track.arrays, view, x[race, car])
        driving = ~state.crashed
        advance(setup, state, theta, 2)  # the command that answers this view
        steer = (state.command[..., 0] - state.disturbance) / setup.vehicles[0].steer_max
        speed = 2.0 * state.command[..., 1] / TOP_SPEED - 1.0
        seen.append(x[driving].reshape(-1, len(INPUTS)))
        done.append(np.stack([steer, speed], axis=-1)[driving].reshape(-1, 2))
        advance(setup, state, theta, 8)
    return np.concatenate(seen), np.concatenate(done)


def test_a_network_learns_to_drive_from_pure_pursuit(drive_alone):
    """Random features and least squares make a driver in a second, that drives on other circuits too."""
    hidden = (48,)
    examples = [lessons(load_track(name)) for name in ("Larkmoor", "Pipkin")]
    x, y = (np.concatenate(part) for part in zip(*examples, strict=True))
    rng = np.random.default_rng(0)
    first = rng.normal(0.0, 0.8, (hidden[0], len(INPUTS) + 1))
    features = np.column_stack([np.tanh(x @ first[:, :-1].T + first[:, -1]), np.ones(len(x))])
    ridge = 1e-5 * len(x) * np.eye(features.shape[1])
    second = np.linalg.solve(features.T @ features + ridge, features.T @ np.arctanh(np.clip(y, -0.97, 0.97)))
    weights = DenseLayers((first[:, :-1], second[:-1].T), (first[:, -1], second[-1])).flat()
    assert np.abs(forward(hidden, weights, x) - y).mean() < 0.03
    planner = network_planner("imitator", hidden, weights)
    for name in ("Larkmoor", "Pipkin", "Saltmere", "Kestrelheim"):
        result = drive_alone(load_track(name), [planner.policy()], duration=10.0)
        assert not result.crashed.any()
        assert (result.state.progress[:, 0] > 30.0).all()
    # A network that has learnt nothing does not get far.
    assert drive_alone(load_track("Pipkin"), [network_planner("new", hidden).policy()], duration=10.0).crashed.all()
