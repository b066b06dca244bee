"""What several studies of the same races say together: gains over the baseline that was best in
training.

    python dev/benchmarks/pooled_studies.py out/contest out/table-1 out/table-2 out/table-3
    python dev/benchmarks/pooled_studies.py out/first-0 out/first-1 out/again-0 --archives 0 1 0

Each folder is that of a finished `pcs-racing study` with a seed of its own. A gain is the score of
an agent minus that of the baseline that won most training races *of its study*. The mean over
archives has a 95 % interval by Student's t over them; --archives names the archive of each study
(by default each has its own), and several studies of an archive count as their mean. The interval
covers what depends on archive, seed of training and races. Opponents that are drivers are taken
together, too. Where an archive has several studies, the standard deviation between them, and
between the means of archives, is printed, too.

With --headroom, given once for each study after the folders, it also prints how much knowing the
opponent's policy is worth on the same circuits, and what share of that the agents gain.
"""

import argparse
import csv
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pcs_racing.planners.registry import planner_names
from pcs_racing_agents.base.statistics import Estimate, clustered_mean
from pcs_racing_agents.base.tables import with_interval

Cell = tuple[str, str]  # circuit and opponent


class Table(NamedTuple):
    """The main table of a study: its best baseline, and the score of each agent in each cell."""

    open_loop: str
    seen: dict[Cell, bool]
    scores: dict[tuple[Cell, str], float]


def read_table(folder: Path) -> Table:
    """Read the table of a finished study."""
    open_loop, seen, scores = "", {}, {}
    with open(folder / "table.csv", newline="", encoding="utf-8") as file:
        for row in csv.DictReader(file):
            cell = row["track"], row["opponent"]
            seen[cell] = row["seen"] == "1"
            scores[cell, row["arm"]], scores[cell, row["base"]] = (
                float(row["score"]),
                float(row["score_base"]),
            )
            if row["kind"] == "adaptivity gain":
                open_loop = row["base"]
    return Table(open_loop, seen, scores)


def by_archive(numbers: list[float], archives: list[str]) -> list[list[float]]:
    """Group the numbers of studies by archive."""
    pairs = list(zip(numbers, archives, strict=True))
    return [[number for number, at in pairs if at == name] for name in dict.fromkeys(archives)]


def pooled(numbers: list[float], archives: list[str]) -> Estimate:
    """Return the mean over archives, with its interval by Student's t over their means."""
    means = [float(np.mean(group)) for group in by_archive(numbers, archives)]
    return clustered_mean(means, np.arange(len(means)))  # a cluster for each mean: Student's t


def told(numbers: list[float], archives: list[str]) -> str:
    """Return the pooled mean with its interval as text."""
    found = pooled(numbers, archives)
    return with_interval(found.mean, found.low, found.high)


def spread(numbers: list[float], archives: list[str]) -> str:
    """Return the standard deviation between studies of one archive, and between the means of
    archives.
    """
    groups = by_archive(numbers, archives)
    # An archive with one study says nothing of the spread between studies.
    within = np.sqrt(np.mean([np.var(group, ddof=1) for group in groups if len(group) > 1]))
    return f"{within:.3f}, {np.std([np.mean(group) for group in groups], ddof=1):.3f}"


def gains(tables: list[Table], cells: list[Cell], arm: str) -> list[float]:
    """Mean gain of an agent over some cells, in each study."""
    return [
        float(
            np.mean(
                [table.scores[cell, arm] - table.scores[cell, table.open_loop] for cell in cells]
            )
        )
        for table in tables
    ]


def read_headroom(folders: list[Path]) -> dict[str, float]:
    """Headroom of a study's archive by circuit, from the folders of `pcs-racing headroom`."""
    found: dict[str, float] = {}
    for folder in folders:
        with open(folder / "headroom.csv", newline="", encoding="utf-8") as file:
            found |= {row["track"]: float(row["H"]) for row in csv.DictReader(file)}
    return found


