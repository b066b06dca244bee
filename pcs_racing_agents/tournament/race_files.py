"""Results files: reading and writing a race table as CSV, one line per race.

The columns of a large file repeat few texts. The reader stores and parses each distinct text of a
column once.
"""

import csv
import io
import math
import os
import re
from array import array
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.errors import InputError
from pcs_racing.base.files import write_atomically
from pcs_racing.base.typing import Floats
from pcs_racing_agents.base.tables import read_csv
from pcs_racing_agents.tournament.races import (
    CRASHES,
    FAULTS,
    WINNERS,
    Categorical,
    RaceRow,
    RaceTable,
    narrow,
)

MAX_TEXT = 300
MAX_RACES = 2_000_000
MAX_STEPS = 100_000_000

CARS = ("ego", "opponent")
_SEED = re.compile(r"0|[1-9][0-9]*")  # one text for each seed: no leading zeros
_PATH = re.compile(r"([0-9]{1,6}(; [0-9]{1,6})*)?")


def write_results(races: Iterable[RaceRow], path: str | os.PathLike[str]) -> Path:
    """Write one CSV line per race; the write is atomic, and the file is equal on every machine."""

    def write(file: IO[bytes]) -> None:
        text = io.TextIOWrapper(file, encoding="utf-8", newline="")
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(RaceRow._fields)
        writer.writerows(map(_texts, races))
        # Detach, since a deleted wrapper would close the file before write_atomically finishes.
        text.detach()

    write_atomically(Path(path), write)
    return Path(path)


def read_results(path: str | os.PathLike[str]) -> RaceTable:
    """Read a results file; it has the fields of a :class:`RaceRow` as columns."""
    table = read_csv(path)
    return _parsed(_in_columns(table.path, table.columns, table.values()))


def race_table(rows: Iterable[RaceRow]) -> RaceTable:
    """Return the table of races in rows, with the same checks as for a file."""
    return _parsed(_in_columns("the table", RaceRow._fields, enumerate(map(_texts, rows), start=2)))


def _texts(row: RaceRow) -> list[str]:
    """Return the cells of a race: lengths and times with 4 decimals, lists with semicolons."""
    return [
        (
            f"{value:.4f}"
            if isinstance(value, float)
            else "; ".join(map(str, value))
            if isinstance(value, tuple)
            else str(value)
        )
        for value in row
    ]


class _Lines(NamedTuple):
    """Lines of a file, stored by column."""

    where: str  #: Name of the file in error messages.
    columns: dict[str, Categorical]
    at: NDArray[np.int32]  #: shape (N,): Line numbers in the file, counted from 1.

    def damaged(self, column: str, word: str, problem: str) -> InputError:
        """Return an error with the line number and race index of the first line with a word."""
        # Later lines with the word repeat the fault.
        words, codes = self.columns[column]
        number = int(np.argmax(codes == words.index(word)))
        return InputError(
            f"{self.where}, line {self.at[number]} (race {number}), is damaged: {column} is"
            f" {problem}"
        )

    def words(self, name: str) -> Categorical:
        """Return a column of words."""
        for word in self.columns[name].words:
            if len(word) > MAX_TEXT:
                raise self.damaged(name, word, f"{len(word)} characters long")
        return self.columns[name]

    def numbers(
        self, name: str, low: float, high: float, *, may_be_unknown: bool = False
    ) -> Floats:
        """Return a column of numbers within bounds; NaN for an unknown number."""
        words, codes = self.columns[name]
        values = np.array([_number(word) for word in words])
        wrong = ~((values >= low) & (values <= high))  # NaN is wrong, too
        if may_be_unknown:
            wrong &= np.array(words) != "nan"
        if wrong.any():
            word = words[int(np.argmax(wrong))]
            raise self.damaged(
                name, word, f"{word!r:.60}; it must be a number from {low:g} to {high:g}"
            )
        return values[codes]

    def wholes(self, name: str, high: int) -> NDArray[Any]:
        """Return a column of whole numbers from 0 to ``high``."""
        values = self.numbers(name, 0, high)
        if (values != np.floor(values)).any():
            words, codes = self.columns[name]
            word = words[codes[int(np.argmax(values != np.floor(values)))]]
            raise self.damaged(name, word, f"{word!r:.60}; it must be a whole number")
        return narrow(values.astype(np.int64))

    def choices(self, name: str, allowed_words: Sequence[str]) -> NDArray[np.int64]:
        """Return the indices of a column's words in a list of allowed words."""
        words, codes = self.columns[name]
        for word in words:
            if word not in allowed_words:
                allowed = ", ".join(allowed_words)
                raise self.damaged(name, word, f"{word!r:.60}; it must be {allowed}")
        return np.array([allowed_words.index(word) for word in words], np.int64)[codes]

    def seeds(self) -> Categorical:
        """Return the column of seeds, whole numbers of any size, as text."""
        seeds = self.words("seed")
        for word in seeds.words:
            if not _SEED.fullmatch(word):
                raise self.damaged("seed", word, f"{word!r:.60}; it must be a whole number")
        return seeds

    def steps(self, name: str) -> Categorical:
        """Return the lists of both cars as words, shape (N, 2, max length)."""
        columns = [self.words(f"{car}_{name}") for car in CARS]
        lists = [[word.split("; ") if word else [] for word in column.words] for column in columns]
        length = max(len(steps) for own in lists for steps in own)
        # Check before any allocation: one long list would widen the table for all races.
        if 2 * len(self.at) * length > MAX_STEPS:
            raise InputError(
                f"{self.where} holds too much: {len(self.at)} races with lists as long as that in"
                f" {name}"
            )
        words: dict[str, int] = {}
        both = []
        for column, own in zip(columns, lists, strict=True):
            codes = np.full((len(own), length), -1, np.int64)
            for row, steps in zip(codes, own, strict=True):
                row[: len(steps)] = [words.setdefault(step, len(words)) for step in steps]
            both.append(narrow(codes)[column.codes])
        return Categorical(tuple(words), np.stack(both, axis=1))

    def paths(self, name: str) -> NDArray[Any]:
        """Return the policies of both cars, shape (N, 2, max length), padded with -1."""
        for column in (f"{car}_{name}" for car in CARS):
            for word in self.words(column).words:
                if not _PATH.fullmatch(word):
                    raise self.damaged(column, word, f"{word!r:.60}; it must be a list of policies")
        words, codes = self.steps(name)
        # A code of -1 indexes the last element.
        return narrow(np.array([*map(int, words), -1], np.int64))[codes]


