"""``pcs-racing tournament``: races of competitors; table, results and picture."""

from collections.abc import Sequence
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from pcs_racing.base.errors import InputError
from pcs_racing.track.loading import load_track
from pcs_racing_agents.base.jobs import Job, open_job, show_progress
from pcs_racing_agents.cli.commands import Option, command
from pcs_racing_agents.cli.options import (
    AGENT_HELP,
    DEFAULT_TRACK,
    ArchiveName,
    Circuits,
    Like,
    RaceOptions,
    Workers,
    archive_for,
    can_draw,
)

if TYPE_CHECKING:
    from pcs_racing_agents.tournament import Protocol, TournamentPlan

RACES = 20


@command(
    "tournament",
    "pcs-racing tournament --agents cfr-argmax never-switch",
    "pcs-racing tournament --track Tarnfjord --agents never-switch random-moves lane-switcher:any"
    " --races 40",
    "pcs-racing tournament --track Pipkin --agents lattice lattice:pace=0.9 --rules contest --out"
    " out/mine",
    "pcs-racing tournament --protocol bench-v4 --agents best-fixed model.zip --out out/bench",
)
def run(
    *,
    track: Circuits = (DEFAULT_TRACK,),
    agents: Annotated[
        Sequence[str],
        Option(f"racer: {AGENT_HELP}", "AGENT"),
    ],
    like: Like = None,
    protocol: Annotated[
        str | None,
        Option(
            "protocol (bench-v4 or a YAML file): fixed opponents, tracks, rules, races and seed",
            "P",
        ),
    ] = None,
    rules: RaceOptions,
    archive: ArchiveName = None,
    races: Annotated[int, Option("number of races of each pair on each track, even")] = RACES,
    out: Annotated[
        Path | None,
        Option(
            "folder for results.csv and scores.png; an interrupted run resumes here",
            "DIR",
        ),
    ] = None,
    workers: Workers,
) -> None:
    """Race every pair of agents and policies, or all by a protocol, and print a table."""
    from pcs_racing_agents.tournament import (
        load_protocol,
        plan_tournament,
        play_plan,
        play_protocol,
        protocol_text,
        write_results,
    )

    fixed = None
    if protocol is None:
        config = rules.read()
        plan = plan_tournament(
            [load_track(name) for name in track],
            agents,
            config,
            archive=archive_for(archive, config),
            races_per_pair=races,
            seed=rules.seed,
            code=True,
            like=like,
        )
    elif (*track, rules, archive, races) != (DEFAULT_TRACK, RaceOptions(), None, RACES):
        raise InputError(
            "a protocol fixes tracks, rules, duration, seed, archive and races: leave these"
            " options out, or write your own protocol"
        )
    else:
        fixed = load_protocol(protocol, agents, like)
        plan = fixed.plan
    # The table is printed within the job, which locks the folder against other writers.
    with workers.start() as executor, _job(out, plan, fixed) as job:
        if fixed is not None:
            table = play_protocol(fixed, job=job, executor=executor, progress=show_progress())
            print(protocol_text(fixed, table))
        else:
            tournament = play_plan(plan, job=job, executor=executor, progress=show_progress())
            table = tournament.races
            print(tournament)
        if out is None:
            return
        print(f"results: {write_results(table, out / 'results.csv')}")
        if fixed is None and can_draw("the scores"):
            from pcs_racing_agents.base.style import save_picture

            print(f"picture: {save_picture(tournament.plot(), out / 'scores.png')}")


def _job(
    out: Path | None, plan: "TournamentPlan", protocol: "Protocol | None"
) -> AbstractContextManager[Job | None]:
    """Return the job of a folder, as a context; without a folder no job."""
    from pcs_racing_agents.tournament import tournament_settings

    if out is None:
        return nullcontext()
    settings = tournament_settings(plan) if protocol is None else protocol.settings
    return open_job(out, "tournament", settings)
