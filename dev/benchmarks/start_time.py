"""How long a new user waits: compilation before the first race, and `pcs-racing race` until its
first line.

    python dev/benchmarks/start_time.py
    python dev/benchmarks/start_time.py --against PATH     # beside the package in another checkout

The first race of two lattice cars runs in a process whose folders for compiled code are empty (the
circuit comes from its own cache, if it is there). The command runs as a user would run it, the
second time and later. Both are processor time of the process; for the command the best of a few.
"""

import argparse
import os
import subprocess
import sys
import tempfile
from pathlib import Path

FIRST_RACE = """
import time
import pcs_racing
track, lattice = pcs_racing.load_track("Tarnfjord"), pcs_racing.racer("lattice")
paper = pcs_racing.load_rules("paper")
pcs_racing.run_races(track, [lattice], lattice, paper, seed=0, threads=1)
print(time.process_time())
"""

# The command, with the processor time of the process when it wrote its first line.
FIRST_LINE = """
import sys, time
class Out:
    def __init__(self, out):
        self.out, self.first = out, None
    def write(self, text):
        self.first = self.first or time.process_time()
        return self.out.write(text)
    def __getattr__(self, name):
        return getattr(self.out, name)
sys.stdout = Out(sys.stdout)
from pcs_racing_agents.cli.main import main
main(["race"])
print(sys.stdout.first)
"""

WARM_STARTS = 6


def processor_time(code: str, folder: Path, **variables: str) -> float:
    """Number in the last line that a program prints with the package in a folder, s."""
    environment = {**os.environ, "PYTHONPATH": str(folder), **variables}
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=folder, env=environment, capture_output=True, text=True
    )
    if done.returncode:
        raise SystemExit(done.stderr)
    return float(done.stdout.splitlines()[-1])


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--against", type=Path, metavar="PATH", help="measure the checkout in this folder, too"
    )
    given = parser.parse_args()
    folders = [
        Path(__file__).resolve().parents[2],
        *([given.against.resolve()] if given.against else []),
    ]
    for folder in folders:
        with tempfile.TemporaryDirectory() as empty:
            first = processor_time(FIRST_RACE, folder, NUMBA_CACHE_DIR=empty)
        print(
            f"{folder}: {first:.1f} s of processor time until the first race is over, nothing"
            " compiled before"
        )
    # The first start compiles and reads files from disk; a user's second one counts.
    best = [float("inf")] * len(folders)
    for _ in range(1 + WARM_STARTS):
        for i, folder in enumerate(folders):
            best[i] = min(best[i], processor_time(FIRST_LINE, folder))
    for folder, seconds in zip(folders, best, strict=True):
        print(
            f"{folder}: {seconds:.2f} s of processor time until `pcs-racing race` writes its first"
            " line"
        )


if __name__ == "__main__":
    main()
