"""How many times as fast two threads are as one: races, environments and branched games.

    python benchmarks/two_threads.py                     # on 2 free cores; takes about four minutes
    python benchmarks/two_threads.py --rounds 10 --only races duels

Wall time, because processor time does not show whether threads wait: one thread and two take turns, and the best round
of each counts. Two processes that do the same work side by side share nothing but the machine (its cache, memory and
clock): what they gain is what threads could gain at most. On a machine that does something else, too, all ratios are
too small; the load is printed.
"""

import argparse
import os
import time
from collections.abc import Callable
from dataclasses import replace
from multiprocessing import get_context
from threading import Barrier

import numpy as np

from pcs_racing import load_race_config, load_track, make_game, parse_policy, run_races
from pcs_racing.envs.drive import DriveHeadToHeadVectorEnv, DriveVectorEnv
from pcs_racing.envs.duel import DuelVectorEnv
from pcs_racing.envs.vector import BatchVectorEnv
from pcs_racing_agents.trees import build_tree, choose_pairs
from pcs_racing_agents.trees.roots import draw_root

Work = Callable[[], object]


def races(track: str, threads: int) -> Work:
    """Two hundred races of 40 s."""
    paces = [parse_policy(f"lattice:pace={pace:.3f}") for pace in np.linspace(0.05, 0.95, 200)]
    opponent, config, loaded = parse_policy("lattice"), load_race_config("paper"), load_track(track)
    return lambda: run_races(loaded, paces, opponent, config, seed=0, threads=threads)


def duels(track: str, threads: int) -> Work:
    """Moves of 256 games, with all that begins anew."""
    envs = DuelVectorEnv(256, track=track, threads=threads)

    def work() -> None:
        rng = np.random.default_rng(0)
        envs.reset(seed=0)
        for _ in range(2):
            envs.step(rng.integers(0, 4, 256))

    return work


def drives(envs: BatchVectorEnv) -> Work:
    """A hundred steps of 0.02 s of a batch at the level of steering and speed."""
    actions = np.tile(np.array([0.0, -0.75], np.float32), (envs.num_envs, 1))

    def work() -> None:
        envs.reset(seed=0)
        for _ in range(100):
            envs.step(actions)

    return work


def one_agent(track: str, threads: int, beams: int) -> Work:
    """Steps of 256 cars with an opponent."""
    options = {"time_step": 0.02, "opponent": "pure-pursuit", "beams": beams}
    return drives(DriveVectorEnv(256, track=track, threads=threads, **options))


def two_agents(track: str, threads: int) -> Work:
    """Steps of 256 races whose cars are both steered by agents, each with 1080 beams."""
    return drives(DriveHeadToHeadVectorEnv(512, track=track, time_step=0.02, beams=1080, threads=threads))


def branches(track: str, threads: int) -> Work:
    """A game tree of three moves."""
    game = replace(make_game(track, moves=3), threads=threads)
    root = draw_root(game, choose_pairs(game.archive, 1, 0)[0], 1, np.random.default_rng(0))
    return lambda: build_tree(game, root.policies, (root.start_s, root.side), root.seeds)


WORKS: dict[str, Callable[[str, int], Work]] = {
    "races": races,
    "duels": duels,
    "drives": lambda track, threads: one_agent(track, threads, 0),
    "drives, 1080 beams": lambda track, threads: one_agent(track, threads, 1080),
    "two agents, 1080 beams": two_agents,
    "game tree": branches,
}


def seconds_beside(name: str, track: str, rounds: int, both: Barrier) -> float:
    """Mean time of a round with one thread, while another process does the same, s."""
    work = WORKS[name](track, 1)
    work()  # compiles, and warms the caches
    both.wait()
    start = time.perf_counter()
    for _ in range(rounds):
        work()
    return (time.perf_counter() - start) / rounds


def two_processes(name: str, track: str, rounds: int) -> float:
    """Mean time of a round in two processes that work side by side, s."""
    context = get_context("spawn")
    with context.Manager() as manager, context.Pool(2) as pool:
        both = manager.Barrier(2)
        return float(np.mean(pool.starmap(seconds_beside, [(name, track, rounds, both)] * 2, chunksize=1)))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--track", default="Tarnfjord", help="name or folder of a circuit")
    parser.add_argument("--rounds", type=int, default=6, help="of which the best counts")
    parser.add_argument("--only", nargs="+", choices=WORKS, default=list(WORKS), help="what to measure (default: all)")
    given = parser.parse_args()
    print(f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.2f} before")
    for name in given.only:
        works = [WORKS[name](given.track, threads) for threads in (1, 2)]
        best = [float("inf")] * 2
        for work in works:
            work()  # compiles, and warms the caches
        for _ in range(given.rounds):
            for i, work in enumerate(works):
                start = time.perf_counter()
                work()
                best[i] = min(best[i], time.perf_counter() - start)
        limit = 2.0 * best[0] / two_processes(name, given.track, given.rounds)
        print(
            f"{name:22} {1e3 * best[0]:8.0f} ms with one thread, {best[0] / best[1]:.2f} times as fast with two, "
            f"{limit:.2f} in two processes"
        )


if __name__ == "__main__":
    main()