def _in_columns(where: str, names: Sequence[str], lines: Iterable[tuple[int, list[str]]]) -> _Lines:
    """Return lines by column, with each distinct text stored once."""
    # Arrays of machine integers, since Python lists need several times as much memory.
    codes, at = [array("i") for _ in names], array("i")
    words: list[dict[str, int]] = [{} for _ in names]
    work = [
        (column.append, codes_of.setdefault, codes_of)
        for column, codes_of in zip(codes, words, strict=True)
    ]
    for number, line in lines:
        at.append(number)
        for (append, place, codes_of), text in zip(work, line, strict=True):
            append(place(text, len(codes_of)))
    columns = {}
    for name in names:
        # Column by column, so that memory never holds two copies of the whole table.
        codes_of, column = words.pop(0), codes.pop(0)
        columns[name] = Categorical(
            tuple(codes_of), np.array(column, np.min_scalar_type(len(codes_of)))
        )
    return _Lines(where, columns, np.array(at, np.int32))


def _parsed(lines: _Lines) -> RaceTable:
    """Return the table of a file's lines, with all words checked and converted."""
    if not len(lines.at):
        raise InputError(f"{lines.where} holds no races")
    missing = [name for name in RaceRow._fields if name not in lines.columns]
    if missing:
        raise InputError(
            f"{lines.where} has no column {missing[0]!r}; it must be a results.csv of races"
        )
    if len(lines.at) > MAX_RACES:
        raise InputError(
            f"{lines.where} holds {len(lines.at)} races; at most {MAX_RACES} can be read"
        )

    def both(name: str) -> NDArray[Any]:
        return np.stack([lines.wholes(f"{car}_{name}", 1_000_000) for car in CARS], axis=1)

    # The index of the word is a pair of bits: 1 for the ego, 2 for the opponent.
    fault = lines.choices("fault", FAULTS)
    return RaceTable(
        rules=lines.words("rules"),
        agents=Categorical.concatenate([lines.words(car) for car in CARS], axis=1),
        track=lines.words("track"),
        race=lines.wholes("race", 2**31 - 1),
        start_s=lines.numbers("start_s", -1e6, 1e6),
        side=lines.wholes("side", 1),
        seed=lines.seeds(),
        lead=lines.numbers("lead", -1e6, 1e6),
        winner=np.array([0, 1, -1], np.int8)[lines.choices("winner", WINNERS)],
        crash=narrow(lines.choices("crash", CRASHES)),
        fault=narrow(np.stack([fault & 1, fault >> 1], axis=1)),
        overtakes=both("overtakes"),
        duration=lines.numbers("duration", 0.0, 1e6, may_be_unknown=True),
        variants=both("variant"),
        path=lines.paths("path"),
        moves=lines.steps("moves"),
        best_laps=np.stack([lines.numbers(f"{car}_best_lap", -1.0, 1e6) for car in CARS], axis=1),
    )


def _number(word: str) -> float:
    try:
        return float(word)
    except ValueError:
        return math.nan
