"""Two cars with 1080-beam lidars on one map, for the same time: here, and in the F1TENTH gym (v1.0.0).

    python benchmarks/beside_f1tenth_gym.py                                  # our half alone
    python benchmarks/beside_f1tenth_gym.py --checkout PATH --python PATH    # both, and the ratio

PATH are a checkout of https://github.com/f1tenth/f1tenth_gym and the Python of an environment in which it is installed
(``python -m venv ENV && ENV/bin/pip install -e CHECKOUT``); it is not on PyPI and pins other versions than we do.

Both simulators drive the same two cars (the parameters of both are those of the F1TENTH car) along the race line, from
the same poses, by the same pure pursuit in plain Python, one car 3 m ahead of the other. Only the steps are timed, not
the pursuit: processor time of the thread, after a run that compiles. A step lasts 0.01 s there and 0.02 s here, inside
which we integrate at 0.01 s, too: what counts is simulated seconds per second. Each step scans for both cars.
"""

import argparse
import json
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from pcs_racing import load_track
from pcs_racing.base.errors import InputError
from pcs_racing.car.vehicle import F1TENTH
from pcs_racing.envs.drive_batch import DriveBatch
from pcs_racing.track.track import Track

GAP = 3.0  # m between the cars along the line
SPEED = 3.0  # m/s that both cars hold
BEAMS, FOV = 1080, 4.7

# Shared by both halves, so that both sides are steered by the same lines.
PURSUIT = '''
import math

def steer(line, x, y, heading):
    """Pure pursuit towards the point of the line that is 1 m beyond the nearest one."""
    near = min(range(len(line)), key=lambda i: (line[i][0] - x) ** 2 + (line[i][1] - y) ** 2)
    gx, gy = line[(near + ahead) % len(line)]
    dx, dy = gx - x, gy - y
    across = -dx * math.sin(heading) + dy * math.cos(heading)
    return max(-0.4, min(0.4, math.atan(0.33 * 2.0 * across / (dx * dx + dy * dy))))
'''

# Run by the other environment's Python: reads the task as JSON, answers with one line of JSON.
THEIRS = (
    PURSUIT
    + """
import json, pathlib, sys, time
import gymnasium, numpy as np
import f1tenth_gym
from f1tenth_gym.envs.track import Track

task = json.load(sys.stdin)
line, ahead = task["line"], task["ahead"]
env = gymnasium.make("f1tenth_gym:f1tenth-v0", config={
    "map": Track.from_track_path(pathlib.Path(task["map"])), "num_agents": 2, "timestep": 0.01, "integrator": "rk4",
    "model": "st", "control_input": ["speed", "steering_angle"], "observation_config": {"type": "original"},
}).unwrapped

def run(seconds):
    env.reset(options={"poses": np.array(task["poses"])})
    spent, steps, crashed = 0.0, 0, False
    while steps < round(100 * seconds) and not crashed:
        x, y, heading = env.sim.agent_poses.T
        if steps % 2 == 0:
            action = np.array([[steer(line, x[i], y[i], heading[i]), task["speed"]] for i in range(2)])
        start = time.thread_time()
        env.step(action)
        spent += time.thread_time() - start
        steps += 1
        crashed = bool(np.any(env.sim.collisions))
    return spent, steps / 100, crashed

run(0.5)
spent, driven, crashed = run(task["seconds"])
print(json.dumps({"spent": spent, "driven": driven, "crashed": crashed}))
"""
)


def the_task(track: Track, seconds: float) -> dict[str, Any]:
    """What both halves are told: map, line, poses and time."""
    assert track.folder is not None
    # Every second point: their half searches the nearest one in plain Python in each step.
    line = track.line[::2, :2]
    poses = track.to_cartesian(np.array([[GAP, 0.0], [0.0, 0.0]]))
    return {
        "map": str(track.folder / f"{track.name}_map.yaml"),
        "line": line.tolist(),
        "ahead": round(1.0 / (2.0 * track.arrays.ds)),
        "poses": poses.tolist(),
        "speed": SPEED,
        "seconds": seconds,
    }


