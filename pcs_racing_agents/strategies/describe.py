"""What the zoo says of itself: the sections of docs/agents.md, and the command ``pcs-racing agents``.

python -m pcs_racing_agents.strategies.describe docs/agents.md     # writes the sections again
"""

import inspect
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from pcs_racing_agents.strategies.zoo import ZOO, Entry, options

__all__ = ["MARK", "describe", "option_meanings", "write_sections", "zoo_sections"]

MARK = "<!-- What follows is written by `python -m pcs_racing_agents.strategies.describe docs/agents.md`. -->"

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


def write_sections(page: Path) -> None:
    """Write the sections into a page, in the place of all that follows the mark."""
    before, mark, _ = page.read_text(encoding="utf-8").partition(MARK)
    page.write_text(f"{before}{mark}\n\n{zoo_sections()}\n", encoding="utf-8")


def _plain(text: str) -> str:
    """Sphinx roles as plain code."""
    return re.sub(r":\w+:`~?([^`]+)`", r"`\1`", text).replace("``", "`")


if __name__ == "__main__":
    write_sections(Path(sys.argv[1]))
