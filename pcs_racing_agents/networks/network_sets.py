"""Sets of networks with weights: what a mixture of learned strategies is kept as.

A set is a folder: a folder for each network as :func:`save_network` writes it, and ``set.yaml``, which names them and
says how often each is played. It is written last; until then the folder is no set.
"""

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.artifacts import ManifestFormat
from pcs_racing.base.checks import check_text
from pcs_racing.base.errors import InputError, UnknownNameError
from pcs_racing.game.identity import GameIdentity, check_same_game
from pcs_racing_agents.jobs.fingerprint import fingerprint
from pcs_racing_agents.networks.network import RegretNetwork
from pcs_racing_agents.networks.network_files import NETWORK_FORMAT, load_network, save_network

SET_FILE = "set.yaml"
SET_FORMAT = ManifestFormat(
    "network set", ("name", "decision", "weights", "networks", "digests", "training"), "save_network_set"
)
LARGEST = 64
"""Most networks of a set."""


@dataclass(frozen=True, eq=False)
class NetworkSet:
    """Networks of one game, one of which is drawn for each game that is played."""

    name: str
    networks: tuple[RegretNetwork, ...]
    weights: NDArray[np.float64]  #: shape (C,): Probability of each; they sum to 1.
    decision: (
        str  #: How moves follow from a network's values (:data:`pcs_racing_agents.agents.from_network.DECISIONS`).
    )
    #: How the set was made: texts and numbers by name.
    training: Mapping[str, str | int | float | bool] = field(default_factory=dict)

    def __post_init__(self) -> None:
        where = f"network set {check_text('the name of a network set', self.name)!r}"
        object.__setattr__(self, "networks", tuple(self.networks))
        if not 1 <= len(self.networks) <= LARGEST:
            raise InputError(f"{where} has {len(self.networks)} networks; give 1 to {LARGEST}")
        weights = np.asarray(self.weights, np.float64)
        if weights.shape != (len(self.networks),) or not np.isfinite(weights).all() or (weights < 0.0).any():
            raise InputError(f"{where}: weights are {self.weights!r:.80}; give a number of 0 or more for each network")
        if not weights.any():
            raise InputError(f"{where}: all weights are 0; some must be above 0")
        object.__setattr__(self, "weights", weights / weights.sum())
        for network in self.networks[1:]:
            check_same_game(network.identity, self.identity, f"{where}: network {network.name!r}", "the first")

    @property
    def identity(self) -> GameIdentity:
        """The game that the networks were made for."""
        return self.networks[0].identity


def save_network_set(networks: NetworkSet, folder: str | Path) -> Path:
    """Write a set into a folder, which is made if need be; returns the folder."""
    folder = Path(folder)
    names = [f"{i:02d}" for i in range(len(networks.networks))]
    (folder / SET_FILE).unlink(missing_ok=True)
    for name, network in zip(names, networks.networks, strict=True):
        save_network(network, folder / name)
    fields = {
        "name": networks.name,
        "decision": networks.decision,
        "weights": [float(weight) for weight in networks.weights],
        "networks": names,
        "digests": [fingerprint(network.layers) for network in networks.networks],
        "training": dict(networks.training),
    }
    SET_FORMAT.write(folder / SET_FILE, fields)
    return folder


def list_network_sets() -> list[str]:
    """Names of the sets that come with the package, sorted."""
    return sorted(path.parent.name for path in NETWORK_FORMAT.shipped.glob(f"*/{SET_FILE}"))


def load_network_set(source: str | os.PathLike[str] | NetworkSet) -> NetworkSet:
    """Return a set from the name of a shipped one, from its folder, or as it is."""
    if isinstance(source, NetworkSet):
        return source
    if not isinstance(source, str | os.PathLike):
        raise InputError(f"network set {source!r} must be a name or a folder")
    names = list_network_sets()
    if source in names:
        folder = NETWORK_FORMAT.shipped / str(source)
    elif os.path.isdir(source):
        folder = Path(source)
    else:
        raise UnknownNameError(
            f"unknown network set {str(source)!r}: neither a folder nor one of those shipped "
            f"({', '.join(names) or 'none'})"
        )
    file = folder / SET_FILE
    fields = SET_FORMAT.read(file)
    for key, kind in (("weights", float), ("networks", str), ("digests", str)):
        values = fields[key]
        if not isinstance(values, list) or not all(isinstance(value, kind) for value in values):
            raise InputError(f"{file}: {key} is {values!r:.80}; it must be a list, a {kind.__name__} for each network")
        if len(values) != len(fields["networks"]):
            raise InputError(f"{file}: there are {len(values)} {key} for {len(fields['networks'])} networks")
    if any(Path(name).name != name or name in (".", "..") for name in fields["networks"]):
        raise InputError(f"{file}: networks are {fields['networks']!r:.80}; they must be names of folders beside it")
    if not isinstance(fields["training"], dict):
        raise InputError(f"{file}: training is {fields['training']!r:.80}; it must be a mapping")
    networks = tuple(load_network(folder / name) for name in fields["networks"])
    for name, network, digest in zip(fields["networks"], networks, fields["digests"], strict=True):
        if fingerprint(network.layers) != digest:
            raise InputError(f"{folder / name} is not the network that {file} describes: its digest differs")
    decision = check_text(f"{file}: decision", fields["decision"])
    return NetworkSet(fields["name"], networks, np.array(fields["weights"]), decision, fields["training"])
