"""The same actions give the gym's results: recorded facts, and a checkout of v1.0.0 if present.

``PCS_RACING_GYM`` names the checkout, ``PCS_RACING_GYM_PYTHON`` its Python.
"""

import os
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from refusal import refused
from situations import CELL, RADIUS, place, run_theirs, situations, steer_round, write_ring

from pcs_racing.base.errors import InputError
from pcs_racing.f1tenth.env import GenerationA, GenerationB, Integrator
from pcs_racing.f1tenth.lines import Track
from pcs_racing.f1tenth.rendering import get_vertices

STEPS = 1000


@pytest.fixture(scope="module")
def ring(tmp_path_factory):
    return write_ring(tmp_path_factory.mktemp("ring"))


def drive(ring, config, poses, plan):
    """Make 1,000 steps; return the actions, and states, facts, ends and scans, those after the
    reset first.
    """
    env = gymnasium.make(
        "pcs_racing:f1tenth-v0", config={**config, "map": str(ring), "num_agents": len(poses)}
    )
    obs, info = env.reset(options={"poses": np.array(poses)})
    actions, rows, done = [], [], False
    for k in range(STEPS + 1):
        facts = (
            env.sim.collisions,
            env.lap_counts,
            env.lap_times,
            obs["lap_times"],
            info["checkpoint_done"],
        )
        rows.append((env.sim.states, np.stack(facts), done, env.sim.agent_scans.astype(np.float32)))
        if k < STEPS:
            action = (
                plan[k]
                if plan.ndim == 3
                else np.stack([steer_round(env.sim.agent_poses), plan], axis=1)
            )
            actions.append(action.tolist())
            obs, _, done, _, info = env.step(action)
    return actions, {
        name: np.array([row[i] for row in rows])
        for i, name in enumerate(("states", "facts", "done", "scans"))
    }


def test_states_and_scans_beside_the_gym(ring, tmp_path):
    checkout, python = (os.environ.get(f"PCS_RACING_GYM{end}") for end in ("", "_PYTHON"))
    if not checkout or not python:
        pytest.skip(
            "PCS_RACING_GYM and PCS_RACING_GYM_PYTHON name no checkout of the gym and its Python"
        )
    ours, runs = {}, []
    for name, config, poses, plan in situations():
        actions, ours[name] = drive(ring, config, poses, plan)
        runs.append([name, config, poses, actions])
    theirs = run_theirs(Path(checkout), Path(python), ring, runs, tmp_path / "theirs.npz")
    assert len(ours) == 10
    for name, own in ours.items():
        np.testing.assert_array_equal(own["facts"], theirs[f"{name}/facts"], err_msg=name)
        np.testing.assert_array_equal(own["done"], theirs[f"{name}/done"], err_msg=name)
        np.testing.assert_allclose(
            own["states"], theirs[f"{name}/states"], rtol=0.0, atol=1e-9, err_msg=name
        )
        apart = np.abs(own["scans"] - theirs[f"{name}/scans"])
        # Theirs end inside the wall, up to a cell behind its face; ours at the face (below).
        assert np.median(apart) < CELL, name


def test_states_are_those_that_the_gym_recorded(reference):
    """Ten trajectories from separate states, far off the map, by the gym's controllers with
    steering delayed.
    """
    recorded = np.load(reference / "st_dynamics.npz")
    angle = np.linspace(0.0, 6.0, 60)
    empty = Track.from_refline(10.0 * np.cos(angle) + 1000.0, 10.0 * np.sin(angle), np.ones(60))
    env = gymnasium.make("pcs_racing:f1tenth-v0", config={"map": empty, "num_agents": 1})
    for states, controls in zip(recorded["cmd_states"], recorded["cmd_controls"], strict=True):
        env.sim.reset([[0.0, 0.0, 0.0]])
        env.sim.agents[0].state = states[0]
        for k in range(len(controls)):
            env.sim.step(controls[k : k + 1])
            np.testing.assert_allclose(env.sim.agents[0].state, states[k + 1], rtol=0.0, atol=1e-9)


