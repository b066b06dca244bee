"""Folders of networks and of network sets as agents."""

from pathlib import Path

from pcs_racing.base.artifacts import MANIFEST
from pcs_racing.base.errors import InputError
from pcs_racing.game.archive_files import ARCHIVE_FORMAT
from pcs_racing.game.players import Competitor
from pcs_racing.planners.learned import folder_format
from pcs_racing.planners.racers import Reader, Request, renamed
from pcs_racing_agents.agents.game_spec import GameSpec, make_game_spec
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
    is_set = bool(request.text) and (folder / SET_FILE).is_file()
    if not is_set and not (request.text and (folder / MANIFEST).is_file()):
        return None
    first = "" if is_set else folder_format(folder)
    if first == f"format: pcs-racing {ARCHIVE_FORMAT.noun}":
        raise InputError(f"{folder} is an archive of policies; name one, as in '{folder}[0]'")
    if not is_set and first != f"format: pcs-racing {NETWORK_FORMAT.noun}":
        raise InputError(
            f"{folder}/{MANIFEST} begins with {first!r:.80}; it is no racer's manifest"
        )
    rules = request.rules
    spec = rules if isinstance(rules, GameSpec) else make_game_spec(rules.archive, rules.config)
    if is_set:
        made = build("self-play", spec, seed=request.seed, networks=load_network_set(folder))
        return renamed(made, request.text)
    network = load_network(folder)
    if network.target not in AGENT_OF:
        raise InputError(f"{folder} approximates {network.target!r}, which no agent decides by")
    made = build(AGENT_OF[network.target], spec, seed=request.seed, network=network)
    return renamed(made, request.text)


FOLDERS = Reader(read_folder)
