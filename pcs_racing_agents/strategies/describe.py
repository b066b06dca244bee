"""What the zoo says of itself: the sections of docs/agents.md, and the command ``pcs-racing agents``."""

import inspect
import re
from collections.abc import Callable
from typing import Any

from pcs_racing_agents.strategies.zoo import ZOO, Entry, options

__all__ = ["describe", "option_meanings", "zoo_sections"]

NEEDS = {
    "": "nothing",
    "fit": "a choice made on training races, the file `ARCHIVE-RACE-{name}.yaml` or `fit=FILE`",
    "network": "the network `ARCHIVE-RACE-{kind}`, or `network=FOLDER`",
    "agents": "what the agents need that it is made of",
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
    """Return the section of an agent or driver in Markdown."""
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


def zoo_sections() -> str:
    """Return the sections of everything that this package brings."""
    agents = [describe(name, entry) for name, entry in ZOO.items() if entry.moves]
    drivers = [describe(name, entry) for name, entry in ZOO.items() if not entry.moves]
    return "\n\n".join(["## Agents", *agents, "## Drivers", *drivers])


def _plain(text: str) -> str:
    """Sphinx roles as plain code."""
    return re.sub(r":\w+:`~?([^`]+)`", r"`\1`", text).replace("``", "`")
