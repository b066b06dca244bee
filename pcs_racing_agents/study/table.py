"""The table of a study: scores of agents against kinds of opponents, with the paper's figures.

A row is a track and a kind of opponent; all agents of a row drove the same races. A line is an
agent in a row. ``docs/statistics.md`` explains the columns and the intervals.
"""

import math
import os
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pcs_racing.base.errors import InputError
from pcs_racing.race.config import PAPER, Rules
from pcs_racing_agents.base.statistics import Comparison, compare, holm, match_units
from pcs_racing_agents.base.tables import Column, aligned, interval_text, table_rows, write_csv
from pcs_racing_agents.tournament.races import RaceTable, series_of

GAIN = "adaptivity gain"
"""Kind of the lines that compare the best agent with the best baseline in training."""
MIN_LINES = 5
"""Min number of shared start lines for clustering by start line (fewer: too few df)."""


class PaperRow(NamedTuple):
    """A row of the paper's table of win rates (Table I)."""

    #: ``non_gt``, ``gt``: Win rates of the never-switching and of the game-theoretic agent.
    non_gt: float | None = None
    gt: float | None = None
    difference: float | None = None
    p: float | None = None  #: p-value of the paired t-test.


NO_FIGURES = PaperRow()
PAPER_TABLE = {
    ("never-switch", True): PaperRow(0.515, 0.569, 0.054, 0.0142),
    ("random-policy", True): PaperRow(0.624, 0.670, 0.046, 0.00370),
    ("lane-switcher:any", True): PaperRow(0.586, 0.597, 0.011, 0.0863),
    ("never-switch", False): PaperRow(0.553, 0.628, 0.075, 0.0124),
    ("random-policy", False): PaperRow(0.625, 0.738, 0.113, 0.00276),
    ("lane-switcher:any", False): PaperRow(0.556, 0.565, 0.009, 0.147),
}
"""The paper's table, by (opponent's name in the zoo, True for a training track)."""


class TableLine(NamedTuple):
    """An agent on one track against one kind of opponent."""

    #: Name of the value: ``"score"`` of the first agent (compared with itself), ``"difference"`` of
    #: another agent from it, or ``"adaptivity gain"``: best agent minus the best baseline in
    #: training.
    kind: str
    track: str
    train: bool  #: True for a training track.
    opponent: str
    arm: str  #: ``arm``, ``base``: Names of the agent and of the agent to compare with.
    base: str
    lines: int  #: Number of start lines.
    score_sd: float  #: Standard deviation of the score over start policies (paper: plus-minus).
    #: ``crash``, ``own_crash``: Shares of races with a crash, and with a crash by own fault.
    crash: float
    own_crash: float
    #: Scores, difference, interval and p-values; clusters: egos, opponents, shared start lines.
    result: Comparison
    p_holm: float = math.nan  #: ``result.p_clustered`` adjusted over the agent's rows (Holm 1979).
    paper: PaperRow = NO_FIGURES  #: The paper's figures for this row.

    @property
    def name(self) -> str:
        """Name of the line: the agent, or the two agents of a gain."""
        return f"{self.arm} - {self.base}" if self.kind == GAIN else self.arm

    @property
    def circuit(self) -> str:
        """Track and its kind."""
        return f"{self.track} ({'train' if self.train else 'test'})"

    @property
    def interval(self) -> str:
        """Interval of the difference as text."""
        return interval_text(self.result.low, self.result.high)

    @property
    def short(self) -> str:
        """Score of the first agent; difference of another one, with a star if significant."""
        if self.kind == "score":
            return f"{self.result.mean_a:.3f}"
        return f"{self.result.difference:+.3f}{'*' if self.p_holm < 0.05 else ' '}"


