"""The table of a study: what each agent scores against each kind of opponent, beside the figures of the paper.

A row is a circuit and a kind of opponent; an arm is an agent that raced the very races of the others in its row. What
the columns mean, and which of the intervals to quote, is told in ``docs/statistics.md``.
"""

from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.errors import InputError
from pcs_racing_agents.results.races import RaceTable
from pcs_racing_agents.tournament.statistics import Comparison, clustered_mean, compare, holm, match_units

__all__ = [
    "PAPER_OPPONENTS",
    "PAPER_TABLE",
    "ArmResult",
    "Difference",
    "PaperRow",
    "StudyTable",
    "TableRow",
    "make_table",
]

Floats = NDArray[np.float64]
Labels = NDArray[np.int64]

FEWEST_LINES = 5
"""With fewer shared start lines an interval that knows of them has too few degrees of freedom to say anything."""


class PaperRow(NamedTuple):
    """A row of the paper's table of win rates (Table I).

    Attributes
    ----------
    non_gt, gt : float
        Win rate of the agent that never switches, and of the game-theoretic one.
    non_gt_sd, gt_sd : float
        What stands behind the paper's plus-minus signs.
    difference : float
    p : float
        Of the paired t-test.
    """

    non_gt: float
    non_gt_sd: float
    gt: float
    gt_sd: float
    difference: float
    p: float


PAPER_OPPONENTS = {"never-switch": "Non-GT", "random-policy": "Random", "lane-switcher": "Unseen"}
"""Opponents of the zoo that stand for those of the paper's table."""

PAPER_TABLE: dict[tuple[str, bool], PaperRow] = {
    ("Non-GT", True): PaperRow(0.515, 0.251, 0.569, 0.213, 0.054, 0.0142),
    ("Random", True): PaperRow(0.624, 0.225, 0.670, 0.199, 0.046, 0.00370),
    ("Unseen", True): PaperRow(0.586, 0.101, 0.597, 0.089, 0.011, 0.0863),
    ("Non-GT", False): PaperRow(0.553, 0.256, 0.628, 0.180, 0.075, 0.0124),
    ("Random", False): PaperRow(0.625, 0.278, 0.738, 0.172, 0.113, 0.00276),
    ("Unseen", False): PaperRow(0.556, 0.101, 0.565, 0.098, 0.009, 0.147),
}
"""The paper's table, by (kind of opponent, whether the circuit was seen in training)."""


class ArmResult(NamedTuple):
    """How one agent did in a row.

    Attributes
    ----------
    arm : str
    races : int
    score : float
    low, high : float
        Interval of the score that is robust to the clusters of the races.
    sd : float
        Standard deviation of the score over the ego's start policies: what the paper's plus-minus is taken to be.
    crash, own_crash : float
        Shares of races that ended in a crash, and in one that the agent is to blame for.
    """

    arm: str
    races: int
    score: float
    low: float
    high: float
    sd: float
    crash: float
    own_crash: float


@dataclass(frozen=True)
class Difference:
    """One agent minus another, over the same races.

    Attributes
    ----------
    arm, base : str
    result : Comparison
        The one to quote: its interval knows of egos, opponents and, where pairs shared them, start lines.
    two_way : Comparison
        The same with egos and opponents alone: it takes the start lines as given.
    p_holm : float
        ``result.p_clustered``, adjusted over the rows of the table in which this arm stands (Holm 1979).
    """

    arm: str
    base: str
    result: Comparison
    two_way: Comparison
    p_holm: float


@dataclass(frozen=True)
class TableRow:
    """All agents on one circuit against one kind of opponent.

    Attributes
    ----------
    track, opponent : str
    seen : bool
        Whether somebody learned on this circuit.
    paper : PaperRow, optional
        The row of the paper's table that it corresponds to.
    lines : int
        Different start lines.
    lines_drawn : bool
        Whether the intervals stand for other start lines, too; else they take these as given, or every pair had its
        own.
    arms : tuple of ArmResult
        The base first.
    differences : tuple of Difference
        Of every other arm from the base.
    gain : Difference, optional
        The adaptivity gain: the best agent minus the blind one that was best in training.
    """

    track: str
    opponent: str
    seen: bool
    paper: PaperRow | None
    lines: int
    lines_drawn: bool
    arms: tuple[ArmResult, ...]
    differences: tuple[Difference, ...]
    gain: Difference | None

    @property
    def name(self) -> str:
        """What it is called in a sentence."""
        return f"{self.track} ({'seen' if self.seen else 'unseen'}) against {self.opponent}"


@dataclass(frozen=True)
class StudyTable:
    """The whole table.

    Attributes
    ----------
    rows : tuple of TableRow
    base : str
        The agent that others are compared with: the paper's non-GT one.
    best, blind : str, optional
        The agents that the adaptivity gain is the difference of.
    """

    rows: tuple[TableRow, ...]
    base: str
    best: str | None
    blind: str | None

    @property
    def arms(self) -> tuple[str, ...]:
        """Names of all agents, the base first."""
        return tuple(dict.fromkeys(result.arm for row in self.rows for result in row.arms))


