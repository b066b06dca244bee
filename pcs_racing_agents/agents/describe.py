"""Descriptions of the zoo's agents as text: options, training, strength, cost and hash."""

import inspect
import re
from collections.abc import Callable
from typing import Any

import numpy as np

from pcs_racing.base.errors import UnknownNameError
from pcs_racing_agents.agents.agent import competitor_hash
from pcs_racing_agents.agents.measured import Measured, measured
from pcs_racing_agents.agents.setting import Setting
from pcs_racing_agents.agents.zoo import Entry, build, entries, options

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


def facts_of(name: str, setting: Setting) -> list[str]:
    """Return lines about an agent in one game: its training, strength, cost and hash."""
    try:
        agent = build(name, setting)
    except UnknownNameError:
        return NOT_SHIPPED
    facts = dict(getattr(agent, "facts", {}))
    for key in ("does", "source", "weights sha256"):
        facts.pop(key, None)
    lines = [f"{key[0].upper()}{key[1:]}: {value}." for key, value in facts.items()]
    digest = competitor_hash(agent)
    measurement = measured(setting.archive.name, setting.race, name, digest)
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
