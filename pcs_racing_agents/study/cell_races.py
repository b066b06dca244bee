"""What the table of a study needs of its races: from cells that were played, or from their lines in a file."""

from collections.abc import Collection
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.errors import InputError
from pcs_racing_agents.results.csv_files import read_csv
from pcs_racing_agents.tournament.cells import Cell
from pcs_racing_agents.tournament.statistics import score

__all__ = ["CellRaces", "Key", "cell_races", "read_races"]

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]
Labels = NDArray[np.int64]
Key = tuple[str, str, str]
"""What a cell is: (circuit, opponent, arm)."""

CRASHES = ("", "wall", "car")
FAULTS = ("", "ego", "opponent", "both")
COLUMNS = (
    "track", "opponent", "ego", "winner", "crash", "fault", "ego_variant", "opponent_variant", "start_s", "side",
    "seed",
)  # fmt: skip


class CellRaces(NamedTuple):
    """What the table needs of the U races of a cell.

    Attributes
    ----------
    score : ndarray, shape (U,)
        Of the ego: 1 win, 0.5 tie, 0 else.
    crash, own_crash : ndarray of bool, shape (U,)
        Whether the race ended in a crash, and in one that the ego is (also) to blame for.
    ego, opponent, line, side : ndarray of int, shape (U,)
        Variants, the place where the race started (lines of a short circuit may share one), side.
    """

    score: Floats
    crash: Flags
    own_crash: Flags
    ego: Labels
    opponent: Labels
    line: Labels
    side: Labels

    @property
    def ids(self) -> list[tuple[int, ...]]:
        """What makes a race the same race in another cell."""
        columns = (self.ego, self.opponent, self.line, self.side)
        return list(zip(*(column.tolist() for column in columns), strict=True))

    def same_units(self, other: "CellRaces") -> bool:
        """Whether another cell's races are the same ones, in the same order."""
        columns = ("ego", "opponent", "line", "side")
        return all(np.array_equal(getattr(self, name), getattr(other, name)) for name in columns)


def cell_races(cell: Cell) -> CellRaces:
    """Return what the table needs of a cell that was played."""
    units, matches = cell.units, cell.matches
    return CellRaces(
        score=matches.score,
        crash=np.asarray(matches.crash.any(axis=1)),
        own_crash=matches.fault[:, 0] > 0,
        ego=units.variants[:, 0],
        opponent=units.variants[:, 1],
        line=units.place,
        side=units.starts.side.astype(np.int64),
    )


def read_races(path: str | Path, seeds: Collection[int] | None = None) -> dict[Key, CellRaces]:
    """Read the cells of a study back from its ``results.csv``.

    Places are told apart to a tenth of a millimetre.

    Parameters
    ----------
    path : str or Path
    seeds : collection of int, optional
        Only the cells of these seeds. The tables of a study differ in their seeds: one for each opponent of the first
        table, counted from the study's own, and 100 more for the second.

    Raises
    ------
    InputError
        If the file can't be read, a line of it is no race, or the same agents raced on a circuit with different seeds.
    """
    cells: dict[Key, list[tuple[float, ...]]] = {}
    seed_of: dict[Key, int] = {}
    table = read_csv(path)
    missing = [name for name in COLUMNS if name not in table.columns]
    if missing:
        raise InputError(f"{path} has no column {missing[0]!r}; it must be a results.csv of races")
    for number, row in table.lines():
        race, seed = _race(row, f"{path}, line {number}")
        key = (row["track"], row["opponent"], row["ego"])
        if seeds is None or seed in seeds:
            if seed_of.setdefault(key, seed) != seed:
                raise InputError(
                    f"{path}: {key[2]} raced {key[1]} on {key[0]} with seeds {seed_of[key]} and {seed}, which are of "
                    "different tables; say which with seeds"
                )
            cells.setdefault(key, []).append(race)
    found = {}
    for key, rows in cells.items():
        won, tied, crash, own, ego, opponent, start, side = np.array(rows).T
        line = np.unique(start, return_inverse=True)[1]
        labels = (column.astype(np.int64) for column in (ego, opponent, line, side))
        found[key] = CellRaces(score(won > 0, tied > 0), crash > 0, own > 0, *labels)
    return found


def _race(row: dict[str, str], where: str) -> tuple[tuple[float, ...], int]:
    """Return the numbers of a race, and its seed."""
    known = (("winner", ("ego", "opponent", "")), ("crash", CRASHES), ("fault", FAULTS))
    for name, values in known:
        if row[name] not in values:
            raise InputError(f"{where}: {name} is {row[name]!r}; it must be one of {values}")
    try:
        labels = [float(row[name]) for name in ("ego_variant", "opponent_variant", "start_s", "side")]
        seed = int(row["seed"])
        if not all(abs(label) < 1e9 for label in labels):
            raise ValueError
    except (TypeError, ValueError):
        raise InputError(f"{where} is no race: a number is missing") from None
    crash = row["crash"] != ""
    tied = row["winner"] == "" and not crash
    return (row["winner"] == "ego", tied, crash, row["fault"] in ("ego", "both"), *labels), seed
