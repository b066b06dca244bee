"""``pcs-racing tree``: build game trees and store them in a folder."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

from pcs_racing.game.config import UTILITIES, load_game_config
from pcs_racing.game.make import make_game
from pcs_racing_agents.cli.commands import Option, command
from pcs_racing_agents.cli.options import DEFAULT_TRACK, ArchiveName, Circuit, Race, Workers, archive_for
from pcs_racing_agents.jobs.progress import show_progress
from pcs_racing_agents.results.text_table import aligned
from pcs_racing_agents.trees import StoredTrees, build_trees
from pcs_racing_agents.trees.paths import check_size
from pcs_racing_agents.trees.tree import TreeStatistics


@command(
    "tree",
    "pcs-racing tree --pairs 8 --out out/trees",
    "pcs-racing tree --track Tarnfjord --pairs 20 --out out/trees",
    "pcs-racing tree --track Tarnfjord --race contest --moves 4 --pairs 10 --seeds 4 --out out/contest",
)
def run(
    *,
    archive: ArchiveName = None,
    track: Circuit = DEFAULT_TRACK,
    race: Race = "paper",
    moves: Annotated[int | None, Option("number of moves of each player (default: that of the rules)", "M")] = None,
    step: Annotated[float | None, Option("mean time of a move in s (default: that of the rules)", "S")] = None,
    epsilon: Annotated[
        Sequence[float] | None, Option("length of a move in normalised coordinates (default: 0.5)", "E")
    ] = None,
    utility: Annotated[
        str | None, Option("utility at the end of a game (default: that of the preset)", choices=UTILITIES)
    ] = None,
    stay: Annotated[bool | None, Option("whether the game has a move that keeps the policy")] = None,
    pairs: Annotated[int, Option("number of pairs of starting policies")] = 20,
    seeds: Annotated[int | None, Option("noise realisations per pair (default: 4 with noise, else 1)", "S")] = None,
    seed: Annotated[int, Option("seed of all random draws")] = 0,
    out: Annotated[Path, Option("folder for the trees; a command that was stopped resumes in its folder", "DIR")],
    workers: Workers,
) -> None:
    """Build game trees: simulate all moves of both players, for pairs of starting policies."""
    lengths = None if epsilon is None else tuple(epsilon)
    options = {"moves": moves, "step_seconds": step, "epsilon": lengths, "utility": utility, "stay": stay}
    changes: dict[str, Any] = {key: value for key, value in options.items() if value is not None}
    rules = load_game_config(race, **changes)
    game = make_game(track, archive_for(archive, rules.race), rules)
    count = len(game.move_names)
    check_size(count, game.config.moves)
    print(f"{game.track.name}, archive {game.archive.name}, preset {game.config.race.name}, {count} moves", flush=True)
    with workers.start() as executor:
        progress = show_progress("trees")
        trees = build_trees(
            game, out, pairs=pairs, seeds_per_pair=seeds, seed=seed, executor=executor, progress=progress
        )
    print(tree_table(trees))
    print(f"{len(trees)} trees in {out}")


def tree_table(trees: StoredTrees) -> str:
    """Return a table of the simulated segments of each tree, and of the share that sharing saved."""
    rows: list[tuple[str, ...]] = [
        ("tree", "policies", "start", "side", "seeds", "driven", "of shared", "of replayed", "crashes", "repeats")
    ]
    total = []
    for i, tree in enumerate(trees):
        s = tree.statistics
        total.append(s)
        first, second = tree.policies
        rows.append((str(i), f"{first} {second}", f"{tree.start_s:.1f} m", str(tree.side), str(s.seeds), *_shares(s)))
    lines = aligned(rows, left=0)
    driven, live, shared, replayed = (sum(getattr(s, key) for s in total) for key in TreeStatistics._fields[1:5])
    lines += [
        f"{driven} segments driven of {live} different ones: {driven / shared:.0%} of the {shared} of trees that share "
        f"only beginnings, {driven / replayed:.1%} of the {replayed} of races from the start",
        "driven: segments; crashes, repeats: histories of moves that end in a crash, or repeat another's policies",
    ]
    return "\n".join(lines)


def _shares(s: TreeStatistics) -> tuple[str, ...]:
    return (
        str(s.driven),
        f"{s.driven / s.shared:.1%}",
        f"{s.driven / s.replayed:.1%}",
        f"{s.crashed:.1%}",
        f"{s.duplicates:.1%}",
    )
