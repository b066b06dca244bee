"""1, 2 and 4 cars with 1080-beam lidars on one map, for the same time: here, and in the F1TENTH gym
(v1.0.0).

    python dev/benchmarks/beside_f1tenth_gym.py                                  # our half alone
    python dev/benchmarks/beside_f1tenth_gym.py --checkout PATH --python PATH  # both, and the ratio

PATH are a checkout of https://github.com/f1tenth/f1tenth_gym and the Python of an environment in
which it is installed (``python -m venv ENV && ENV/bin/pip install -e CHECKOUT
"yamldataclassconfig==1.5"``); it is not on PyPI and pins other versions than we do.

Both simulators drive the same cars, with the parameters of the F1TENTH car, along the
race line, from the same poses, by the same pure pursuit in plain Python, each car 3 m ahead of the
next. A first run compiles and records the actions; three more repeat them, and the fastest
counts: processor time of the thread, nothing but steps. A step of the gym and of our drop-in for it
(``pcs_racing:f1tenth-v0``) lasts 0.01 s, one of `Drive` 0.02 s, integrated at 0.01 s, too:
simulated seconds per second count. Each step scans for every car. `Drive` and its
batch race two cars.
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
from pcs_racing.envs.drive_options import DriveOptions
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

# Run by the other environment's Python and by ours: reads the task as JSON, answers with one line
# of JSON.
STEPPING = (
    PURSUIT
    + """
import json, pathlib, sys, time
import gymnasium, numpy as np

task = json.load(sys.stdin)
line, ahead, cars = task["line"], task["ahead"], len(task["poses"])
made, chosen = task["id"], task["map"]
if made.startswith("f1tenth_gym"):
    import yaml
    from PIL import Image
    from f1tenth_gym.envs.track import Raceline, Track, TrackSpec

    file = pathlib.Path(chosen)
    spec = TrackSpec(name="track", **yaml.safe_load(file.read_text()))
    picture = Image.open(file.parent / spec.image).convert("L")
    pixels = np.array(picture.transpose(Image.FLIP_TOP_BOTTOM))
    xs, ys = np.array(line, np.float32).T
    race = Raceline(xs, ys, np.ones_like(xs))
    free = np.where(pixels > 128, 255.0, 0.0).astype(np.float32)
    chosen = Track(spec, free, centerline=race, raceline=race)
env = gymnasium.make(made, config={
    "map": chosen, "num_agents": cars, "timestep": 0.01, "integrator": "rk4",
    "model": "st", "control_input": ["speed", "steering_angle"],
    "observation_config": {"type": "original"},
}).unwrapped

env.reset(options={"poses": np.array(task["poses"])})
actions, crashed = [], False
while len(actions) < round(100 * task["seconds"]) and not crashed:
    x, y, heading = env.sim.agent_poses.T
    if len(actions) % 2 == 0:
        turns = [steer(line, x[i], y[i], heading[i]) for i in range(cars)]
        action = np.array([[turn, task["speed"]] for turn in turns])
    actions.append(action)
    env.step(action)
    crashed = bool(np.any(env.sim.collisions))
spent, driven = math.inf, len(actions) / 100
for _ in range(3):
    env.reset(options={"poses": np.array(task["poses"])})
    start = time.thread_time()
    for action in actions:
        env.step(action)
    spent = min(spent, time.thread_time() - start)
