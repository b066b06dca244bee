"""Unknown names on a command line, told before the code of what would race is imported, which takes a second."""

import os
from collections.abc import Sequence
from importlib.metadata import entry_points

from pcs_racing.base.errors import UnknownNameError, choices
from pcs_racing.planners.shipped import SHIPPED as PLANNERS
from pcs_racing.race.config import load_race_config
from pcs_racing.track.maps import find_shipped
from pcs_racing_agents.agents.shipped import SHIPPED as AGENTS

NAMING = {
    "race": {"--ego": "planner", "--opponent": "planner"},
    "tournament": {"--policies": "planner", "--agents": "agent"},
    "headroom": {"--policies": "planner"},
    "overtaking": {"--drivers": "planner"},
    "policies": {"": "planner"},
    "learn": {"--pool": "agent"},
    "best-reply": {"": "agent"},
    "explain": {"--agents": "agent"},
    "play": {"--opponent": "agent"},
}
"""What the words behind an option name, by command; "" stands for the words before all options."""


def check_command(word: str, commands: Sequence[str]) -> None:
    """Refuse a word that is no command."""
    if word not in commands and not word.startswith("-"):
        raise UnknownNameError(f"command {word!r} is unknown; {choices(word, commands)}")


def check_names(words: Sequence[str]) -> None:
    """Refuse names of planners, agents, circuits and rules that nobody knows; of paths and code nothing is asked."""
    kinds = {**NAMING.get(words[0], {}), "--track": "track", "--race": "race"}
    option = ""
    for word in words[1:]:
        if word.startswith("--"):
            option, _, word = word.partition("=")
        kind = kinds.get(option)
        name, colon, rest = word.partition(":")
        if not word or kind is None or os.path.exists(word) or os.sep in word or (kind == "race" and "." in word):
            continue
        if kind == "track":
            find_shipped(word)
        elif kind == "race":
            load_race_config(word)
        # A place with a colon may be code of one's own: module:function.
        elif not (name.endswith((".py", ".zip")) or (colon and rest.isidentifier()) or name.startswith("always-")):
            _check_racer(kind, name.strip())


def _check_racer(kind: str, name: str) -> None:
    groups = ("pcs_racing.planners", "pcs_racing.agents")
    known = {*PLANNERS, *AGENTS, *(point.name for group in groups for point in entry_points(group=group))}
    if name not in known:
        shown = sorted(PLANNERS if kind == "planner" else {*AGENTS, "always-MOVE"})
        raise UnknownNameError(f"{kind} {name!r} is unknown; {choices(name, shown)}")
