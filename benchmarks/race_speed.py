"""How long a 40 s race between two lattice cars takes on one core, and where the time goes.

    python benchmarks/race_speed.py                    # on a shipped circuit
    python benchmarks/race_speed.py --track DIR --json # ends with one JSON line holding ms_per_race_per_core
    python benchmarks/race_speed.py --against PATH     # beside the package in another checkout: how many times as fast

Processor time, the best of several repeats, scaled to 40 s (races end early in a crash). The parts are timed alone
on states from the middle of the same races, and multiplied by how often a race calls them; what they leave over is the
loop itself. With ``--against`` the two packages take turns, each in a process of its own.
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
from numba import njit

from pcs_racing.base.seeds import race_seeds
from pcs_racing.car.lanes import LANES, LANES_SIZE, load_car, step_lanes
from pcs_racing.car.vehicle import F1TENTH
from pcs_racing.planners import lattice
from pcs_racing.planners.lattice import LATTICE
from pcs_racing.planners.pursuit import follow_path
from pcs_racing.planners.view import PATH_COLUMNS, PATH_POINTS, VIEW_SIZE
from pcs_racing.race.config import load_race_config
from pcs_racing.race.contacts import collide
from pcs_racing.race.kernel import fill_view, measure_ittc
from pcs_racing.race.progress import update_progress
from pcs_racing.race.races import RaceSetup, advance, draw_starts, start_races
from pcs_racing.race.rates import CONTROL_EVERY, ITTC_EVERY, PLAN_EVERY
from pcs_racing.race.state import RaceState, take
from pcs_racing.track.frenet import WALLS_BEGIN, WALLS_END, WallArrays
from pcs_racing.track.loading import load_track

REPEATS = 8
CALLS = 4000


@njit(error_model="numpy")
def _plans(n, track, theta, view, memory, scratch, path):  # type: ignore[no-untyped-def]
    for _ in range(n):
        lattice.plan(track, theta, view, memory, scratch, path)


@njit(error_model="numpy")
def _controls(n, track, theta, view, memory, scratch, path, command):  # type: ignore[no-untyped-def]
    for _ in range(n):
        follow_path(track, theta, view, memory, scratch, path, command)


@njit(error_model="numpy")
def _steps(n, lanes):  # type: ignore[no-untyped-def]
    for _ in range(n):
        step_lanes(lanes, LANES, 0.01)


@njit(error_model="numpy")
def _progresses(n, line, ds, length, cars, frenet, progress, laps):  # type: ignore[no-untyped-def]
    for _ in range(n):
        update_progress(line, ds, length, cars, frenet, progress, laps, 0, 0)


@njit(error_model="numpy")
def _collisions(n, t, cars, frenet, crash, fault, params):  # type: ignore[no-untyped-def]
    near = WallArrays(*t[WALLS_BEGIN:WALLS_END])
    for _ in range(n):
        collide(near, cars, frenet, crash, fault, 0, params)


@njit(error_model="numpy")
def _ittcs(n, t, cars, frenet, sums, params):  # type: ignore[no-untyped-def]
    near = WallArrays(*t[WALLS_BEGIN:WALLS_END])
    for _ in range(n):
        measure_ittc(near, cars, frenet, sums, 0, params, 10.0)


def best_of(action: Callable[[], object]) -> float:
    """Least processor time of several repeats, s; the first call, which compiles, does not count."""
    action()
    times = []
    for _ in range(REPEATS):
        start = time.process_time()
        action()
        times.append(time.process_time() - start)
    return min(times)


# Runs the same races once for each line that it reads; nothing but the public interface, which other checkouts have.
RACES = """
import sys, time
import numpy as np
import pcs_racing
track, races = pcs_racing.load_track(sys.argv[1]), int(sys.argv[2])
config, lattice = pcs_racing.load_race_config("paper"), pcs_racing.parse_policy("lattice")
paces = [pcs_racing.parse_policy(f"lattice:pace={pace:.3f}") for pace in np.linspace(0.05, 0.95, races)]
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
    """Least value that a program prints with this package and with the one in another checkout, which take turns."""
    workers = [
        subprocess.Popen(
            [sys.executable, "-c", code, *arguments],
            env={**os.environ, "PYTHONPATH": str(folder)},
            cwd=folder,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        for folder in (Path(__file__).resolve().parents[1], other.resolve())
    ]
    best = [float("inf")] * len(workers)
    for worker in workers:
        assert worker.stdout is not None
        print(f"  {worker.stdout.readline().strip()}")
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
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--track", default="Tarnfjord", help="name or folder of a circuit")
    parser.add_argument("--races", type=int, default=40)
    parser.add_argument("--json", action="store_true", help="end with one JSON line")
    parser.add_argument("--against", type=Path, metavar="PATH", help="only compare with the checkout in this folder")
    arguments = parser.parse_args()
    if arguments.against is not None:
        new, old = side_by_side(RACES, [arguments.track, str(arguments.races)], arguments.against)
        print(f"{new:.2f} ms per 40 s race and core here, {old:.2f} ms there: {old / new:.2f} times as fast")
        return
    track = load_track(arguments.track)
    config = load_race_config("paper")
    races = arguments.races
    setup = RaceSetup(track, config, (LATTICE, LATTICE))
    starts = draw_starts(track, config, races, 0)
    rng = np.random.default_rng(0)
    theta = np.tile(LATTICE.default, (races, 2, 1))
    theta[:, :, LATTICE.parameter_names.index("pace")] = rng.uniform(0.0, 1.0, (races, 2))

    def run(threads: int) -> float:
        state = start_races(setup, starts, race_seeds(0, races))
        advance(setup, state, theta, config.ticks, threads=threads)
        return float(state.tick.sum()) / config.ticks

    full = run(1)
    per_race = 1e3 * best_of(lambda: run(1)) / full
    wall = []
    for threads in (1, 2):
        start = time.perf_counter()
        for _ in range(3):
            run(threads)
        wall.append(time.perf_counter() - start)

    state = start_races(setup, starts, race_seeds(0, races))
    advance(setup, state, theta, 600, threads=1)
    going = take(state, np.flatnonzero(~state.crashed)[:8])
    params = np.stack([vehicle.as_row() for vehicle in setup.vehicles])
    t = track.arrays
    scratch, path = np.empty(LATTICE.scratch_size), np.zeros((PATH_POINTS, PATH_COLUMNS))
    ticks = config.ticks

    def parts(one: RaceState) -> dict[str, float]:
        """Milliseconds that each part takes in a 40 s race, timed on one race."""
        view, command = np.zeros(VIEW_SIZE), np.zeros(2)
        fill_view(t, one, 0, 0, params, setup.settings, view)
        memory = one.memory[0, 0]
        theta = LATTICE.default
        lattice.plan(t, theta, view, memory, scratch, path)
        lanes = np.zeros(LANES_SIZE)
        for lane in range(LANES):
            load_car(lanes, lane, one.cars[0, lane % 2], F1TENTH.as_row())
        arrays = (one.cars, one.frenet)
        timed: dict[str, tuple[int, Callable[[], object]]] = {
            "planner": (2 * ticks // PLAN_EVERY, lambda: _plans(CALLS, t, theta, view, memory, scratch, path)),
            "pursuit": (
                2 * ticks // CONTROL_EVERY,
                lambda: _controls(CALLS, t, theta, view, memory, scratch, path, command),
            ),
            "dynamics (RK4)": (2 * ticks // LANES, lambda: _steps(CALLS, lanes.copy())),
            "Frenet projection": (
                ticks // CONTROL_EVERY,
                lambda: _progresses(CALLS, t.line, t.ds, t.length, *arrays, one.progress, one.laps),
            ),
            "collisions": (
                ticks // CONTROL_EVERY,
                lambda: _collisions(CALLS, t, *arrays, one.crash, one.fault, params),
            ),
            "minimum iTTC": (ticks // ITTC_EVERY, lambda: _ittcs(CALLS, t, *arrays, one.sums, params)),
        }
        return {name: 1e3 * best_of(action) / CALLS * calls for name, (calls, action) in timed.items()}

    every = [parts(take(going, [i])) for i in range(going.races)]
    rows = {name: float(np.mean([one[name] for one in every])) for name in every[0]}
    print(f"{track.name}: {per_race:.2f} ms per 40 s race and core ({races} races, {full:.1f} of full length)")
    print(f"two threads: {wall[0] / wall[1]:.2f} times as fast as one")
    for name, value in rows.items():
        print(f"  {name:18s} {value:5.2f} ms  {value / per_race:4.0%}")
    rest = per_race - sum(rows.values())
    print(f"  {'loop and views':18s} {rest:5.2f} ms  {rest / per_race:4.0%}")
    if arguments.json:
        print(
            json.dumps(
                {"ms_per_race_per_core": round(per_race, 3), "parts_ms": {k: round(v, 3) for k, v in rows.items()}}
            )
        )


if __name__ == "__main__":
    main()
