"""Policies and agents for :mod:`pcs_racing`: planners, archives, strategies and tournaments.

``make(name)`` returns an agent; ``names()`` lists the names of all agents.
"""

from typing import Any

from pcs_racing.game.competitor_collections import register_competitors

register_competitors("zoo", "pcs_racing_agents.agents.opponents")


def __getattr__(name: str) -> Any:
    """Import the zoo on access to ``make`` or ``names``."""
    if name in ("make", "names"):
        from pcs_racing_agents.agents import zoo

        return getattr(zoo, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
