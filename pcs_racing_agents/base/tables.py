"""Tables of texts: columns, aligned plain text, Markdown, and CSV files, read with limits."""

import csv
import io
import math
import os
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from operator import attrgetter
from pathlib import Path
from typing import Any, NamedTuple

from pcs_racing.base.errors import InputError
from pcs_racing.base.files import read_limited, write_atomically


class Column(NamedTuple):
    """Column of a table: an attribute of the table's lines, its heading and its format."""

    name: str  #: Name of the attribute; with dots for an attribute of an attribute.
    heading: str = ""  #: Heading; the name by default.
    format: str = ""  #: Format of the values, such as ``"+.3f"``.

    def text(self, line: object) -> str:
        """Return the cell of a line; "-" for NaN, an empty text for None."""
        value = attrgetter(self.name)(line)
        if isinstance(value, tuple):
            return ", ".join(value)
        if value is None:
            return ""
        return "-" if isinstance(value, float) and math.isnan(value) else format(value, self.format)


def table_rows(columns: Sequence[Column], lines: Iterable[object]) -> list[tuple[str, ...]]:
    """Return a table as texts, headings first."""
    head = tuple(column.heading or column.name for column in columns)
    return [head, *(tuple(column.text(line) for column in columns) for line in lines)]


def is_number(cell: str) -> bool:
    """Return whether a cell begins like a number, an interval or a bound."""
    return bool(re.match(r"[-+\[<]?\s?[-+]?[0-9]", cell))


def interval_text(low: float, high: float) -> str:
    """Return an interval of shares of races as text: ``"[-0.012, +0.034]"``."""
    return f"[{low:+.3f}, {high:+.3f}]"


def with_interval(value: float, low: float, high: float) -> str:
    """Return a difference in shares of races with its interval: ``"+0.011 [-0.012, +0.034]"``."""
    return f"{value:+.3f} {interval_text(low, high)}"


def aligned(rows: Iterable[Sequence[str]], *, left: int | None = None) -> list[str]:
    """Return rows as lines of plain text, without trailing blanks; the first row may be a head.

    The first ``left`` columns are aligned left. By default the first column and all columns without
    numbers are aligned left.
    """
    cells = [list(row) for row in rows]
    columns = list(zip(*cells, strict=True))
    widths = [max(map(len, column)) for column in columns]
    # Numbers are aligned right, so that their digits line up; words are aligned left.
    words = [
        (
            i < left
            if left is not None
            else i == 0
            or not any(cell[:1].isdigit() or cell[:1] in tuple("+-") for cell in column[1:] if cell)
        )
        for i, column in enumerate(columns)
    ]
    return [
        "  ".join(
            cell.ljust(width) if word else cell.rjust(width)
            for cell, width, word in zip(row, widths, words, strict=True)
        ).rstrip()
        for row in cells
    ]


def markdown(rows: Iterable[Sequence[str]]) -> list[str]:
    """Return rows as lines of a table in Markdown; the first row is its head."""
    head, *others = (
        [re.sub(r"<(?=[A-Za-z/!])", "&lt;", cell.replace("|", "\\|")) for cell in row]
        for row in rows
    )
    return [f"| {' | '.join(row)} |" for row in (head, ["---"] * len(head), *others)]


MAX_BYTES = 500_000_000
MAX_COLUMNS = 1000


@dataclass(frozen=True, eq=False)
class CsvTable:
    """Table with the names of its columns in the first line."""

    path: str  #: Path for messages.
    columns: tuple[str, ...]
    _data: bytes = field(repr=False)

    def values(self) -> Iterator[tuple[int, list[str]]]:
        """Yield the number in the file and the values of every line; skip empty lines."""
        reader = _reader(self._data)
        try:
            next(reader, None)
            for values in reader:
                # A csv reader gives an empty list for an empty line, which is harmless.
                if len(values) not in (0, len(self.columns)):
                    raise InputError(
                        f"{self.path}, line {reader.line_num} is damaged: it has {len(values)}"
                        f" values, more or fewer than the {len(self.columns)} that the first line"
                        " names"
                    )
                if values:
                    yield reader.line_num, values
        except csv.Error as error:
            raise InputError(f"{self.path}, line {reader.line_num} is damaged: {error}") from None

    def rows(self) -> list[dict[str, str]]:
        """Return all lines."""
        return [dict(zip(self.columns, values, strict=True)) for _, values in self.values()]


def write_csv(rows: Iterable[Iterable[object]], path: str | os.PathLike[str]) -> Path:
    """Write the rows of a table, column names first; the file appears whole or not at all."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    write_atomically(Path(path), text.getvalue())
    return Path(path)


def read_csv(path: str | os.PathLike[str]) -> CsvTable:
    """Read a table; an empty file has no columns."""
    name = os.fspath(path)
    try:
        data = read_limited(path, MAX_BYTES, "a table")
        # The whole file must be text. The mark that spreadsheets write at its beginning is not part
        # of a name.
        data.decode("utf-8-sig")
        columns = tuple(next(_reader(data), ()))
    except OSError as error:
        raise InputError(f"can't read {name}: {error.strerror}") from None
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{name} is damaged: {error}") from None
    if len(columns) > MAX_COLUMNS:
        raise InputError(
            f"{name} has {len(columns)} columns; a table of races has at most {MAX_COLUMNS}"
        )
    return CsvTable(name, columns, data)


def _reader(data: bytes) -> Any:
    """Return a reader that decodes line by line: the text of a large table takes four times the
    memory of its bytes.
    """
    return csv.reader(
        io.TextIOWrapper(io.BytesIO(data), encoding="utf-8-sig", newline=""), strict=True
    )
