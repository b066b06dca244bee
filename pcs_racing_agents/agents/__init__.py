"""The zoo: everything that answers ``predict(observation)``, and the drivers that make no moves."""

from pcs_racing_agents.agents.agent import Agent, Competitor, Decider, Driver, Strategy, as_competitor
from pcs_racing_agents.agents.setting import Setting, make_setting
from pcs_racing_agents.agents.zoo import Entry, make, names, parse_agent, register_agent

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
