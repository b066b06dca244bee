"""The table of a study: scores of agents against kinds of opponents, with the paper's figures.

A row is a track and a kind of opponent. An arm is an agent in a row; all arms of a row drove the
same races.
``docs/statistics.md`` explains the columns and the intervals.
"""

from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.errors import InputError
from pcs_racing_agents.base.statistics import (
    Comparison,
    clustered_mean,
    compare,
    holm,
    match_units,
)
from pcs_racing_agents.tournament import RaceTable

Floats = NDArray[np.float64]
Labels = NDArray[np.int64]

GAIN = "adaptivity gain"
MIN_LINES = 5
"""Min number of shared start lines for clustering by start line (fewer: too few df)."""


class PaperRow(NamedTuple):
    """A row of the paper's table of win rates (Table I)."""

    non_gt: float  #: ``non_gt``, ``gt``: Win rates of the never-switching and game-theoretic agent.
    non_gt_sd: float  #: ``non_gt_sd``, ``gt_sd``: Figures after the paper's plus-minus signs.
    gt: float
    gt_sd: float
    difference: float
    p: float  #: p-value of the paired t-test.


PAPER_TABLE: dict[tuple[str, bool], PaperRow] = {
    ("never-switch", True): PaperRow(0.515, 0.251, 0.569, 0.213, 0.054, 0.0142),
    ("random-policy", True): PaperRow(0.624, 0.225, 0.670, 0.199, 0.046, 0.00370),
    ("lane-switcher", True): PaperRow(0.586, 0.101, 0.597, 0.089, 0.011, 0.0863),
    ("never-switch", False): PaperRow(0.553, 0.256, 0.628, 0.180, 0.075, 0.0124),
    ("random-policy", False): PaperRow(0.625, 0.278, 0.738, 0.172, 0.113, 0.00276),
    ("lane-switcher", False): PaperRow(0.556, 0.101, 0.565, 0.098, 0.009, 0.147),
}
"""The paper's table, by (opponent's name in the zoo, True for a training track)."""


class ArmResult(NamedTuple):
    """Results of one agent in a row."""

    arm: str
    races: int
    score: float
    low: float  #: ``low``, ``high``: Cluster-robust interval of the score.
    high: float
    sd: float  #: Standard deviation of the score over start policies (the paper's plus-minus).
    #: ``crash``, ``own_crash``: Shares of races with a crash, and with a crash by own fault.
    crash: float
    own_crash: float


@dataclass(frozen=True)
class Difference:
    """One agent minus another, over the same races."""

    arm: str
    base: str
    result: Comparison  #: Result to quote; clusters: egos, opponents and shared start lines.
    #: ``result.p_clustered``, adjusted over this arm's rows (Holm 1979).
    p_holm: float = np.nan


@dataclass(frozen=True)
class TableRow:
    """All agents on one track against one kind of opponent."""

    track: str
    opponent: str
    train: bool  #: True for a training track.
    paper: PaperRow | None  #: Matching row of the paper's table.
    lines: int  #: Number of different start lines.
    #: True if intervals are clustered by start line; else each pair had its own, or too few.
    lines_drawn: bool
    arms: tuple[ArmResult, ...]  #: Results of all arms, the base first.
    differences: tuple[Difference, ...]  #: Differences of the other arms from the base.
    gain: Difference | None  #: Adaptivity gain: best agent minus the best baseline in training.

    @property
    def name(self) -> str:
        """Track and opponent as text."""
        return f"{self.track} ({'train' if self.train else 'test'}) against {self.opponent}"

    @property
    def questions(self) -> list[tuple[str, Difference]]:
        """Differences by the name of the arm, then the gain."""
        gains = [] if self.gain is None else [(GAIN, self.gain)]
        return [*((one.arm, one) for one in self.differences), *gains]


@dataclass(frozen=True)
class StudyTable:
    """The whole table."""

    rows: tuple[TableRow, ...]
    base: str  #: Reference agent of the differences: the paper's non-GT agent.
    best: str | None  #: ``best``, ``open_loop``: Agents of the adaptivity gain, their difference.
    open_loop: str | None

    @property
    def arms(self) -> tuple[str, ...]:
        """Names of all agents, the base first."""
        return tuple(dict.fromkeys(result.arm for row in self.rows for result in row.arms))


def make_table(
    races: RaceTable,
    *,
    best: str | None = None,
    open_loop: str | None = None,
    train: Collection[str] = (),
) -> StudyTable:
    """Compare the arms of every row.

    Parameters
    ----------
    races : RaceTable
        Races; rows and arms (the egos) are in order of first occurrence. The first arm is the base
        of the differences.
    best : str, optional
        The agent of the adaptivity gain. It must be chosen before the races.
    open_loop : str, optional
        The best arm without observations, chosen on training races.
    train : collection of str
        Training tracks.
    """
    pairs: dict[tuple[str, str, str], RaceTable] = {}
    seeds: dict[tuple[str, str, str], str] = {}
    for (track, ego, opponent, seed), numbers in races.pairs.items():
        pair = (track, opponent, ego)
        if seeds.setdefault(pair, seed) != seed:
            raise InputError(
                f"{ego} raced {opponent} on {track} with seeds {seeds[pair]} and {seed}, of"
                " different tables; take the races of one table (RaceTable.with_seeds)"
            )
        pairs[pair] = races.take(numbers)
    if not pairs:
        raise InputError("there are no races; a table needs some")
    arms = list(dict.fromkeys(arm for *_, arm in pairs))
    for role, name in (("best", best), ("open_loop", open_loop)):
        if name is not None and name not in arms:
            raise InputError(
                f"{role} is {name!r}, which did not race; the arms are {', '.join(arms)}"
            )
    if best == open_loop:
        open_loop = None  # the best agent is open-loop itself: no gain
    rows = [
        _row(track, opponent, pairs, arms, best, open_loop, track in train)
        for track, opponent in dict.fromkeys((track, opponent) for track, opponent, _ in pairs)
    ]
    return StudyTable(tuple(_adjusted(rows)), arms[0], best, open_loop)


