from pcs_racing_agents.agents.agent import Agent as Agent
from pcs_racing_agents.agents.agent import Competitor as Competitor
from pcs_racing_agents.agents.agent import Driver as Driver
from pcs_racing_agents.agents.agent import Strategy as Strategy
from pcs_racing_agents.agents.agent import as_agent as as_agent
from pcs_racing_agents.agents.game_spec import GameSpec as GameSpec
from pcs_racing_agents.agents.game_spec import make_game_spec as make_game_spec
from pcs_racing_agents.agents.zoo import Entry as Entry
from pcs_racing_agents.agents.zoo import make as make
from pcs_racing_agents.agents.zoo import names as names
from pcs_racing_agents.agents.zoo import parse_agent as parse_agent
from pcs_racing_agents.agents.zoo import register_agent as register_agent

__all__ = [
    "Agent",
    "Competitor",
    "Driver",
    "Entry",
    "GameSpec",
    "Strategy",
    "as_agent",
    "make",
    "make_game_spec",
    "names",
    "parse_agent",
    "register_agent",
]