def ours(track: Track, task: dict[str, Any], races: int) -> tuple[float, float, bool]:
    """Processor time of a batch of races, the seconds that it drove in each, and whether a car crashed."""
    shared: dict[str, Any] = {"ahead": task["ahead"]}
    exec(PURSUIT, shared)  # our own text, above
    batch = DriveBatch(
        races,
        players=2,
        opponent=None,
        track=track,
        time_step=0.02,
        top_speed=2.0 * SPEED,  # so that the action 0 is the speed to hold
        beams=BEAMS,
        fov=FOV,
        threads=1,
    )
    rows, generators = np.arange(races), [np.random.default_rng(0) for _ in range(races)]
    spent = driven = 0.0
    crashed = False
    # The first, short run compiles, and does not count.
    for seconds in (0.5, task["seconds"]):
        batch.restart(rows, generators, {"poses": [[*pose, SPEED] for pose in task["poses"]]})
        spent, driven, crashed = 0.0, 0.0, False
        while driven < seconds and not crashed:
            actions = np.zeros((races, 2, 2))
            for car in range(2):
                pose = batch.state.cars[0, car, [0, 1, 4]].tolist()
                actions[:, car, 0] = shared["steer"](task["line"], *pose) / F1TENTH.steer_max
            # The pursuit is plain Python on both sides and outside the clock.
            start = time.thread_time()
            ended = batch.step(actions, generators).terminated
            spent += time.thread_time() - start
            driven = round(driven + 0.02, 2)
            crashed = bool(ended[0])
    batch.close()
    return spent, driven, crashed


def theirs(task: dict[str, Any], checkout: Path, python: Path) -> tuple[float, float, bool]:
    """The same in the gym, run by the Python of its own environment."""
    done = subprocess.run(
        [str(python), "-c", THEIRS], cwd=checkout, input=json.dumps(task), capture_output=True, text=True, check=False
    )
    if done.returncode:
        last = done.stderr.strip().splitlines()[-1:] or ["no message"]
        raise InputError(f"the gym in {checkout} could not be driven by {python}: {last[0]}")
    answer = json.loads(done.stdout.splitlines()[-1])
    return answer["spent"], answer["driven"], answer["crashed"]


def check_gym(checkout: Path | None, python: Path | None) -> None:
    """Refuse half of the two paths, a folder without the gym, and a Python that is none."""
    if (checkout is None) is not (python is None):
        raise InputError("give both --checkout and --python: the gym, and the Python of the environment it runs in")
    if checkout is not None and not (checkout / "f1tenth_gym" / "envs").is_dir():
        raise InputError(f"--checkout {checkout} holds no f1tenth_gym/envs; give a checkout of f1tenth/f1tenth_gym")
    if python is not None and not python.is_file():
        raise InputError(f"--python {python} is no file; give the Python that the gym is installed for")


def main(given: list[str] | None = None) -> int:
    """Print a table; an error that can be put right is one line, and status 2."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--checkout", type=Path, metavar="PATH", help="checkout of the F1TENTH gym")
    parser.add_argument(
        "--python", type=Path, metavar="PATH", help="Python of the environment in which it is installed"
    )
    parser.add_argument("--track", default="Tarnfjord", help="name or folder of a circuit (default: Tarnfjord)")
    parser.add_argument("--seconds", type=float, default=10.0, help="to drive (default: 10)")
    parser.add_argument("--races", type=int, default=64, help="races in our batch (default: 64)")
    arguments = parser.parse_args(given)
    try:
        check_gym(arguments.checkout, arguments.python)
        if not (arguments.seconds >= 1.0 and arguments.races >= 1):
            raise InputError(f"{arguments.seconds:g} s and {arguments.races} races: drive at least 1 s in 1 race")
        track = load_track(arguments.track)
        task = the_task(track, arguments.seconds)
        rows = []
        if arguments.checkout is not None:
            rows.append(("F1TENTH gym, one race", 1, *theirs(task, arguments.checkout, arguments.python)))
        for races in dict.fromkeys((1, arguments.races)):
            rows.append((f"here, {'one race' if races == 1 else f'{races} at once'}", races, *ours(track, task, races)))
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    print(f"{track.name}: two cars, {BEAMS} beams each, {arguments.seconds:g} s, one thread\n")
    first = rows[0][1] * rows[0][3] / rows[0][2]
    print("| simulator | driven, s | simulated seconds per second | ratio | |\n|---|---|---|---|---|")
    for name, races, spent, driven, crashed in rows:
        rate = races * driven / spent
        print(f"| {name} | {driven:g} | {rate:,.0f} | {rate / first:.1f} | {'crashed' if crashed else ''} |")
    if arguments.checkout is None:
        print("\nFor the other simulator give --checkout and --python (see --help).")
    return 0


if __name__ == "__main__":
    sys.exit(main())
