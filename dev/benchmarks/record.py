"""History of speed: a few ratios of times measured in one run, so that machines can be compared,
roughly.

    python dev/benchmarks/record.py            measure
    python dev/benchmarks/record.py --add      measure, and add a line to dev/benchmarks/history.csv
    python dev/benchmarks/record.py --check    measure, and compare with the history (exit code 1)

Every time is divided by the time of a fixed piece of compiled arithmetic (the reference), measured
alternately: the processor's speed and its other work mostly cancel out. Times are the
thread's own, the best of several. A ratio counts as slower when it is more than 30 % above the
median of the last five lines of the same machine, or of all machines if this one has no line.
"""

import argparse
import csv
import platform
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from statistics import median

import numpy as np

HISTORY = Path(__file__).resolve().parent / "history.csv"
FACTS = ("date", "version", "commit", "processor", "reference_ms")
RATIOS = {
    "race": "one race of the paper, two lattice planners, 40 s",
    "scan": "a lidar scan of 1080 beams",
    "drive_step": (
        "a step of 0.1 s of the control-level environment, in a batch of 64 alone on the track"
    ),
    "drive_call": "one call of the scalar control-level environment, 0.02 s",
    "cfr": "100 iterations of CFR on a game of two moves with four choices",
    "exact": "the exact solution of that game",
}
SLOWER = 1.3
LAST = 5
ROUNDS = 5


def slower(
    found: Mapping[str, float], history: Sequence[Mapping[str, str]], processor: str
) -> list[str]:
    """Return the ratios that are well above their last values, in a line each.

    Parameters
    ----------
    found : mapping of str to float
        The ratios of now.
    history : sequence of mapping
        Lines of the file, oldest first; a ratio may be missing in old ones.
    processor : str
        The present machine, whose own lines count if there are any.
    """
    # Ratios still differ between processors: caches and vectors do not scale as the reference does.
    own = [line for line in history if line.get("processor") == processor] or list(history)
    lines = []
    for name, ratio in found.items():
        before = [float(line[name]) for line in own if line.get(name)][-LAST:]
        if before and ratio > SLOWER * median(before):
            lines.append(
                f"{name} takes {ratio:.4g} times the reference; it was {median(before):.4g} "
                f"({100.0 * (ratio / median(before) - 1.0):+.0f} %): {RATIOS.get(name, name)}"
            )
    return lines


def reference() -> Callable[[], object]:
    """A fixed piece of arithmetic, compiled: square roots and a branch, a few million times."""
    from numba import njit

    @njit(cache=False)
    def work(n):  # type: ignore[no-untyped-def]
        x, total = 0.5, 0.0
        for i in range(n):
            x = np.sqrt(x * x + 0.25 + 1e-9 * i)
            if x > 1.0:
                x -= 1.0
            total += x
        return total

    return lambda: work(2_000_000)


def measured() -> dict[str, tuple[Callable[[], object], int]]:
    """Timed calls, with the number of units in a call."""
    from pcs_racing import PAPER, load_track, racer, run_races
    from pcs_racing.car.lidar import Lidar
    from pcs_racing.envs.drive import DriveEnv, DriveVectorEnv
    from pcs_racing.race.races import draw_starts
    from pcs_racing_agents.solvers import GameTree, cfr, solve_exact

    track, car = load_track("Tarnfjord"), racer("lattice")
    starts = draw_starts(track, PAPER, 10, 1)
    lidar, places = (
        Lidar(track),
        track.to_cartesian(np.column_stack([np.linspace(0.0, 50.0, 100), np.zeros(100)])),
    )
    envs = DriveVectorEnv(64, track=track, opponent=None, threads=1)
    envs.reset(seed=0)
    straight = np.tile(np.array([0.0, -0.75], np.float32), (64, 1))
    env = DriveEnv(track=track, opponent="pure-pursuit", time_step=0.02)
    tree = GameTree.from_payoffs(np.random.default_rng(0).normal(size=(4,) * 4))

    def calls() -> None:
        env.reset(seed=0)
        for _ in range(50):
            env.step(straight[0])

    return {
        "race": (lambda: run_races(track, car, car, PAPER, seed=1, starts=starts, threads=1), 10),
        "scan": (lambda: lidar.scan(places), 100),
        "drive_step": (lambda: [envs.step(straight) for _ in range(20)], 20 * 64),
        "drive_call": (calls, 50),
        "cfr": (lambda: cfr(tree, 100), 1),
        "exact": (lambda: solve_exact(tree), 1),
    }


def measure() -> tuple[dict[str, float], float]:
    """Return the ratios, and the reference in ms."""
    base, tasks = reference(), measured()
    # The best, not the mean: other work on the machine only ever makes something slower.
    best = dict.fromkeys(("reference", *tasks), np.inf)
    for _ in range(ROUNDS + 1):  # the first one compiles
        # The reference in each round, so that a change of the clock during the run meets both sides
        # of a ratio.
        for name, (work, units) in {"reference": (base, 1), **tasks}.items():
            start = time.thread_time()
            work()
            best[name] = min(best[name], (time.thread_time() - start) / units)
    ratios = {name: best[name] / best["reference"] for name in tasks}
    return ratios, 1e3 * best["reference"]


def processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        return next(
            line.partition(":")[2].strip() for line in lines if line.startswith("model name")
        )
    except (OSError, StopIteration):
        return platform.processor() or platform.machine()


def commit() -> str:
    found = subprocess.run(
        ["git", "rev-parse", "--short", "HEAD"],
        cwd=HISTORY.parent,
        capture_output=True,
        text=True,
        check=False,
    )
    return found.stdout.strip() or "unknown"


def read_history(file: Path = HISTORY) -> list[dict[str, str]]:
    with open(file, newline="", encoding="utf-8") as lines:
        return list(csv.DictReader(lines))


def add_line(ratios: Mapping[str, float], reference_ms: float, file: Path = HISTORY) -> None:
    """Add a line; columns that older lines do not have are empty there."""
    facts = {
        "date": datetime.now(UTC).date().isoformat(),
        "version": version("pcs-racing"),
        "commit": commit(),
        "processor": processor(),
        "reference_ms": f"{reference_ms:.4g}",
    }
    rows = [
        *read_history(file),
        {**facts, **{name: f"{ratio:.4g}" for name, ratio in ratios.items()}},
    ]
    with open(file, "w", newline="", encoding="utf-8") as lines:
        writer = csv.DictWriter(lines, [*FACTS, *RATIOS], restval="", lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--check", action="store_true", help="compare, and add nothing")
    parser.add_argument("--add", action="store_true", help="add a line to the history")
    given = parser.parse_args()
    ratios, reference_ms = measure()
    for name, ratio in ratios.items():
        print(
            f"{name:12} {ratio:10.4g} times the reference ({reference_ms:.2f} ms): {RATIOS[name]}"
        )
    if given.check:
        wrong = slower(ratios, read_history(), processor())
        sys.exit("SLOWER\n" + "\n".join(wrong) if wrong else 0)
    if given.add:
        add_line(ratios, reference_ms)
        print(f"added to {HISTORY}")


if __name__ == "__main__":
    main()
