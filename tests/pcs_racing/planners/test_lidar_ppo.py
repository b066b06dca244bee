"""The lidar planner that PPO trained: inputs of its network, its commands and its folders."""

import numpy as np
import pytest
import yaml
from random_layers import random_layers
from refusal import refused

from pcs_racing.base.dense import DenseLayers
from pcs_racing.base.errors import UnknownNameError
from pcs_racing.planners.field import lidar_ppo
from pcs_racing.planners.field.lidar_ppo import (
    CHANGE,
    EDGES,
    FRAMES,
    MEMORY,
    SCRATCH,
    SECTORS,
    SEEN,
    SIZES,
    load_lidar_planner,
    read_lidar_planner,
    save_lidar_planner,
)
from pcs_racing.planners.racers import racer
from pcs_racing.planners.scanning import BEAMS, MAX_RANGE, SCAN_SIZE, scan
from pcs_racing.planners.view import OWN_PSI_DOT, OWN_V, PATH_POINTS


def seen_from(oval, view, memory, share=1.0):
    out = np.zeros(SEEN)
    lidar_ppo.observe(oval.arrays, view, share, memory, np.zeros(SCRATCH), out)
    lidar_ppo.remember(memory, out)
    return out


def nearest(oval, view):
    scratch = np.zeros(SCAN_SIZE)
    scan(oval.arrays, view, scratch)
    sectors = np.minimum.reduceat(scratch[SCAN_SIZE - BEAMS : -1], EDGES[:-1])
    return 2.0 * np.sqrt(sectors / MAX_RANGE) - 1.0


def test_the_network_sees_sectors_and_their_changes(oval, view_at):
    views = [view_at(oval, 3.0 + 0.4 * k, speed=4.0, gap=2.0 - 0.1 * k) for k in range(4)]
    memory, scans = np.zeros(MEMORY), [nearest(oval, view) for view in views]
    for k, view in enumerate(views):
        frames = seen_from(oval, view, memory)[: FRAMES * SECTORS].reshape(FRAMES, SECTORS)
        np.testing.assert_array_equal(frames[0], scans[k])
        for j in (1, 2):
            change = CHANGE * (scans[k] - scans[max(k - j, 0)])
            np.testing.assert_array_equal(frames[j], np.clip(change, -1.0, 1.0))
    assert np.ptp(frames[1]) > 0.1  # something changed


def test_the_network_sees_its_own_measurements_and_its_last_command(oval, view_at):
    view, memory, path = view_at(oval, 3.0, speed=4.0), np.zeros(MEMORY), np.zeros((PATH_POINTS, 4))
    view[OWN_PSI_DOT] = 1.0
    lidar_ppo.lay_command(view, 0.5, memory, -0.25, 0.75, path)
    assert seen_from(oval, view, memory, 0.5)[-5:].tolist() == [1.0, 0.5, 0.0, -0.25, 0.75]


def test_a_car_at_half_its_speed_commands_half_of_what_it_would_at_full_speed(oval, view_at):
    full, half = np.zeros((2, PATH_POINTS, 4))
    lidar_ppo.lay_command(view_at(oval, 3.0, speed=6.0), 1.0, np.zeros(3), 0.5, 0.2, full)
    lidar_ppo.lay_command(view_at(oval, 3.0, speed=3.0), 0.5, np.zeros(3), 0.5, 0.2, half)
    kappa = 0.5 * lidar_ppo.MAX_KAPPA / (1.0 + (6.0 / lidar_ppo.HALVED) ** 2)
    np.testing.assert_allclose(full[:, 2:], np.tile([6.2, kappa], (PATH_POINTS, 1)))
    np.testing.assert_allclose(half[:, 2:], np.tile([3.1, kappa], (PATH_POINTS, 1)))


def test_the_plan_is_the_network(oval, view_at):
    layers = random_layers(*SIZES)
    pairs = list(zip(layers.weights, layers.biases, strict=True))
    view, path, memory = view_at(oval, 3.0, speed=4.0), np.zeros((PATH_POINTS, 4)), np.zeros(MEMORY)
    plan = lidar_ppo.frozen_plan(layers.flat().astype(np.float64).tobytes())
    plan(oval.arrays, np.ones(1), view, memory, np.zeros(SCRATCH), path)
    x = seen_from(oval, view, np.zeros(MEMORY))
    for weight, bias in pairs[:2]:
        x = np.maximum(weight @ x + bias, 0.0)
    turn, push = np.tanh(pairs[2][0] @ x + pairs[2][1])
    assert memory[1:3] == pytest.approx([turn, push], rel=1e-6)
    assert path[0, 2:] == pytest.approx(
        [max(view[OWN_V] + push, 0.5), turn * lidar_ppo.max_curvature(view[OWN_V])], rel=1e-6
    )


@pytest.fixture
def folder(tmp_path):
    return save_lidar_planner(
        tmp_path / "mine", random_layers(*SIZES), name="mine", training={"rounds": 7}
    )


def test_what_is_written_is_read(folder):
    name, layers = read_lidar_planner(folder)
    assert name == "mine"
    np.testing.assert_array_equal(layers.flat(), random_layers(*SIZES).flat())
    planner = load_lidar_planner(folder)
    assert planner.plan is load_lidar_planner(folder).plan  # compiled once
    assert planner.parameter_names == ("speed_share",)
    folder.rename(folder.with_name("best"))
    refused(
        f"is the folder of a training; its best network is {folder.parent}", racer, folder.parent
    )


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"format": "pcs-racing driver"}, "no manifest of a lidar driver"),
        ({"beams": 108}, "beams 271"),
        ({"name": 3}, "name must be a text"),
        ({"training": "long"}, "training a mapping"),
    ],
)
def test_manifests_that_do_not_fit_are_refused(folder, changes, message):
    file = folder / "manifest.yaml"
    file.write_text(yaml.safe_dump({**yaml.safe_load(file.read_text()), **changes}))
    refused(message, load_lidar_planner, folder)


def test_networks_that_do_not_fit_are_refused(tmp_path):
    layers = random_layers(*SIZES)
    large = DenseLayers(layers.weights, (*layers.biases[:-1], np.array([0.0, 101.0])))
    for wrong, said in (
        (large, "weights up to 101"),
        (random_layers(SEEN, 2), r"sizes \(230, 2\)"),
    ):
        refused(said, save_lidar_planner, tmp_path / "x", wrong, name="x", training={})
    assert not (tmp_path / "x").exists()
    refused("unknown lidar driver 'nobody'", load_lidar_planner, "nobody", error=UnknownNameError)
