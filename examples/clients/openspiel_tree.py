# /// script
# dependencies = ["open_spiel==2.0.2"]
# ///
"""OpenSpiel: solve a game tree with CFR+ and MCCFR, and compare with our solvers.

    python examples/clients/openspiel_tree.py
    pcs-racing tree --archive default --track Pipkin --pairs 2 --out out/trees
    python examples/clients/openspiel_tree.py --trees out/trees --tree 1

Without --trees the tree is small, with random payoffs. OpenSpiel reads the tree as extensive-form
text. The table gives seconds and exploitability, each by its own best responses. Needs OpenSpiel:
pip install open_spiel.
"""

import argparse
import time
from pathlib import Path

import numpy as np

from pcs_racing_agents import solvers, trees

try:
    import pyspiel
except ModuleNotFoundError as error:
    raise SystemExit(f"this example needs {error.name}: pip install open_spiel") from None


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--trees", type=Path, metavar="DIR", help="folder of 'pcs-racing tree'")
    parser.add_argument(
        "--tree", type=int, default=0, metavar="N", help="index of the tree in the folder"
    )
    parser.add_argument(
        "--iterations",
        type=int,
        default=200,
        help="iterations of CFR+; MCCFR runs for the same time",
    )
    parser.add_argument("--seed", type=int, default=0, help="seed of the payoffs and of MCCFR")
    arguments = parser.parse_args()

    if arguments.trees:
        tree = trees.load_trees(arguments.trees)[arguments.tree].game_tree()
    else:
        tree = solvers.GameTree.from_payoffs(
            np.random.default_rng(arguments.seed).normal(0.0, 20.0, (3,) * 6)
        )
    game = pyspiel.load_efg_game(solvers.efg_text(tree))
    nodes = sum(tree.nodes(k) for k in range(tree.depth))
    print(
        f"{nodes} decision nodes, {tree.payoffs.size} leaves, payoffs of range"
        f" {np.ptp(tree.payoffs):.1f}"
    )
    print(f"{'method':38} {'seconds':>9} {'exploitability':>15}")

    def report(method: str, seconds: float, exploitability: float) -> None:
        print(f"{method:38} {seconds:9.4f} {exploitability:15.3g}")

    begin = time.perf_counter()
    theirs = pyspiel.CFRPlusSolver(game)
    for _ in range(arguments.iterations):
        theirs.evaluate_and_update_policy()
    allowed = time.perf_counter() - begin
    report(
        f"OpenSpiel CFR+, {arguments.iterations} iterations",
        allowed,
        pyspiel.exploitability(game, theirs.tabular_average_policy()),
    )

    sampled = pyspiel.ExternalSamplingMCCFRSolver(game, seed=arguments.seed)
    begin, count = time.perf_counter(), 0
    while time.perf_counter() - begin < allowed:
        sampled.run_iteration()
        count += 1
    report(
        f"OpenSpiel MCCFR, {count} iterations",
        time.perf_counter() - begin,
        pyspiel.exploitability(game, sampled.average_policy()),
    )

    solvers.cfr(tree, 1)  # load or compile the code
    begin = time.perf_counter()
    ours = solvers.cfr(tree, arguments.iterations).average
    report(
        f"pcs-racing CFR+, {arguments.iterations} iterations",
        time.perf_counter() - begin,
        solvers.exploitability(tree, ours).exploitability,
    )

    solvers.solve_exact(tree)
    begin = time.perf_counter()
    exact = solvers.solve_exact(tree)
    seconds = time.perf_counter() - begin
    judged = solvers.exploitability(tree, exact.profile)
    report("pcs-racing, exact", seconds, judged.exploitability)
    print(f"value {exact.value:.6f}")


if __name__ == "__main__":
    main()
