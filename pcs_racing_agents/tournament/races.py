"""Columnar table of race results, read and written by tournaments, studies and the viewer.

A :class:`RaceTable` holds small integers. A :class:`RaceRow` and the CSV file
(:mod:`pcs_racing_agents.tournament.race_files`) hold words. A race of four moves takes about 70
bytes.
"""

from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.typing import Floats
from pcs_racing.game.reward import sum_winners, utility
from pcs_racing.race.config import Rules

WINNERS = ("ego", "opponent", "none")
"""Labels of ``RaceTable.winner``; -1 indexes the last label."""
CRASHES = ("none", "wall", "car")
FAULTS = ("none", "ego", "opponent", "both")

BLOCK = 10_000  # number of rows converted together

Flags = NDArray[np.bool_]


class RaceRow(NamedTuple):
    """One race in words, a line of ``results.csv``."""

    rules: str = ""  #: Name of the rules.
    ego: str = ""  #: ``ego``, ``opponent``: Names of the competitors in car 0 and car 1.
    opponent: str = ""
    track: str = ""
    #: Index of the race within its pair; start line, side and noise of an index are equal for all
    #: pairs.
    race: int = 0
    start_s: float = 0.0  #: Arc length of the start line, m.
    side: int = 0  #: Start side of the ego: 0 for left or in front.
    seed: int = 0  #: Seed of the pair's races.
    lead: float = 0.0  #: Ego's progress minus opponent's progress at the end, m.
    winner: str = "none"  #: ``"ego"``, ``"opponent"``, or ``"none"`` for a tie or a no-contest.
    crash: str = "none"  #: Kind of crash: ``"none"``, ``"wall"`` or ``"car"``.
    fault: str = "none"  #: Fault of the crash: ``"none"``, ``"ego"``, ``"opponent"`` or ``"both"``.
    ego_overtakes: int = 0  #: ``ego_overtakes``, ``opponent_overtakes``: Number of overtakes.
    opponent_overtakes: int = 0
    #: Length of the race, s; shortened by a crash; NaN if unknown.
    duration: float = np.nan
    #: ``ego_variant``, ``opponent_variant``: Index of the start policy, or of a planner's policy.
    ego_variant: int = 0
    opponent_variant: int = 0
    #: ``ego_path``, ``opponent_path``: Archive policies of each step, until the end or a crash;
    #: empty for a planner.
    ego_path: tuple[int, ...] = ()
    opponent_path: tuple[int, ...] = ()
    #: ``ego_moves``, ``opponent_moves``: Moves of each step; empty for a planner.
    ego_moves: tuple[str, ...] = ()
    opponent_moves: tuple[str, ...] = ()
    ego_best_lap: float = (
        -1.0
    )  #: ``ego_best_lap``, ``opponent_best_lap``: Shortest lap, s; -1 for none.
    opponent_best_lap: float = -1.0


class Categorical(NamedTuple):
    """A column of words that stores each distinct word once."""

    words: tuple[str, ...]
    codes: NDArray[Any]  #: Indices into ``words``; -1 for no word.

    @classmethod
    def constant(cls, word: str, count: int) -> "Categorical":
        """Return a column with one repeated word."""
        return cls((word,), np.zeros(count, np.int8))

    @classmethod
    def concatenate(cls, columns: "Sequence[Categorical]", axis: int = 0) -> "Categorical":
        """Join columns along the rows or side by side; words are ordered by first occurrence."""
        words: dict[str, int] = {}
        codes = []
        for column in columns:
            # A code of -1 indexes the last element.
            places = np.array(
                [*(words.setdefault(word, len(words)) for word in column.words), -1], np.int64
            )
            codes.append(narrow(places[column.codes]))
        joined = _concatenate(codes) if axis == 0 else np.stack(codes, axis=axis)
        return cls(tuple(words), joined)


