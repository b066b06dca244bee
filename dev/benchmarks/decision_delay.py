"""Delay of a decision on a car: from the messages of ROS to the command, at a fixed rate.

    python dev/benchmarks/decision_delay.py

The logic of the planner node (``examples/ros2_bridge``) drives a simulated car in real time, with
scans of 1080 beams and odometry of both cars 50 times a second. ROS itself is not part of it.
"""

import argparse
import sys
import tempfile
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from pcs_racing_agents.agents import export_onnx

ROOT = Path(__file__).resolve().parents[2]
KINDS = {"/scan": "scan", "/ego_racecar/odom": "odometry", "/opp_racecar/odom": "opponent"}


def as_message(fields: dict[str, Any]) -> SimpleNamespace:
    parts = {k: as_message(v) if isinstance(v, dict) else v for k, v in fields.items()}
    return SimpleNamespace(**{"range_min": 0.0, **parts})


def delays_of(policy: str, rate: float, seconds: float) -> np.ndarray:
    """Return the delay of each decision, ms."""
    sys.path.insert(0, str(ROOT / "examples" / "ros2_bridge"))
    from pcs_racing_ros.planning import Planning
    from pcs_racing_ros.simulation import TIME_STEP, Simulation

    race, planning = Simulation(opponent="lattice:pace=0", seed=1), Planning(policy)
    delays, stepped = [], 0
    begin = time.perf_counter()
    for k in range(round(rate * seconds)):
        now = k / rate
        if now >= stepped * TIME_STEP:
            stepped += 1
            for one in race.step():
                if one.topic in KINDS:
                    planning.hear(KINDS[one.topic], as_message(one.fields), now)
        time.sleep(max(0.0, begin + now - time.perf_counter()))
        asked = time.perf_counter()
        command = planning.command(now)
        delays.append(1e3 * (time.perf_counter() - asked))
        race.command(0, *command)
    return np.array(delays[5:])  # the first ones load code


def main() -> None:
    parser = argparse.ArgumentParser(description="delay of a decision on a car")
    parser.add_argument("--rate", type=float, default=100.0, help="commands a second")
    parser.add_argument("--seconds", type=float, default=20.0, help="duration of a drive")
    arguments = parser.parse_args()
    print("| policy | commands a second | median, ms | 99 %, ms | max, ms |\n|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        file = export_onnx("lidar-ppo", Path(folder) / "lidar-ppo.onnx")
        for policy in ("line-ppo", str(file)):
            delays = delays_of(policy, arguments.rate, arguments.seconds)
            numbers = np.percentile(delays, [50, 99, 100])
            cells = " | ".join(f"{number:.2f}" for number in numbers)
            print(f"| {Path(policy).name} | {arguments.rate:g} | {cells} |", flush=True)


if __name__ == "__main__":
    main()
