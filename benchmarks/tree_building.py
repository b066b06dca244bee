"""What game trees cost: seconds and segments of full trees and of ego trees, against trees that save nothing.

    python benchmarks/tree_building.py                    # 8 full trees of the paper, 2 of the contest, 128 roots
    python benchmarks/tree_building.py --trees 4 --json   # ends with one JSON line

A segment is a step of driving, 8 s of two cars. Processor time is that of all threads together; on two cores that have
nothing else to do a tree takes half of it. Wall time depends on what else the machine does. "Shared" trees share their
beginnings only, one segment for each joint history; "replayed" ones race every joint history from the start.
"""

import argparse
import json
import time
from dataclasses import replace

import numpy as np

from pcs_racing.game.make import make_game
from pcs_racing.game.rules import RaceGame
from pcs_racing.race.driving import default_threads
from pcs_racing_agents.networks.from_ego import ego_rows
from pcs_racing_agents.trees import TreeStatistics, build_tree, choose_pairs, play_ego
from pcs_racing_agents.trees.roots import draw_root


def measure_trees(game: RaceGame, trees: int, seed: int, *, share: bool = True) -> tuple[list[TreeStatistics], list]:
    """Statistics, and seconds of processor and wall, of trees of one noise seed."""
    statistics, seconds = [], []
    for i, pair in enumerate(choose_pairs(game.archive, trees, seed)):
        root = draw_root(game, pair, 1, np.random.default_rng([seed, i]))
        begin = time.process_time(), time.perf_counter()
        tree = build_tree(game, root.policies, (root.start_s, root.side), root.seeds, share=share)
        seconds.append((time.process_time() - begin[0], time.perf_counter() - begin[1]))
        statistics.append(tree.statistics)
    return statistics, seconds


def tell_trees(name: str, statistics: list[TreeStatistics], seconds: list) -> dict[str, float]:
    """Print a block of figures, and return it."""
    driven, live, shared, replayed = (
        np.array([getattr(s, key) for s in statistics]) for key in ("driven", "live", "shared", "replayed")
    )
    processor, wall = np.array(seconds).T
    figures = {
        "trees": len(statistics),
        "processor_s_mean": processor.mean(),
        "processor_s_max": processor.max(),
        "wall_s_mean": wall.mean(),
        "wall_s_max": wall.max(),
        "driven_mean": driven.mean(),
        "driven_max": int(driven.max()),
        "live_mean": live.mean(),
        "shared": int(shared[0]),
        "replayed": int(replayed[0]),
        "driven_of_shared": driven.sum() / shared.sum(),
        "driven_of_replayed": driven.sum() / replayed.sum(),
        "ms_per_segment": 1e3 * processor.sum() / driven.sum(),
        "crashed": float(np.mean([s.crashed for s in statistics])),
        "duplicates": float(np.mean([s.duplicates for s in statistics])),
    }
    print(f"{name}: {len(statistics)} trees of one noise seed")
    print(f"  processor time   {processor.mean():7.2f} s a tree, at most {processor.max():.2f} s")
    print(f"  wall time        {wall.mean():7.2f} s a tree, at most {wall.max():.2f} s, on {default_threads()} cores")
    print(f"  driven           {driven.mean():7.0f} segments a tree, at most {driven.max()}")
    print(f"  different ones   {live.mean():7.0f} segments a tree, those after a crash left out")
    print(f"  shared           {shared[0]:7d} segments: {driven.sum() / shared.sum():.1%} of them driven")
    print(f"  replayed         {replayed[0]:7d} segments: {driven.sum() / replayed.sum():.2%} of them driven")
    print(f"  a segment        {figures['ms_per_segment']:7.3f} ms of processor time, everything included")
    print(f"  crashes          {figures['crashed']:7.1%} of the histories of all moves")
    print(f"  duplicate moves  {figures['duplicates']:7.1%} of the histories repeat another's policies")
    return figures


def measure_ego(game: RaceGame, roots: int, seed: int) -> dict[str, float]:
    """Print and return what ego trees cost, and how many rows they give."""
    begin = time.process_time(), time.perf_counter()
    trees = play_ego(game, roots, seed=seed)
    processor, wall = time.process_time() - begin[0], time.perf_counter() - begin[1]
    rows = len(ego_rows(trees))
    figures = {
        "roots": roots,
        "processor_s_a_root": processor / roots,
        "wall_s_a_root": wall / roots,
        "segments_a_root": float(trees.driven.mean()),
        "rows_a_root": rows / roots,
        "rows_per_processor_s": rows / processor,
    }
    print(f"ego trees: {roots} roots")
    print(f"  processor time   {processor / roots:7.3f} s a root")
    print(f"  wall time        {wall / roots:7.3f} s a root, on {default_threads()} cores")
    print(f"  driven           {trees.driven.mean():7.1f} segments a root")
    print(f"  rows             {rows / roots:7.1f} a root, {rows / processor:.0f} per second of processor time")
    return figures


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--track", default="Tarnfjord", help="name or folder of a circuit")
    parser.add_argument("--archive", default="default", help="name or folder of an archive")
    parser.add_argument("--epsilon", type=float, default=0.35, help="length of a move")
    parser.add_argument("--trees", type=int, default=8, help="full trees of the paper's race")
    parser.add_argument("--contest", type=int, default=2, help="full trees of the contest, five moves to choose from")
    parser.add_argument("--roots", type=int, default=128, help="ego trees")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", action="store_true", help="end with one JSON line")
    arguments = parser.parse_args()
    paper, contest = (
        make_game(arguments.track, arguments.archive, preset, epsilon=arguments.epsilon)
        for preset in ("paper", "contest")
    )
    play_ego(replace(paper, config=replace(paper.config, moves=1)), 4)  # compiles
    figures = {}
    if arguments.trees:
        figures["paper"] = tell_trees("paper", *measure_trees(paper, arguments.trees, arguments.seed))
    if arguments.contest:
        figures["contest"] = tell_trees("contest", *measure_trees(contest, arguments.contest, arguments.seed))
    if arguments.roots:
        figures["ego"] = measure_ego(paper, arguments.roots, arguments.seed)
    if arguments.json:
        print(
            json.dumps(
                {"archive": arguments.archive, "track": paper.track.name, "epsilon": arguments.epsilon, **figures}
            )
        )


if __name__ == "__main__":
    main()
