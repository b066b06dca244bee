"""Reading of the tables that studies write, with one error for a damaged line."""

from collections.abc import Sequence
from pathlib import Path

from pcs_racing.base.errors import InputError
from pcs_racing_agents.base.tables import read_csv

Row = dict[str, str]
KEY = ("kind", "track", "opponent", "arm", "base")
"""Columns that name a comparison."""


def read_comparisons(
    file: Path, shares: Sequence[str] = (), numbers: Sequence[str] = ()
) -> list[Row]:
    """Return the comparisons of a study's table, each once.

    Parameters
    ----------
    shares, numbers : sequence of str
        Columns of numbers from 0 to 1, and from -1 to 1.
    """
    if not file.is_file():
        raise InputError(f"there is no {file}; give folders of finished studies")
    rows = [dict(row) for row in read_csv(file).rows()]
    low = dict.fromkeys(shares, 0.0) | dict.fromkeys(numbers, -1.0)
    missing = [key for key in (*KEY, "train", *low) if not rows or key not in rows[0]]
    if missing:
        raise InputError(f"{file} has no {missing[0]!r} or no lines; run the study again")
    seen: set[tuple[str, ...]] = set()
    for number, row in enumerate(rows, 2):
        where, key = f"{file}, line {number}", tuple(row[name] for name in KEY)
        if row["train"] not in ("0", "1"):
            raise InputError(f"{where}: train is {row['train']!r}; it must be 0 or 1")
        if key in seen:
            raise InputError(f"{where}: the comparison {' '.join(key)} is there twice")
        seen.add(key)
        for name, least in low.items():
            if not least <= _number(row[name]) <= 1.0:
                raise InputError(f"{where}: {name} is {row[name]!r}; it must be {least:g} to 1")
    return [row for row in rows if row["kind"] != "score"]


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return float("nan")
