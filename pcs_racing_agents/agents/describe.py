"""Descriptions of the zoo's agents as text: options, training, strength, cost and hash.

``dev/benchmarks/zoo.py`` measures strength and cost and writes ``measured.csv``. A line is valid
for an agent with the same hash (:func:`pcs_racing_agents.agents.agent.competitor_hash`).
"""

import inspect
import re
from collections.abc import Callable
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pcs_racing.base.errors import UnknownNameError
from pcs_racing.game.make import make_game
from pcs_racing.game.rules import RaceGame
from pcs_racing_agents.agents.agent import competitor_hash
from pcs_racing_agents.agents.zoo import Entry, build, entries, options
from pcs_racing_agents.base.tables import read_csv

AGAINST = "against "


class Measured(NamedTuple):
    """Measured strength and cost of an agent."""

    #: ``archive``, ``rules``, ``agent``: Archive and rules of the game, and name of the agent.
    archive: str
    rules: str
    agent: str
    sha256: str  #: Hash of the agent.
    tracks: str  #: Tracks, separated by ``", "``.
    races: float  #: Number of races.
    score: float  #: Share of races won, mean over the opponents; a tie counts half.
    #: ``rating``, ``rating_low``, ``rating_high``: Bradley-Terry rating among all measured agents
    #: with its 95 % interval; NaN if it can't be estimated.
    rating: float
    rating_low: float
    rating_high: float
    own_crash: float  #: Share of races with a crash by the agent's fault.
    #: ``one_us``, ``many_us``: Microseconds per decision for a single observation, and for each of
    #: 1,000 at once. For a fixed policy, which decides by planning ten times a second: microseconds
    #: per plan with 0.1 s of simulation. NaN if not measured.
    one_us: float
    many_us: float
    against: dict[str, float]  #: Score against each opponent, by name.


TEXTS, NUMBERS = Measured._fields[:5], Measured._fields[5:-1]
"""Columns of the table, before the scores against each opponent."""


@lru_cache(maxsize=1)
def measurements() -> dict[tuple[str, str, str], Measured]:
    """Return all measurements, by archive, rules and agent."""
    # Read the file once for all agents: the description of each agent needs the table.
    path = measured_file()
    if not path.is_file():
        return {}
    table = {}
    for row in read_csv(path).rows():
        values: dict[str, Any] = {name: row[name] for name in TEXTS}
        values |= {name: float(row[name]) if row[name] else np.nan for name in NUMBERS}
        against = {
            name.removeprefix(AGAINST): value
            for name, value in row.items()
            if name.startswith(AGAINST)
        }
        scores = {name: float(value) for name, value in against.items() if value}
        table[row["archive"], row["rules"], row["agent"]] = Measured(**values, against=scores)
    return table


def measured_file() -> Path:
    """Return the path of the table."""
    return Path(__file__).resolve().parents[1] / "data" / "measured.csv"


NEEDS = {
    "": "nothing",
    "fit": "a fit to training races, the file `ARCHIVE-RULES-{name}.yaml` or `fit=FILE`",
    "network": "the network `ARCHIVE-RULES-{kind}`, or `network=FOLDER`",
    "networks": "the network set `ARCHIVE-RULES-{kind}`, or `networks=FOLDER`",
}


SHIPPED_GAMES = (("default", "paper"), ("contest", "contest"))
"""Archives and rules of the shipped agents."""

NOT_SHIPPED = ["Not shipped for this game."]
"""Facts about an agent that is not shipped for a game."""


def shipped_words(name: str) -> str:
    """Return the rules of a shipped trained agent, in brackets; empty for other agents."""
    rules = []
    for archive, race in SHIPPED_GAMES if entries()[name].needs else ():
        with suppress(UnknownNameError):
            build(name, make_game(None, archive, race))
            rules.append(race)
    return f" (ships for {' and '.join(rules)})" if rules else ""


def option_meanings(function: Callable[..., Any]) -> dict[str, str]:
    """Return the descriptions of a function's parameters by name, from its docstring."""
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
    """Return a description of an agent or fixed policy with its options, in Markdown."""
    summary = f"{entry.summary[0].upper()}{entry.summary[1:]}."
    needs = NEEDS[entry.needs].format(name=name, kind=options(name).get("kind", ""))
    lines = [summary, ""]
    if entry.source:
        lines.append(f"- Source: {entry.source}.")
    lines.append(f"- Needs {needs}.")
    meanings = option_meanings(entry.build)
    for key, default in options(name).items():
        if key not in ("kind", "planner"):
            lines.append(
                f"- Option `{key}`, by default `{default}`. {meanings.get(key, '')}".rstrip()
            )
    return "\n".join(lines)


def facts_of(name: str, spec: RaceGame) -> list[str]:
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
    measurement = measurements().get((spec.archive.name, spec.rules.name, name))
    if measurement is None or measurement.sha256 != digest:
        lines.append("Strength and cost: not measured as it is.")
    else:
        against = ", ".join(
            f"{score:.3f} against {rival}" for rival, score in measurement.against.items()
        )
        lines.append(
            f"Strength: score {measurement.score:.3f}, rating {rating_text(measurement)}, on"
            f" {measurement.tracks} in {measurement.races:.0f} races ({against}); own crashes"
            f" {measurement.own_crash:.1%}."
        )
        lines.append(f"Cost: {_cost(measurement)}.")
    return [*lines, f"Hash: {digest[:16]}."]


def rating_text(measurement: Measured) -> str:
    """Return a rating with its interval as text."""
    if np.isnan(measurement.rating):
        return "unknown"
    low, high = measurement.rating_low, measurement.rating_high
    return f"{measurement.rating:+.0f}" + ("" if np.isnan(low) else f" [{low:+.0f}, {high:+.0f}]")


def _cost(measurement: Measured) -> str:
    first, second = microseconds(measurement.one_us), microseconds(measurement.many_us)
    if second:
        return f"{first} us for one observation, {second} us for each of 1,000 at once"
    entry = entries().get(measurement.agent)
    return (
        f"{first} us for a"
        f" {'decision' if entry is None or entry.moves else 'plan with 0.1 s of simulation'}"
    )


def microseconds(value: float) -> str:
    """Return a time as text; empty for NaN."""
    return "" if np.isnan(value) else f"{value:,.0f}" if value >= 100.0 else f"{value:.3g}"


def _plain(text: str) -> str:
    """Return a text with plain code in place of Sphinx roles."""
    return re.sub(r":\w+:`~?([^`]+)`", r"`\1`", text).replace("``", "`")
