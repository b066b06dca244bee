"""``pcs-racing tree``: build game trees, or the cheaper ego trees, and store them in a folder."""

import argparse
import time
from pathlib import Path
from typing import Any

from pcs_racing.base.errors import InputError
from pcs_racing.game.config import UTILITIES
from pcs_racing.game.make import make_game
from pcs_racing.game.rules import RaceGame
from pcs_racing_agents.cli.estimates import announce, cores_of, ego_seconds, tree_seconds
from pcs_racing_agents.cli.options import Commands, add_command, add_race, add_track
from pcs_racing_agents.jobs.executors import add_executor_options, executor_from
from pcs_racing_agents.jobs.progress import Progress, show_progress
from pcs_racing_agents.results.text_table import aligned
from pcs_racing_agents.trees import StoredTrees, build_ego_trees, build_trees
from pcs_racing_agents.trees.ego import OPPONENTS
from pcs_racing_agents.trees.paths import check_size
from pcs_racing_agents.trees.roots import default_seeds
from pcs_racing_agents.trees.tree import TreeStatistics


def add(commands: Commands) -> None:
    """Add the command ``tree``."""
    parser = add_command(
        commands,
        "tree",
        "build game trees: simulate all moves of both players, for pairs of starting policies",
        "pcs-racing tree --pairs 8 --out out/trees",
        "pcs-racing tree --archive default --track Tarnfjord --pairs 20 --out out/trees",
        "pcs-racing tree --archive default --track Tarnfjord --race contest --pairs 10 --seeds 4 --out out/contest",
        "pcs-racing tree --archive default --track Tarnfjord --ego 640 --out out/ego",
    )
    parser.add_argument(
        "--archive", default="default", help="name of a shipped archive, or a folder (default: default)"
    )
    add_track(parser)
    add_race(parser)
    parser.add_argument("--moves", type=int, metavar="M", help="number of moves of each player (default: 4)")
    parser.add_argument("--step", type=float, metavar="S", help="simulated time per move in s (default: 8)")
    parser.add_argument(
        "--epsilon",
        type=float,
        nargs="+",
        metavar="E",
        help="length of a move in normalised coordinates (default: 0.5)",
    )
    parser.add_argument(
        "--utility", choices=list(UTILITIES), help="utility at the end of a game (default: that of the preset)"
    )
    parser.add_argument(
        "--stay", action=argparse.BooleanOptionalAction, help="whether the game has a move that keeps the policy"
    )
    parser.add_argument(
        "--pairs", type=int, default=20, metavar="N", help="number of pairs of starting policies (default: 20)"
    )
    parser.add_argument(
        "--seeds", type=int, metavar="S", help="noise realisations per pair (default: 4 with noise, else 1)"
    )
    parser.add_argument(
        "--ego",
        type=int,
        metavar="N",
        help="build N ego trees instead: all moves of car 0 against one sequence of moves of car 1",
    )
    parser.add_argument(
        "--opponent",
        choices=list(OPPONENTS),
        default="random",
        help="behaviour of car 1 in ego trees: "
        + "; ".join(f"{name}: {meaning}" for name, meaning in OPPONENTS.items()),
    )
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="seed of all random draws (default: 0)")
    parser.add_argument(
        "--out",
        type=Path,
        required=True,
        metavar="DIR",
        help="folder for the trees; a command that was stopped resumes in its folder",
    )
    add_executor_options(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> None:
    """Build the trees, and print a summary with the time that it took."""
    game = _game(arguments)
    moves = len(game.move_names)
    if arguments.ego is None:
        check_size(moves, game.config.moves)
        seeds = default_seeds(game) if arguments.seeds is None else arguments.seeds
        seconds = tree_seconds(game.config, moves, arguments.pairs, seeds)
    else:
        seconds = ego_seconds(game.config, moves, arguments.ego)
    print(f"{game.track.name}, archive {game.archive.name}, preset {game.config.race.name}, {moves} moves", flush=True)
    begin = time.monotonic()
    reports: list[int] = []

    def progress(done: int, total: int, label: str) -> None:
        reports.append(done)
        show(done, total, label)

    with executor_from(arguments) as executor:
        announce(seconds, cores_of(arguments))
        common: dict[str, Any] = {"seed": arguments.seed, "executor": executor, "progress": progress}
        if arguments.ego is None:
            show: Progress = show_progress("trees")
            trees = build_trees(game, arguments.out, pairs=arguments.pairs, seeds_per_pair=arguments.seeds, **common)
            print(tree_table(trees))
            count, unit = len(trees), "trees"
        else:
            if arguments.seeds is not None:
                raise InputError(f"--seeds {arguments.seeds} does not go with --ego: every ego tree has its own noise")
            show = show_progress("batches of ego trees")
            ego = build_ego_trees(game, arguments.out, roots=arguments.ego, opponent=arguments.opponent, **common)
            count, unit = len(ego), "ego trees"
            print(f"{int(ego.driven.sum())} segments driven, {ego.driven.mean():.1f} for each root")
    new = (reports[-1] - reports[0]) / reports[-1] * count
    spent = time.monotonic() - begin
    took = f"{spent:.1f} s, {spent / new:.3g} s each" if new > 0.0 else "all of them were there already"
    print(f"{count} {unit} in {arguments.out}: {took}")


def _game(arguments: argparse.Namespace) -> RaceGame:
    options = {
        "moves": arguments.moves,
        "step_seconds": arguments.step,
        "epsilon": None if arguments.epsilon is None else tuple(arguments.epsilon),
        "utility": arguments.utility,
        "stay": arguments.stay,
    }
    changes = {key: value for key, value in options.items() if value is not None}
    return make_game(arguments.track, arguments.archive, arguments.race, **changes)


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
