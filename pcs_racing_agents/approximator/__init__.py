"""The regret approximator: training rows, the network, and how it is trained and judged."""

from pcs_racing_agents.approximator.network import GameIdentity, RegretNetwork, game_identity
from pcs_racing_agents.approximator.network_files import list_networks, load_network
from pcs_racing_agents.approximator.rows import Rows, join_rows

__all__ = ["GameIdentity", "RegretNetwork", "Rows", "game_identity", "join_rows", "list_networks", "load_network"]