def main() -> None:
    # Options that take several folders swallow those that follow, so the studies come first.
    usage = "%(prog)s FOLDER FOLDER ... [--archives NAME ...] [--headroom FOLDER ...]..."
    layout = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(usage=usage, description=__doc__, formatter_class=layout)
    parser.add_argument(
        "folders", nargs="+", type=Path, metavar="FOLDER", help="finished studies, at least two"
    )
    parser.add_argument(
        "--headroom",
        nargs="+",
        action="append",
        default=[],
        type=Path,
        metavar="FOLDER",
        help=(
            "folders of `pcs-racing headroom` for the archive of a study; once for each study, in"
            " their order"
        ),
    )
    parser.add_argument(
        "--archives",
        nargs="+",
        metavar="NAME",
        help="archive of each study, in their order (default: each its own)",
    )
    given = parser.parse_args()
    folders = given.folders
    archives = given.archives or [str(number) for number in range(len(folders))]
    if len(archives) != len(folders):
        parser.error(
            f"--archives names {len(archives)} for {len(folders)} studies; name one for each"
        )
    if len(set(archives)) < 2:
        parser.error("give studies of at least two archives: the interval is over them")
    if given.headroom and len(given.headroom) != len(folders):
        parser.error(
            f"--headroom is given {len(given.headroom)} times for {len(folders)} studies; once for"
            " each"
        )
    files = [folder / "table.csv" for folder in folders]
    files += [folder / "headroom.csv" for group in given.headroom for folder in group]
    if missing := [str(file) for file in files if not file.is_file()]:
        parser.error(f"there is no {', '.join(missing)}")
    # Only cells and agents that every study has: a mean over different cells would compare
    # circuits, not agents.
    tables = [read_table(folder) for folder in folders]
    cells = [cell for cell in tables[0].seen if all(cell in table.seen for table in tables)]
    arms = list(dict.fromkeys(arm for (_, arm) in tables[0].scores))
    arms = [
        arm
        for arm in arms
        if all((cell, arm) in table.scores for table in tables for cell in cells)
    ]

    print("| study | archive | best baseline in training |\n|---|---|---|")
    for folder, archive, table in zip(folders, archives, tables, strict=True):
        print(f"| {folder.name} | {archive} | {table.open_loop} |")
    kinds = {opponent: {opponent} for _, opponent in cells}
    drivers = set(planner_names()) & set(kinds)
    if len(drivers) > 1:
        kinds = {opponent: {opponent} for opponent in kinds if opponent not in drivers} | {
            "drivers": drivers
        }
    groups: dict[str, list[Cell]] = {}
    for kind, opponents in kinds.items():
        for seen, what in ((True, "learning circuits"), (False, "unseen circuits")):
            some = [cell for cell in cells if cell[1] in opponents and tables[0].seen[cell] == seen]
            groups |= {f"{what}, {kind}": some} if some else {}
        if {f"{what}, {kind}" for what in ("learning circuits", "unseen circuits")} <= set(groups):
            groups[f"all circuits, {kind}"] = [cell for cell in cells if cell[1] in opponents]
    print(f"\n| agent | {' | '.join(groups)} |\n|---|{'---|' * len(groups)}")
    for arm in arms:
        print(
            f"| {arm} |"
            f" {' | '.join(told(gains(tables, some, arm), archives) for some in groups.values())} |"
        )
    if len(set(archives)) < len(archives):
        print(
            "\n| standard deviation: between studies of an archive, between archives |"
            f" {' | '.join(groups)} |"
        )
        print(f"|---|{'---|' * len(groups)}")
        for arm in arms:
            spreads = [spread(gains(tables, some, arm), archives) for some in groups.values()]
            print(f"| {arm} | {' | '.join(spreads)} |")
    print(f"\n| circuit | opponent | {' | '.join(arms)} |\n|---|---|{'---|' * len(arms)}")
    for cell in cells:
        print(
            f"| {' | '.join(cell)} |"
            f" {' | '.join(told(gains(tables, [cell], arm), archives) for arm in arms)} |"
        )
    for opponent in dict.fromkeys(opponent for _, opponent in cells):
        some = [cell for cell in cells if cell[1] == opponent]
        print(
            f"| all | {opponent} |"
            f" {' | '.join(told(gains(tables, some, arm), archives) for arm in arms)} |"
        )
    if given.headroom:
        print_shares(
            tables, archives, [read_headroom(group) for group in given.headroom], groups, arms
        )


def print_shares(
    tables: list[Table],
    archives: list[str],
    rooms: list[dict[str, float]],
    groups: dict[str, list[Cell]],
    arms: list[str],
) -> None:
    """Print the headroom of each group, and what share of it agents gain: the ratio of the means
    over archives.
    """
    of_groups = {
        name: [float(np.mean([room[track] for track, _ in some])) for room in rooms]
        for name, some in groups.items()
        if all(track in room for track, _ in some for room in rooms)
    }
    print(f"\n| | {' | '.join(of_groups)} |\n|---|{'---|' * len(of_groups)}")
    print(f"| headroom | {' | '.join(told(values, archives) for values in of_groups.values())} |")
    for arm in arms:
        shares = [
            pooled(gains(tables, groups[name], arm), archives).mean / pooled(values, archives).mean
            for name, values in of_groups.items()
        ]
        print(f"| {arm}, share of it | {' | '.join(f'{share:.0%}' for share in shares)} |")


if __name__ == "__main__":
    main()
