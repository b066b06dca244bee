"""Memory, descriptors, threads and speed under load: environments for many steps or made anew, and
many races.

    python dev/benchmarks/load.py drive [--envs 1000] [--steps 10000]
    python dev/benchmarks/load.py made [--steps 10000]
    python dev/benchmarks/load.py duel [--envs 100] [--steps 500] [--step-seconds 8]
    python dev/benchmarks/load.py tournament --out FOLDER [--races 1906] [--step-seconds 8]

The work is cut into slices. After each of them: the memory that the process holds (resident, MB),
its open descriptors and threads (not those of worker processes), and the processor time that a unit
of work took, which other processes disturb far less than the time on the clock. Environments get
random actions, so cars crash and episodes begin anew all the time. In a tournament the pairs and
circuits follow each other and are not equally much work; its speed is therefore read off a
yardstick, the same 50 races after every slice. Growth and drift compare the last quarter of the
slices with the second one; the first is left out, since memory is first filled there.
"""

import argparse
import gc
import os
import resource
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

SLICES = 20
PROC = ("/proc/self/fd", "/proc/self/task")
TRACKS = ("Tarnfjord", "Vellindra", "Kestrelheim", "Pipkin", "Saltmere", "Larkmoor", "Quillburg")
AGENTS = (
    "never-switch",
    "random-moves",
    "random-policy",
    "cfr-argmax",
    "lane-switcher",
    "pure-pursuit",
)


class Slice(NamedTuple):
    """Where the work stands after a slice."""

    done: int
    clock: float
    processor: float
    unit_microseconds: float
    megabytes: float
    descriptors: int  #: 0 where the system does not tell.
    threads: int


def resident_megabytes() -> float:
    """Return the memory of the process; where the system does not say, the largest it ever had."""
    try:
        pages = int(Path("/proc/self/statm").read_text().split()[1])
        return pages * os.sysconf("SC_PAGE_SIZE") / 1e6
    except (OSError, ValueError):
        return peak_megabytes()


def slice_at(*facts: float) -> Slice:
    """A slice of these first facts that ends now."""
    gc.collect()  # what only waits to be collected is no leak
    counts = (len(list(folder.iterdir())) if folder.is_dir() else 0 for folder in map(Path, PROC))
    return Slice(*facts, resident_megabytes(), *counts)  # type: ignore[arg-type]