def test_scans_are_exact_to_half_a_cell(ring):
    """The fast lidar of circuits against exact rays through the cells, from all over the ring."""
    env = gymnasium.make("pcs_racing:f1tenth-v0", config={"map": str(ring), "num_agents": 1})
    assert env.sim.setup.on_circuit
    for k in range(8):
        poses = np.array([place(0.8 * k, RADIUS + 0.1 * k - 0.4, 0.5 * k)])
        env.reset(options={"poses": poses})
        fast, world = env.sim.agent_scans[0], env.sim._world
        env.sim._world = world._replace(setup=world.setup._replace(on_circuit=False))
        env.reset(options={"poses": poses})
        env.sim._world = world
        # Of beams along a wall the range changes faster than the place of the wall.
        assert np.median(np.abs(fast - env.sim.agent_scans[0])) < 0.5 * CELL


def made(ring, cars, **named):
    return gymnasium.make(
        "pcs_racing:f1tenth-v0", config={"map": str(ring), "num_agents": cars}, **named
    )


def test_the_gym_s_faults_are_kept(ring):
    """A wall sets the heading to 0, and the flag clears a step later; a crash of another car does
    not end the episode; every episode has the same noise; driving to and fro over the line counts
    laps; steering overshoots its limit.
    """
    into, along = place(0.0, turned=-0.8), place(3.0)
    env = made(ring, 2)
    for car, poses in enumerate(([into, along], [along, into])):
        scans = []
        for seed in (1, 2):
            env.reset(seed=seed, options={"poses": np.array(poses)})
            scans.append(env.sim.agent_scans)
        assert np.array_equal(*scans)
        speeds, ended = np.array([[0.0, 0.0], [0.0, 0.0]]), False
        speeds[car, 1] = 4.0
        while not env.sim.collisions.any():
            ended = env.step(speeds)[2]
        assert ended == (car == 0)
        assert env.sim.agents[car].state[4] == 0.0
        env.step(np.zeros((2, 2)))
        assert not env.sim.collisions.any()
    env = made(ring, 1)
    env.reset(options={"poses": np.array([place(0.0)])})
    for speed in (2.0, -2.0, 2.0, -2.0, 2.0):
        for _ in range(180):
            env.step(np.array([[0.07, speed]]))
    assert env.lap_counts[0] >= 2.0
    for _ in range(40):
        env.step(np.array([[0.5, 0.0]]))
    assert env.sim.agent_steerings[0] > 0.4189


def test_euler_contacts_and_a_map_without_walls():
    """Euler is no Runge-Kutta, the feature has no contacts of cars, and beams that leave the map
    meet nothing.
    """
    features = {"type": "features", "features": ["collision", "scan"]}
    angle = np.linspace(0.0, 6.0, 60)
    empty = Track.from_refline(3.0 * np.cos(angle), 3.0 * np.sin(angle), np.ones(60))
    ends = []
    for integrator in ("rk4", "euler"):
        config = {"map": empty, "integrator": integrator, "observation_config": features}
        env = GenerationB(config)
        env.reset(options={"poses": np.array([[0.0, 0.0, 0.0], [0.5, 0.0, 0.0]])})
        for _ in range(10):
            obs, *_ = env.step(np.array([[0.3, 1.0], [0.0, 0.0]]))
        ends.append(env.sim.states[0])
    assert obs["agent_0"]["collision"] == 0
    assert env.sim.collisions.all()
    assert (obs["agent_1"]["scan"] > 25.0).any()
    assert not np.array_equal(*ends)


def test_observations_fit_their_space_and_types_of_reset(ring):
    features = {"type": "features", "features": ["scan", "beta", "lap_time"]}
    for config in ({}, features, {"type": "dynamic_state"}, {"type": "kinematic_state"}):
        env = gymnasium.make(
            "pcs_racing:f1tenth-v0",
            config={
                "map": str(ring),
                "num_agents": 3,
                "observation_config": config or {"type": None},
                "reset_config": {"type": "cl_grid_random"},
                "control_input": ["accl", "steering_speed"],
            },
        )
        obs, _ = env.reset(seed=3)
        # Single numbers are of numpy's types, as in the gym, and no arrays: Gymnasium would warn.
        assert (
            env.observation_space.contains(obs)
            if not config
            else obs.keys() == env.observation_space.keys()
        )
        gaps = np.linalg.norm(
            env.sim.agent_poses[:, None, :2] - env.sim.agent_poses[None, :, :2], axis=2
        )
        assert gaps[~np.eye(3, dtype=bool)].min() > 1.0
        assert env.action_space.high[0].tolist() == pytest.approx([3.2, 9.51], abs=1e-5)


