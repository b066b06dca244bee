"""Folders of networks and of network sets as agents."""

from pathlib import Path
from typing import Any

from pcs_racing.base.errors import InputError
from pcs_racing.game.archive_files import ARCHIVE_FORMAT
from pcs_racing.game.players import Competitor
from pcs_racing.planners.learned import LOADERS, folder_kind, wrong_kind
from pcs_racing.planners.racers import Reader, Request, renamed
from pcs_racing_agents.agents.zoo import build
from pcs_racing_agents.networks.network_files import (
    NETWORK_FORMAT,
    SET_FILE,
    load_network,
    load_network_set,
)

AGENT_OF = {"regret": "cfr-argmax", "nash": "nash", "advantage": "response", "ppo": "ppo"}
"""Agent of a network, by the quantity that the network approximates."""


def read_folder(request: Request) -> Competitor | None:
    """Return the agent of a folder: the usual agent of its network, or of its network set."""
    folder = Path(request.text)
    kind = folder_kind(folder) if request.text else ""
    if kind == ARCHIVE_FORMAT.noun:
        raise InputError(f"{folder} is an archive of policies; name one, as in '{folder}[0]'")
    if kind == NETWORK_FORMAT.noun:
        network = load_network(folder)
        if network.target not in AGENT_OF:
            raise InputError(f"{folder} approximates {network.target!r}, which no agent decides by")
        options: dict[str, Any] = {"network": network}
        name = AGENT_OF[network.target]
    elif request.text and (folder / SET_FILE).is_file():
        name, options = "self-play", {"networks": load_network_set(folder)}
    elif kind:
        raise wrong_kind(folder, kind, (*LOADERS, NETWORK_FORMAT.noun))
    else:
        return None
    return renamed(build(name, request.asked_game, seed=request.seed, **options), request.text)


FOLDERS = Reader(read_folder)
