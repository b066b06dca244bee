"""The zoo as opponents of the environments of :mod:`pcs_racing`, which finds this module by its registry."""

from pcs_racing.game.archive import PolicyArchive
from pcs_racing.game.config import GameConfig
from pcs_racing_agents.agents import zoo
from pcs_racing_agents.agents.agent import Competitor
from pcs_racing_agents.agents.setting import make_setting


def names(archive: PolicyArchive, config: GameConfig) -> list[str]:
    """Return the names of all agents and drivers for a game."""
    return zoo.names(archive, config)


def make(text: str, archive: PolicyArchive, config: GameConfig) -> Competitor:
    """Make an agent or a driver from its name, which may be followed by options as in ``"cfr-argmax:network=NAME"``."""
    return zoo.parse_agent(text, make_setting(archive, config))
