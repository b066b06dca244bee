"""``pcs-racing tournament``: race every pair of competitors; print a table, write results and a payoff matrix."""

import argparse
from pathlib import Path

from pcs_racing.planners.registry import parse_policy
from pcs_racing.track.loading import load_track
from pcs_racing_agents.cli.options import POLICY_HELP, Commands, add_command, add_rules, add_tracks, can_draw, rules
from pcs_racing_agents.jobs.executors import add_executor_options, executor_from
from pcs_racing_agents.jobs.jobs import open_job
from pcs_racing_agents.jobs.progress import show_progress


def add(commands: Commands) -> None:
    """Add the command ``tournament``."""
    parser = add_command(
        commands,
        "tournament",
        "race every pair of agents, drivers and policies against each other, and print a table",
        "pcs-racing tournament --agents cfr-argmax never-switch",
        "pcs-racing tournament --track Tarnfjord --agents never-switch random-moves lane-switcher --races 40",
        "pcs-racing tournament --track Pipkin --policies lattice lattice:pace=0.9 --race contest --out out/mine",
    )
    add_tracks(parser)
    parser.add_argument(
        "--agents",
        nargs="+",
        default=[],
        metavar="AGENT",
        help="name of an agent, or name:option=value,... (see 'pcs-racing agents' and docs/agents.md)",
    )
    parser.add_argument("--policies", nargs="+", default=[], metavar="POLICY", help=POLICY_HELP)
    add_rules(parser)
    parser.add_argument(
        "--archive",
        default="default",
        help="archive whose policies the agents drive: its name or folder (default: default)",
    )
    parser.add_argument(
        "--races",
        type=int,
        default=20,
        metavar="N",
        help="number of races of each pair on each track, even (default: 20)",
    )
    parser.add_argument(
        "--out",
        type=Path,
        metavar="DIR",
        help="folder for results.csv and the payoff matrix; a tournament that was stopped resumes in its folder",
    )
    add_executor_options(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> None:
    """Run the races, print the table and write the results."""
    from pcs_racing_agents.cli.estimates import announce, cores_of, racing_seconds
    from pcs_racing_agents.tournament import (
        payoff_picture,
        plan_tournament,
        play_plan,
        tournament_settings,
        tournament_text,
        write_results,
    )

    plan = plan_tournament(
        [load_track(name) for name in arguments.track],
        [*arguments.agents, *(parse_policy(text) for text in arguments.policies)],
        rules(arguments),
        archive=arguments.archive,
        races_per_pair=arguments.races,
        seed=arguments.seed,
    )
    pairs = len(plan.competitors) * (len(plan.competitors) - 1) // 2
    races = pairs * len(plan.tracks) * plan.races_per_pair
    with executor_from(arguments) as executor:
        announce(racing_seconds(races, plan.config.duration), cores_of(arguments))
        if arguments.out is None:
            print(tournament_text(play_plan(plan, executor=executor, progress=show_progress())))
            return
        with open_job(arguments.out, "tournament", tournament_settings(plan)) as job:
            tournament = play_plan(plan, job=job, executor=executor, progress=show_progress())
            print(tournament_text(tournament))
            print(f"results: {write_results(tournament.races, arguments.out / 'results.csv')}")
            if can_draw("the payoff matrix"):
                print(f"picture: {payoff_picture(tournament, arguments.out / 'payoffs.png')}")
