"""``python -m studies headroom``: headroom within a grid slot and over lead plans, and the game
that a pool holds.
"""

from pathlib import Path
from typing import Annotated

from pcs_racing.track.loading import as_track
from pcs_racing_agents.base.jobs import open_job
from pcs_racing_agents.base.progress import show_progress
from pcs_racing_agents.base.style import save_picture
from pcs_racing_agents.base.tables import aligned, write_csv
from pcs_racing_agents.cli.commands import Option, command
from pcs_racing_agents.cli.headroom import PoolOptions, pool_settings
from pcs_racing_agents.cli.options import Workers, can_draw
from pcs_racing_agents.policies.policy_pool import slot_payoffs
from studies.headroom.lead_plans import (
    lead_plan_payoffs,
    lead_plan_value,
    make_lead_plans,
    plan_members,
)
from studies.headroom.report import (
    LEAD_NOTE,
    headroom_picture,
    headroom_text,
    lead_plan_rows,
    track_game,
    write_headroom,
)


@command(
    "headroom",
    "python -m studies headroom --archive contest-early --rules contest --out out/headroom",
    "python -m studies headroom --archive contest-early --rules contest --lead-plans 6 --out"
    " out/plans",
)
def run(
    *,
    options: PoolOptions,
    lead_plans: Annotated[
        int,
        Option(
            "also race all plans 'one policy while ahead, another one while behind' of K policies,"
            " evenly spaced in "
            "the pool, against every policy: K*K*N pairs; 0 for none",
            "K",
        ),
    ] = 0,
    out: Annotated[
        Path,
        Option(
            "folder for headroom.csv, payoffs.csv and pictures; a stopped run resumes there", "DIR"
        ),
    ],
    workers: Workers,
) -> None:
    """Race all pairs of a pool, and print the game that it holds."""
    names, pool = options.pool()
    tracks = [as_track(track).name for track in pool.tracks]
    members = plan_members(len(names), lead_plans)
    plans = make_lead_plans(len(names), members) if members else []
    with workers.start() as executor, open_job(out, "headroom", pool_settings(pool)) as job:
        payoffs = slot_payoffs(pool, job=job, executor=executor, progress=show_progress("blocks"))
        games = [track_game(track, folds) for track, folds in zip(tracks, payoffs, strict=True)]
        print(headroom_text(games, names))
        if plans:
            raced = lead_plan_payoffs(
                pool, plans, job=job, executor=executor, progress=show_progress("lead plans")
            )
            values = [lead_plan_value(folds, plans) for folds in raced]
            rows = lead_plan_rows(tracks, values, names)
            print("\n".join(["", *aligned(rows), "", LEAD_NOTE]))
            print(f"written: {write_csv(rows, out / 'lead_plans.csv')}")
        for file in write_headroom(games, names, out):
            print(f"written: {file}")
        if can_draw("the payoff matrix"):
            for game in games:
                file = save_picture(headroom_picture(game, names), out / f"{game.track}.png")
                print(f"picture: {file}")
