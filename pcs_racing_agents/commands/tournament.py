"""``pcs-racing tournament``: all against all, as a table, a payoff matrix and a results file."""

import argparse
from pathlib import Path

from pcs_racing.errors import InputError
from pcs_racing.registry import parse_policy
from pcs_racing.track import load_track
from pcs_racing_agents.commands.options import (
    POLICY_HELP,
    TRACK_HELP,
    Commands,
    add_command,
    add_rules,
    output_folder,
    rules,
)
from pcs_racing_agents.tournament import play_tournament, show_progress, tournament_text, write_results

__all__ = ["add"]


def add(commands: Commands) -> None:
    """Add the command."""
    parser = add_command(
        commands,
        "tournament",
        "play every pair of policies against each other",
        "pcs-racing tournament --track Tarnfjord --policies lattice lattice:pace=0.2 lattice:pace=0.9 --races 40",
        "pcs-racing tournament --track Pipkin Saltmere --policies lattice lattice:pace=0.9 --preset contest",
    )
    parser.add_argument("--track", required=True, nargs="+", metavar="T", help=TRACK_HELP)
    parser.add_argument("--policies", required=True, nargs="+", metavar="POLICY", help=POLICY_HELP)
    add_rules(parser)
    parser.add_argument(
        "--races", type=int, default=20, metavar="N", help="races of each pair on each track, even (default: 20)"
    )
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder to write results.csv to")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> None:
    """Play, print the table, write the results."""
    config = rules(arguments)
    policies = [parse_policy(text) for text in arguments.policies]
    if len(policies) < 2:
        raise InputError("a tournament needs at least two policies")
    tracks = [load_track(name) for name in arguments.track]
    folder = output_folder(arguments.out) if arguments.out else None
    tournament = play_tournament(
        tracks, policies, config, races_per_pair=arguments.races, seed=arguments.seed, progress=show_progress()
    )
    print(tournament_text(tournament))
    if folder is not None:
        print(f"results: {write_results(tournament, folder / 'results.csv')}")
