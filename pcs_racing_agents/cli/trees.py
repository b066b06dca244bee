"""``pcs-racing tree`` and ``solve``: build, solve and export game trees."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import numpy as np

from pcs_racing.base.errors import InputError
from pcs_racing.game.make import make_game
from pcs_racing.race.config import load_rules
from pcs_racing_agents.base.jobs import show_progress
from pcs_racing_agents.base.tables import aligned
from pcs_racing_agents.cli.commands import Option, command
from pcs_racing_agents.cli.options import (
    DEFAULT_TRACK,
    ArchiveName,
    Circuit,
    RulesName,
    Workers,
    archive_for,
    output_file,
)
from pcs_racing_agents.solvers.compare import METHODS, MethodRow, compare_methods
from pcs_racing_agents.solvers.efg import write_efg
from pcs_racing_agents.trees import StoredTrees, build_trees, load_trees
from pcs_racing_agents.trees.tree import check_size


@command(
    "tree",
    "pcs-racing tree --pairs 8 --out out/trees",
    "pcs-racing tree --track Tarnfjord --pairs 20 --out out/trees",
    "pcs-racing tree --track Tarnfjord --rules contest --moves 4 --pairs 10 --seeds 4 --out"
    " out/contest",
)
def run(
    *,
    archive: ArchiveName = None,
    track: Circuit = DEFAULT_TRACK,
    rules: RulesName = "paper",
    moves: Annotated[
        int | None, Option("number of moves of each player (default: from the rules)", "M")
    ] = None,
    step: Annotated[
        float | None, Option("mean time of a move in s (default: from the rules)", "S")
    ] = None,
    pairs: Annotated[int, Option("number of pairs of starting policies")] = 20,
    seeds: Annotated[
        int | None, Option("noise realisations per pair (default: 4 with noise, else 1)", "S")
    ] = None,
    seed: Annotated[int, Option("seed of all random draws")] = 0,
    out: Annotated[Path, Option("folder for the trees; an interrupted run resumes here", "DIR")],
    workers: Workers,
) -> None:
    """Build game trees: simulate all moves of both players, for pairs of starting policies."""
    config = load_rules(rules)
    if moves is not None or step is not None:
        config = load_rules(config, steps=(8.0 if step is None else step,) * (1 + (moves or 4)))
    game = make_game(track, archive_for(archive, config), config)
    count = game.offered
    check_size(count, game.rules.moves)
    print(
        f"{game.track.name}, archive {game.archive.name}, rules {game.rules.name}, {count} moves",
        flush=True,
    )
    with workers.start() as executor:
        progress = show_progress("trees")
        trees = build_trees(
            game,
            out,
            pairs=pairs,
            seeds_per_pair=seeds,
            seed=seed,
            executor=executor,
            progress=progress,
        )
    print(tree_table(trees))
    print(f"{len(trees)} trees in {out}")


TREE_NOTE = """driven: segments; of shared: their share of the segments of a tree whose branches
share only beginnings; crashes: histories of moves that end in a crash"""


def tree_table(trees: StoredTrees) -> str:
    """Return a table of each tree's simulated segments and the share saved by sharing."""
    rows: list[tuple[str, ...]] = [
        ("tree", "policies", "start", "side", "seeds", "driven", "of shared", "crashes")
    ]
    for i, tree in enumerate(trees):
        s, (first, second) = tree.statistics, tree.policies
        place = (f"{first} {second}", f"{tree.start_s:.1f} m", str(tree.side), str(s.seeds))
        rows.append(
            (str(i), *place, str(s.driven), f"{s.driven / s.shared:.1%}", f"{s.crashed:.1%}")
        )
    return "\n".join([*aligned(rows, left=0), TREE_NOTE])


NOTE = """value: utility of car 0; exploitability: half of the gain of both by best responses
agreement: decisions whose likeliest move is a best one against the exact solution; on path: the
same, weighted by the reach of the exact solution; decisions with equal values do not count"""


