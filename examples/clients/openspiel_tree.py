# /// script
# dependencies = ["open_spiel==2.0.2"]
# ///
"""OpenSpiel: two of its algorithms on a game tree, beside ours: how far from an equilibrium, after
how long.

    python examples/clients/openspiel_tree.py
    pcs-racing tree --archive default-early --track Pipkin --pairs 2 --out out/trees
    python examples/clients/openspiel_tree.py --trees out/trees --tree 1

Without --trees a small tree of random payoffs is solved. OpenSpiel gets the tree as extensive form
text, which its C++ plays; its CFR+ and its external-sampling MCCFR then run beside our CFR+ and our
exact solver. Every strategy is judged by OpenSpiel's own best responses. Needs OpenSpiel: pip
install ".[games]".
"""

import argparse
import time
from pathlib import Path

import numpy as np

from pcs_racing_agents import solvers, trees

try:
    import pyspiel
except ModuleNotFoundError as error:
    raise SystemExit(f'this example needs {error.name}: pip install ".[games]"') from None


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--trees", type=Path, metavar="DIR", help="folder that 'pcs-racing tree' wrote"
    )
    parser.add_argument("--tree", type=int, default=0, metavar="N", help="which tree of the folder")
    parser.add_argument(
        "--iterations", type=int, default=200, help="iterations of CFR+; MCCFR gets as much time"
    )
    parser.add_argument(
        "--seed", type=int, default=0, help="payoffs of the small tree, and samples of MCCFR"
    )
    arguments = parser.parse_args()

    if arguments.trees:
        tree = trees.load_trees(arguments.trees)[arguments.tree].game_tree()
    else:
        tree = solvers.GameTree.from_payoffs(
            np.random.default_rng(arguments.seed).normal(0.0, 20.0, (3,) * 6)
        )
    game = solvers.efg_game(tree)
    nodes = sum(tree.nodes(k) for k in range(tree.depth))
    print(
        f"{nodes} decision nodes, {tree.payoffs.size} leaves, payoffs of range"
        f" {np.ptp(tree.payoffs):.1f}"
    )
    print(f"{'method':38} {'seconds':>9} {'exploitability':>15}")

    def report(method: str, seconds: float, policy: object) -> None:
        print(f"{method:38} {seconds:9.4f} {pyspiel.exploitability(game, policy):15.3g}")

    begin = time.perf_counter()
    theirs = pyspiel.CFRPlusSolver(game)
    for _ in range(arguments.iterations):
        theirs.evaluate_and_update_policy()
    allowed = time.perf_counter() - begin
    report(
        f"OpenSpiel CFR+, {arguments.iterations} iterations",
        allowed,
        theirs.tabular_average_policy(),
    )

    sampled = pyspiel.ExternalSamplingMCCFRSolver(game, seed=arguments.seed)
    begin, count = time.perf_counter(), 0
    while time.perf_counter() - begin < allowed:
        sampled.run_iteration()
        count += 1
    report(
        f"OpenSpiel MCCFR, {count} iterations",
        time.perf_counter() - begin,
        sampled.average_policy(),
    )

    solvers.cfr(tree, 1)  # load or compile the code
    begin = time.perf_counter()
    ours = solvers.cfr(tree, arguments.iterations).average
    report(
        f"pcs-racing CFR+, {arguments.iterations} iterations",
        time.perf_counter() - begin,
        solvers.efg_policy(tree, ours),
    )

    solvers.solve_exact(tree)
    begin = time.perf_counter()
    exact = solvers.solve_exact(tree)
    seconds = time.perf_counter() - begin
    report("pcs-racing, exact", seconds, solvers.efg_policy(tree, exact.profile))
    print(
        f"value {exact.value:.6f}; by our own measure the exact solution leaves"
        f" {solvers.exploitability(tree, exact.profile)}"
    )


if __name__ == "__main__":
    main()
