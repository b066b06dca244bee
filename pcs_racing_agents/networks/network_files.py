"""Networks and sets of networks as folders.

The folder of a network holds ``weights.safetensors`` and a manifest. A set stores a mixture of
learned strategies: a folder with a folder for each network and ``set.yaml``, with the name and the
probability of each network. ``set.yaml`` is written last; until then the folder is no set.
"""

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.artifacts import MANIFEST, ArtifactFormat, ManifestFormat, shipped_folder
from pcs_racing.base.checks import check_names, check_text
from pcs_racing.base.dense import layers_from_bytes, layers_to_bytes
from pcs_racing.base.errors import InputError, UnknownNameError
from pcs_racing.game.identity import GameIdentity, check_same_game
from pcs_racing.game.moves import check_epsilon
from pcs_racing_agents.base.fingerprint import fingerprint
from pcs_racing_agents.networks.network import RegretNetwork

_SCALING = ("input.mean", "input.scale")

_IDENTITY = ("elements", "moves", "epsilon", "archive", "archive_sha256", "preset")
"""Manifest entries about the network's game; the number of decisions follows from the elements."""

NETWORK_FORMAT = ArtifactFormat(
    "network",
    ("name", "target", "clipped", "hidden", *_IDENTITY, "training", "weights_sha256"),
    "save_network",
    data_file="weights.safetensors",
    digest_key="weights_sha256",
    max_bytes=32_000_000,
    shipped=shipped_folder(Path(__file__).resolve().parents[1], "networks"),
)

_KINDS: dict[str, tuple[Any, Any, str]] = {
    **dict.fromkeys(
        ("name", "target", "archive", "archive_sha256", "preset"), (str, None, "a text")
    ),
    "clipped": (bool, None, "true or false"),
    **dict.fromkeys(("elements", "moves"), (list, str, "a list of texts")),
    "epsilon": (list, float, "a list of numbers"),
    "training": (dict, None, "a mapping"),
}
"""Type, element type and name in messages of each manifest field."""


def save_network(network: RegretNetwork, folder: str | Path) -> Path:
    """Write a network into a folder, made if missing; return the folder."""
    recorded = {key: getattr(network.identity, key) for key in _IDENTITY}
    fields = {
        "name": network.name,
        "target": network.target,
        "clipped": network.clipped,
        "hidden": list(network.hidden),
        **{
            key: list(value) if isinstance(value, tuple) else value
            for key, value in recorded.items()
        },
        "training": dict(network.training),
    }
    scaling = dict(zip(_SCALING, (network.mean, network.scale), strict=True))
    return NETWORK_FORMAT.save(folder, fields, layers_to_bytes(network.layers, scaling))


def list_networks() -> list[str]:
    """Return the names of the shipped networks, sorted."""
    return NETWORK_FORMAT.shipped_names()


def load_network(source: str | os.PathLike[str] | RegretNetwork) -> RegretNetwork:
    """Return a network by shipped name or folder; a network is returned unchanged."""
    if isinstance(source, RegretNetwork):
        return source
    folder = NETWORK_FORMAT.find(source)
    fields, content = NETWORK_FORMAT.load(folder)
    for key, (kind, inner, wanted) in _KINDS.items():
        value = fields[key]
        if not isinstance(value, kind) or (
            inner and not all(isinstance(item, inner) for item in value)
        ):
            raise InputError(f"{folder / MANIFEST}: {key} is {value!r:.80}; it must be {wanted}")
    file = folder / NETWORK_FORMAT.data_file
    layers, scaling = layers_from_bytes(file, content, fields["hidden"], _SCALING)
    identity: dict[str, Any] = {}
    for key in _IDENTITY:
        identity[key] = tuple(fields[key]) if isinstance(fields[key], list) else fields[key]
    try:
        for key in ("elements", "moves"):
            check_names(key, identity[key])
        check_epsilon(identity["epsilon"])
        return RegretNetwork(
            name=fields["name"],
            identity=GameIdentity(**identity),
            target=fields["target"],
            clipped=fields["clipped"],
            layers=layers,
            mean=scaling["input.mean"],
            scale=scaling["input.scale"],
            training=fields["training"],
        )
    except InputError as error:
        raise type(error)(f"{folder}: {error}") from None


SET_FILE = "set.yaml"
SET_FORMAT = ManifestFormat(
    "network set",
    ("name", "decision", "weights", "networks", "digests", "training"),
    "save_network_set",
)
LARGEST = 64
"""Maximum number of networks in a set."""


def check_weights(name: str, values: ArrayLike, count: int) -> NDArray[np.float64]:
    """Return ``count`` frequencies, in any unit, as an array, or raise an error."""
    weights = np.asarray(values, np.float64)
    if (
        weights.shape != (count,)
        or not np.isfinite(weights).all()
        or (weights < 0.0).any()
        or not weights.any()
    ):
        raise InputError(
            f"{name} are {values!r:.80}; give {count} finite numbers of 0 or above, not all of"
            " them 0"
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
        object.__setattr__(self, "networks", tuple(self.networks))
        if not 1 <= len(self.networks) <= LARGEST:
            raise InputError(f"{where} has {len(self.networks)} networks; give 1 to {LARGEST}")
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
    names = [f"{i:02d}" for i in range(len(networks.networks))]
    # The manifest is written last: a set with half-replaced networks is no set.
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
    """Return the names of the shipped sets, sorted."""
    return sorted(path.parent.name for path in NETWORK_FORMAT.shipped.glob(f"*/{SET_FILE}"))


def load_network_set(source: str | os.PathLike[str] | NetworkSet) -> NetworkSet:
    """Return a set by shipped name or folder; a set is returned unchanged."""
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
            raise InputError(
                f"{file}: {key} is {values!r:.80}; it must be a list, a {kind.__name__} for each"
                " network"
            )
        if len(values) != len(fields["networks"]):
            raise InputError(
                f"{file}: there are {len(values)} {key} for {len(fields['networks'])} networks"
            )
    if any(Path(name).name != name or name in (".", "..") for name in fields["networks"]):
        raise InputError(
            f"{file}: networks are {fields['networks']!r:.80}; they must be names of folders"
            " beside it"
        )
    if not isinstance(fields["training"], dict):
        raise InputError(f"{file}: training is {fields['training']!r:.80}; it must be a mapping")
    networks = tuple(load_network(folder / name) for name in fields["networks"])
    for name, network, digest in zip(fields["networks"], networks, fields["digests"], strict=True):
        if fingerprint(network.layers) != digest:
            raise InputError(
                f"{folder / name} is not the network that {file} describes: its digest differs"
            )
    decision = check_text(f"{file}: decision", fields["decision"])
    return NetworkSet(
        fields["name"], networks, np.array(fields["weights"]), decision, fields["training"]
    )