def make_table(
    races: RaceTable,
    *,
    best: str | None = None,
    open_loop: str | None = None,
    train: Collection[str] = (),
    paper: bool = False,
    rules: Rules = PAPER,
) -> list[TableLine]:
    """Compare the agents of every row.

    Parameters
    ----------
    races : RaceTable
        Races; rows and agents (the egos) are in order of first occurrence. The first agent is the
        base of the differences.
    best : str, optional
        The agent of the adaptivity gain. It must be chosen before the races.
    open_loop : str, optional
        The best agent without observations, chosen on training races.
    train : collection of str
        Training tracks.
    paper : bool
        True for races by the paper's rules, to add the paper's figures.
    rules : Rules
        Rules of the races, for scores of series.
    """
    rows: dict[tuple[str, str], dict[str, RaceTable]] = {}
    for (track, ego, opponent, seed), numbers in races.pairs.items():
        row = rows.setdefault((track, opponent), {})
        if ego in row:
            raise InputError(
                f"{ego} raced {opponent} on {track} with seeds {row[ego][0].seed} and {seed}, of"
                f" different tables; take the races of one table (RaceTable.with_seeds)"
            )
        row[ego] = races.take(numbers)
    if not rows:
        raise InputError("there are no races; a table needs some")
    arms = list(dict.fromkeys(arm for row in rows.values() for arm in row))
    for role, name in (("best", best), ("open_loop", open_loop)):
        if name is not None and name not in arms:
            raise InputError(
                f"{role} is {name!r}, which did not race; the agents are {', '.join(arms)}"
            )
    lines: list[TableLine] = []
    for (track, opponent), raced in rows.items():
        if arms[0] not in raced:
            raise InputError(
                f"{track} against {opponent}: {arms[0]!r} did not race; there is nothing to"
                " compare with"
            )
        pairs = [("score" if arm == arms[0] else "difference", arm, arms[0]) for arm in raced]
        # An open-loop best agent has no gain.
        if best in raced and open_loop in raced and best != open_loop:
            pairs.append((GAIN, best, open_loop))
        facts = (track, track in train, opponent)
        figures = PAPER_TABLE.get((opponent, track in train), NO_FIGURES) if paper else NO_FIGURES
        scored = {arm: series_of(races, rules) for arm, races in raced.items()}
        lines += (line._replace(paper=figures) for line in _row(raced, scored, pairs, *facts))
    return _adjusted(lines)


def by_progress(races: RaceTable) -> RaceTable:
    """Return the races by the paper's scoring: the final leader wins, crash or not."""
    return replace(
        races,
        winner=np.where(races.lead == 0.0, -1, races.lead < 0.0),
        crash=np.zeros_like(races.crash),
    )


def _row(
    raced: Mapping[str, RaceTable],
    scored: Mapping[str, RaceTable],
    pairs: Sequence[tuple[str, str, str]],
    track: str,
    train: bool,
    opponent: str,
) -> Iterator[TableLine]:
    """Yield the lines of a row, one for each pair of agents."""
    # Variants and lines come from the first agent; all scores follow the order of its races.
    first = scored[pairs[0][2]]
    labels = first.variants.T.astype(np.int64)
    places, egos = (np.unique(each, return_inverse=True)[1] for each in (first.start_s, labels[0]))
    lines, pairings = int(places.max()) + 1, len(np.unique(labels, axis=1).T)
    start = places if lines_shared(lines, pairings) else None
    scores = {}
    for arm, races in scored.items():
        try:
            scores[arm] = races.score[match_units(_units(first), _units(races))]
        except InputError as error:
            raise InputError(f"{track} against {opponent}, {arm}: {error}") from None
    for kind, arm, base in pairs:
        result = compare(scores[arm], scores[base], *labels, start=start)
        by_ego = np.bincount(egos, scores[arm]) / np.bincount(egos)
        yield TableLine(
            kind,
            track,
            train,
            opponent,
            arm,
            base,
            lines,
            score_sd=float(by_ego.std(ddof=1)),
            crash=float(raced[arm].crashed.mean()),
            own_crash=float((raced[arm].fault[:, 0] > 0).mean()),
            result=result,
        )


def lines_shared(lines: int, pairings: int) -> bool:
    """Return whether pairs of variants share start lines, and enough of them for clusters."""
    # At least as many lines as pairs: lines were drawn per pair and are no separate cluster.
    return MIN_LINES <= lines < pairings


def _units(races: RaceTable) -> list[tuple[int, int, int, float, int]]:
    """Return the identity of each race, equal for all agents: number, variants, line, side."""
    # Two start lines can share a place: only the number of the race distinguishes them.
    # Results files have four digits of a start line: rounding matches races in file and memory.
    columns = (races.race, *races.variants.T, races.start_s.round(4), races.side)
    return list(zip(*(column.tolist() for column in columns), strict=True))