@dataclass(frozen=True, eq=False)
class RaceTable:
    """Table of N races; ``table[k]`` is race k in words."""

    #: shape (N,): ``rules``, ``track``, ``seed``: Rules, track, and seed (as text, since a seed
    #: may exceed the range of numeric columns).
    rules: Categorical
    agents: Categorical  #: shape (N, 2): Names of the competitors in car 0 (ego), car 1 (opponent).
    track: Categorical
    race: NDArray[Any]  #: shape (N,): Index of the race within its pair.
    #: shape (N,): ``start_s``, ``lead``, ``duration``: Start line, m; final lead of the ego, m;
    #: length, s, NaN if unknown.
    start_s: Floats
    side: NDArray[Any]  #: shape (N,): Start side of the ego.
    seed: Categorical
    lead: Floats
    winner: NDArray[Any]  #: shape (N,): Car that won; -1 for a tie or a no-contest.
    crash: NDArray[Any]  #: shape (N,): Index into :data:`CRASHES`.
    fault: NDArray[Any]  #: shape (N, 2): 1 for a car at fault for the crash.
    overtakes: NDArray[Any]  #: shape (N, 2)
    duration: Floats
    variants: NDArray[Any]
    #: shape (N, 2, m + 1): Archive policy in each step; -1 for a planner and after a crash.
    path: NDArray[Any]
    moves: Categorical  #: shape (N, 2, m): Moves; no word for a planner and after a crash.
    best_laps: Floats  #: shape (N, 2): Time of each car's shortest lap, s; -1 if there is none.
    #: shape (N, 2, D): Last observations of both cars, with the history of earlier observations;
    #: None if not recorded. Files do not contain them.
    observations: Any = None

    def __len__(self) -> int:
        return len(self.race)

    def __getitem__(self, number: int) -> RaceRow:
        # A range supports negative indices, and raises IndexError to end loops over sequences.
        number = range(len(self))[number]
        return next(self._rows(slice(number, number + 1)))

    def __iter__(self) -> Iterator[RaceRow]:
        for first in range(0, len(self), BLOCK):
            yield from self._rows(slice(first, first + BLOCK))

    def take(self, rows: ArrayLike) -> "RaceTable":
        """Return the races of an array of indices or of a boolean mask."""
        indices = np.asarray(rows)
        if indices.size == 0:
            # numpy converts an empty list to floats, which are invalid indices.
            indices = indices.astype(np.intp)

        def taken(column: Any) -> Any:
            if column is None:
                return None
            return (
                column._replace(codes=column.codes[indices])
                if isinstance(column, Categorical)
                else column[indices]
            )

        return RaceTable(**{field.name: taken(getattr(self, field.name)) for field in fields(self)})

    @property
    def crashed(self) -> Flags:
        """True for races that ended in a crash, shape (N,)."""
        return np.asarray(self.crash > 0)

    @property
    def tie(self) -> Flags:
        """True for races that ended in a tie, without a crash, shape (N,)."""
        return (self.winner < 0) & ~self.crashed

    @property
    def score(self) -> Floats:
        """Score of the ego, shape (N,): 1 for a win, 0.5 for a tie, else 0 (also a no-contest)."""
        return (self.winner == 0) + 0.5 * self.tie

    @property
    def switches(self) -> NDArray[np.int64]:
        """Number of policy switches of each car, shape (N, 2)."""
        before, after = self.path[..., :-1], self.path[..., 1:]
        # The value -1 after a crash is no switch.
        return ((before != after) & (after >= 0)).sum(axis=-1)

    @property
    def places(self) -> NDArray[np.int64]:
        """Labels of the races' start places, shape (N,): clusters of confidence intervals.

        Short tracks have few places: races or start lines with different numbers may share a place.
        The resolution is 0.1 mm.
        """
        # Format only the few distinct places, not the places of a million races.
        lines, line = np.unique(
            np.stack([self.track.codes, self.start_s]), axis=1, return_inverse=True
        )
        labels = [
            f"{self.track.words[int(track)]} {start:.4f}" for track, start in lines.T.tolist()
        ]
        return np.unique(np.array(labels, np.str_), return_inverse=True)[1][line.reshape(-1)]

    @cached_property
    def pairs(self) -> dict[tuple[str, str, str, str], NDArray[np.intp]]:
        """Race indices by (track, ego, opponent, seed), with keys in order of first occurrence."""
        if not len(self):
            return {}
        # Codes instead of words: numbers sort much faster than text.
        columns = np.stack([self.track.codes, *self.agents.codes.T, self.seed.codes])
        _, first, pair = np.unique(columns, axis=1, return_index=True, return_inverse=True)
        pair = pair.reshape(-1)
        rows = np.split(np.argsort(pair, kind="stable"), np.cumsum(np.bincount(pair))[:-1])
        words = (self.track.words, self.agents.words, self.agents.words, self.seed.words)
        numbers = {}
        for k in np.argsort(first).tolist():
            track, ego, opponent, seed = (
                words[i][code] for i, code in enumerate(columns[:, first[k]].tolist())
            )
            numbers[track, ego, opponent, seed] = rows[k]
        return numbers

    def seen_by(self, name: str) -> "RaceTable":
        """Return the races of a competitor, with the competitor as ego in all of them."""
        code = self.agents.words.index(name)
        ahead, behind = (self.take(self.agents.codes[:, car] == code) for car in range(2))
        turned = replace(
            behind,
            agents=behind.agents._replace(codes=behind.agents.codes[:, ::-1]),
            side=1 - behind.side,
            lead=-behind.lead,
            winner=np.array([1, 0, -1], np.int8)[behind.winner],
            moves=behind.moves._replace(codes=behind.moves.codes[:, ::-1]),
            **{
                column: getattr(behind, column)[:, ::-1]
                for column in ("fault", "overtakes", "variants", "path", "best_laps")
            },
            observations=None,
        )
        return concatenate_races([ahead, turned])

    def with_seeds(self, seeds: Collection[int]) -> "RaceTable":
        """Return the races with these seeds."""
        wanted = np.array([int(word) in seeds for word in self.seed.words], bool)
        return self.take(wanted[self.seed.codes])

    def _rows(self, rows: slice) -> Iterator[RaceRow]:
        moves = self.moves.words
        columns = (
            self.rules.codes,
            self.agents.codes,
            self.track.codes,
            self.race,
            self.start_s,
            self.side,
            self.seed.codes,
            self.lead,
            self.winner,
            self.crash,
            self.fault,
            self.overtakes,
            self.duration,
            self.variants,
            self.path,
            self.moves.codes,
            self.best_laps,
        )
        # Plain Python numbers, column by column, since numpy scalars would be slower.
        for row in zip(*(column[rows].tolist() for column in columns), strict=True):
            rules, agents, track, race, start, side, seed, lead, winner, crash, fault = row[:11]
            overtakes, duration, variants, path, move_codes, best_laps = row[11:]
            paths = [tuple(policy for policy in steps if policy >= 0) for steps in path]
            lists = [tuple(moves[move] for move in steps if move >= 0) for steps in move_codes]
            yield RaceRow(
                self.rules.words[rules],
                self.agents.words[agents[0]],
                self.agents.words[agents[1]],
                self.track.words[track],
                race,
                start,
                side,
                int(self.seed.words[seed]),
                lead,
                WINNERS[winner],
                CRASHES[crash],
                FAULTS[fault[0] + 2 * fault[1]],
                overtakes[0],
                overtakes[1],
                duration,
                variants[0],
                variants[1],
                paths[0],
                paths[1],
                lists[0],
                lists[1],
                best_laps[0],
                best_laps[1],
            )


