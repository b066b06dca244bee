"""``pcs-racing compile``: compile the kernels ahead of the first race."""

import sys
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from contextlib import suppress
from functools import partial
from io import StringIO
from multiprocessing import get_context

import numpy as np

from pcs_racing.car.lidar import Lidar
from pcs_racing.game.make import make_game
from pcs_racing.planners.registry import parse_policy, planner_names
from pcs_racing.race.config import load_rules
from pcs_racing.race.races import draw_starts, run_races
from pcs_racing.track.loading import load_track
from pcs_racing_agents.base.jobs import show_progress
from pcs_racing_agents.cli.commands import command

TRACK = "Pipkin"
PLANNERS = ("lattice", "lane-switcher:3", "pure-pursuit", "gap-follower")


@command("compile", "pcs-racing compile")
def run() -> None:
    """Compile the kernels now (they are cached on disk)."""
    begin = time.monotonic()
    compile_kernels()
    print(f"compiled in {time.monotonic() - begin:.0f} s; cached kernels skipped")


def compile_kernels() -> None:
    """Compile the common kernels of commands, environments and tests, in two processes.

    The tasks of a row take about the same time and share few functions, since two processes would
    both compile a shared function. Functions of a row may call functions of the rows above.
    """
    rows: tuple[dict[str, Callable[[], object]], ...] = (
        {"a circuit": partial(load_track, TRACK), "planners of most races": _planners},
        {"races": _races, "all other planners": _field},
        {"environments at the control level": _drives, "random circuits": _circuits},
        {"the step of the F1TENTH gym": _gym, "solvers of games": _solvers},
    )
    show, done, total = show_progress("parts"), 0, sum(map(len, rows))
    # Spawned, not forked: numba's threads do not survive a fork.
    with ProcessPoolExecutor(2, get_context("spawn"), _say_nothing) as pool:
        for row in rows:
            for task in [pool.submit(function) for function in row.values()]:
                show(done, total, " and ".join(row))
                task.result()
                done += 1
    show(done, total, "")


def _say_nothing() -> None:
    """Keep the announcements of a process out of the line of progress."""
    sys.stderr = StringIO()


def _planners() -> None:
    """Compile the planners of most races, without a race."""
    for text in PLANNERS:
        parse_policy(text).planner.pointers()


def _field() -> None:
    """Compile all other planners."""
    for name in sorted({*planner_names()} - {*PLANNERS}):
        parse_policy(name).planner.pointers()


def _races() -> None:
    """Compile races of all planners, single and batched, and a game's observations of them."""
    track, lattice = load_track(TRACK), parse_policy("lattice")
    config = load_rules("contest", duration=0.1)
    for count in (1, 2):
        starts = draw_starts(track, config, count, 0)
        for text in PLANNERS:
            run_races(track, lattice, parse_policy(text), config, starts=starts)
    game = make_game(track, steps=(0.1,) * 5)
    game.observation(game.step(game.reset(games=2, seed=0), np.zeros((2, 2), int)))


def _solvers() -> None:
    """Compile solvers of games, and a lidar."""
    from pcs_racing_agents.solvers import GameTree, cfr, exploitability, solve_exact

    tree = GameTree.from_payoffs(np.random.default_rng(0).normal(size=(2, 2, 2, 2)))
    solve_exact(tree)
    exploitability(tree, cfr(tree, 2).average)
    Lidar(load_track(TRACK), 8).scan(np.zeros((2, 3)))


def _gym() -> None:
    """Compile the step of the F1TENTH gym."""
    from pcs_racing.f1tenth.env import GenerationA

    GenerationA(map=TRACK, num_agents=1).reset(np.zeros((1, 3)))


def _circuits() -> None:
    """Compile the generation of a circuit, and the building of a track from its walls."""
    from pcs_racing.envs.random_circuits import RandomCircuits, random_circuit

    # The libraries of the extra "mapping" may be missing.
    with suppress(ModuleNotFoundError):
        random_circuit(RandomCircuits(), 7)


def _drives() -> None:
    """Compile environments at the control level: with a lidar and an opponent, and single-car."""
    from pcs_racing.envs.drive import DriveVectorEnv

    for options in ({"opponent": "lattice", "beams": 8}, {"opponent": None}):
        env = DriveVectorEnv(2, track=TRACK, **options)
        env.reset(seed=0)
        env.step(np.zeros((2, 2), np.float32))
        env.close()
