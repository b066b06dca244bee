"""Results of races as a columnar table, which tournaments, studies and the viewer read and write.

Inside a :class:`RaceTable` stand small whole numbers; words are made for the reader (:class:`RaceRow`) and for the csv
file (:mod:`pcs_racing_agents.tournament.race_files`). A race of four moves takes about 70 bytes.
"""

from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

WINNERS = ("ego", "opponent", "none")
"""Words of ``RaceTable.winner``; the last one stands for -1, too."""
CRASHES = ("none", "wall", "car")
FAULTS = ("none", "ego", "opponent", "both")

BLOCK = 10_000  # rows that are made together

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]


class RaceRow(NamedTuple):
    """One race in words: a line of ``results.csv``."""

    preset: str = ""  #: Name of the rules.
    ego: str = ""  #: ``ego``, ``opponent``: Names of the competitors in car 0 and car 1.
    opponent: str = ""
    track: str = ""
    #: Number of the race within its pair: the same number is the same start line, side and noise for every pair.
    race: int = 0
    start_s: float = 0.0  #: Arc length of the start line, m.
    side: int = 0  #: 0 when the ego started on the left or in front.
    seed: int = 0  #: Seed that the races of the pair were drawn with.
    lead: float = 0.0  #: Progress of the ego minus that of the opponent at the end, m.
    winner: str = "none"  #: ``"ego"``, ``"opponent"``, or ``"none"`` for a tie and for a crash that pays neither.
    crash: str = "none"  #: ``"none"``, ``"wall"`` or ``"car"``.
    fault: str = "none"  #: Who is to blame for the crash: ``"none"``, ``"ego"``, ``"opponent"`` or ``"both"``.
    ego_overtakes: int = 0  #: ``ego_overtakes``, ``opponent_overtakes``: How often each passed the other.
    opponent_overtakes: int = 0
    #: Length of the race, s; shorter than the rules say after a crash; NaN where it is not known.
    duration: float = np.nan
    #: ``ego_variant``, ``opponent_variant``: The policy that it started with, or which of a driver's policies it was.
    ego_variant: int = 0
    opponent_variant: int = 0
    #: ``ego_path``, ``opponent_path``: Policies of the archive that it drove, step by step, until the end or a crash;
    #: empty for a driver.
    ego_path: tuple[int, ...] = ()
    opponent_path: tuple[int, ...] = ()
    ego_moves: tuple[str, ...] = ()  #: ``ego_moves``, ``opponent_moves``: Moves that it made; empty for a driver.
    opponent_moves: tuple[str, ...] = ()


class Categorical(NamedTuple):
    """A column of words, each of which is kept once."""

    words: tuple[str, ...]
    codes: NDArray[Any]  #: Places in ``words``; -1 for no word.

    @classmethod
    def constant(cls, word: str, count: int) -> "Categorical":
        """Return a column of one word."""
        return cls((word,), np.zeros(count, np.int8))

    @classmethod
    def concatenate(cls, columns: "Sequence[Categorical]", axis: int = 0) -> "Categorical":
        """Join columns: along the rows, or side by side; words keep the order in which they first occur."""
        words: dict[str, int] = {}
        codes = []
        for column in columns:
            # The last place is where a code of -1 points to.
            places = np.array([*(words.setdefault(word, len(words)) for word in column.words), -1], np.int64)
            codes.append(narrow(places[column.codes]))
        joined = _concatenate(codes) if axis == 0 else np.stack(codes, axis=axis)
        return cls(tuple(words), joined)