def _adjusted(lines: Sequence[TableLine]) -> list[TableLine]:
    """Return the lines with p-values adjusted over all rows, separately for each agent."""
    # Per agent: the question is about the gain of this agent over all rows, not of any agent.
    p_values: dict[str, list[float]] = {}
    for line in lines:
        p_values.setdefault(line.name, []).append(line.result.p_clustered)
    adjusted = {name: iter(holm(values).tolist()) for name, values in p_values.items()}
    return [line._replace(p_holm=next(adjusted[line.name])) for line in lines]


# Texts and files

COLUMNS = (
    Column("circuit"),
    Column("opponent"),
    Column("name", "agent"),
    Column("result.mean_a", "score", ".3f"),
    Column("score_sd", "sd", ".3f"),
    Column("crash", format=".1%"),
    Column("own_crash", "own fault", ".1%"),
    Column("result.difference", "difference", "+.3f"),
    Column("interval", "95 % interval"),
    Column("result.p_clustered", "p", ".2g"),
    Column("p_holm", "p (Holm)", ".2g"),
    Column("result.p_paired_t", "paired t", ".2g"),
)
"""Columns of the table as text."""

# Six digits: further digits depend on the processor, and files are compared byte by byte.
CSV_COLUMNS = (
    Column("kind"),
    Column("track"),
    Column("train", format="d"),
    Column("opponent"),
    Column("arm"),
    Column("base"),
    Column("result.units", "races"),
    Column("result.egos", "egos"),
    Column("result.opponents", "opponents"),
    Column("lines"),
    Column("result.mean_a", "score", ".6g"),
    Column("result.mean_b", "score_base", ".6g"),
    Column("score_sd", format=".6g"),
    Column("crash", format=".6g"),
    Column("own_crash", format=".6g"),
    Column("result.difference", "difference", ".6g"),
    Column("result.low", "low", ".6g"),
    Column("result.high", "high", ".6g"),
    Column("result.p_clustered", "p", ".6g"),
    Column("p_holm", format=".6g"),
    Column("result.p_paired_t", "paired_t_p", ".6g"),
    Column("result.cohen_d", "cohen_d", ".6g"),
    Column("paper.non_gt", "paper_non_gt", "g"),
    Column("paper.gt", "paper_gt", "g"),
    Column("paper.difference", "paper_difference", "g"),
    Column("paper.p", "paper_p", "g"),
)
"""Columns of the table's file."""


def overview_rows(lines: Sequence[TableLine]) -> list[tuple[str, ...]]:
    """Return the short table, head first: a row for each track and opponent."""
    names = dict.fromkeys(line.name for line in lines)
    shown = {(line.circuit, line.opponent, line.name): line.short for line in lines}
    theirs = Column("paper.difference", "paper: GT", "+.3f")
    columns = (theirs,) if any(line.paper != NO_FIGURES for line in lines) else ()
    rows = [("circuit", "opponent", *names, *(column.heading for column in columns))]
    for line in lines:
        if line.kind == "score":
            row = (line.circuit, line.opponent)
            cells = (shown.get((*row, name), "") for name in names)
            rows.append((*row, *cells, *(column.text(line) for column in columns)))
    return rows


def notes(lines: Sequence[TableLine]) -> str:
    """Return the meaning of the columns, in a few sentences."""
    # Rows may differ here: then the weaker claim holds for all rows.
    shared = all(
        lines_shared(line.lines, line.result.egos * line.result.opponents) for line in lines
    )
    clusters = "egos, opponents and start lines" if shared else "egos and opponents"
    text = (
        "All agents of a row drove the same races. Score: races won, a tie counting half. Sd:"
        " standard deviation over the ego's start policies. Own fault: crashes that the agent is"
        f" also to blame for. Difference: from {lines[0].arm}, with a 95 % interval and a p-value"
        f" robust to clusters of {clusters}; *: p (Holm, adjusted over the rows) below 0.05. Paired"
        " t: the paper's test over the ego's start policies, for these opponents alone."
    )
    gains = [line.name for line in lines if line.kind == GAIN]
    return f"{text} {gains[0]}: gain over the best baseline in training." if gains else text


def table_text(lines: Sequence[TableLine]) -> str:
    """Return the table as plain text."""
    tables = (overview_rows(lines), table_rows(COLUMNS, lines))
    return "\n\n".join([*("\n".join(aligned(rows)) for rows in tables), notes(lines)]) + "\n"


def write_table(lines: Sequence[TableLine], path: str | os.PathLike[str]) -> Path:
    """Write the lines as CSV; equal lines give equal bytes."""
    return write_csv(table_rows(CSV_COLUMNS, lines), path)
