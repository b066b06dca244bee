"""Zoo as opponents in environments; :mod:`pcs_racing` finds this module by its registry."""

from pcs_racing.game.archive import PolicyArchive
from pcs_racing.game.config import GameConfig
from pcs_racing_agents.agents.agent import Competitor
from pcs_racing_agents.agents.game_spec import make_game_spec
from pcs_racing_agents.agents.zoo import names as names
from pcs_racing_agents.agents.zoo import parse_agent


def make(text: str, archive: PolicyArchive, config: GameConfig) -> Competitor:
    """Make an agent or a fixed policy from its name.

    Options may follow the name, as in ``"cfr-argmax:network=NAME"``.
    """
    return parse_agent(text, make_game_spec(archive, config))