def peak_megabytes() -> float:
    """The most memory that the process ever held."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (
        1e6 if sys.platform == "darwin" else 1e3
    )


def run_steps(step: Callable[[], object], envs: int, steps: int) -> list[Slice]:
    """Call ``step`` again and again, in slices."""
    rows: list[Slice] = []
    size = max(steps // SLICES, 1)
    clock, processor = time.monotonic(), time.process_time()
    before = processor
    for number in range(1, steps + 1):
        step()
        if number % size == 0:
            now = time.process_time()
            unit = 1e6 * (now - before) / (size * envs)
            rows.append(slice_at(number * envs, time.monotonic() - clock, now - processor, unit))
            tell(rows[-1], "steps")
            before = time.process_time()
    return rows


def episodes(env: Any, draw: Callable[[np.random.Generator], object], steps: int) -> list[Slice]:
    """Steps of environments with random actions."""
    env.reset(seed=0)
    rng = np.random.default_rng(0)
    ended = 0

    def step() -> None:
        nonlocal ended
        _, _, terminated, truncated, _ = env.step(draw(rng))
        ended += int((terminated | truncated).sum())

    step()  # compiled, or read from the disk
    rows = run_steps(step, env.num_envs, steps)
    env.close()
    print(f"{ended} episodes ended")
    return rows


def drive(envs: int, steps: int, threads: int) -> list[Slice]:
    """Control-level environments with an opponent on the lattice."""
    from pcs_racing.envs.drive import DriveVectorEnv

    env = DriveVectorEnv(envs, threads=threads)
    return episodes(env, lambda rng: rng.uniform(-1.0, 1.0, (envs, 2)).astype(np.float32), steps)


def duel(envs: int, steps: int, threads: int, step_seconds: float) -> list[Slice]:
    """Games against random moves."""
    from pcs_racing.envs.duel import DuelVectorEnv

    env = DuelVectorEnv(envs, threads=threads, step_seconds=step_seconds)
    moves = int(env.single_action_space.n)  # type: ignore[attr-defined]
    return episodes(env, lambda rng: rng.integers(0, moves, envs), steps)


def made(count: int) -> list[Slice]:
    """Environments of both levels that are made, driven for a step on two threads, and closed."""
    from pcs_racing.envs.drive import DriveVectorEnv
    from pcs_racing.envs.duel import DuelVectorEnv

    def step() -> None:
        for env in (DriveVectorEnv(2, threads=2), DuelVectorEnv(2, threads=2, step_seconds=0.2)):
            env.reset(seed=0)
            env.step(np.zeros(env.action_space.shape, env.action_space.dtype))
            env.close()

    step()
    return run_steps(step, 2, count // 2)


def tournament(folder: Path, races: int, step_seconds: float, executor: str) -> list[Slice]:
    """Race all against all through a job with chunks, as the command does; write the results."""
    from pcs_racing import load_track
    from pcs_racing_agents.base.executors import make_executor
    from pcs_racing_agents.base.jobs import open_job
    from pcs_racing_agents.tournament import (
        game_rules,
        plan_tournament,
        play_plan,
        tournament_settings,
        tournament_text,
        write_results,
    )

    rules = game_rules("paper", step_seconds=step_seconds)
    plan = plan_tournament(
        [load_track(name) for name in TRACKS], list(AGENTS), rules, races_per_pair=races
    )
    measure = yardstick()
    rows: list[Slice] = []
    clock, processor, apart = time.monotonic(), time.process_time(), 0.0

    def progress(done: int, total: int, what: str) -> None:
        nonlocal apart
        if done < total * (len(rows) + 1) // SLICES:
            return
        unit, spent = measure()
        apart += spent
        used = time.process_time() - processor - apart
        rows.append(slice_at(done, time.monotonic() - clock, used, unit))
        tell(rows[-1], "races")

    # The first call compiles; its time belongs neither to the races nor to the yardstick.
    measure()
    apart = 0.0
    clock, processor = time.monotonic(), time.process_time()
    with (
        make_executor(executor) as workers,
        open_job(folder, "tournament", tournament_settings(plan)) as job,
    ):
        played = play_plan(plan, job=job, executor=workers, progress=progress)
        used = time.process_time() - processor - apart
        print(
            f"{len(played.races)} races: {used:.0f} s of processor time,"
            f" {1e3 * used / len(played.races):.2f} ms a race"
        )
        print(
            f"with what came of them: {resident_megabytes():.0f} MB, at most so far"
            f" {peak_megabytes():.0f} MB"
        )
        begin = time.process_time()
        write_results(played.races, folder / "results.csv")
        print(
            f"a line for each written in {time.process_time() - begin:.1f} s:"
            f" {resident_megabytes():.0f} MB"
        )
        begin = time.process_time()
        print(tournament_text(played))
        print(f"table in {time.process_time() - begin:.1f} s: at most {peak_megabytes():.0f} MB")
    return rows


def yardstick() -> Callable[[], tuple[float, float]]:
    """Return a function that drives the same races, and says how many microseconds of processor
    each took, and all.
    """
    from pcs_racing import PAPER, load_track, parse_policy, run_races
    from pcs_racing.race.races import draw_starts

    track, car = load_track("Tarnfjord"), parse_policy("lattice")
    starts = draw_starts(track, PAPER, 50, 1)

    def measure() -> tuple[float, float]:
        begin, best = time.thread_time(), np.inf
        for _ in range(3):
            start = time.thread_time()
            run_races(track, car, car, PAPER, seed=1, starts=starts, threads=1)
            best = min(best, time.thread_time() - start)
        return 1e6 * best / 50, time.thread_time() - begin

    return measure


def tell(row: Slice, unit: str) -> None:
    print(
        f"{row.done:10d} {unit}  {row.clock:7.0f} s on the clock  {row.processor:7.0f} s of"
        f" processor  {row.unit_microseconds:9.2f} us  {row.megabytes:7.0f} MB  {row.descriptors}"
        f" open  {row.threads} threads",
        flush=True,
    )


def judge(rows: list[Slice]) -> None:
    """Compare the last quarter of the slices with the second."""
    if len(rows) < SLICES:
        print("not all of it was done now: there is nothing to compare")
        return
    # The first quarter fills caches and memory, which is no leak.
    quarter = max(len(rows) // 4, 1)
    early, late = rows[quarter : 2 * quarter], rows[-quarter:]
    memory = np.mean([row.megabytes for row in late]) - np.mean([row.megabytes for row in early])
    speed = np.median([row.unit_microseconds for row in late]) / np.median(
        [row.unit_microseconds for row in early]
    )
    work = np.mean([row.done for row in late]) - np.mean([row.done for row in early])
    print(
        f"memory: {memory:+.1f} MB, {1e6 * memory / work:+.1f} bytes for each further one of"
        f" {work:.0f}"
    )
    for what in ("descriptors", "threads"):
        print(
            f"{what}: at most",
            *(f"{max(getattr(row, what) for row in rows)}" for rows in (early, late)),
        )
    print(f"time of a unit: {100.0 * (speed - 1.0):+.1f} %")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "what", choices=("drive", "duel", "made", "tournament"), nargs="?", default="duel"
    )
    parser.add_argument("--envs", type=int)
    parser.add_argument("--steps", type=int)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--races", type=int, default=1906, help="of each pair on each circuit")
    parser.add_argument(
        "--step-seconds",
        type=float,
        default=8.0,
        help="driving per move, s; a race has five such steps",
    )
    parser.add_argument("--executor", default="threads")
    parser.add_argument("--out", type=Path, help="folder of the tournament")
    given = parser.parse_args()
    if given.what == "tournament":
        if given.out is None:
            parser.error("a tournament needs --out FOLDER")
        rows = tournament(given.out, given.races, given.step_seconds, given.executor)
    elif given.what == "made":
        rows = made(given.steps or 10_000)
    else:
        envs, steps = (1000, 10_000) if given.what == "drive" else (100, 500)
        size = (given.envs or envs, given.steps or steps, given.threads)
        rows = drive(*size) if given.what == "drive" else duel(*size, given.step_seconds)
    judge(rows)


if __name__ == "__main__":
    main()
