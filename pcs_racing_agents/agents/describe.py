"""Descriptions of the zoo's agents as text: options, training, strength, cost and hash.

Strength and cost were measured by ``dev/benchmarks/zoo.py``, which wrote ``measured.csv``. A line is valid for an agent
with the same hash (:func:`pcs_racing_agents.agents.agent.competitor_hash`).
"""

import inspect
import re
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pcs_racing.base.errors import InputError, UnknownNameError
from pcs_racing_agents.agents.agent import competitor_hash
from pcs_racing_agents.agents.game_spec import GameSpec
from pcs_racing_agents.agents.zoo import Entry, build, entries, options
from pcs_racing_agents.base.tables import read_csv

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
    # Read once for all agents: it is asked for with every one of them.
    path = measured_file()
    if not path.is_file():
        return {}
    table = {}
    try:
        for row in read_csv(path).rows():
            values: dict[str, Any] = {name: row[name] for name in TEXTS}
            values |= {name: float(row[name]) if row[name] else np.nan for name in NUMBERS}
            against = {name.removeprefix(AGAINST): value for name, value in row.items() if name.startswith(AGAINST)}
            scores = {name: float(value) for name, value in against.items() if value}
            table[row["archive"], row["race"], row["agent"]] = Measured(**values, against=scores)
    except (KeyError, ValueError, TypeError) as error:
        raise InputError(f"{path} is damaged ({error}); python dev/benchmarks/zoo.py --write makes it again") from None
    return table


def measured_file() -> Path:
    """Path of the table."""
    return Path(__file__).resolve().parents[1] / "data" / "measured.csv"


NEEDS = {
    "": "nothing",
    "fit": "a fit to training races, the file `ARCHIVE-RACE-{name}.yaml` or `fit=FILE`",
    "network": "the network `ARCHIVE-RACE-{kind}`, or `network=FOLDER`",
    "networks": "the network set `ARCHIVE-RACE-{kind}`, or `networks=FOLDER`",
}


NOT_SHIPPED = ["Not shipped for this game."]
"""What is told of an agent in a game for which nothing of it is shipped."""


def option_meanings(function: Callable[..., Any]) -> dict[str, str]:
    """Return what a function's docstring says of its parameters, by name."""
    text = inspect.getdoc(function) or ""
    _, _, rest = text.partition("Parameters\n----------\n")
    meanings: dict[str, str] = {}
    names: list[str] = []
    for line in rest.splitlines():
        if re.fullmatch(r"-+", line):
            break
        if line and not line.startswith(" "):
            names = [name.strip() for name in line.partition(" : ")[0].split(",")]
            meanings |= dict.fromkeys(names, "")
        else:
            for name in names:
                meanings[name] = f"{meanings[name]} {line.strip()}".strip()
    return {name: _plain(meaning) for name, meaning in meanings.items() if meaning}


def describe(name: str, entry: Entry) -> str:
    """Return what an agent or driver is and takes, in Markdown."""
    summary = f"{entry.summary[0].upper()}{entry.summary[1:]}."
    needs = NEEDS[entry.needs].format(name=name, kind=options(name).get("kind", ""))
    lines = [summary, ""]
    if entry.source:
        lines.append(f"- Source: {entry.source}.")
    lines.append(f"- Needs {needs}.")
    meanings = option_meanings(entry.build)
    for key, default in options(name).items():
        if key not in ("kind", "planner"):
            lines.append(f"- Option `{key}`, by default `{default}`. {meanings.get(key, '')}".rstrip())
    return "\n".join(lines)


def facts_of(name: str, spec: GameSpec) -> list[str]:
    """Return lines about an agent in one game: its training, strength, cost and hash."""
    try:
        agent = build(name, spec)
    except UnknownNameError:
        return NOT_SHIPPED
    facts = dict(getattr(agent, "facts", {}))
    for key in ("does", "source", "weights sha256"):
        facts.pop(key, None)
    lines = [f"{key[0].upper()}{key[1:]}: {value}." for key, value in facts.items()]
    digest = competitor_hash(agent)
    measurement = measured(spec.archive.name, spec.race, name, digest)
    if measurement is None:
        lines.append("Strength and cost: not measured as it is.")
    else:
        against = ", ".join(f"{score:.3f} against {rival}" for rival, score in measurement.against.items())
        lines.append(
            f"Strength: score {measurement.score:.3f}, rating {rating_text(measurement)}, on {measurement.tracks} in "
            f"{measurement.races:.0f} races ({against}); own crashes {measurement.own_crash:.1%}."
        )
        lines.append(f"Cost: {_cost(measurement)}.")
    return [*lines, f"Hash: {digest[:16]}."]


def rating_text(measurement: Measured) -> str:
    """Return a rating with its interval."""
    if np.isnan(measurement.rating):
        return "unknown"
    low, high = measurement.rating_low, measurement.rating_high
    return f"{measurement.rating:+.0f}" + ("" if np.isnan(low) else f" [{low:+.0f}, {high:+.0f}]")


def _cost(measurement: Measured) -> str:
    first, second = microseconds(measurement.one_us), microseconds(measurement.many_us)
    if second:
        return f"{first} us for one observation, {second} us for each of 1,000 at once"
    entry = entries().get(measurement.agent)
    return f"{first} us for a {'decision' if entry is None or entry.moves else 'plan with 0.1 s of simulation'}"


def microseconds(value: float) -> str:
    """Return a time as text; nothing for NaN."""
    return "" if np.isnan(value) else f"{value:,.0f}" if value >= 100.0 else f"{value:.3g}"


def _plain(text: str) -> str:
    """Sphinx roles as plain code."""
    return re.sub(r":\w+:`~?([^`]+)`", r"`\1`", text).replace("``", "`")
