"""Policies and agents for :mod:`pcs_racing`: planners, archives, strategies and tournaments.

``make(name)`` returns an agent; ``names()`` lists the names of all agents.
"""

from typing import Any


def __getattr__(name: str) -> Any:
    """Import the agents on access to a public name."""
    if name in ("Agent", "make", "names"):
        from pcs_racing_agents import agents

        return getattr(agents, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
