from pcs_racing_agents.agents.agent import Agent as Agent
from pcs_racing_agents.agents.agent import Competitor as Competitor
from pcs_racing_agents.agents.agent import Decider as Decider
from pcs_racing_agents.agents.agent import Driver as Driver
from pcs_racing_agents.agents.agent import Strategy as Strategy
from pcs_racing_agents.agents.agent import as_competitor as as_competitor
from pcs_racing_agents.agents.setting import Setting as Setting
from pcs_racing_agents.agents.setting import make_setting as make_setting
from pcs_racing_agents.agents.zoo import Entry as Entry
from pcs_racing_agents.agents.zoo import make as make
from pcs_racing_agents.agents.zoo import names as names
from pcs_racing_agents.agents.zoo import parse_agent as parse_agent
from pcs_racing_agents.agents.zoo import register_agent as register_agent

__all__ = [
    "Agent",
    "Competitor",
    "Decider",
    "Driver",
    "Entry",
    "Setting",
    "Strategy",
    "as_competitor",
    "make",
    "make_setting",
    "names",
    "parse_agent",
    "register_agent",
]
