"""Zoo: agents, and fixed policies, which make no moves."""

from importlib import import_module
from typing import Any

_PLACES = {
    "agent": "Agent Competitor Driver Strategy as_agent",
    "game_spec": "GameSpec make_game_spec",
    "zoo": "Entry make names parse_agent register_agent",
}
_FILES = {name: file for file, names in _PLACES.items() for name in names.split()}
__all__ = sorted(_FILES)


def __getattr__(name: str) -> Any:
    """Import a public name on access; ``__init__.pyi`` has the types."""
    if name not in _FILES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"pcs_racing_agents.agents.{_FILES[name]}"), name)
