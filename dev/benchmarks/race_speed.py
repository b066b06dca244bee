"""Time a 40 s race between two lattice cars on one core.

    python dev/benchmarks/race_speed.py                    # on a shipped circuit
    # ends with one JSON line holding ms_per_race_per_core
    python dev/benchmarks/race_speed.py --track DIR --json
    # times as fast as the package in another checkout
    python dev/benchmarks/race_speed.py --against PATH

Processor time, the best of several repeats, scaled to 40 s (races end early in a crash). With
``--against`` the two packages take turns, each in a process of its own.
"""

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from pcs_racing import load_rules, load_track, racer, run_races

REPEATS = 8


def best_of(action: Callable[[], object], clock: Callable[[], float]) -> float:
    """Least time of several repeats, s; the first call, which compiles, does not count."""
    action()
    times = []
    for _ in range(REPEATS):
        start = clock()
        action()
        times.append(clock() - start)
    return min(times)


# Runs the same races once for each line that it reads; nothing but the public interface, which
# other checkouts have.
RACES = """
import sys, time
import numpy as np
import pcs_racing
track, races = pcs_racing.load_track(sys.argv[1]), int(sys.argv[2])
config, lattice = pcs_racing.load_rules("paper"), pcs_racing.racer("lattice")
texts = [f"lattice:pace={pace:.3f}" for pace in np.linspace(0.05, 0.95, races)]
paces = [pcs_racing.racer(text) for text in texts]
def run():
    start = time.process_time()
    state = pcs_racing.run_races(track, paces, lattice, config, seed=0, threads=1).state
    return 1e3 * (time.process_time() - start) * config.ticks / state.tick.sum()
run()
print(pcs_racing.__file__, flush=True)
for _ in sys.stdin:
    print(run(), flush=True)
"""


def side_by_side(code: str, arguments: list[str], other: Path) -> tuple[float, float]:
    """Least value that a program prints with this package and with the one in another checkout,
    which take turns.
    """
    workers = [
        subprocess.Popen(
            [sys.executable, "-c", code, *arguments],
            env={**os.environ, "PYTHONPATH": str(folder)},
            cwd=folder,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        for folder in (Path(__file__).resolve().parents[2], other.resolve())
    ]
    best = [float("inf")] * len(workers)
    for worker in workers:
        assert worker.stdout is not None
        print(f"  {worker.stdout.readline().strip()}")
    # Alternately: the first measured checkout would meet a cooler processor.
    for _ in range(4 * REPEATS):
        for i, worker in enumerate(workers):
            assert worker.stdin is not None
            assert worker.stdout is not None
            print(file=worker.stdin, flush=True)
            best[i] = min(best[i], float(worker.stdout.readline()))
    for worker in workers:
        worker.communicate()
    return best[0], best[1]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--track", default="Tarnfjord", help="name or folder of a circuit")
    parser.add_argument("--races", type=int, default=40)
    parser.add_argument("--json", action="store_true", help="end with one JSON line")
    parser.add_argument(
        "--against", type=Path, metavar="PATH", help="only compare with the checkout in this folder"
    )
    arguments = parser.parse_args()
    if arguments.against is not None:
        new, old = side_by_side(RACES, [arguments.track, str(arguments.races)], arguments.against)
        print(
            f"{new:.2f} ms per 40 s race and core here, {old:.2f} ms there: {old / new:.2f} times"
            " as fast"
        )
        return
    track, config, races = load_track(arguments.track), load_rules("paper"), arguments.races
    paces = [racer(f"lattice:pace={pace:.3f}") for pace in np.linspace(0.05, 0.95, races)]
    lattice = racer("lattice")

    def run(threads: int) -> float:
        """Drive them, and return how many races of full length that was."""
        state = run_races(track, paces, lattice, config, seed=0, threads=threads).state
        return float(state.tick.sum()) / config.ticks

    full = run(1)
    per_race = 1e3 * best_of(lambda: run(1), time.process_time) / full
    wall = [best_of(lambda threads=threads: run(threads), time.perf_counter) for threads in (1, 2)]
    print(
        f"{track.name}: {per_race:.2f} ms per 40 s race and core ({races} policies, {full:.1f}"
        " races of full length)"
    )
    print(f"two threads: {wall[0] / wall[1]:.2f} times as fast as one")
    if arguments.json:
        print(json.dumps({"ms_per_race_per_core": round(per_race, 3)}))


if __name__ == "__main__":
    main()
