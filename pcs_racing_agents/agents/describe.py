"""What an agent of the zoo is, what it learned from, how strong it is and what it costs, as text."""

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

__all__ = ["describe", "facts_of", "microseconds", "option_meanings", "rating_text"]

NEEDS = {
    "": "nothing",
    "fit": "a fit to training races, the file `ARCHIVE-RACE-{name}.yaml` or `fit=FILE`",
    "network": "the network `ARCHIVE-RACE-{kind}`, or `network=FOLDER`",
    "agents": "what its member agents need",
}


def option_meanings(function: Callable[..., Any]) -> dict[str, str]:
    """Return what a function's docstring says of its parameters, by name."""
    text = inspect.getdoc(function) or ""
    _, _, rest = text.partition("Parameters\n----------\n")
    found: dict[str, str] = {}
    names: list[str] = []
    for line in rest.splitlines():
        if re.fullmatch(r"-+", line):
            break
        if line and not line.startswith(" "):
            names = [name.strip() for name in line.partition(" : ")[0].split(",")]
            found |= dict.fromkeys(names, "")
        else:
            for name in names:
                found[name] = f"{found[name]} {line.strip()}".strip()
    return {name: _plain(meaning) for name, meaning in found.items() if meaning}


def describe(name: str, entry: Entry) -> str:
    """Return what an agent or driver is and takes, in Markdown."""
    summary = f"{entry.summary[0].upper()}{entry.summary[1:]}."
    needs = NEEDS[entry.needs].format(name=name, kind=options(name).get("kind", ""))
    lines = [f"### `{name}`", "", summary, ""]
    if entry.source:
        lines.append(f"- Source: {entry.source}.")
    lines.append(f"- Needs {needs}.")
    meanings = option_meanings(entry.build)
    for key, default in options(name).items():
        if key not in ("kind", "planner"):
            lines.append(f"- Option `{key}`, by default `{default}`. {meanings.get(key, '')}".rstrip())
    return "\n".join(lines)


def facts_of(name: str, setting: Setting) -> list[str]:
    """Return what an agent has learned from, how strong it is, what it costs and its hash, in one game; a line each."""
    try:
        agent = build(name, setting)
    except UnknownNameError:
        return ["Not shipped for this game."]
    facts = dict(getattr(agent, "facts", {}))
    for known in ("does", "source", "weights sha256"):
        facts.pop(known, None)
    lines = [f"{key[0].upper()}{key[1:]}: {value}." for key, value in facts.items()]
    digest = competitor_hash(agent)
    found = measured(setting.archive.name, setting.race, name, digest)
    if found is None:
        lines.append("Strength and cost: not measured as it is.")
    else:
        against = ", ".join(f"{score:.3f} against {rival}" for rival, score in found.against.items())
        lines.append(
            f"Strength: score {found.score:.3f}, rating {rating_text(found)}, on {found.tracks} in {found.races:.0f} "
            f"races ({against}); own crashes {found.own_crash:.1%}."
        )
        lines.append(f"Cost: {_cost(found)}.")
    return [*lines, f"Hash: {digest[:16]}."]


def rating_text(one: Measured) -> str:
    """Return a rating with its interval."""
    if np.isnan(one.rating):
        return "unknown"
    interval = "" if np.isnan(one.rating_low) else f" [{one.rating_low:+.0f}, {one.rating_high:+.0f}]"
    return f"{one.rating:+.0f}{interval}"


def _cost(one: Measured) -> str:
    first, second = microseconds(one.one_us), microseconds(one.many_us)
    if second:
        return f"{first} us for one observation, {second} us for each of 1,000 at once"
    kind = "decision" if one.agent not in entries() or entries()[one.agent].moves else "plan with 0.1 s of simulation"
    return f"{first} us for a {kind}"


def microseconds(value: float) -> str:
    """Return a time as text; nothing for NaN."""
    return "" if np.isnan(value) else f"{value:,.0f}" if value >= 100.0 else f"{value:.3g}"


def _plain(text: str) -> str:
    """Sphinx roles as plain code."""
    return re.sub(r":\w+:`~?([^`]+)`", r"`\1`", text).replace("``", "`")
