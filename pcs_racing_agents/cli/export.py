"""``pcs-racing export``: write a game tree in a format that other programs read."""

import argparse
from pathlib import Path

from pcs_racing.base.errors import InputError
from pcs_racing_agents.cli.options import Commands, add_command, output_file
from pcs_racing_agents.solvers.efg import write_efg
from pcs_racing_agents.trees import load_trees


def add(commands: Commands) -> None:
    """Add the command ``export``."""
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
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> None:
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