def series_of(races: RaceTable, rules: Rules) -> RaceTable:
    """Return one race for each series of consecutive races of a pair.

    The result is the first race of the series, with the winner of the series.
    """
    if rules.heats == 1:
        return races
    winner, first = series_winner(races, rules)
    crash = np.zeros(len(first), np.int8)
    return replace(races.take(first), winner=winner[first], crash=crash)


def series_winner(races: RaceTable, rules: Rules) -> tuple[NDArray[np.int8], NDArray[np.intp]]:
    """Return the winner of each race's series, shape (N,), and the first race of each series.

    The winner has more wins in the series; in series of two legs it has the higher sum of
    utilities.
    """
    keys = [races.track.codes, *races.agents.codes.T, races.seed.codes, races.race // rules.heats]
    _, first, series = np.unique(np.stack(keys), axis=1, return_index=True, return_inverse=True)
    ahead = np.array([1.0, -1.0, 0.0])[races.winner]
    if rules.legs == 2:
        ahead = utility(rules, races.lead, races.crashed, races.fault, races.winner)
    series = series.reshape(-1)
    return sum_winners(rules, np.bincount(series, ahead))[series], first


def concatenate_races(tables: Iterable[RaceTable]) -> RaceTable:
    """Join the races of one or more tables, in order."""
    members = list(tables)

    def joined(name: str) -> Any:
        columns = [getattr(member, name) for member in members]
        if any(column is None for column in columns):
            return None
        return (
            Categorical.concatenate(columns)
            if isinstance(columns[0], Categorical)
            else _concatenate(columns)
        )

    return RaceTable(**{field.name: joined(field.name) for field in fields(RaceTable)})


def closeness_text(races: RaceTable) -> str:
    """Return a text on the final gaps of races without a crash; empty without such races."""
    gaps = np.abs(races.lead[~races.crashed])
    if not len(gaps):
        return ""
    return (
        f"Final gaps: of the {len(gaps):,} races without a crash {(gaps <= 5.0).mean():.0%}"
        f" ended within 5 m and {(gaps <= 20.0).mean():.0%} within 20 m; the median gap was"
        f" {np.median(gaps):.1f} m."
    )


def narrow(values: NDArray[Any]) -> NDArray[Any]:
    """Return integers in the narrowest sufficient signed type, and other numbers unchanged."""
    if values.dtype.kind != "i":
        return values
    # The type must always be able to hold -1, the code of missing values.
    lowest, highest = values.min(initial=-1), values.max(initial=0)
    return values.astype(
        np.promote_types(np.min_scalar_type(lowest), np.min_scalar_type(-1 - highest))
    )


def _concatenate(arrays: Sequence[NDArray[Any]]) -> NDArray[Any]:
    """Join arrays along the first axis; pad games with fewer moves with -1."""
    if arrays[0].ndim == 3:
        steps = max(array.shape[2] for array in arrays)
        arrays = [
            np.pad(array, ((0, 0), (0, 0), (0, steps - array.shape[2])), constant_values=-1)
            for array in arrays
        ]
    return np.concatenate(arrays)