print(json.dumps({"spent": spent, "driven": driven, "crashed": crashed}))
"""
)


def the_task(track: Track, seconds: float, cars: int) -> dict[str, Any]:
    """Input of both halves: map, line, poses and time."""
    assert track.folder is not None
    # Every second point: their half searches the nearest one in plain Python in each step.
    line = track.line[::2, :2]
    poses = track.to_cartesian(np.array([[GAP * (cars - 1 - i), 0.0] for i in range(cars)]))
    return {
        "map": str(track.folder / f"{track.name}_map.yaml"),
        "line": line.tolist(),
        "ahead": round(1.0 / (2.0 * track.arrays.ds)),
        "poses": poses.tolist(),
        "speed": SPEED,
        "seconds": seconds,
    }


def ours(track: Track, task: dict[str, Any], races: int) -> tuple[float, float, bool]:
    """Processor time of a batch of races, the seconds that it drove in each, and whether a car
    crashed.
    """
    shared: dict[str, Any] = {"ahead": task["ahead"]}
    exec(PURSUIT, shared)  # our own text, above
    options = DriveOptions(
        opponent=None,
        track=track,
        time_step=0.02,
        top_speed=2.0 * SPEED,  # so that the action 0 is the speed to hold
        beams=BEAMS,
        fov=FOV,
    )
    batch = DriveBatch(races, options, players=2, threads=1)
    rows, generators = np.arange(races), [np.random.default_rng(0) for _ in range(races)]
    poses = {"poses": [[*pose, SPEED] for pose in task["poses"]]}
    batch.restart(rows, generators, poses)
    recorded: list[np.ndarray] = []
    crashed = False
    while len(recorded) < round(50 * task["seconds"]) and not crashed:
        actions = np.zeros((races, 2, 2))
        for car in range(2):
            pose = batch.state.cars[0, car, [0, 1, 4]].tolist()
            actions[:, car, 0] = shared["steer"](task["line"], *pose) / F1TENTH.steer_max
        recorded.append(actions)
        crashed = bool(batch.step(actions, generators).terminated[0])
    spent = np.inf
    for _ in range(3):
        batch.restart(rows, generators, poses)
        start = time.thread_time()
        for actions in recorded:
            batch.step(actions, generators)
        spent = min(spent, time.thread_time() - start)
    batch.close()
    return spent, len(recorded) / 50, crashed


def stepped(
    task: dict[str, Any], made: str, python: Path, folder: Path | None
) -> tuple[float, float, bool]:
    """The same in an environment with the gym's interface, run by a Python in a folder."""
    done = subprocess.run(
        [str(python), "-c", STEPPING],
        cwd=folder,
        input=json.dumps({**task, "id": made}),
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode:
        last = done.stderr.strip().splitlines()[-1:] or ["no message"]
        raise InputError(f"{made} could not be driven by {python}: {last[0]}")
    answer = json.loads(done.stdout.splitlines()[-1])
    return answer["spent"], answer["driven"], answer["crashed"]


def check_gym(checkout: Path | None, python: Path | None) -> None:
    """Refuse half of the two paths, a folder without the gym, and a Python that is none."""
    if (checkout is None) is not (python is None):
        raise InputError(
            "give both --checkout and --python: the gym, and the Python of the environment it"
            " runs in"
        )
    if checkout is not None and not (checkout / "f1tenth_gym" / "envs").is_dir():
        raise InputError(
            f"--checkout {checkout} holds no f1tenth_gym/envs; give a checkout of"
            " f1tenth/f1tenth_gym"
        )
    if python is not None and not python.is_file():
        raise InputError(
            f"--python {python} is no file; give the Python that the gym is installed for"
        )


def main(given: list[str] | None = None) -> int:
    """Print a table; an error that can be put right is one line, and status 2."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--checkout", type=Path, metavar="PATH", help="checkout of the F1TENTH gym")
    parser.add_argument(
        "--python",
        type=Path,
        metavar="PATH",
        help="Python of the environment with the gym",
    )
    parser.add_argument(
        "--track", default="Tarnfjord", help="name or folder of a circuit (default: Tarnfjord)"
    )
    parser.add_argument("--seconds", type=float, default=10.0, help="to drive (default: 10)")
    parser.add_argument("--races", type=int, default=64, help="races in our batch (default: 64)")
    parser.add_argument(
        "--cars", type=int, nargs="+", default=[1, 2, 4], metavar="N", help="(default: 1 2 4)"
    )
    arguments = parser.parse_args(given)
    try:
        check_gym(arguments.checkout, arguments.python)
        if not (arguments.seconds >= 1.0 and arguments.races >= 1 and min(arguments.cars) >= 1):
            raise InputError(
                f"{arguments.seconds:g} s and {arguments.races} races: drive at least 1 s in 1 race"
            )
        track = load_track(arguments.track)
        rows = []
        for cars in arguments.cars:
            task = the_task(track, arguments.seconds, cars)
            if arguments.checkout is not None:
                gym = stepped(task, "f1tenth_gym:f1tenth-v0", arguments.python, arguments.checkout)
                rows.append((cars, "F1TENTH gym", 1, *gym))
            here = stepped(task, "pcs_racing:f1tenth-v0", Path(sys.executable), None)
            rows.append((cars, "here, drop-in", 1, *here))
            for races in dict.fromkeys((1, arguments.races)) if cars == 2 else ():
                name = "here, Drive" if races == 1 else f"here, Drive, {races} at once"
                rows.append((cars, name, races, *ours(track, task, races)))
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    print(f"{track.name}: {BEAMS} beams for each car, {arguments.seconds:g} s, one thread\n")
    print(
        "| cars | simulator | driven, s | simulated seconds per second | ratio |"
        " |\n|---|---|---|---|---|---|"
    )
    first: dict[int, float] = {}
    for cars, name, races, spent, driven, crashed in rows:
        rate = races * driven / spent
        ratio = rate / first.setdefault(cars, rate)
        print(
            f"| {cars} | {name} | {driven:g} | {rate:,.1f} | {ratio:.1f} |"
            f" {'crashed' if crashed else ''} |"
        )
    if arguments.checkout is None:
        print("\nFor the other simulator give --checkout and --python (see --help).")
    return 0


if __name__ == "__main__":
    sys.exit(main())
