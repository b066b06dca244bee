"""Ten scripted situations on a ring, and a program that runs them in a checkout of the gym (v1.0.0)
by its own Python.
"""

import json
import math
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

RADIUS, INNER, OUTER, CELL, SIDE = 4.5, 3.0, 6.0, 0.05, 300  # m, m, m, m, cells


def write_ring(folder: Path) -> Path:
    """Write a map, a ring around the origin; return its path without ending."""
    at = (np.arange(SIDE) + 0.5) * CELL - 0.5 * SIDE * CELL
    radius = np.hypot(*np.meshgrid(at, at))
    free = (radius > INNER) & (radius < OUTER)
    Image.fromarray(np.where(free, np.uint8(255), np.uint8(0))).save(folder / "ring.png")
    corner = -0.5 * SIDE * CELL
    (folder / "ring.yaml").write_text(
        f"image: ring.png\nresolution: {CELL}\norigin: [{corner}, {corner}, 0.0]\nnegate: 0\n"
        "occupied_thresh: 0.65\nfree_thresh: 0.196\n"
    )
    angle = np.arange(0.0, 2.0 * np.pi, 0.05)
    rows = np.stack(
        [RADIUS * np.cos(angle), RADIUS * np.sin(angle), 1.4 + 0 * angle, 1.4 + 0 * angle], axis=1
    )
    np.savetxt(folder / "ring_centerline.csv", rows, delimiter=", ")
    return folder / "ring"


def place(angle: float, radius: float = RADIUS, turned: float = 0.0) -> list[float]:
    """Pose at an angle of the ring, heading along it and turned from there."""
    return [radius * math.cos(angle), radius * math.sin(angle), angle + 0.5 * math.pi + turned]


def hold(steps: int, *cars: tuple[float, float]) -> np.ndarray:
    return np.tile(np.array(cars), (steps, 1, 1))


def steer_round(poses: np.ndarray) -> np.ndarray:
    """Steering angles that keep cars in the middle of the ring."""
    radius = np.hypot(poses[:, 0], poses[:, 1])
    turned = poses[:, 2] - np.arctan2(poses[:, 1], poses[:, 0]) - 0.5 * np.pi
    turned -= 2.0 * np.pi * np.round(turned / (2.0 * np.pi))
    return np.clip(0.075 + 0.4 * (radius - RADIUS) - 0.8 * turned, -0.4, 0.4)


def situations() -> Iterator[tuple[str, dict[str, Any], list[list[float]], Any]]:
    """Yield names, changes of the configuration, start poses, and actions or speeds at which to go
    round.
    """
    to_and_fro = np.stack(
        [np.full(1000, 0.07), 1.5 * np.sign(np.sin(np.arange(1000) / 60.0))], axis=1
    )
    yield "wall ahead", {}, [place(0.0, turned=-0.6)], hold(1000, (0.0, 4.0))
    yield "wall at the side", {}, [place(0.0, 5.6)], hold(1000, (0.02, 3.0))
    yield "wall behind", {}, [place(0.0, turned=0.9)], hold(1000, (0.1, -2.0))
    yield "rear-end", {}, [place(0.2), place(0.5)], np.array([3.0, 1.0])
    yield (
        "side by side",
        {},
        [place(0.0, 4.7), place(0.0, 4.2)],
        hold(1000, (0.0, 2.0), (-0.1, 2.0)),
    )
    yield "two laps", {}, [place(0.0), place(-1.0)], np.array([6.3, 6.2])
    yield "to and fro over the line", {}, [place(0.0)], to_and_fro[:, None]
    yield (
        "three cars",
        {"ego_idx": 1},
        [place(0.0), place(1.0), place(2.0)],
        np.array([4.0, 3.0, 2.0]),
    )
    inputs = np.stack(
        [0.4 * np.sin(np.arange(1000) / 40.0), np.sin(np.arange(1000) / 90.0)], axis=1
    )[:, None]
    rates = {"control_input": ["accl", "steering_speed"]}
    yield "kinematic model, accelerations", {"model": "ks", **rates}, [place(0.0)], inputs
    wild = np.random.default_rng(3).uniform([-0.4, 2.0], [0.4, 7.0], (1000, 2, 2))
    yield (
        "Euler, wild commands",
        {"integrator": "euler", "params": {"mu": 0.8}},
        [place(0.0), place(3.0)],
        wild,
    )


# Run by the gym's Python, in its checkout.
_THEIRS = """
import json, sys
import numpy as np, gymnasium, f1tenth_gym
from PIL import Image
from f1tenth_gym.envs.track import Track
from f1tenth_gym.envs.track.track import TrackSpec
from f1tenth_gym.envs.track.raceline import Raceline
task = json.loads(sys.stdin.read())
picture = Image.open(task["map"] + ".png").transpose(Image.FLIP_TOP_BOTTOM)
pixels = np.array(picture).astype(np.float32)
corner = [-0.5 * pixels.shape[1] * task["cell"]] * 2 + [0.0]
angle = np.arange(0.0, 6.28, 0.05)
line = Raceline(np.cos(angle), np.sin(angle), np.ones_like(angle))
spec = TrackSpec(name="ring", image="ring.png", resolution=task["cell"], origin=corner, negate=0,
                 occupied_thresh=0.65, free_thresh=0.196)
levels = np.where(pixels > 128, 255.0, 0.0).astype(np.float32)
track = Track(spec, levels, centerline=line, raceline=line)
out = {}
for name, config, poses, actions in task["runs"]:
    config = {**config, "map": track, "num_agents": len(poses)}
    env = gymnasium.make("f1tenth_gym:f1tenth-v0", config=config).unwrapped
    obs, info = env.reset(options={"poses": np.array(poses)})
    rows = []
    for action in [None, *actions]:
        done = False
        if action is not None:
            obs, _, done, _, info = env.step(np.array(action))
        states = np.zeros((len(poses), 7))
        for i, agent in enumerate(env.sim.agents):
            states[i, : len(agent.state)] = agent.state
        facts = (env.sim.collisions, env.lap_counts, env.lap_times, obs["lap_times"],
                 info["checkpoint_done"])
        rows.append((states, np.stack(facts), done, env.sim.agent_scans.astype(np.float32)))
    for k, what in enumerate(("states", "facts", "done", "scans")):
        out[name + "/" + what] = np.array([row[k] for row in rows])
np.savez(task["out"], **out)
"""


def run_theirs(
    checkout: Path, python: Path, ring: Path, runs: list[Any], out: Path
) -> dict[str, np.ndarray]:
    """Run situations with recorded actions in the gym; return states, facts, ends and scans by
    situation.
    """
    task = {"map": str(ring), "cell": CELL, "runs": runs, "out": str(out)}
    subprocess.run(
        [str(python), "-c", _THEIRS],
        cwd=checkout,
        input=json.dumps(task),
        text=True,
        check=True,
        capture_output=True,
    )
    with np.load(out) as archive:
        return dict(archive)