@dataclass(frozen=True, eq=False)
class RaceTable:
    """N races; ``table[k]`` is one of them in words."""

    #: shape (N,): ``preset``, ``track``, ``seed``: Rules, circuit, and the seed (as text: it may be larger than any
    #: column of numbers holds).
    preset: Categorical
    agents: Categorical  #: shape (N, 2): Who drove car 0 (the ego) and car 1 (the opponent).
    track: Categorical
    race: NDArray[Any]  #: shape (N,): Number of the race within its pair.
    #: shape (N,): ``start_s``, ``lead``, ``duration``: Start line, m; lead of the ego at the end, m; length, s, NaN
    #: where it is not known.
    start_s: Floats
    side: NDArray[Any]  #: shape (N,): Of the ego.
    seed: Categorical
    lead: Floats
    winner: NDArray[Any]  #: shape (N,): Car that won; -1 for a tie and for a crash that pays neither.
    crash: NDArray[Any]  #: shape (N,): Place in :data:`CRASHES`.
    fault: NDArray[Any]  #: shape (N, 2): 1 for a car that is to blame for the crash.
    overtakes: NDArray[Any]  #: shape (N, 2)
    duration: Floats
    variants: NDArray[Any]
    path: NDArray[Any]  #: shape (N, 2, m + 1): Policies of the archive in each step; -1 for a driver and after a crash.
    moves: Categorical  #: shape (N, 2, m): Moves made; no word for a driver and after a crash.
    #: shape (N, 2, D): Last observations of both cars, which include the earlier ones; None where they were not kept.
    #: They are not part of a file.
    observations: Any = None

    def __len__(self) -> int:
        return len(self.race)

    def __getitem__(self, number: int) -> RaceRow:
        # A range knows negative numbers, and raises an IndexError, which ends loops over sequences.
        number = range(len(self))[number]
        return next(self._rows(slice(number, number + 1)))

    def __iter__(self) -> Iterator[RaceRow]:
        for first in range(0, len(self), BLOCK):
            yield from self._rows(slice(first, first + BLOCK))

    def take(self, rows: ArrayLike) -> "RaceTable":
        """Return some of the races: numbers, or a bool for each."""
        indices = np.asarray(rows)
        if indices.size == 0:
            # An empty list is one of floats to numpy, which no index may be.
            indices = indices.astype(np.intp)

        def taken(column: Any) -> Any:
            if column is None:
                return None
            return column._replace(codes=column.codes[indices]) if isinstance(column, Categorical) else column[indices]

        return RaceTable(**{field.name: taken(getattr(self, field.name)) for field in fields(self)})

    @property
    def crashed(self) -> Flags:
        """Whether a race ended in a crash, shape (N,)."""
        return np.asarray(self.crash > 0)

    @property
    def tie(self) -> Flags:
        """Whether a race ended level, without a crash, shape (N,)."""
        return (self.winner < 0) & ~self.crashed

    @property
    def score(self) -> Floats:
        """Score of the ego, shape (N,): 1 for a win, a half for a tie, else 0 (a crash that pays neither included)."""
        return (self.winner == 0) + 0.5 * self.tie

    @property
    def switches(self) -> NDArray[np.int64]:
        """How often each car changed its policy, shape (N, 2)."""
        before, after = self.path[..., :-1], self.path[..., 1:]
        # After a crash the path holds -1: that is no switch.
        return ((before != after) & (after >= 0)).sum(axis=-1)

    @property
    def places(self) -> NDArray[np.int64]:
        """Labels of the places where the races started, shape (N,): the clusters of confidence intervals.

        Short circuits have few places, so that races of different numbers, and start lines of different numbers, may
        share one. Places count as different from a tenth of a millimetre.
        """
        # Texts only of the places that differ, which are few, and not of a million races.
        lines, line = np.unique(np.stack([self.track.codes, self.start_s]), axis=1, return_inverse=True)
        labels = [f"{self.track.words[int(track)]} {start:.4f}" for track, start in lines.T.tolist()]
        return np.unique(np.array(labels, np.str_), return_inverse=True)[1][line.reshape(-1)]

    @property
    def pairs(self) -> dict[tuple[str, str, str, str], NDArray[np.intp]]:
        """Numbers of the races by (track, ego, opponent, seed), in the order in which these first occur."""
        if not len(self):
            return {}
        # Codes instead of words: numbers sort much faster than texts.
        columns = np.stack([self.track.codes, *self.agents.codes.T, self.seed.codes])
        _, first, pair = np.unique(columns, axis=1, return_index=True, return_inverse=True)
        pair = pair.reshape(-1)
        rows = np.split(np.argsort(pair, kind="stable"), np.cumsum(np.bincount(pair))[:-1])
        words = (self.track.words, self.agents.words, self.agents.words, self.seed.words)
        numbers = {}
        for k in np.argsort(first).tolist():
            track, ego, opponent, seed = (words[i][code] for i, code in enumerate(columns[:, first[k]].tolist()))
            numbers[track, ego, opponent, seed] = rows[k]
        return numbers

    def with_seeds(self, seeds: Collection[int]) -> "RaceTable":
        """Return the races of these seeds."""
        wanted = np.array([int(word) in seeds for word in self.seed.words], bool)
        return self.take(wanted[self.seed.codes])

    def _rows(self, rows: slice) -> Iterator[RaceRow]:
        moves = self.moves.words
        columns = (
            self.preset.codes, self.agents.codes, self.track.codes, self.race, self.start_s, self.side, self.seed.codes,
            self.lead, self.winner, self.crash, self.fault, self.overtakes, self.duration, self.variants, self.path,
            self.moves.codes,
        )  # fmt: skip
        # Plain numbers, column by column: numpy would make a scalar of its own of each, which takes longer.
        for row in zip(*(column[rows].tolist() for column in columns), strict=True):
            preset, agents, track, race, start, side, seed, lead, winner, crash, fault = row[:11]
            overtakes, duration, variants, path, move_codes = row[11:]
            paths = [tuple(policy for policy in steps if policy >= 0) for steps in path]
            lists = [tuple(moves[move] for move in steps if move >= 0) for steps in move_codes]
            yield RaceRow(
                self.preset.words[preset], self.agents.words[agents[0]], self.agents.words[agents[1]],
                self.track.words[track], race, start, side, int(self.seed.words[seed]), lead, WINNERS[winner],
                CRASHES[crash], FAULTS[fault[0] + 2 * fault[1]], overtakes[0], overtakes[1], duration, variants[0],
                variants[1], paths[0], paths[1], lists[0], lists[1],
            )  # fmt: skip


