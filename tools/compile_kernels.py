"""Compiles what tests need most, two things at a time, and leaves it in numba's cache.

    python tools/compile_kernels.py

Workers of pytest that begin with an empty cache would each compile the same functions. Here every function is compiled
by one process only: what is in the second row calls what is in the first.
"""

import sys
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import numpy as np

TRACK = "Pipkin"
PLANNERS = ("lane-switcher:3", "pure-pursuit", "gap-follower")


def races() -> None:
    """Races of all planners, one and several at a time, and what a game sees of them."""
    import pcs_racing

    track, lattice = pcs_racing.load_track(TRACK), pcs_racing.parse_policy("lattice")
    config = pcs_racing.load_race_config("contest", duration=0.1)
    for count in (1, 2):
        starts = pcs_racing.draw_starts(track, config, count, 0)
        for text in PLANNERS:
            pcs_racing.run_races(track, lattice, pcs_racing.parse_policy(text), config, starts=starts)
    game = pcs_racing.make_game(track, step_seconds=0.1)
    game.observation(game.step(game.reset(games=2, seed=0), np.zeros((2, 2), int)))


def solvers() -> None:
    """Solvers of games."""
    from pcs_racing_agents.solvers import GameTree, cfr, exploitability, solve_exact

    tree = GameTree.from_payoffs(np.random.default_rng(0).normal(size=(2, 2, 2, 2)))
    solve_exact(tree)
    exploitability(tree, cfr(tree, 2).average)


def environments() -> None:
    """Environments at the control level, with a lidar, a rival and alone."""
    import gymnasium

    import pcs_racing  # noqa: F401

    for options in ({"opponent": "lattice", "beams": 8}, {"opponent": None}):
        env = gymnasium.make_vec("pcs_racing/Drive-v1", num_envs=2, track=TRACK, **options)
        env.reset(seed=0)
        env.step(np.zeros((2, 2), np.float32))
        env.close()


def circuits() -> None:
    """A new circuit, and a lidar on it."""
    import pcs_racing
    from pcs_racing.track.mapping.circuits import generate_circuit

    generate_circuit(7)
    track = pcs_racing.load_track(TRACK)
    pcs_racing.Lidar(track, 8).scan(np.zeros((2, 3)))


ROWS = ((races, solvers), (environments, circuits))


def main() -> None:
    begin = time.monotonic()
    with ProcessPoolExecutor(2, get_context("spawn")) as pool:
        for row in ROWS:
            for done in [pool.submit(task) for task in row]:
                done.result()
    print(f"compiled what tests need most: {time.monotonic() - begin:.0f} s", file=sys.stderr)


if __name__ == "__main__":
    main()
