"""The same actions give what the gym gives: recorded facts, and beside a checkout of v1.0.0 where there is one.

The checkout is that of ``PCS_RACING_GYM``, its Python that of ``PCS_RACING_GYM_PYTHON``.
"""

import os
from pathlib import Path

import gymnasium
import numpy as np
import pytest

import pcs_racing  # noqa: F401
from situations import CELL, run_theirs, situations, steer_round, write_ring

STEPS = 1000


@pytest.fixture(scope="module")
def ring(tmp_path_factory):
    return write_ring(tmp_path_factory.mktemp("ring"))


def drive(ring, config, poses, plan):
    """Make 1,000 steps; return the actions, and states, facts, ends and scans, those after the reset first."""
    env = gymnasium.make("pcs_racing:f1tenth-v0", config={**config, "map": str(ring), "num_agents": len(poses)})
    obs, info = env.reset(options={"poses": np.array(poses)})
    actions, rows, done = [], [], False
    for k in range(STEPS + 1):
        facts = (env.sim.collisions, env.lap_counts, env.lap_times, obs["lap_times"], info["checkpoint_done"])
        rows.append((env.sim.states, np.stack(facts), done, env.sim.agent_scans.astype(np.float32)))
        if k < STEPS:
            action = plan[k] if plan.ndim == 3 else np.stack([steer_round(env.sim.agent_poses), plan], axis=1)
            actions.append(action.tolist())
            obs, _, done, _, info = env.step(action)
    return actions, {name: np.array([row[i] for row in rows]) for i, name in enumerate(("states", "facts", "done", "scans"))}


def test_states_and_scans_beside_the_gym(ring, tmp_path):
    checkout, python = (os.environ.get(f"PCS_RACING_GYM{end}") for end in ("", "_PYTHON"))
    if not checkout or not python:
        pytest.skip("PCS_RACING_GYM and PCS_RACING_GYM_PYTHON name no checkout of the gym and its Python")
    ours, runs = {}, []
    for name, config, poses, plan in situations():
        actions, ours[name] = drive(ring, config, poses, plan)
        runs.append([name, config, poses, actions])
    theirs = run_theirs(Path(checkout), Path(python), ring, runs, tmp_path / "theirs.npz")
    assert len(ours) == 10
    for name, own in ours.items():
        np.testing.assert_array_equal(own["facts"], theirs[f"{name}/facts"], err_msg=name)
        np.testing.assert_array_equal(own["done"], theirs[f"{name}/done"], err_msg=name)
        np.testing.assert_allclose(own["states"], theirs[f"{name}/states"], rtol=0.0, atol=1e-9, err_msg=name)
        apart = np.abs(own["scans"] - theirs[f"{name}/scans"])
        assert np.median(apart) < 0.5 * CELL, name