def series_of(races: RaceTable, heats: int) -> RaceTable:
    """Return a race for each series of so many of a pair, by their numbers: the first, won by who won more of them."""
    if heats == 1:
        return races
    keys = [races.track.codes, *races.agents.codes.T, races.seed.codes, races.race // heats]
    _, first, series = np.unique(np.stack(keys), axis=1, return_index=True, return_inverse=True)
    wins = np.bincount(series.reshape(-1), np.array([1.0, -1.0, 0.0])[races.winner])
    winner = np.where(wins > 0.0, 0, np.where(wins < 0.0, 1, -1)).astype(np.int8)
    return replace(races.take(first), winner=winner, crash=np.zeros(len(first), np.int8))


def concatenate_races(tables: Iterable[RaceTable]) -> RaceTable:
    """Join the races of at least one table, in their order."""
    members = list(tables)

    def joined(name: str) -> Any:
        columns = [getattr(member, name) for member in members]
        if any(column is None for column in columns):
            return None
        return Categorical.concatenate(columns) if isinstance(columns[0], Categorical) else _concatenate(columns)

    return RaceTable(**{field.name: joined(field.name) for field in fields(RaceTable)})


def closeness_text(races: RaceTable) -> str:
    """Return how close the races without a crash were at their end; empty if there are none."""
    gaps = np.abs(races.lead[~races.crashed])
    if not len(gaps):
        return ""
    return (
        f"How close the races were: of the {len(gaps):,} without a crash {(gaps <= 5.0).mean():.0%} ended within 5 m "
        f"and {(gaps <= 20.0).mean():.0%} within 20 m; the median gap was {np.median(gaps):.1f} m."
    )


def narrow(values: NDArray[Any]) -> NDArray[Any]:
    """Return whole numbers in the narrowest signed type that holds them, and other numbers as they are."""
    if values.dtype.kind != "i":
        return values
    # -1 stands for missing values, so there must always be room for it.
    lowest, highest = values.min(initial=-1), values.max(initial=0)
    return values.astype(np.promote_types(np.min_scalar_type(lowest), np.min_scalar_type(-1 - highest)))


def _concatenate(arrays: Sequence[NDArray[Any]]) -> NDArray[Any]:
    """Join arrays along the first axis; where games have different numbers of moves, -1 fills up the shorter ones."""
    if arrays[0].ndim == 3:
        steps = max(array.shape[2] for array in arrays)
        arrays = [np.pad(array, ((0, 0), (0, 0), (0, steps - array.shape[2])), constant_values=-1) for array in arrays]
    return np.concatenate(arrays)
