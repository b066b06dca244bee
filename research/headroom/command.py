"""``python -m research headroom``: headroom within a grid slot and over lead plans, and the game that a pool holds."""

import argparse
from pathlib import Path

from pcs_racing.track.loading import as_track
from pcs_racing_agents.cli.estimates import announce, cores_of, racing_seconds
from pcs_racing_agents.cli.headroom import add_pool_options, pool_from, pool_settings
from pcs_racing_agents.cli.options import Commands, add_command, can_draw
from pcs_racing_agents.jobs.executors import add_executor_options, executor_from
from pcs_racing_agents.jobs.jobs import open_job
from pcs_racing_agents.jobs.progress import show_progress
from pcs_racing_agents.payoffs.policy_pool import slot_payoffs
from pcs_racing_agents.pictures.style import save_picture
from pcs_racing_agents.results.csv_files import write_csv
from pcs_racing_agents.results.text_table import aligned
from research.headroom.lead_plans import lead_plan_payoffs, lead_plan_value, make_lead_plans, plan_members
from research.headroom.report import (
    LEAD_NOTE,
    headroom_picture,
    headroom_text,
    lead_plan_rows,
    track_game,
    write_headroom,
)


def add(commands: Commands) -> None:
    """Add the experiment."""
    parser = add_command(
        commands,
        "headroom",
        "race all pairs of a pool, and print the game that it holds",
        "python -m research headroom --archive contest --race contest --out out/headroom",
        "python -m research headroom --archive contest --race contest --lead-plans 6 --out out/plans",
    )
    add_pool_options(parser)
    parser.add_argument(
        "--lead-plans",
        type=int,
        default=0,
        metavar="K",
        help="also race all plans 'one policy while ahead, another one while behind' of K policies, evenly spaced in "
        "the pool, against every policy: K*K*N pairs (default: 0, none)",
    )
    parser.add_argument(
        "--out",
        type=Path,
        required=True,
        metavar="DIR",
        help="folder for headroom.csv, payoffs.csv and pictures; a run that was stopped there goes on",
    )
    add_executor_options(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> None:
    """Race all pairs, print the table, and write files and pictures."""
    names, pool = pool_from(arguments)
    tracks = [as_track(track).name for track in pool.tracks]
    members = plan_members(len(names), arguments.lead_plans)
    plans = make_lead_plans(len(names), members) if members else []
    pairs = len(pool.pairs) + len(plans) * len(names)
    with executor_from(arguments) as executor:
        announce(racing_seconds(len(tracks) * pairs * pool.races, pool.config.duration), cores_of(arguments))
        with open_job(arguments.out, "headroom", pool_settings(pool)) as job:
            payoffs = slot_payoffs(pool, job=job, executor=executor, progress=show_progress("blocks"))
            games = [track_game(track, folds) for track, folds in zip(tracks, payoffs, strict=True)]
            print(headroom_text(games, names))
            if plans:
                raced = lead_plan_payoffs(pool, plans, job=job, executor=executor, progress=show_progress("lead plans"))
                values = [lead_plan_value(folds, plans) for folds in raced]
                rows = lead_plan_rows(tracks, values, names)
                print("\n".join(["", *aligned(rows), "", LEAD_NOTE]))
                print(f"written: {write_csv(rows, arguments.out / 'lead_plans.csv')}")
            for file in write_headroom(games, names, arguments.out):
                print(f"written: {file}")
            if can_draw("the payoff matrix"):
                for game in games:
                    file = save_picture(headroom_picture(game, names), arguments.out / f"{game.track}.png")
                    print(f"picture: {file}")
