"""Policies and agents for :mod:`pcs_racing`: motion planners, archives, strategies and tournaments.

``make(name)`` makes one of the agents that ``names()`` lists.
"""

from pathlib import Path
from typing import Any

from pcs_racing.base.code_cache import forget_stale_code
from pcs_racing.game.competitor_names import register_competitors
from pcs_racing.planners.registry import register_planner

forget_stale_code(Path(__file__).parent)

register_planner("pcs_racing_agents.networks.driver:PPO_DRIVE", name="ppo-drive")
register_competitors("zoo", "pcs_racing_agents.agents.opponents")


def __getattr__(name: str) -> Any:
    """Import the zoo when somebody asks for an agent."""
    if name in ("make", "names"):
        from pcs_racing_agents.agents import zoo

        return getattr(zoo, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
