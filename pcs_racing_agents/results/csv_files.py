"""Tables as CSV files: writing them, and reading untrusted ones with limits on their size and shape."""

import csv
import io
import os
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pcs_racing.base.errors import InputError
from pcs_racing.base.files import read_limited, write_atomically

MAX_BYTES = 500_000_000
MAX_COLUMNS = 1000


@dataclass(frozen=True, eq=False)
class CsvTable:
    """A table whose first line names its columns."""

    path: str  #: For messages.
    columns: tuple[str, ...]
    _data: bytes = field(repr=False)

    def values(self) -> Iterator[tuple[int, list[str]]]:
        """Go through the table: for every line its number in the file, and its values; empty ones left out."""
        reader = _reader(self._data)
        try:
            next(reader, None)
            for values in reader:
                # A reader of csv gives an empty list for an empty line, which is harmless.
                if len(values) not in (0, len(self.columns)):
                    raise InputError(
                        f"{self.path}, line {reader.line_num} is damaged: it has {len(values)} values, more or fewer "
                        f"than the {len(self.columns)} that the first line names"
                    )
                if values:
                    yield reader.line_num, values
        except csv.Error as error:
            raise InputError(f"{self.path}, line {reader.line_num} is damaged: {error}") from None

    def lines(self) -> Iterator[tuple[int, dict[str, str]]]:
        """Go through the table as :meth:`values`, with the values by column."""
        return ((number, dict(zip(self.columns, values, strict=True))) for number, values in self.values())

    def rows(self) -> list[dict[str, str]]:
        """Return all lines."""
        return [row for _, row in self.lines()]


def write_csv(rows: Iterable[Iterable[object]], path: str | os.PathLike[str]) -> Path:
    """Write the rows of a table, its columns' names first; the file appears whole or not at all."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    write_atomically(Path(path), lambda file: file.write(text.getvalue().encode("utf-8")))
    return Path(path)


def csv_cell(value: object) -> str:
    """Return a value as text: numbers with six digits, lists with semicolons."""
    if isinstance(value, tuple):
        return "; ".join(value)
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def read_csv(path: str | os.PathLike[str]) -> CsvTable:
    """Read a table; an empty file has no columns."""
    name = os.fspath(path)
    try:
        data = read_limited(path, MAX_BYTES, "a table")
        # All of it must be text, and the mark at the beginning that spreadsheets write is no part of a name.
        data.decode("utf-8-sig")
        columns = tuple(next(_reader(data), ()))
    except OSError as error:
        raise InputError(f"can't read {name}: {error.strerror}") from None
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{name} is damaged: {error}") from None
    if len(columns) > MAX_COLUMNS:
        raise InputError(f"{name} has {len(columns)} columns; a table of races has at most {MAX_COLUMNS}")
    return CsvTable(name, columns, data)


def _reader(data: bytes) -> Any:
    """Return a reader that decodes line by line: the text of a large table takes four times the memory of its bytes."""
    return csv.reader(io.TextIOWrapper(io.BytesIO(data), encoding="utf-8-sig", newline=""), strict=True)
