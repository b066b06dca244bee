"""Networks as folders: ``weights.safetensors`` beside a manifest."""

import os
from pathlib import Path
from typing import Any

from pcs_racing.base.artifacts import MANIFEST, ArtifactFormat, shipped_folder
from pcs_racing.base.dense import layers_from_bytes, layers_to_bytes
from pcs_racing.base.errors import InputError
from pcs_racing.game.identity import GameIdentity
from pcs_racing_agents.networks.network import RegretNetwork

_SCALING = ("input.mean", "input.scale")

_IDENTITY = ("elements", "moves", "epsilon", "archive", "archive_sha256", "preset")
"""What a manifest records of the network's game; the number of decisions follows from the elements."""

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
    **dict.fromkeys(("name", "target", "archive", "archive_sha256", "preset"), (str, None, "a text")),
    "clipped": (bool, None, "true or false"),
    **dict.fromkeys(("elements", "moves"), (list, str, "a list of texts")),
    "epsilon": (list, float, "a list of numbers"),
    "training": (dict, None, "a mapping"),
}
"""Of each field of the manifest: its type, that of its elements, and how messages call it."""


def save_network(network: RegretNetwork, folder: str | Path) -> Path:
    """Write a network into a folder, which is made if need be; returns the folder."""
    recorded = {key: getattr(network.identity, key) for key in _IDENTITY}
    fields = {
        "name": network.name,
        "target": network.target,
        "clipped": network.clipped,
        "hidden": list(network.hidden),
        **{key: list(value) if isinstance(value, tuple) else value for key, value in recorded.items()},
        "training": dict(network.training),
    }
    scaling = dict(zip(_SCALING, (network.mean, network.scale), strict=True))
    return NETWORK_FORMAT.save(folder, fields, layers_to_bytes(network.layers, scaling))


def list_networks() -> list[str]:
    """Names of the networks that come with the package, sorted."""
    return NETWORK_FORMAT.shipped_names()


def load_network(source: str | os.PathLike[str] | RegretNetwork) -> RegretNetwork:
    """Return a network from the name of a shipped one, from its folder, or as it is."""
    if isinstance(source, RegretNetwork):
        return source
    folder = NETWORK_FORMAT.find(source)
    fields, content = NETWORK_FORMAT.load(folder)
    for key, (kind, inner, wanted) in _KINDS.items():
        value = fields[key]
        if not isinstance(value, kind) or (inner and not all(isinstance(item, inner) for item in value)):
            raise InputError(f"{folder / MANIFEST}: {key} is {value!r:.80}; it must be {wanted}")
    file = folder / NETWORK_FORMAT.data_file
    layers, scaling = layers_from_bytes(file, content, fields["hidden"], _SCALING)
    identity: dict[str, Any] = {}
    for key in _IDENTITY:
        identity[key] = tuple(fields[key]) if isinstance(fields[key], list) else fields[key]
    try:
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
