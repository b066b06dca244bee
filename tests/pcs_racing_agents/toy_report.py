"""A report with everything in it, whose texts would break out of the page if they could."""

from dataclasses import replace

from toy_races import toy_races

from pcs_racing_agents.study.report import software, standings
from pcs_racing_agents.study.report_page import ReportContent, TitledTable
from pcs_racing_agents.study.table import make_table
from pcs_racing_agents.tournament.race_files import race_table
from pcs_racing_agents.tournament.races import RaceRow
from pcs_racing_agents.tournament.ratings import round_robin

NASTY = '</script><script>document.title="owned"</script><b>&amp;"\'<!--body-->'


def toy_report(archive, watched) -> ReportContent:
    races = toy_races(tracks=("Tarnfjord", NASTY), opponents=("never-switch",), egos=4, variants=4)
    table = make_table(
        races,
        best="our-best",
        open_loop="best-fixed",
        train={"Tarnfjord"},
    )
    return ReportContent(
        title=f"A study {NASTY}",
        facts=f"Races {NASTY}",
        about=f"{NASTY}\n\nSecond paragraph.",
        findings=[NASTY, NASTY],
        caution=NASTY,
        table=table,
        standings=standings(races),
        archive=replace(archive, name=NASTY),
        round_robin=round_robin(
            ("a", NASTY),
            race_table(
                RaceRow(ego="a", opponent=NASTY, winner=winner, start_s=start)
                for winner, start in (("ego", 1.0), ("ego", 1.0), ("none", 2.0), ("opponent", 2.0))
            ),
        ),
        sheets=[TitledTable("Sheet", ("change", "gain"), ((NASTY, "+0.05"),), NASTY)],
        races=[watched, watched._replace(title=NASTY, text=NASTY)],
        settings={"race": NASTY, "tracks": ["a", "b"]},
        versions=software(),
    )
