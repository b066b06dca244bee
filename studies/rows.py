"""``python -m studies rows``: the main table of a study as Markdown and as a picture."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from pcs_racing.base.errors import InputError
from pcs_racing_agents.base.tables import markdown, with_interval, write_csv
from pcs_racing_agents.cli.commands import Option, command
from pcs_racing_agents.cli.options import can_draw, output_folder
from studies.intervals import draw_intervals
from studies.tables import Row, read_comparisons


def read_differences(study: Path) -> dict[tuple[str, str], list[Row]]:
    """Return the lines of a study's table by circuit and opponent."""
    file = study / "table.csv"
    found: dict[tuple[str, str], list[Row]] = {}
    for row in read_comparisons(file, ("score_base",), ("difference", "low", "high")):
        circuit = f"{row['track']} ({'training' if row['train'] == '1' else 'test'})"
        found.setdefault((circuit, row["opponent"]), []).append(row)
    names = [[name_of(row) for row in own] for own in found.values()]
    for cell, own in zip(found, names, strict=True):
        if own != names[0]:
            raise InputError(f"{file}: {', '.join(cell)} compares other agents than the first row")
    return found


def name_of(row: Row) -> str:
    """Return the name of a comparison: an agent, or two for the adaptivity gain."""
    return row["arm"] if row["kind"] == "difference" else f"{row['arm']} - {row['base']}"


def text_of(row: Row) -> str:
    """Return a difference with its interval."""
    return with_interval(*(float(row[key]) for key in ("difference", "low", "high")))


def table_rows(cells: dict[tuple[str, str], list[Row]]) -> list[Sequence[str]]:
    """Return the table: score of the base, the paper's difference, differences from the base."""
    first = next(iter(cells.values()))
    head = ("circuit", "opponent", "paper: GT", first[0]["base"], *map(name_of, first))
    lines = [
        (
            *cell,
            *(f"{float(text):+.3f}" if (text := own[0]["paper_difference"]) else "",),
            f"{float(own[0]['score_base']):.3f}",
            *map(text_of, own),
        )
        for cell, own in cells.items()
    ]
    return [head, *lines]


@command("rows", "python -m studies rows out/all/paper --out out/all/paper-rows")
def run(
    study: Annotated[Path, Option("folder of a finished study", "DIR")],
    *,
    out: Annotated[Path, Option("folder for rows.csv and rows.png", "DIR")],
) -> None:
    """Print the main table of a study, and draw it."""
    cells = read_differences(study)
    rows, folder = table_rows(cells), output_folder(out)
    print("\n".join(markdown(rows)))
    if can_draw("the table"):
        groups = {
            ", ".join(cell): {
                name_of(row): (float(row["difference"]), float(row["low"]), float(row["high"]))
                for row in own
            }
            for cell, own in cells.items()
        }
        base = next(iter(cells.values()))[0]["base"]
        print(f"picture: {draw_intervals(groups, f'races won minus {base}', folder / 'rows.png')}")
    print(f"written: {write_csv(rows, folder / 'rows.csv')}")
