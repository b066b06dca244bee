"""Networks as folders: ``weights.safetensors`` beside a ``manifest.yaml`` that says what they are."""

import hashlib
import os
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from safetensors import SafetensorError
from safetensors.numpy import load as load_tensors
from safetensors.numpy import save as save_tensors

from pcs_racing.base.errors import InputError, UnknownNameError
from pcs_racing.base.files import write_atomically
from pcs_racing.base.reading import MAX_YAML, parse_manifest, read_limited
from pcs_racing_agents.networks.identity import GameIdentity
from pcs_racing_agents.networks.network import MOST_LAYERS, RegretNetwork

__all__ = ["list_networks", "load_network", "read_network", "save_network", "shipped_folder"]

FORMAT = "pcs-racing network"
VERSION = 1
MAX_BYTES = 32_000_000
_OWN_KEYS = ("format", "version", "name", "target", "clipped", "hidden", "training", "weights_sha256")
_KEYS = (*_OWN_KEYS, *GameIdentity._fields)


def save_network(network: RegretNetwork, folder: str | Path) -> Path:
    """Write a network into a folder, which is made if need be.

    The manifest is written last and carries a digest of the weights: files that do not belong together are noticed.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    tensors = {"input.mean": network.mean, "input.scale": network.scale}
    for i, (weight, bias) in enumerate(zip(network.weights, network.biases, strict=True)):
        tensors |= {f"layers.{i}.weight": weight, f"layers.{i}.bias": bias}
    content = save_tensors({key: np.ascontiguousarray(value) for key, value in tensors.items()})
    identity = {key: _plain(value) for key, value in network.identity._asdict().items()}
    manifest = {
        "format": FORMAT,
        "version": VERSION,
        "name": network.name,
        "target": network.target,
        "clipped": network.clipped,
        "hidden": list(network.hidden),
        **identity,
        "training": dict(network.training),
        "weights_sha256": hashlib.sha256(content).hexdigest(),
    }
    text = yaml.safe_dump(manifest, sort_keys=False, allow_unicode=True, width=110)
    write_atomically(folder / "weights.safetensors", lambda file: file.write(content))
    write_atomically(folder / "manifest.yaml", lambda file: file.write(text.encode("utf-8")))
    return folder


def read_network(folder: str | os.PathLike[str]) -> RegretNetwork:
    """Read a network that :func:`save_network` wrote.

    Raises
    ------
    InputError
        If a file is missing, damaged, too large, from another version, or its contents do not fit each other.
    """
    folder = Path(folder)
    manifest = _read_manifest(folder / "manifest.yaml")
    file = folder / "weights.safetensors"
    content = _read(file, MAX_BYTES)
    if hashlib.sha256(content).hexdigest() != manifest["weights_sha256"]:
        raise InputError(f"{file} is not the file that {folder / 'manifest.yaml'} describes: its digest differs")
    try:
        tensors = load_tensors(content)
    except (SafetensorError, KeyError, TypeError, ValueError) as error:
        raise InputError(f"{file} is no safetensors file of numbers: {error}") from None
    layers = range(len(manifest["hidden"]) + 1)
    names = {"input.mean", "input.scale", *(f"layers.{i}.{part}" for i in layers for part in ("weight", "bias"))}
    if set(tensors) != names:
        odd = ", ".join(sorted(names ^ set(tensors)))
        raise InputError(f"{file}: unknown or missing {odd}; the manifest's hidden layers are {manifest['hidden']}")
    for key, tensor in tensors.items():
        if tensor.dtype != np.float32:
            raise InputError(f"{file}: {key} is of type {tensor.dtype}; it must be float32")
    try:
        network = RegretNetwork(
            name=manifest["name"],
            identity=GameIdentity(**{key: _value(manifest[key]) for key in GameIdentity._fields}),
            target=manifest["target"],
            clipped=manifest["clipped"],
            weights=tuple(tensors[f"layers.{i}.weight"] for i in layers),
            biases=tuple(tensors[f"layers.{i}.bias"] for i in layers),
            mean=tensors["input.mean"],
            scale=tensors["input.scale"],
            training=manifest["training"],
        )
    except InputError as error:
        raise type(error)(f"{folder}: {error}") from None
    if list(network.hidden) != manifest["hidden"]:
        raise InputError(f"{file} has hidden layers {list(network.hidden)}; its manifest says {manifest['hidden']}")
    return network


def shipped_folder() -> Path:
    """Folder of the networks that come with the package."""
    package = Path(__file__).resolve().parents[1]
    inside = package / "shipped_networks"  # in an installed package; in a checkout they lie beside it
    return inside if inside.is_dir() else package.parent / "networks"


def list_networks() -> list[str]:
    """Names of the networks that come with the package, sorted."""
    folder = shipped_folder()
    return sorted(path.parent.name for path in folder.glob("*/manifest.yaml")) if folder.is_dir() else []


def load_network(source: str | os.PathLike[str] | RegretNetwork) -> RegretNetwork:
    """Return a network from the name of a shipped one, from its folder, or as it is.

    Raises
    ------
    UnknownNameError
        If there is none of that name and no such folder.
    InputError
        If the folder holds no sound network.
    """
    if isinstance(source, RegretNetwork):
        return source
    if not isinstance(source, str | os.PathLike):
        raise InputError(f"network {source!r} must be a name, a folder or a RegretNetwork")
    if source in list_networks():
        return read_network(shipped_folder() / str(source))
    if not os.path.isdir(source):
        known = ", ".join(list_networks()) or "none"
        raise UnknownNameError(f"unknown network {str(source)!r}: neither a folder nor one of those shipped ({known})")
    return read_network(source)


def _plain(value: Any) -> Any:
    return list(value) if isinstance(value, tuple) else value


def _value(value: Any) -> Any:
    return tuple(value) if isinstance(value, list) else value


def _read(file: Path, limit: int) -> bytes:
    try:
        return read_limited(file, limit, "a network")
    except OSError as error:
        raise InputError(
            f"can't read {file}: {error.strerror}; a network is a folder that RegretNetwork.save wrote"
        ) from None


def _read_manifest(file: Path) -> dict[str, Any]:
    manifest = parse_manifest(file, _read(file, MAX_YAML), "a network", FORMAT, VERSION, _KEYS)
    kinds: dict[str, tuple[Any, Any, str]] = {
        **dict.fromkeys(("name", "target", "archive", "archive_sha256", "preset"), (str, None, "a text")),
        "clipped": (bool, None, "true or false"),
        **dict.fromkeys(("elements", "moves"), (list, str, "a list of texts")),
        "epsilon": (list, float, "a list of numbers"),
        "hidden": (list, int, "a list of whole numbers"),
        "training": (dict, None, "a mapping"),
    }
    for key, (kind, inner, wanted) in kinds.items():
        value = manifest[key]
        if not isinstance(value, kind) or (inner and not all(isinstance(item, inner) for item in value)):
            raise InputError(f"{file}: {key} is {value!r:.80}; it must be {wanted}")
    if len(manifest["hidden"]) >= MOST_LAYERS:
        raise InputError(f"{file}: there are {len(manifest['hidden'])} hidden layers; {MOST_LAYERS - 1} is the limit")
    return manifest
