"""Tables of texts for people: declared columns, aligned plain text, and Markdown."""

import math
import re
from collections.abc import Iterable, Sequence
from typing import NamedTuple


class Column(NamedTuple):
    """A column of a table: which attribute of its lines it shows, under which heading, and how."""

    name: str
    heading: str = ""  #: By default the name.
    format: str = ""  #: Format of the values, such as ``"+.3f"``.

    def text(self, line: object) -> str:
        """Return the cell of a line; "-" for NaN, nothing for None."""
        value = getattr(line, self.name)
        if isinstance(value, tuple):
            return ", ".join(value)
        if value is None:
            return ""
        return "-" if isinstance(value, float) and math.isnan(value) else format(value, self.format)


def table_rows(columns: Sequence[Column], lines: Iterable[object]) -> list[tuple[str, ...]]:
    """Return a table as texts, its headings first."""
    head = tuple(column.heading or column.name for column in columns)
    return [head, *(tuple(column.text(line) for column in columns) for line in lines)]


def is_number(cell: str) -> bool:
    """Whether a cell begins like a number, an interval or a bound."""
    return bool(re.match(r"[-+\[<]?\s?[-+]?[0-9]", cell))


def interval_text(low: float, high: float) -> str:
    """Return an interval of shares of races as text: ``"[-0.012, +0.034]"``."""
    return f"[{low:+.3f}, {high:+.3f}]"


def with_interval(value: float, low: float, high: float) -> str:
    """Return a difference in shares of races with its interval: ``"+0.011 [-0.012, +0.034]"``."""
    return f"{value:+.3f} {interval_text(low, high)}"


def aligned(rows: Iterable[Sequence[str]], *, left: int | None = None) -> list[str]:
    """Return rows as lines of plain text, without blanks at the end of a line; the first row may be a head.

    So many columns as ``left`` says stand to the left; by default the first one and all that hold no numbers do.
    """
    cells = [list(row) for row in rows]
    columns = list(zip(*cells, strict=True))
    widths = [max(map(len, column)) for column in columns]
    words = [
        i < left
        if left is not None
        else i == 0 or not any(cell[:1].isdigit() or cell[:1] in tuple("+-") for cell in column[1:] if cell)
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
    """Return rows as lines of a table in Markdown; the first is its head."""
    head, *others = ([cell.replace("|", "\\|") for cell in row] for row in rows)
    return [f"| {' | '.join(row)} |" for row in (head, ["---"] * len(head), *others)]
