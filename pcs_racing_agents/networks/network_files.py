"""Networks and sets of networks as folders.

The folder of a network holds ``weights.safetensors`` and a manifest. A set stores a mixture of
learned strategies: a folder with a folder for each network and ``set.yaml``, with the name and the
probability of each network.
"""

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.artifacts import ArtifactFormat
from pcs_racing.base.dense import layers_from_bytes, layers_to_bytes
from pcs_racing.base.errors import InputError, check_array, check_facts, check_names, check_text
from pcs_racing.base.files import shipped_folder, write_together
from pcs_racing.game.identity import (
    GameIdentity,
    check_same_game,
    plain_identity,
    read_identity,
)
from pcs_racing_agents.base.fingerprint import fingerprint
from pcs_racing_agents.networks.network import RegretNetwork

_SCALING = ("input.mean", "input.scale")

NETWORK_FORMAT = ArtifactFormat(
    "network",
    (
        *("name", "target", "clipped", "hidden", *GameIdentity._fields[:-1]),
        *("training", "weights_sha256"),
    ),
    "save_network",
    data_file="weights.safetensors",
    digest_key="weights_sha256",
    max_bytes=32_000_000,
    shipped=shipped_folder(Path(__file__).resolve().parents[1], "networks"),
)


def save_network(network: RegretNetwork, folder: str | Path) -> Path:
    """Write a network into a folder, made if missing; return the folder."""
    return NETWORK_FORMAT.save(folder, *_content(network))


def _content(network: RegretNetwork) -> tuple[dict[str, Any], bytes]:
    """Return the fields of a network's manifest, and its weights."""
    fields = {
        "name": network.name,
        "target": network.target,
        "clipped": network.clipped,
        "hidden": list(network.hidden),
        # The number of decisions follows from the elements.
        **plain_identity(network.identity._replace(decisions=0)),
        "training": dict(network.training),
    }
    return fields, network_to_bytes(network)


def network_to_bytes(network: RegretNetwork) -> bytes:
    """Return layers and scaling of a network as the content of a safetensors file."""
    scaling = dict(zip(_SCALING, (network.mean, network.scale), strict=True))
    return layers_to_bytes(network.layers, scaling)


def weights_from_bytes(file: Path, content: bytes, hidden: Any) -> dict[str, Any]:
    """Return the fields of a network in the output of :func:`network_to_bytes`, by name.

    ``hidden`` lists the widths of the hidden layers; ``file`` is for messages.
    """
    layers, scaling = layers_from_bytes(file, content, hidden, _SCALING)
    mean, scale = (scaling[key] for key in _SCALING)
    return {"layers": layers, "mean": mean, "scale": scale}


def list_networks() -> list[str]:
    """Return the names of the shipped networks, sorted."""
    return NETWORK_FORMAT.shipped_names()


def load_network(source: str | os.PathLike[str] | RegretNetwork) -> RegretNetwork:
    """Return a network by shipped name or folder; a network is returned unchanged."""
    if isinstance(source, RegretNetwork):
        return source
    folder = NETWORK_FORMAT.find(source)
    fields, content = NETWORK_FORMAT.load(folder)
    file = folder / NETWORK_FORMAT.data_file
    weights = weights_from_bytes(file, content, fields["hidden"])
    try:
        return RegretNetwork(
            name=fields["name"],
            identity=read_identity(fields),
            target=fields["target"],
            clipped=fields["clipped"],
            **weights,
            training=fields["training"],
        )
    except InputError as error:
        raise type(error)(f"{folder}: {error}") from None


SET_FILE = "set.yaml"
SET_FORMAT = ArtifactFormat(
    "network set",
    ("name", "decision", "weights", "networks", "digests", "training"),
    "save_network_set",
    shipped=NETWORK_FORMAT.shipped,
    manifest_file=SET_FILE,
)
MAX_NETWORKS = 64
"""Maximum number of networks in a set."""


def check_weights(name: str, values: ArrayLike, count: int) -> NDArray[np.float64]:
    """Return ``count`` frequencies, in any unit, as an array, or raise an error."""
    weights = check_array(name, values, (count,))
    if (weights < 0.0).any() or not weights.any():
        raise InputError(
            f"{name} are {values!r:.80}; they must be 0 or above, and not all of them 0"
        )
    return weights


@dataclass(frozen=True, eq=False)
class NetworkSet:
    """Networks of one game; one network is drawn for each played game."""

    name: str
    networks: tuple[RegretNetwork, ...]
    weights: NDArray[np.float64]  #: shape (C,): Probability of each network; the sum is 1.
    #: Rule from a network's values to moves
    #: (:data:`pcs_racing_agents.agents.from_network.DECISIONS`).
    decision: str
    #: Facts about the origin of the set: texts and numbers by name.
    training: Mapping[str, str | int | float | bool] = field(default_factory=dict)

    def __post_init__(self) -> None:
        where = f"network set {check_text('the name of a network set', self.name)!r}"
        check_text(f"{where}: decision", self.decision)
        object.__setattr__(self, "networks", tuple(self.networks))
        object.__setattr__(self, "training", check_facts(f"{where}: training", self.training))
        if not 1 <= len(self.networks) <= MAX_NETWORKS:
            raise InputError(f"{where} has {len(self.networks)} networks; give 1 to {MAX_NETWORKS}")
        weights = check_weights(f"{where}: weights", self.weights, len(self.networks))
        object.__setattr__(self, "weights", weights / weights.sum())
        for network in self.networks[1:]:
            check_same_game(
                network.identity, self.identity, f"{where}: network {network.name!r}", "the first"
            )

    @property
    def identity(self) -> GameIdentity:
        """Game that the networks were made for."""
        return self.networks[0].identity


def save_network_set(networks: NetworkSet, folder: str | Path) -> Path:
    """Write a set into a folder, made if missing; return the folder."""
    folder = Path(folder)
    members = {f"{i:02d}": network for i, network in enumerate(networks.networks)}
    files = {
        f"{name}/{file}": data
        for name, network in members.items()
        for file, data in NETWORK_FORMAT.files(*_content(network)).items()
    }
    fields = {
        "name": networks.name,
        "decision": networks.decision,
        "weights": [float(weight) for weight in networks.weights],
        "networks": list(members),
        "digests": [fingerprint(network.layers) for network in networks.networks],
        "training": dict(networks.training),
    }
    write_together(folder, {**files, SET_FILE: SET_FORMAT.text(fields)})
    return folder


def list_network_sets() -> list[str]:
    """Return the names of the shipped sets, sorted."""
    return SET_FORMAT.shipped_names()


def load_network_set(source: str | os.PathLike[str] | NetworkSet) -> NetworkSet:
    """Return a set by shipped name or folder; a set is returned unchanged."""
    if isinstance(source, NetworkSet):
        return source
    folder = SET_FORMAT.find(source)
    file = folder / SET_FILE
    fields = SET_FORMAT.read(file)
    names = check_names(f"{file}: networks", fields["networks"])
    if any(Path(name).name != name or name in (".", "..") for name in names):
        raise InputError(f"{file}: networks are {names!r:.80}; they must be folders next to it")
    networks = tuple(load_network(folder / name) for name in names)
    if fields["digests"] != [fingerprint(network.layers) for network in networks]:
        raise InputError(f"the networks are not those that {file} describes: a digest differs")
    try:
        return NetworkSet(
            fields["name"], networks, fields["weights"], fields["decision"], fields["training"]
        )
    except InputError as error:
        raise type(error)(f"{file}: {error}") from None
