"""``pcs-racing tournament``: race all pairs of competitors; table, results and payoff matrix."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from pcs_racing.base.errors import InputError
from pcs_racing.track.loading import load_track
from pcs_racing_agents.agents.own_code import parse_own_policy
from pcs_racing_agents.base.jobs import open_job
from pcs_racing_agents.base.progress import show_progress
from pcs_racing_agents.cli.commands import Option, command
from pcs_racing_agents.cli.options import (
    AGENT_HELP,
    DEFAULT_TRACK,
    POLICY_HELP,
    ArchiveName,
    Circuits,
    Rules,
    Workers,
    archive_for,
    can_draw,
)


@command(
    "tournament",
    "pcs-racing tournament --agents cfr-argmax never-switch",
    "pcs-racing tournament --track Tarnfjord --agents never-switch random-moves lane-switcher"
    " --races 40",
    "pcs-racing tournament --track Pipkin --policies lattice lattice:pace=0.9 --rules contest --out"
    " out/mine",
)
def run(
    *,
    track: Circuits = (DEFAULT_TRACK,),
    agents: Annotated[
        Sequence[str],
        Option(f"agent or planner: {AGENT_HELP}", "AGENT"),
    ] = (),
    policies: Annotated[Sequence[str], Option(POLICY_HELP, "POLICY")] = (),
    rules: Rules,
    archive: ArchiveName = None,
    races: Annotated[int, Option("number of races of each pair on each track, even")] = 20,
    out: Annotated[
        Path | None,
        Option(
            "folder for results.csv and the payoff matrix; an interrupted run resumes here",
            "DIR",
        ),
    ] = None,
    workers: Workers,
) -> None:
    """Race every pair of agents and policies, and print a table."""
    from pcs_racing_agents.tournament import (
        plan_tournament,
        play_plan,
        tournament_settings,
        tournament_text,
        write_results,
    )

    if len(agents) + len(policies) < 2:
        raise InputError(
            "a tournament needs at least 2 competitors: name them after --agents or --policies"
        )
    config = rules.config()
    plan = plan_tournament(
        [load_track(name) for name in track],
        [*agents, *(parse_own_policy(text) for text in policies)],
        config,
        archive=archive_for(archive, config),
        races_per_pair=races,
        seed=rules.seed,
        code=True,
    )
    with workers.start() as executor:
        if out is None:
            print(tournament_text(play_plan(plan, executor=executor, progress=show_progress())))
            return
        # The table is printed within the job, which locks the folder against other writers.
        with open_job(out, "tournament", tournament_settings(plan)) as job:
            tournament = play_plan(plan, job=job, executor=executor, progress=show_progress())
            print(tournament_text(tournament))
            print(f"results: {write_results(tournament.races, out / 'results.csv')}")
            if can_draw("the payoff matrix"):
                from pcs_racing_agents.base.style import save_picture
                from pcs_racing_agents.tournament.table import payoffs_picture

                figure = payoffs_picture(plan.names, tournament.summary.scores)
                print(f"picture: {save_picture(figure, out / 'payoffs.png')}")