def make_table(
    races: RaceTable,
    *,
    base: str | None = None,
    best: str | None = None,
    blind: str | None = None,
    seen: Collection[str] = (),
) -> StudyTable:
    """Compare the arms of every row.

    Parameters
    ----------
    races : RaceTable
        Rows and arms (the egos) keep the order in which they come first.
    base : str, optional
        The arm to compare with; by default the first.
    best : str, optional
        The agent whose adaptivity gain is asked for. It must have been named before the races.
    blind : str, optional
        The best arm that never looks at the race, chosen on training races.
    seen : collection of str
        Circuits that somebody learned on.

    Raises
    ------
    InputError
        If there are no races, an arm is missing, arms of a row did not race the same races, or a pair raced with
        several seeds; and where there are fewer than two ego or opponent variants.
    """
    pairs: dict[tuple[str, str, str], RaceTable] = {}
    seeds: dict[tuple[str, str, str], str] = {}
    for (track, ego, opponent, seed), numbers in races.pairs.items():
        pair = (track, opponent, ego)
        if seeds.setdefault(pair, seed) != seed:
            raise InputError(
                f"{ego} raced {opponent} on {track} with seeds {seeds[pair]} and {seed}, of different tables; "
                "take those of one of them (RaceTable.with_seeds)"
            )
        pairs[pair] = races.take(numbers)
    if not pairs:
        raise InputError("there are no races; a table needs some")
    arms = list(dict.fromkeys(arm for *_, arm in pairs))
    base = arms[0] if base is None else base
    for what, name in (("base", base), ("best", best), ("blind", blind)):
        if name is not None and name not in arms:
            raise InputError(f"{what} is {name!r}, which did not race; the arms are {', '.join(arms)}")
    if best == blind:
        blind = None  # it does not look at the race itself: there is no such gain
    rows = [
        _row(track, opponent, pairs, [base, *(arm for arm in arms if arm != base)], best, blind, track in seen)
        for track, opponent in dict.fromkeys((track, opponent) for track, opponent, _ in pairs)
    ]
    return StudyTable(tuple(_adjusted(rows)), base, best, blind)


def _row(
    track: str,
    opponent: str,
    pairs: dict[tuple[str, str, str], RaceTable],
    arms: list[str],
    best: str | None,
    blind: str | None,
    seen: bool,
) -> TableRow:
    where = f"{track} against {opponent}"
    raced = {arm: pairs[track, opponent, arm] for arm in arms if (track, opponent, arm) in pairs}
    if arms[0] not in raced:
        raise InputError(f"{where}: {arms[0]!r} did not race; there is nothing to compare with")
    first = raced[arms[0]]
    scores = {arm: _scores(first, races, f"{where}, {arm}") for arm, races in raced.items()}
    egos, opponents = first.variants.T.astype(np.int64)
    lines = np.unique(first.start_s, return_inverse=True)[1].astype(np.int64)
    labels = (egos, opponents)
    start = _shared_lines(egos, opponents, lines)
    clusters = labels if start is None else (*labels, start)

    def difference(arm: str, other: str) -> Difference:
        pair = (scores[arm], scores[other], *labels)
        return Difference(arm, other, compare(*pair, start=start), compare(*pair), np.nan)

    results = []
    for arm, races in raced.items():
        mean = clustered_mean(scores[arm], *clusters)
        each = np.bincount(_codes(egos), scores[arm]) / np.bincount(_codes(egos))
        low, high = max(mean.low, 0.0), min(mean.high, 1.0)
        shares = float(races.crashed.mean()), float((races.fault[:, 0] > 0).mean())
        results.append(ArmResult(arm, len(races), mean.mean, low, high, float(each.std(ddof=1)), *shares))
    gain = difference(best, blind) if best in scores and blind in scores else None
    return TableRow(
        track=track,
        opponent=opponent,
        seen=seen,
        paper=PAPER_TABLE.get((PAPER_OPPONENTS.get(opponent, ""), seen)),
        lines=len(np.unique(lines)),
        lines_drawn=start is not None,
        arms=tuple(results),
        differences=tuple(difference(arm, arms[0]) for arm in list(raced)[1:]),
        gain=gain,
    )


def _scores(first: RaceTable, races: RaceTable, where: str) -> Floats:
    """Return the scores of an arm in the order of the base's races."""
    columns = [(table.variants, table.start_s, table.side) for table in (first, races)]
    if all(np.array_equal(one, other) for one, other in zip(*columns, strict=True)):
        return races.score
    try:
        return races.score[match_units(_units(first), _units(races))]
    except InputError as error:
        raise InputError(f"{where}: {error}") from None


def _units(races: RaceTable) -> list[tuple[int, int, float, int]]:
    """What makes a race the same race for two agents: variants, start line, side."""
    columns = (*races.variants.T, races.start_s.round(4), races.side)
    return list(zip(*(column.tolist() for column in columns), strict=True))


def _shared_lines(egos: Labels, opponents: Labels, lines: Labels) -> Labels | None:
    """Labels of start lines where the pairs shared them; None where each pair had its own, or there are too few."""
    pairs = len(set(zip(egos.tolist(), opponents.tolist(), strict=True)))
    return lines if FEWEST_LINES <= len(np.unique(lines)) < pairs else None


def _codes(labels: Labels) -> NDArray[np.intp]:
    return np.unique(labels, return_inverse=True)[1]


def _adjusted(rows: list[TableRow]) -> list[TableRow]:
    """Put in the p-values that hold for all rows together, for each arm by itself."""

    def adjust(found: list[Difference]) -> Iterator[Difference]:
        p_values = holm([one.result.p_clustered for one in found]).tolist() if found else []
        return iter([replace(one, p_holm=p) for one, p in zip(found, p_values, strict=True)])

    every = [one for row in rows for one in row.differences]
    by_arm = {arm: adjust([one for one in every if one.arm == arm]) for arm in dict.fromkeys(one.arm for one in every)}
    gains = adjust([row.gain for row in rows if row.gain is not None])
    return [
        replace(
            row,
            differences=tuple(next(by_arm[one.arm]) for one in row.differences),
            gain=None if row.gain is None else next(gains),
        )
        for row in rows
    ]