def test_wrong_arguments_are_one_line(ring):
    wrong = [
        {"model": "mb"},
        {"control_input": ["speed"]},
        {"num_agents": 0},
        {"observation_config": {"type": "x"}},
    ]
    for config in [
        *wrong,
        {"params": {"mu": "x"}},
        {"map": "Atlantis"},
        {"integrator": 3},
        {"ego_idx": 9},
    ]:
        with pytest.raises(InputError, match=str(next(iter(config)))) as caught:
            GenerationB({"map": str(ring), **config})
        assert "\n" not in str(caught.value)
    with pytest.warns(UserWarning, match="lidar_angle"):
        GenerationA(map=str(ring), lidar_angle=3.0)
    env = GenerationA(map=str(ring), num_agents=1)
    refused("reset", env.step, [[0.0, 0.0]])
    env.reset(np.array([place(0.0)]))
    for action in ([[0.0]], [[np.nan, 0.0]], "x"):
        refused("action", env.step, action)
    stiff = GenerationA(map=str(ring), num_agents=1, params={"I": 1e-6})
    stiff.reset(np.array([place(0.0)]))
    with pytest.raises(InputError, match="a car's state is not finite after"):
        [stiff.step(np.array([[0.1, 5.0]])) for _ in range(100)]


def test_callbacks_draw_into_frames(ring):
    env = made(ring, 1, render_mode="rgb_array")
    env.add_render_callback(
        lambda e: e.render_lines(
            np.array([place(0.1)[:2], place(0.6)[:2]]), color=(255, 0, 9), size=4
        )
    )
    env.reset(options={"poses": np.array([place(0.0)])})
    frame = env.render()
    assert frame.shape == (800, 800, 3)
    assert (frame == (255, 0, 9)).all(axis=2).sum() > 100


def test_what_programs_reach_for(ring):
    """Facts of environment, simulator, car and lidar under the gym's names, right after a reset and
    two steps.
    """
    env = GenerationA(map=str(ring), num_agents=2, integrator=Integrator["Euler"])
    poses = np.array([place(0.0), place(1.0)])
    env.reset(poses)
    for steer in (0.1, 0.2):
        env.step(np.array([[steer, 2.0], [0.0, 1.0]]))
    car, lidar = env.sim.agents[0], env.sim.agents[0].scan_simulator
    assert (env.integrator.name, car.is_ego) == ("Euler", True)
    np.testing.assert_array_equal(car.opp_poses, env.sim.agent_poses[1:])
    loaded = env.sim.map
    assert (lidar.map_resolution, lidar.map_height, lidar.map_width) == (CELL, *loaded.free.shape)
    assert (lidar.orig_x, lidar.orig_y, lidar.orig_c, lidar.origin[2]) == (*loaded.origin, 1.0, 0.0)
    assert lidar.angle_increment == pytest.approx(4.7 / 1079)
    row, column = np.argwhere(loaded.free)[0]
    assert lidar.dt.shape == lidar.map_img.shape == loaded.free.shape
    assert (lidar.dt[row, column] > 0.0) == (lidar.map_img[row, column] == 255.0)
    car.update_params({"mu": 0.5})
    assert (car.params["mu"], env.sim.agents[1].params["mu"]) == (0.5, 1.0489)
    env.sim.set_map(str(ring), ".png")
    seen = env.sim.step(np.zeros((2, 2)))
    assert (len(seen["scans"]), seen["poses_x"], seen["ego_idx"]) == (
        2,
        env.sim.states[:, 0].tolist(),
        0,
    )
    with pytest.raises(AttributeError, match=r"env\.sim\.step"):
        car.update_pose  # noqa: B018


def test_corners_of_a_car():
    corners = get_vertices(np.array([1.9, 0.0, np.pi / 2]), 2.0, 1.0)
    expected = [[1.4, -1.0], [2.4, -1.0], [2.4, 1.0], [1.4, 1.0]]
    np.testing.assert_allclose(corners, expected, atol=1e-12)
