"""``python -m studies ppo-against-cfr``: PPO and counterfactual regret in equal races."""

from pathlib import Path
from typing import Annotated

from pcs_racing_agents.base.jobs import open_job
from pcs_racing_agents.base.progress import show_progress
from pcs_racing_agents.base.tables import markdown, write_csv
from pcs_racing_agents.cli.commands import Option, command
from pcs_racing_agents.cli.options import Workers, can_draw, output_folder
from pcs_racing_agents.tournament.races import RaceTable


@command(
    "ppo-against-cfr",
    "python -m studies ppo-against-cfr --maps maps --out out/ppo-against-cfr",
    "python -m studies ppo-against-cfr --small --out out/small",
)
def run(
    *,
    out: Annotated[Path, Option("folder of the tables; a stopped run resumes there", "DIR")],
    maps: Annotated[
        Path | None, Option("folder of the real circuits (default: $PCS_RACING_MAPS)", "DIR")
    ] = None,
    small: Annotated[bool, Option("four races of a pair, one circuit of each kind")] = False,
    workers: Workers,
) -> None:
    """Race PPO, agents of counterfactual regret, open-loop agents and the best planner."""
    from pcs_racing_agents.tournament.runner import play_pairings
    from studies.ppo_against_cfr import races, tables

    size = races.SMALL if small else races.Size()
    setups = [races.make_setup(rules, size, maps) for rules in races.ARCHIVES]
    settings = races.job_settings(setups, size.races)
    raced: dict[tuple[str, str, str, str], list[RaceTable]] = {}
    with workers.start() as executor, open_job(output_folder(out), "ppo-cfr", settings) as job:
        for setup in setups:
            played = play_pairings(
                races.make_pairings(setup, size.races),
                name=setup.rules,
                job=job,
                executor=executor,
                progress=show_progress("races"),
            )
            raced |= races.by_pair(setup, played)
    cells = tables.make_cells(raced)
    for setup in setups:
        print(f"\n## Rules {setup.rules}\n")
        for kind, tracks in zip(races.CIRCUITS, (setup.training, setup.held_out), strict=True):
            print(f"{kind} circuits: {', '.join(track.name for track in tracks)}")
        for title, rows in tables.page(cells, setup.rules):
            print(f"\n{title}\n\n" + "\n".join(markdown(rows)))
    print(f"\nwritten: {write_csv(tables.score_rows(cells), out / 'scores.csv')}")
    if can_draw("the picture"):
        print(f"written: {tables.draw_scores(cells, out / 'scores.png')}")
