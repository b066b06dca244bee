"""The races of a results file as columns: checked line by line, and packed for a page that lists them."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.errors import InputError
from pcs_racing.base.packing import pack
from pcs_racing_agents.tournament.result_lines import Labels, ResultLines

__all__ = ["RaceColumns", "packed_columns", "race_columns"]

WINNERS = ("", "ego", "opponent")
CRASHES = ("", "wall", "car")
FAULTS = ("", "ego", "opponent", "both")
NEEDED = ("ego", "opponent", "track", "race", "start_s", "side", "seed", "lead", "winner", "crash", "fault")
LONGEST_TEXT = 300
MOST_RACES = 2_000_000

Floats = NDArray[np.float64]
Counts = NDArray[np.int32]


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
    side, winner, crash, fault : ndarray, shape (N,), int32
        Side of the ego; places in ``WINNERS``, ``CRASHES`` and ``FAULTS``.
    overtakes, variants, switches : ndarray, shape (2, N), int32
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


def race_columns(lines: ResultLines) -> RaceColumns:
    """Return the races that a results file holds.

    Parameters
    ----------
    lines : ResultLines
        Columns that only tell details may be missing.

    Raises
    ------
    InputError
        If there are no races or too many, a column is missing, or a line is damaged: the first that says what is wrong
        is named.
    """
    if not len(lines):
        raise InputError(f"{lines.where} holds no races")
    if len(lines) > MOST_RACES:
        raise InputError(f"{lines.where} holds {len(lines)} races; a page lists at most {MOST_RACES}")
    there = lines.columns
    missing = [name for name in NEEDED if name not in there]
    if missing:
        raise InputError(f"{lines.where} has no column {missing[0]!r}; it must be a results.csv of races")
    nothing = Labels(("",), np.zeros(len(lines), np.uint8))

    def words(*names: str) -> Labels:
        for name in names:
            for word in there.get(name, nothing).words:
                if len(word) > LONGEST_TEXT:
                    raise lines.damaged(name, word, f"{len(word)} characters long")
        return _joined([there.get(name, nothing) for name in names])

    def numbers(name: str, low: float, high: float, otherwise: float | None = None) -> Floats:
        if otherwise is not None and name not in there:
            return np.full(len(lines), otherwise)
        values = np.array([_number(word) for word in there[name].words])
        wrong = np.flatnonzero(~((values >= low) & (values <= high)))  # NaN is wrong, too
        if wrong.size:
            word = there[name].words[wrong[0]]
            raise lines.damaged(name, word, f"{word!r:.60}; it must be a number from {low:g} to {high:g}")
        return values[there[name].places]

    def choice(name: str, values: tuple[str, ...]) -> Counts:
        for word in there[name].words:
            if word not in values:
                known = ", ".join(value or "nothing" for value in values)
                raise lines.damaged(name, word, f"{word!r:.60}; it must be {known}")
        return np.array([values.index(word) for word in there[name].words], np.int32)[there[name].places]

    def both(name: str, high: float) -> Counts:
        return np.array([numbers(f"{car}_{name}", 0, high, otherwise=0) for car in ("ego", "opponent")], np.int32)

    def switches(name: str) -> Counts:
        paths = there.get(name, nothing)
        return np.array([_switches(path) for path in paths.words], np.int32)[paths.places]

    return RaceColumns(
        agents=words("ego", "opponent"),
        track=words("track"),
        preset=words("preset"),
        moves=words("ego_moves", "opponent_moves"),
        race=numbers("race", 0, 2**31 - 1).astype(np.int32),
        seed=words("seed"),
        start_s=numbers("start_s", -1e6, 1e6),
        lead=numbers("lead", -1e6, 1e6),
        duration=numbers("duration", 0.0, 1e6, otherwise=math.nan),
        side=numbers("side", 0, 1).astype(np.int32),
        winner=choice("winner", WINNERS),
        crash=choice("crash", CRASHES),
        fault=choice("fault", FAULTS),
        overtakes=both("overtakes", 1e6),
        variants=both("variant", 1e6),
        switches=np.array([switches(f"{car}_path") for car in ("ego", "opponent")]),
    )


def _joined(columns: Sequence[Labels]) -> Labels:
    """One column as it is, shape (N,); several with the words of all of them, shape (C, N)."""
    if len(columns) == 1:
        return Labels(columns[0].words, columns[0].places.astype(np.int32))
    words: dict[str, int] = {}
    places = [
        np.array([words.setdefault(word, len(words)) for word in column.words], np.int32)[column.places]
        for column in columns
    ]
    return Labels(tuple(words), np.array(places))


def _number(word: str) -> float:
    try:
        return float(word)
    except ValueError:
        return math.nan


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
