"""``pcs-racing solve`` and ``export``: solve the trees of a folder with several methods, or write one for others."""

import argparse
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pcs_racing.base.errors import InputError
from pcs_racing_agents.cli.options import Commands, add_command, output_file
from pcs_racing_agents.results.csv_files import write_csv
from pcs_racing_agents.results.text_table import aligned
from pcs_racing_agents.solvers.compare import METHODS, MethodRow, compare_methods
from pcs_racing_agents.solvers.efg import write_efg
from pcs_racing_agents.trees import load_trees

NOTE = """value: what car 0 gets; exploitability: half of what both could gain by best responses; units of the utility
agreement: decisions whose likeliest move is a best one against the exact solution; on path: the same, each as often
as the exact solution leads to it; decisions at which all moves are worth the same do not count"""


class _SolvedTree(NamedTuple):
    """The results of all methods on one tree."""

    number: int  #: Number of the tree in its folder.
    policies: tuple[int, int]  #: Policies of both cars at the start.
    seeds: int  #: Number of noise realisations of the tree.
    rows: list[MethodRow]


def add(commands: Commands) -> None:
    """Add the commands ``solve`` and ``export``."""
    parser = add_command(
        commands,
        "solve",
        "solve game trees exactly and by regret minimisation, and print value and exploitability of each solution",
        "pcs-racing solve out/trees",
        "pcs-racing solve out/trees --iterations 1000 --methods exact alternating+ --out out/solved.csv",
    )
    parser.add_argument("trees", type=Path, metavar="DIR", help="folder of game trees, written by 'pcs-racing tree'")
    parser.add_argument(
        "--iterations", type=int, default=100, metavar="N", help="number of iterations of CFR (default: 100)"
    )
    parser.add_argument(
        "--methods",
        nargs="+",
        default=list(METHODS),
        choices=METHODS,
        metavar="M",
        help=f"one or more of {', '.join(METHODS)} (default: all)",
    )
    parser.add_argument("--out", type=Path, metavar="FILE", help="file for the table (.csv)")
    parser.set_defaults(run=run)
    parser = add_command(
        commands,
        "export",
        "write a game tree as a file that OpenSpiel and Gambit load",
        "pcs-racing export out/trees --format efg --out out/tree.efg",
        "pcs-racing export out/trees --tree 3 --format efg --out out/tree3.efg",
    )
    parser.add_argument("trees", type=Path, metavar="DIR", help="folder of game trees, written by 'pcs-racing tree'")
    parser.add_argument(
        "--tree", type=int, default=0, metavar="N", help="number of the tree in the folder (default: 0)"
    )
    parser.add_argument(
        "--format", choices=("efg",), default="efg", help="format: efg, the extensive form of Gambit as text (default)"
    )
    parser.add_argument("--out", type=Path, required=True, metavar="FILE", help="file to write (.efg)")
    parser.set_defaults(run=run_export)


def run(arguments: argparse.Namespace) -> None:
    """Solve all trees, print the table, and write it."""
    target = output_file(arguments.out, ".csv") if arguments.out else None
    trees = load_trees(arguments.trees)
    solved = []
    for number, tree in enumerate(trees):
        first, second = (int(policy) for policy in tree.policies)
        rows = compare_methods(tree.game_tree(), arguments.iterations, arguments.methods)
        solved.append(_SolvedTree(number, (first, second), len(tree.seeds), rows))
    names = {key: trees.settings[key]["name"] for key in ("archive", "track")}
    print(
        f"{len(trees)} trees of archive {names['archive']} on {names['track']}, preset {trees.settings['preset']}; "
        f"CFR with {arguments.iterations} iterations"
    )
    print(solve_table(solved))
    if target is not None:
        print(f"table: {write_csv(_csv_rows(solved), target)}")


def solve_table(solved: Sequence[_SolvedTree]) -> str:
    """Return a text table of every tree and method, and of the means over the trees."""
    lines: list[tuple[str, ...]] = [
        ("tree", "policies", "method", "value", "exploitability", "agreement", "on path", "ms")
    ]
    for tree in solved:
        for i, row in enumerate(tree.rows):
            first, second = tree.policies
            head = (str(tree.number), f"{first}, {second}") if i == 0 else ("", "")
            lines.append((*head, *_cells(row)))
    for i, rows in enumerate(zip(*(tree.rows for tree in solved), strict=True)):
        mean = MethodRow(rows[0].method, *(float(np.mean(numbers)) for numbers in list(zip(*rows, strict=True))[1:]))
        lines.append(("mean" if i == 0 else "", "", *_cells(mean)))
    table = "\n".join(aligned(lines, left=3))
    return f"{table}\n\n{NOTE}"


def _cells(row: MethodRow) -> tuple[str, ...]:
    exploited = f"{row.exploitability:.2e}" if row.exploitability < 1e-3 else f"{row.exploitability:.4f}"
    agreed = (f"{row.agreement:.1%}", f"{row.on_path:.1%}")
    return row.method, f"{row.value:.4f}", exploited, *agreed, f"{1e3 * row.seconds:.1f}"


def _csv_rows(solved: Sequence[_SolvedTree]) -> Iterator[tuple[object, ...]]:
    yield ("tree", "policy_0", "policy_1", "seeds", *MethodRow._fields)
    for tree in solved:
        for row in tree.rows:
            numbers = (f"{number:.9g}" for number in row[1:])
            yield (tree.number, *tree.policies, tree.seeds, row.method, *numbers)


def run_export(arguments: argparse.Namespace) -> None:
    """Load the tree and write the file."""
    target = output_file(arguments.out, ".efg")
    trees = load_trees(arguments.trees)
    if not 0 <= arguments.tree < len(trees):
        raise InputError(f"there is no tree {arguments.tree} in {arguments.trees}; it holds 0 to {len(trees) - 1}")
    played = trees[arguments.tree]
    first, second = (int(policy) for policy in played.policies)
    names = trees.settings["move_names"]
    tree = played.game_tree()
    title = f"pcs-racing: {trees.settings['archive']['name']} {first} and {second} on {trees.settings['track']['name']}"
    write_efg(tree, target, title=title, move_names=[(names, names)] * tree.depth)
    print(f"written: {target} ({tree.payoffs.size} leaves, {target.stat().st_size / 1e6:.1f} MB)")
