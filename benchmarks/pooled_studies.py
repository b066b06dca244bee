"""What several studies of the same races say together: gains over the blind agent that was best in training.

    python benchmarks/pooled_studies.py out/contest out/table-1 out/table-2 out/table-3 out/table-4

Each folder is that of a finished `pcs-racing study` with an archive and a seed of its own. A gain is the score of an
agent minus that of the blind agent which won most training races *of its study*. The mean over the studies comes with a
95 % interval by Student's t over them: it covers what depends on archive, seed of training and races.
"""

import argparse
import csv
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pcs_racing_agents.tournament.statistics import clustered_mean

Cell = tuple[str, str]  # circuit and opponent


class Table(NamedTuple):
    """The main table of a study: its best blind agent, and the score of each agent in each cell."""

    blind: str
    seen: dict[Cell, bool]
    scores: dict[tuple[Cell, str], float]


def read_table(folder: Path) -> Table:
    """Read the table of a finished study."""
    blind, seen, scores = "", {}, {}
    with open(folder / "table.csv", newline="", encoding="utf-8") as file:
        for row in csv.DictReader(file):
            cell = row["track"], row["opponent"]
            seen[cell] = row["seen"] == "1"
            scores[cell, row["arm"]], scores[cell, row["base"]] = float(row["score"]), float(row["score_base"])
            if row["kind"] == "adaptivity gain":
                blind = row["base"]
    return Table(blind, seen, scores)


def gain(tables: list[Table], cells: list[Cell], arm: str) -> str:
    """Mean gain of an agent over some cells, pooled over studies."""
    gains = [np.mean([table.scores[cell, arm] - table.scores[cell, table.blind] for cell in cells]) for table in tables]
    found = clustered_mean(gains, np.arange(len(gains)))
    return f"{found.mean:+.3f} [{found.low:+.3f}, {found.high:+.3f}]"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs="+", type=Path, metavar="FOLDER", help="finished studies, at least two")
    folders = parser.parse_args().folders
    if len(folders) < 2:
        parser.error("give at least two studies: the interval is over them")
    if missing := [str(folder) for folder in folders if not (folder / "table.csv").is_file()]:
        parser.error(f"no table.csv in {', '.join(missing)}; give folders of finished studies")
    tables = [read_table(folder) for folder in folders]
    cells = [cell for cell in tables[0].seen if all(cell in table.seen for table in tables)]
    arms = list(dict.fromkeys(arm for (_, arm) in tables[0].scores))
    arms = [arm for arm in arms if all((cell, arm) in table.scores for table in tables for cell in cells)]

    print("| study | best blind agent in training |\n|---|---|")
    for folder, table in zip(folders, tables, strict=True):
        print(f"| {folder.name} | {table.blind} |")
    groups = {f"{track}, {opponent}": [(track, opponent)] for track, opponent in cells}
    for opponent in dict.fromkeys(opponent for _, opponent in cells):
        for seen, what in ((True, "learning circuits"), (False, "unseen circuits")):
            some = [cell for cell in cells if cell[1] == opponent and tables[0].seen[cell] == seen]
            groups |= {f"*{what}, {opponent}*": some} if some else {}
    print(f"\n| agent | {' | '.join(groups)} |\n|---|{'---|' * len(groups)}")
    for arm in arms:
        print(f"| {arm} | {' | '.join(gain(tables, some, arm) for some in groups.values())} |")


if __name__ == "__main__":
    main()