def by_progress(races: RaceTable) -> RaceTable:
    """Return the races by the paper's scoring: the final leader wins, crash or not."""
    return replace(
        races,
        winner=np.where(races.lead == 0.0, -1, races.lead < 0.0),
        crash=np.zeros_like(races.crash),
    )


def _row(
    track: str,
    opponent: str,
    pairs: dict[tuple[str, str, str], RaceTable],
    arms: list[str],
    best: str | None,
    open_loop: str | None,
    train: bool,
) -> TableRow:
    label = f"{track} against {opponent}"
    raced = {arm: pairs[track, opponent, arm] for arm in arms if (track, opponent, arm) in pairs}
    if arms[0] not in raced:
        raise InputError(f"{label}: {arms[0]!r} did not race; there is nothing to compare with")
    first = raced[arms[0]]
    scores = {arm: _matched_scores(first, races, f"{label}, {arm}") for arm, races in raced.items()}
    egos, opponents = first.variants.T.astype(np.int64)
    lines = np.unique(first.start_s, return_inverse=True)[1].astype(np.int64)
    # Labels and lines come from the first arm; the scores of all other arms follow its order.
    labels = (egos, opponents)
    start = _shared_lines(egos, opponents, lines)
    # A planner with a single policy is taken as given.
    varied = tuple(codes for codes in labels if codes is egos or len(np.unique(codes)) > 1)
    clusters = varied if start is None else (*varied, start)

    def difference(arm: str, other: str) -> Difference:
        return Difference(arm, other, compare(scores[arm], scores[other], *labels, start=start))

    results = []
    for arm, races in raced.items():
        mean = clustered_mean(scores[arm], *clusters)
        by_ego = np.bincount(_codes(egos), scores[arm]) / np.bincount(_codes(egos))
        # A score is between 0 and 1; the t distribution is unbounded.
        low, high = max(mean.low, 0.0), min(mean.high, 1.0)
        shares = float(races.crashed.mean()), float((races.fault[:, 0] > 0).mean())
        results.append(
            ArmResult(arm, len(races), mean.mean, low, high, float(by_ego.std(ddof=1)), *shares)
        )
    gain = difference(best, open_loop) if best in scores and open_loop in scores else None
    return TableRow(
        track=track,
        opponent=opponent,
        train=train,
        paper=PAPER_TABLE.get((opponent, train)),
        lines=len(np.unique(lines)),
        lines_drawn=start is not None,
        arms=tuple(results),
        differences=tuple(difference(arm, arms[0]) for arm in list(raced)[1:]),
        gain=gain,
    )


def _matched_scores(first: RaceTable, races: RaceTable, label: str) -> Floats:
    """Return the scores of an arm in the order of the races of another arm."""
    try:
        return races.score[match_units(_units(first), _units(races))]
    except InputError as error:
        raise InputError(f"{label}: {error}") from None


def _units(races: RaceTable) -> list[tuple[int, int, int, float, int]]:
    """Return the identity of each race, equal for all arms: number, variants, start line, side."""
    # Two start lines can share a place: only the number of the race distinguishes them.
    # Results files have four digits of a start line: rounding matches races in file and memory.
    columns = (races.race, *races.variants.T, races.start_s.round(4), races.side)
    return list(zip(*(column.tolist() for column in columns), strict=True))


def _shared_lines(egos: Labels, opponents: Labels, lines: Labels) -> Labels | None:
    """Return the labels of shared start lines; None if each pair had its own, or too few."""
    # At least as many lines as pairs: lines were drawn per pair and are no separate cluster.
    pairs = len(set(zip(egos.tolist(), opponents.tolist(), strict=True)))
    return lines if MIN_LINES <= len(np.unique(lines)) < pairs else None


def _codes(labels: Labels) -> NDArray[np.intp]:
    return np.unique(labels, return_inverse=True)[1]


def _adjusted(rows: list[TableRow]) -> list[TableRow]:
    """Return the rows with p-values adjusted over all rows, separately for each arm."""
    # Per arm: the question is about the gain of this agent over all rows, not of any agent.
    p_values: dict[str, list[float]] = {}
    for row in rows:
        for arm, difference in row.questions:
            p_values.setdefault(arm, []).append(difference.result.p_clustered)
    adjusted = {arm: iter(holm(values).tolist()) for arm, values in p_values.items()}
    results = []
    for row in rows:
        own = {arm: replace(one, p_holm=next(adjusted[arm])) for arm, one in row.questions}
        gain = own.pop(GAIN, None)
        results.append(replace(row, differences=tuple(own.values()), gain=gain))
    return results
