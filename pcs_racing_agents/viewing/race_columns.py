"""The races of a results file as columns: checked line by line, and packed for a page that lists them."""

import math
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcs_racing.errors import InputError
from pcs_racing.packing import pack
from pcs_racing_agents.csv_files import read_csv

__all__ = ["Labels", "RaceColumns", "packed_columns", "race_columns", "read_lines"]

WINNERS = ("", "ego", "opponent")
CRASHES = ("", "wall", "car")
FAULTS = ("", "ego", "opponent", "both")
NEEDED = ("ego", "opponent", "track", "race", "start_s", "side", "seed", "lead", "winner", "crash", "fault")
LONGEST_TEXT = 300
MOST_RACES = 2_000_000

Floats = NDArray[np.float64]
Counts = NDArray[np.int64]


class Labels(NamedTuple):
    """A column of words.

    Attributes
    ----------
    words : tuple of str
        Each of them once, in the order in which they first occur.
    places : ndarray, shape (N,), int64
        Which of them stands in each line.
    """

    words: tuple[str, ...]
    places: Counts


@dataclass(frozen=True, eq=False)
class RaceColumns:
    """N races.

    Attributes
    ----------
    agents : Labels
        Of shape (2, N): who drove car 0 (the ego) and car 1.
    track, preset, moves : Labels
        ``moves`` are of shape (2, N) like ``agents``: what each made, as the file tells it.
    race, seed : ndarray, shape (N,)
        Number within the pair; seed of the tournament (as a label: seeds may be larger than 2^53).
    start_s, lead, duration : ndarray, shape (N,)
        Metres, metres (of the ego), seconds; duration is NaN where the file does not tell.
    side, winner, crash, fault : ndarray, shape (N,), int64
        Side of the ego; places in ``WINNERS``, ``CRASHES`` and ``FAULTS``.
    overtakes, variants, switches : ndarray, shape (2, N), int64
        Of both cars; ``switches`` counts how often the policy changed.
    """

    agents: Labels
    track: Labels
    preset: Labels
    moves: Labels
    race: Counts
    seed: Labels
    start_s: Floats
    lead: Floats
    duration: Floats
    side: Counts
    winner: Counts
    crash: Counts
    fault: Counts
    overtakes: Counts
    variants: Counts
    switches: Counts

    def __len__(self) -> int:
        return len(self.race)


def read_lines(path: str | os.PathLike[str]) -> list[dict[str, str]]:
    """Read the lines of a results file that stands by itself.

    Raises
    ------
    InputError
        If it can't be read, or a line is damaged.
    """
    return read_csv(path).rows()


def race_columns(lines: Sequence[Mapping[str, str]], where: str | Path) -> RaceColumns:
    """Return the races that a results file holds.

    Parameters
    ----------
    lines : sequence of mapping
        As ``csv.DictReader`` gives them. Columns that only tell details may be missing.
    where : str or Path
        How errors call the file.

    Raises
    ------
    InputError
        If there are no races or too many, a column is missing, or a line is damaged; the first such line is named.
    """
    if not lines:
        raise InputError(f"{where} holds no races")
    if len(lines) > MOST_RACES:
        raise InputError(f"{where} holds {len(lines)} races; a page lists at most {MOST_RACES}")
    there = lines[0].keys()
    missing = [name for name in NEEDED if name not in there]
    if missing:
        raise InputError(f"{where} has no column {missing[0]!r}; it must be a results.csv of races")
    for number, line in enumerate(lines):
        # A line that is too short leaves None, one that is too long the rest under the key None.
        if None in line or None in line.values():
            raise InputError(
                f"{_line(where, number)} is damaged: it has more or fewer values than the first line names"
            )

    def words(*names: str) -> Labels:
        return _labels(lines, names, where)

    def numbers(name: str, low: float, high: float, otherwise: float | None = None) -> Floats:
        return _numbers(lines, name, low, high, otherwise, where)

    def choice(name: str, values: tuple[str, ...]) -> Counts:
        return _choice(lines, name, values, where)

    def both(name: str, high: float) -> Counts:
        return np.array([numbers(f"{car}_{name}", 0, high, otherwise=0) for car in ("ego", "opponent")], np.int64)

    return RaceColumns(
        agents=words("ego", "opponent"),
        track=words("track"),
        preset=words("preset"),
        moves=words("ego_moves", "opponent_moves"),
        race=numbers("race", 0, 2**31).astype(np.int64),
        seed=words("seed"),
        start_s=numbers("start_s", -1e6, 1e6),
        lead=numbers("lead", -1e6, 1e6),
        duration=numbers("duration", 0.0, 1e6, otherwise=math.nan),
        side=numbers("side", 0, 1).astype(np.int64),
        winner=choice("winner", WINNERS),
        crash=choice("crash", CRASHES),
        fault=choice("fault", FAULTS),
        overtakes=both("overtakes", 1e6),
        variants=both("variant", 1e6),
        switches=np.array([[_switches(line.get(f"{car}_path", "")) for line in lines] for car in ("ego", "opponent")]),
    )


