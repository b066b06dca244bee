"""The lines of a results file as text, in columns: every text that a column holds is kept once.

Most of what a file of many races says, it says again and again. A race takes some 100 bytes in this way, and what is
read out of a text (a number, a path) is read once for all races that say the same.
"""

import os
from array import array
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.errors import InputError
from pcs_racing_agents.results.csv_files import read_csv

__all__ = ["Labels", "ResultLines", "lines_of", "read_lines"]


class Labels(NamedTuple):
    """A column of words.

    Attributes
    ----------
    words : tuple of str
        Each of them once, in the order in which they first occur.
    places : ndarray of whole numbers, shape (N,)
        Which of them stands in each line.
    """

    words: tuple[str, ...]
    places: NDArray[Any]


@dataclass(frozen=True, eq=False)
class ResultLines:
    """N lines; ``lines[k]`` is that of race ``k``, counted from 0, as texts by column.

    Attributes
    ----------
    where : str
        How errors call the file.
    columns : mapping of str to Labels
        By name, in the order of the file.
    at : ndarray, shape (N,), int32
        Where they stand in the file, whose first line is 1.
    """

    where: str
    columns: Mapping[str, Labels]
    at: NDArray[np.int32]

    def __len__(self) -> int:
        return len(self.at)

    def __getitem__(self, number: int) -> dict[str, str]:
        return {name: column.words[column.places[number]] for name, column in self.columns.items()}

    def __iter__(self) -> Iterator[dict[str, str]]:
        return (self[number] for number in range(len(self)))

    def damaged(self, column: str, word: str, what: str) -> InputError:
        """Return an error about the first line that holds a word: as a line of the file, and as ``explain`` counts."""
        words, places = self.columns[column]
        number = int(np.argmax(places == words.index(word)))
        return InputError(f"{self.where}, line {self.at[number]} (race {number}), is damaged: {column} is {what}")


def read_lines(path: str | os.PathLike[str]) -> ResultLines:
    """Read a results file.

    Raises
    ------
    InputError
        If it can't be read, or a line has more or fewer values than the first one names.
    """
    table = read_csv(path)
    return _columns(table.path, table.columns, table.values())


def lines_of(rows: Iterable[Mapping[str, str]], where: str) -> ResultLines:
    """Return lines that stand in no file; all of them have the columns of the first."""
    given = list(rows)
    names = tuple(given[0]) if given else ()
    return _columns(where, names, ((at, [row[name] for name in names]) for at, row in enumerate(given, start=2)))


def _columns(where: str, names: tuple[str, ...], lines: Iterable[tuple[int, list[str]]]) -> ResultLines:
    places, at = [array("i") for _ in names], array("i")
    words: list[dict[str, int]] = [{} for _ in names]
    work = [(column.append, found.setdefault, found) for column, found in zip(places, words, strict=True)]
    for number, line in lines:
        at.append(number)
        for (append, place, found), text in zip(work, line, strict=True):
            append(place(text, len(found)))
    columns = {}
    for name in names:
        found, column = words.pop(0), places.pop(0)  # one after the other, lest all of them lie there twice
        columns[name] = Labels(tuple(found), np.array(column, np.min_scalar_type(len(found))))
    return ResultLines(where, columns, np.array(at, np.int32))
