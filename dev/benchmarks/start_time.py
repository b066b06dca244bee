"""Measure a new user's wait: processor time until the first step, nothing compiled before, and the
number of compiled functions.

    python dev/benchmarks/start_time.py
    python dev/benchmarks/start_time.py --against PATH     # and the package in another checkout

Each program runs in a process with an empty folder for compiled code, after a first run that builds
and keeps the circuit. With another checkout both are measured in turns; printed are the medians of
three, and the ratio.
"""

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

COUNTED = """
import time
from numba.core import event
class Count(event.Listener):
    number = 0
    def on_start(self, event):
        Count.number += 1
    def on_end(self, event):
        pass
event.register("numba:compile", Count())
{}
print()
print(time.process_time(), Count.number)
"""
"""Program that also prints its processor time (s) and its number of compiled functions."""

STEP = """
import gymnasium as gym
import pcs_racing
env = gym.make({})
env.reset(seed=1)
env.step(env.action_space.sample())
"""

PROGRAMS = {
    "one car alone": STEP.format('"pcs_racing/Drive-v1", opponent=None'),
    "README": STEP.format('"pcs_racing/Drive-v1", opponent="lattice:pace=0.3", beams=108'),
    "duel": STEP.format('"pcs_racing/Duel-v1"'),
    "pcs-racing race": """
from pcs_racing_agents.cli.main import main
main(["race"])
""",
    "batch with lidar": """
import numpy as np
from pcs_racing.envs.drive import DriveVectorEnv
env = DriveVectorEnv(64, opponent="lattice", beams=1080)
env.reset(seed=1)
env.step(np.zeros((64, 2), np.float32))
""",
}

RUNS = 3


def first_step(program: str, folder: Path) -> tuple[float, float]:
    """Processor time (s) and compiled functions of a program with the package in a folder."""
    with tempfile.TemporaryDirectory() as empty:
        paths = {"PYTHONPATH": str(folder), "NUMBA_CACHE_DIR": empty}
        done = subprocess.run(
            [sys.executable, "-c", COUNTED.format(program)],
            cwd=empty,
            env={**os.environ, **paths, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
            capture_output=True,
            text=True,
        )
    if done.returncode:
        raise SystemExit(done.stderr)
    seconds, functions = done.stdout.splitlines()[-1].split()
    return float(seconds), float(functions)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--against", type=Path, metavar="PATH", help="measure the checkout in this folder, too"
    )
    given = parser.parse_args()
    folders = [Path(__file__).resolve().parents[2]]
    folders += [given.against.resolve()] if given.against else []
    for name, program in PROGRAMS.items():
        runs = [[first_step(program, folder) for folder in folders] for _ in range(1 + RUNS)]
        rows = [
            [statistics.median(run[i][k] for run in runs[1:]) for k in range(2)]
            for i in range(len(folders))
        ]
        said = " against ".join(
            f"{seconds:.1f} s, {count:.0f} functions" for seconds, count in rows
        )
        print(f"{name}: {said}; ratio {rows[0][0] / rows[-1][0]:.2f}", flush=True)


if __name__ == "__main__":
    main()
