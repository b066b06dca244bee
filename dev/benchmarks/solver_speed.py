"""Compare the solvers of game trees with OpenSpiel's C++ on one tree: speed and exploitability.

    python dev/benchmarks/solver_speed.py [--trees FOLDER] [--tree N] [--moves M] [--steps K]

One tree of simultaneous moves (4 moves, 4 steps, payoffs from a seed; or a tree of ``pcs-racing
tree``) goes as extensive form text to OpenSpiel, which must find the same exploitability
after 9 and 13 iterations. Then both sides iterate alternately: a ratio is measured within each
round, and the median over the rounds is reported. Times are CPU time of one thread. Without
OpenSpiel only our side is measured.
"""

import argparse
import time
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from pcs_racing_agents.solvers import (
    VARIANTS,
    GameTree,
    cfr,
    exploitability,
    solve_exact,
    uniform_profile,
)
from pcs_racing_agents.solvers.efg import efg_text
from pcs_racing_agents.trees import load_trees

ROUNDS = 9
OURS = 100  # iterations a round
THEIRS = 2
ITERATIONS = (10, 30, 100, 300, 1000, 3000)


def seconds(function: Callable[[], object]) -> float:
    """CPU time of this thread: other work of the machine counts only through its caches."""
    begin = time.thread_time()
    function()
    return time.thread_time() - begin


def median(values: list[float]) -> float:
    return float(np.median(values))


def against_openspiel(tree: GameTree) -> None:
    """Alternate iterations; exploitability after 9 and 13 iterations on both sides."""
    import pyspiel

    begin = time.thread_time()
    game = pyspiel.load_efg_game(efg_text(tree))
    print(f"text written and loaded by OpenSpiel: {time.thread_time() - begin:.2f} s")
    for variant, name in (("alternating", "CFRSolver"), ("alternating+", "CFRPlusSolver")):
        solver = getattr(pyspiel, name)(game)
        done = 0
        for iterations in (9, 13):
            for _ in range(iterations - done):
                solver.evaluate_and_update_policy()
            done = iterations
            theirs = pyspiel.exploitability(game, solver.tabular_average_policy())
            ours = exploitability(tree, cfr(tree, iterations, variant).average).exploitability
            print(
                f"{variant:12} {iterations:2} iterations: exploitability {ours:.12g}, {name}"
                f" {theirs:.12g}"
            )
            # Times of two solvers compare nothing unless both walk the same tree by the same rules.
            if abs(ours - theirs) > 1e-10 * max(1.0, abs(theirs)):
                raise SystemExit(f"{variant} and {name} do not play the same game")
        rounds = []
        # Alternately, so that a slow moment of the machine meets both sides of a ratio.
        for _ in range(ROUNDS):
            mine = seconds(lambda variant=variant: cfr(tree, OURS, variant)) / OURS
            other = (
                seconds(
                    lambda solver=solver: [
                        solver.evaluate_and_update_policy() for _ in range(THEIRS)
                    ]
                )
                / THEIRS
            )
            rounds.append((mine, other, other / mine))
        mine, other, ratio = (median(list(column)) for column in zip(*rounds, strict=True))
        print(
            f"{variant:12} {1e3 * mine:.3f} ms an iteration, {name} {1e3 * other:.1f} ms:"
            f" {ratio:.0f} times"
        )


def convergence(tree: GameTree) -> None:
    """Exploitability over iterations, for each variant."""
    print("| variant | " + " | ".join(str(count) for count in ITERATIONS) + " |")
    print("|---" * (len(ITERATIONS) + 1) + "|")
    for variant in VARIANTS:
        row = [
            exploitability(tree, cfr(tree, count, variant).average).exploitability
            for count in ITERATIONS
        ]
        print(f"| `{variant}` | " + " | ".join(f"{value:.2g}" for value in row) + " |")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--trees", type=Path, metavar="FOLDER", help="take a tree that was played")
    parser.add_argument("--tree", type=int, default=0, metavar="N", help="which one (default: 0)")
    parser.add_argument(
        "--moves", type=int, default=4, help="moves of each player, if none is given (default: 4)"
    )
    parser.add_argument("--steps", type=int, default=4, help="steps of moves (default: 4)")
    options = parser.parse_args()

    if options.trees:
        tree = load_trees(options.trees)[options.tree].game_tree()
    else:
        tree = GameTree.from_payoffs(
            np.random.default_rng(0).normal(0.0, 20.0, (options.moves,) * (2 * options.steps))
        )
    nodes = sum(tree.nodes(k) for k in range(tree.depth))
    span = float(np.ptp(tree.payoffs))
    print(f"tree: {nodes} nodes, {tree.payoffs.size} leaves, payoffs of range {span:.4g}")

    for variant in VARIANTS:
        cfr(tree, 1, variant)
    for variant in VARIANTS:
        each = median(
            [
                seconds(lambda variant=variant: cfr(tree, OURS, variant)) / OURS
                for _ in range(ROUNDS)
            ]
        )
        print(f"cfr {variant:12} {1e3 * each:.3f} ms an iteration")

    exact = solve_exact(tree)
    took = median([seconds(lambda: solve_exact(tree)) for _ in range(ROUNDS)])
    left = exploitability(tree, exact.profile).exploitability
    print(f"exact: {1e3 * took:.1f} ms, value {exact.value:.6g}, exploitability {left:.1e}")
    even = uniform_profile(tree)
    took = median([seconds(lambda: exploitability(tree, even)) for _ in range(ROUNDS)])
    print(f"exploitability of a profile: {1e3 * took:.1f} ms")

    if find_spec("pyspiel"):
        against_openspiel(tree)
    else:
        print("OpenSpiel is not here: pip install open_spiel")
    print("\nexploitability after so many iterations")
    convergence(tree)


if __name__ == "__main__":
    main()
