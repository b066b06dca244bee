"""``pcs-racing headroom``: the value of knowing the opponent's policy, in an archive or a pool of policies."""

import argparse
from pathlib import Path

from pcs_racing.game.archive_files import load_archive
from pcs_racing.planners.registry import parse_policy
from pcs_racing.track.loading import load_track
from pcs_racing_agents.cli.options import (
    POLICY_HELP,
    Commands,
    add_command,
    add_rules,
    add_tracks,
    can_draw,
    rules,
)
from pcs_racing_agents.jobs.jobs import add_executor_options, executor_from, open_job, show_progress

__all__ = ["add"]

MOST = 16
"""Policies of a pool whose size is not given: all pairs of them race in less than a minute a circuit."""


def add(commands: Commands) -> None:
    """Add the command."""
    parser = add_command(
        commands,
        "headroom",
        "race all pairs of an archive's policies, and print what knowing the opponent is worth",
        "pcs-racing headroom --archive contest --race contest --out out/headroom",
        "pcs-racing headroom --archive contest --race contest --lead-plans 6 --out out/plans",
        "pcs-racing headroom --policies lattice:pace=0.2 lattice:pace=0.6 lattice --race contest --out out/mine",
    )
    add_tracks(parser)
    parser.add_argument("--archive", default="contest", help="archive: its name or folder (default: contest)")
    parser.add_argument(
        "--size",
        type=int,
        metavar="N",
        help="policies of the pool, evenly spaced in the order of the archive's first axis "
        f"(default: {MOST}, or all if the archive has fewer)",
    )
    parser.add_argument(
        "--policies", nargs="+", metavar="POLICY", help=f"a pool of your own instead of an archive: {POLICY_HELP}"
    )
    add_rules(parser)
    parser.add_argument(
        "--races", type=int, default=64, metavar="N", help="races of each pair on each track (default: 64)"
    )
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
    from pcs_racing_agents.cli.estimates import announce, cores_of, racing_seconds
    from pcs_racing_agents.payoffs.lead_plans import lead_plan_payoffs, lead_plan_value, make_lead_plans, plan_members
    from pcs_racing_agents.payoffs.policy_pool import PolicyPool, slot_payoffs, spanning_policies
    from pcs_racing_agents.pictures.style import save_picture
    from pcs_racing_agents.results.csv_files import write_csv
    from pcs_racing_agents.results.text_table import aligned
    from pcs_racing_agents.tournament.headroom_report import (
        LEAD_NOTE,
        headroom_picture,
        headroom_text,
        lead_plan_rows,
        track_game,
        write_headroom,
    )

    if arguments.policies:
        names, policies = list(arguments.policies), tuple(parse_policy(text) for text in arguments.policies)
    else:
        archive = load_archive(arguments.archive)
        size = min(MOST, len(archive)) if arguments.size is None else arguments.size
        names, policies = spanning_policies(archive, size)
    tracks = tuple(load_track(name) for name in arguments.track)
    pool = PolicyPool(policies, tracks, rules(arguments), races=arguments.races, seed=arguments.seed)
    settings = {
        "tracks": [track.content_hash for track in tracks],
        "policies": [[policy.planner.name, *policy.parameters.tolist()] for policy in policies],
        "race": repr(pool.config),
        "races": pool.races,
        "folds": pool.folds,
        "seed": pool.seed,
    }
    members = plan_members(len(policies), arguments.lead_plans)
    plans = make_lead_plans(len(policies), members) if members else []
    pairs = len(pool.pairs) + len(plans) * len(policies)
    with executor_from(arguments) as executor:
        announce(racing_seconds(len(tracks) * pairs * pool.races, pool.config.duration), cores_of(arguments))
        with open_job(arguments.out, "headroom", settings) as job:
            payoffs = slot_payoffs(pool, job=job, executor=executor, progress=show_progress("blocks"))
            games = [track_game(track.name, folds) for track, folds in zip(tracks, payoffs, strict=True)]
            print(headroom_text(games, names))
            if plans:
                raced = lead_plan_payoffs(pool, plans, job=job, executor=executor, progress=show_progress("lead plans"))
                values = [lead_plan_value(folds, plans) for folds in raced]
                rows = lead_plan_rows([track.name for track in tracks], values, names)
                print("\n".join(["", *aligned(rows), "", LEAD_NOTE]))
                print(f"written: {write_csv(rows, arguments.out / 'lead_plans.csv')}")
            for file in write_headroom(games, names, arguments.out):
                print(f"written: {file}")
            if can_draw("the payoff matrix"):
                for game in games:
                    print(
                        f"picture: {save_picture(headroom_picture(game, names), arguments.out / f'{game.track}.png')}"
                    )