@command(
    "solve",
    "pcs-racing solve out/trees",
    "pcs-racing solve out/trees --iterations 1000 --methods exact alternating+",
    "pcs-racing solve out/trees --export out/tree3.efg --tree 3",
)
def run_solve(
    trees: Annotated[Path, Option("folder of game trees, written by 'pcs-racing tree'", "DIR")],
    *,
    iterations: Annotated[int, Option("number of iterations of CFR")] = 100,
    methods: Annotated[
        Sequence[str],
        Option(f"one or more of {', '.join(METHODS)} (default: all)", "M", choices=METHODS),
    ] = (),
    export: Annotated[
        Path | None,
        Option("file for one tree (.efg), which OpenSpiel and Gambit load; solves nothing", "FILE"),
    ] = None,
    tree: Annotated[int | None, Option("number of the tree to export (default: 0)")] = None,
) -> None:
    """Solve game trees exactly and by regret minimisation, or export a tree."""
    if tree is not None and export is None:
        raise InputError("--tree goes with --export")
    exported = output_file(export, ".efg") if export else None
    stored = load_trees(trees)
    if exported is not None:
        _export(stored, tree or 0, exported)
        return
    solved = [compare_methods(one.game_tree(), iterations, methods or METHODS) for one in stored]
    policies = [(int(one.policies[0]), int(one.policies[1])) for one in stored]
    names = {key: stored.settings[key]["name"] for key in ("archive", "track")}
    print(
        f"{len(stored)} trees of archive {names['archive']} on {names['track']}, rules"
        f" {stored.settings['rules']['name']}; CFR with {iterations} iterations"
    )
    print(solve_table(policies, solved))


def solve_table(policies: Sequence[tuple[int, int]], solved: Sequence[Sequence[MethodRow]]) -> str:
    """Return a text table of all methods on all trees, with means over the trees.

    ``policies``: policies of both cars at the start of each tree.
    """
    lines: list[tuple[str, ...]] = [
        ("tree", "policies", "method", "value", "exploitability", "agreement", "on path", "ms")
    ]
    for number, ((first, second), rows) in enumerate(zip(policies, solved, strict=True)):
        heads = [(str(number), f"{first}, {second}"), *[("", "")] * (len(rows) - 1)]
        lines += [(*head, *_cells(row)) for head, row in zip(heads, rows, strict=True)]
    for i, rows in enumerate(zip(*solved, strict=True)):
        means = np.mean([row[1:] for row in rows], axis=0)
        lines.append(
            ("mean" if i == 0 else "", "", *_cells(MethodRow(rows[0].method, *means.tolist())))
        )
    return "\n".join([*aligned(lines, left=3), "", NOTE])


def _cells(row: MethodRow) -> tuple[str, ...]:
    exploited = (
        f"{row.exploitability:.2e}" if row.exploitability < 1e-3 else f"{row.exploitability:.4f}"
    )
    agreed = (f"{row.agreement:.1%}", f"{row.on_path:.1%}")
    return row.method, f"{row.value:.4f}", exploited, *agreed, f"{1e3 * row.seconds:.1f}"


def _export(stored: StoredTrees, number: int, target: Path) -> None:
    """Write a tree as Gambit's extensive form."""
    if not 0 <= number < len(stored):
        raise InputError(f"there is no tree {number}; there are trees 0 to {len(stored) - 1}")
    tree = stored[number]
    first, second = (int(policy) for policy in tree.policies)
    names = stored.settings["move_names"]
    game = tree.game_tree()
    title = (
        f"pcs-racing: {stored.settings['archive']['name']} {first} and {second} on"
        f" {stored.settings['track']['name']}"
    )
    write_efg(game, target, title=title, move_names=[(names, names)] * game.depth)
    print(f"written: {target} ({game.payoffs.size} leaves, {target.stat().st_size / 1e6:.1f} MB)")
