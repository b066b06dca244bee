"""``python -m studies ppo-against-cfr``: PPO and counterfactual regret in equal races."""

from pathlib import Path
from typing import Annotated

from pcs_racing_agents.base.jobs import open_job, show_progress
from pcs_racing_agents.base.tables import markdown, write_csv
from pcs_racing_agents.cli.commands import Option, command
from pcs_racing_agents.cli.options import Workers, can_draw, output_folder
from pcs_racing_agents.tournament.pairings import play_pairings
from pcs_racing_agents.tournament.races import RaceTable
from studies.ppo_against_cfr import races, tables


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
    number = races.SMALL if small else races.RACES
    tracks = {rules: races.circuits(rules, small, maps) for rules in races.ARCHIVES}
    hashes = {
        rules: [track.content_hash for kind in own.values() for track in kind]
        for rules, own in tracks.items()
    }
    settings = {"seed": races.SEED, "races": number, "tracks": hashes}
    raced: dict[races.Key, list[RaceTable]] = {}
    with workers.start() as executor, open_job(output_folder(out), "ppo-cfr", settings) as job:
        for rules, own in tracks.items():
            keys, pairings = zip(*races.make_pairings(rules, own, number), strict=True)
            show = show_progress("races")
            played = play_pairings(pairings, name=rules, job=job, executor=executor, progress=show)
            for key, table in zip(keys, played, strict=True):
                raced.setdefault(key, []).append(table)
    cells = tables.make_cells(raced)
    for rules, own in tracks.items():
        print(f"\n## Rules {rules}\n")
        for kind, several in own.items():
            print(f"{kind} circuits: {', '.join(track.name for track in several)}")
        for title, rows in tables.page(cells, rules):
            print(f"\n{title}\n\n" + "\n".join(markdown(rows)))
    print(f"\nwritten: {write_csv(tables.score_rows(cells), out / 'scores.csv')}")
    if can_draw("the picture"):
        print(f"written: {tables.draw_scores(cells, out / 'scores.png')}")
