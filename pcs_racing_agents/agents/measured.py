"""Measured strength of the agents and cost of their decisions, written by ``benchmarks/zoo.py``.

The table is a file of the package, ``measured.csv``. A line is valid for an agent with the same hash
(:func:`pcs_racing_agents.agents.agent.competitor_hash`).
"""

import csv
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pcs_racing.base.errors import InputError

AGAINST = "against "
TEXTS = ("archive", "race", "agent", "sha256", "tracks")
NUMBERS = ("races", "score", "rating", "rating_low", "rating_high", "own_crash", "one_us", "many_us")


class Measured(NamedTuple):
    """Measured strength and cost of an agent."""

    archive: str  #: ``archive``, ``race``, ``agent``: The game, and the agent's name.
    race: str
    agent: str
    sha256: str  #: The agent's hash.
    tracks: str  #: Circuits, separated by ``", "``.
    races: float  #: Number of its races.
    score: float  #: Races won, a tie counting half, mean over the opponents.
    #: ``rating``, ``rating_low``, ``rating_high``: Bradley-Terry rating among all measured agents, and its 95 %
    #: interval; NaN if it can't be estimated.
    rating: float
    rating_low: float
    rating_high: float
    own_crash: float  #: Share of its races that ended in a crash by its fault.
    #: ``one_us``, ``many_us``: Microseconds of a decision for a single observation, and for each of 1,000 at once; of a
    #: driver, which decides by planning ten times a second, those of a plan with 0.1 s of simulation. NaN where it was
    #: not measured.
    one_us: float
    many_us: float
    against: dict[str, float]  #: Score against each of the opponents, by name.


def measured(archive: str, race: str, agent: str, sha256: str) -> Measured | None:
    """Return the measurement of an agent; None if there is none, or if the agent has changed since."""
    measurement = measurements().get((archive, race, agent))
    return measurement if measurement is not None and measurement.sha256 == sha256 else None


@lru_cache(maxsize=1)
def measurements() -> dict[tuple[str, str, str], Measured]:
    """Return all measurements, by archive, race and agent."""
    path = measured_file()
    if not path.is_file():
        return {}
    table = {}
    try:
        with open(path, newline="", encoding="utf-8") as file:
            for row in csv.DictReader(file):
                values: dict[str, Any] = {name: row[name] for name in TEXTS}
                values.update({name: float(row[name]) if row[name] else np.nan for name in NUMBERS})
                scores = {
                    name.removeprefix(AGAINST): float(value)
                    for name, value in row.items()
                    if name.startswith(AGAINST) and value
                }
                measurement = Measured(**values, against=scores)
                table[measurement.archive, measurement.race, measurement.agent] = measurement
    except (KeyError, ValueError, TypeError) as error:
        raise InputError(f"{path} is damaged ({error}); python benchmarks/zoo.py --write makes it again") from None
    return table


def measured_file() -> Path:
    """Path of the table."""
    return Path(__file__).resolve().parent / "measured.csv"