def _line(where: str | Path, number: int) -> str:
    """Name a race both ways: as a line of the file, and as ``explain`` counts."""
    return f"{where}, line {number + 2} (race {number}),"


def _labels(lines: Sequence[Mapping[str, str]], names: Iterable[str], where: str | Path) -> Labels:
    found: dict[str, int] = {}
    columns = []
    for name in names:
        column = []
        for number, line in enumerate(lines):
            word = line.get(name, "")
            if len(word) > LONGEST_TEXT:
                raise InputError(f"{_line(where, number)} is damaged: {name} is {len(word)} characters long")
            column.append(found.setdefault(word, len(found)))
        columns.append(column)
    places = np.array(columns, np.int64)
    return Labels(tuple(found), places if len(places) > 1 else places[0])


def _numbers(
    lines: Sequence[Mapping[str, str]], name: str, low: float, high: float, otherwise: float | None, where: str | Path
) -> Floats:
    if otherwise is not None and name not in lines[0]:
        return np.full(len(lines), otherwise)
    values = np.empty(len(lines))
    for number, line in enumerate(lines):
        try:
            values[number] = float(line[name])
        except ValueError:
            values[number] = math.nan
        if not low <= values[number] <= high:  # false for NaN, too
            raise InputError(
                f"{_line(where, number)} is damaged: {name} is {line[name]!r:.60}; it must be a number from {low:g} to "
                f"{high:g}"
            )
    return values


def _choice(lines: Sequence[Mapping[str, str]], name: str, values: tuple[str, ...], where: str | Path) -> Counts:
    place = {value: i for i, value in enumerate(values)}
    for number, line in enumerate(lines):
        if line[name] not in place:
            known = ", ".join(value or "nothing" for value in values)
            raise InputError(f"{_line(where, number)} is damaged: {name} is {line[name]!r:.60}; it must be {known}")
    return np.array([place[line[name]] for line in lines], np.int64)


def _switches(path: str) -> int:
    """How often the policy changes in a path such as ``"3; 3; 5"``."""
    steps = path.split("; ")
    return sum(before != after for before, after in pairwise(steps))


def packed_columns(columns: RaceColumns) -> dict[str, Any]:
    """Return the races as plain values for the page's JSON: leads to a millimetre, other lengths and times
    to a hundredth, the rest exactly.

    Parameters
    ----------
    columns : RaceColumns
    """
    whole = {
        "ego": columns.agents.places[0],
        "opponent": columns.agents.places[1],
        "track": columns.track.places,
        "preset": columns.preset.places,
        "seed": columns.seed.places,
        "race": columns.race,
        "side": columns.side,
        "winner": columns.winner,
        "crash": columns.crash,
        "fault": columns.fault,
    }
    for name in ("overtakes", "variants", "switches"):
        for car in range(2):
            whole[f"{name}{car}"] = getattr(columns, name)[car]
    for car in range(2):
        whole[f"moves{car}"] = columns.moves.places[car]
    # Differences make the long runs of equal values, and numbers that count up, one character each.
    return {
        "length": len(columns),
        "agents": list(columns.agents.words),
        "tracks": list(columns.track.words),
        "presets": list(columns.preset.words),
        "seeds": list(columns.seed.words),
        "moves": list(columns.moves.words),
        "columns": {
            **{name: pack(values, 1, [0]) for name, values in whole.items()},
            "start_s": pack(columns.start_s, 100, [0]),
            "lead": pack(columns.lead, 1000),
            "duration": pack(np.nan_to_num(columns.duration, nan=-1.0), 100, [0]),
        },
    }
