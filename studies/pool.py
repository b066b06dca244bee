"""``python -m studies pool``: gains of agents in studies of several archives.

A gain is the score of an agent minus the score of the baseline that won most training races of its
study. The interval is Student's t over the studies, one of each archive: it covers the variation
by archive, seed of the training and races.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np

from pcs_racing.base.errors import InputError
from pcs_racing.planners.registry import planner_names
from pcs_racing_agents.base.statistics import Estimate, clustered_mean
from pcs_racing_agents.base.tables import markdown, read_csv, with_interval, write_csv
from pcs_racing_agents.cli.commands import Option, command
from pcs_racing_agents.cli.options import can_draw, output_folder
from studies.intervals import draw_intervals
from studies.tables import read_comparisons

Cell = tuple[str, str]
"""Circuit and opponent."""
SHARES = ("score", "score_base", "own_crash")
"""Columns of shares in a study's table."""
TRAINING_PLANNERS = ("lattice", "iterated-best-response", "gap-follower")
"""Planners among the training opponents of the study ``contest``."""


class Table(NamedTuple):
    """Main table of a study."""

    baseline: str  #: Baseline that won most training races.
    training: Mapping[Cell, bool]  #: True for cells on circuits of the training.
    scores: Mapping[tuple[Cell, str], float]  #: Score of each agent in each cell.
    #: Share of races ended by an own crash, of each agent but the base of the differences.
    own_crashes: Mapping[tuple[Cell, str], float]

    def gain(self, cells: Sequence[Cell], agent: str) -> float:
        """Return the mean gain of an agent over some cells."""
        pairs = [(self.scores[cell, agent], self.scores[cell, self.baseline]) for cell in cells]
        return float(np.mean([score - base for score, base in pairs]))


def read_table(folder: Path) -> Table:
    """Read the tables of a finished study: the main one, and the one of further opponents."""
    file, further = folder / "table.csv", folder / "table_further.csv"
    baseline, training, scores, crashes = "", {}, {}, {}
    files = (file, further) if further.is_file() else (file,)
    for row in [row for one in files for row in read_comparisons(one, SHARES)]:
        cell = row["track"], row["opponent"]
        training[cell] = row["train"] == "1"
        scores[cell, row["arm"]] = float(row["score"])
        crashes[cell, row["arm"]] = float(row["own_crash"])
        scores[cell, row["base"]] = float(row["score_base"])
        if row["kind"] == "adaptivity gain":
            baseline = row["base"]
    if not baseline:
        raise InputError(f"{file} has no row of kind 'adaptivity gain', which names the baseline")
    return Table(baseline, training, scores, crashes)


def won_in_front(folder: Path, opponent: str = "never-switch") -> float | None:
    """Return the share of races of `never-switch` won by the car that starts in front.

    The result is None for a study without its races.
    """
    file = folder / "results.csv"
    if not file.is_file():
        return None
    races = [
        row["winner"] == ("ego" if row["side"] == "0" else "opponent")
        for row in read_csv(file).rows()
        if row["ego"] == "never-switch" and row["opponent"] == opponent
    ]
    return float(np.mean(races)) if races else None


def groups(table: Table, cells: Sequence[Cell]) -> dict[str, list[Cell]]:
    """Return groups of cells by kind of opponent, on training and on test circuits."""
    found: dict[str, list[Cell]] = {}
    planners = dict.fromkeys(planner_names(), "held-out planners")
    planners |= dict.fromkeys(TRAINING_PLANNERS, "training planners")
    for training in (True, False):
        for cell in (one for one in cells if table.training[one] == training):
            kind = planners.get(cell[1], cell[1])
            found.setdefault(f"{kind}, {'training' if training else 'test'}", []).append(cell)
    return found


class Pooled(NamedTuple):
    """Gains of agents over studies of several archives."""

    gains: Mapping[str, Mapping[str, Estimate]]  #: Mean gain by group of cells and agent.
    own_crashes: Mapping[str, float | None]  #: Mean by agent; None for the base.


def pool(tables: Sequence[Table]) -> Pooled:
    """Return the gains of the agents in each group of cells, in the cells of all studies."""
    common = [cell for cell in tables[0].training if all(cell in one.training for one in tables)]
    if not common:
        raise InputError("the studies have no circuit and opponent in common")
    agents = [
        agent
        for agent in dict.fromkeys(agent for _, agent in tables[0].scores)
        if all((cell, agent) in table.scores for table in tables for cell in common)
    ]

    def mean(agent: str, cells: Sequence[Cell]) -> Estimate:
        gains = [table.gain(cells, agent) for table in tables]
        return clustered_mean(gains, np.arange(len(gains)))  # a cluster for each: Student's t

    def crashes(agent: str) -> float | None:
        own = [table.own_crashes.get((cell, agent)) for table in tables for cell in common]
        return None if None in own else float(np.mean(np.array(own, np.float64)))

    parts = groups(tables[0], common) | {"all": common}
    gains = {part: {agent: mean(agent, parts[part]) for agent in agents} for part in parts}
    return Pooled(gains, {agent: crashes(agent) for agent in agents})


def gain_rows(pooled: Pooled) -> list[tuple[str, ...]]:
    """Return a line for each agent: gains with their intervals, and own crashes."""
    lines = [
        (
            f"`{agent}`",
            *(with_interval(*own[agent][:3]) for own in pooled.gains.values()),
            "" if share is None else f"{share:.3f}",
        )
        for agent, share in pooled.own_crashes.items()
    ]
    return [("agent", *pooled.gains, "own crashes"), *lines]


@command("pool", "python -m studies pool out/all/contest-0 out/all/contest-1 --out out/all/pool")
def run(
    studies: Annotated[Sequence[Path], Option("folders of finished studies, two or more", "DIR")],
    *,
    out: Annotated[Path, Option("folder for gains.csv and gains.png", "DIR")],
) -> None:
    """Pool the gains of studies of several archives."""
    if len(studies) < 2:
        raise InputError("give at least two studies: the interval is over them")
    tables = [read_table(folder) for folder in studies]
    for k, table in enumerate(tables):
        if table in tables[:k]:
            raise InputError(f"{studies[k]} has the table of another one; give each study once")
    for folder, table in zip(studies, tables, strict=True):
        print(f"{folder.name}: best baseline in training {table.baseline}")
        front = won_in_front(folder)
        if front is not None:
            print(f"  of never-switch against itself, the car in front wins {front:.3f}")
    pooled, folder = pool(tables), output_folder(out)
    rows = gain_rows(pooled)
    print("\n".join(["", *markdown(rows)]))
    if can_draw("the gains"):
        shown = {
            part: {agent: one[:3] for agent, one in own.items()}
            for part, own in pooled.gains.items()
        }
        label = "races won minus the best baseline"
        print(f"picture: {draw_intervals(shown, label, folder / 'gains.png')}")
    print(f"written: {write_csv(rows, folder / 'gains.csv')}")
