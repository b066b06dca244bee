"""Trained planners: networks with fixed weights, saved in folders; ``ppo-drive`` is shipped.

The weights of a trained planner are constants of its compiled code, unlike the weights of
:func:`pcs_racing.planners.network.network_planner`. So it has no parameters, and the state of a
race does not grow with it.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pcs_racing.base.artifacts import MANIFEST, ArtifactFormat, shipped_folder
from pcs_racing.base.dense import DenseLayers, layers_from_bytes, layers_to_bytes
from pcs_racing.base.errors import InputError
from pcs_racing.planners.network import (
    INPUTS,
    TOP_SPEED,
    check_network_planner,
    make_network_planner,
)
from pcs_racing.planners.planner import Planner

NAME = "ppo-drive"

PLANNER_FORMAT = ArtifactFormat(
    "driver",
    ("name", "inputs", "hidden", "hold", "top_speed", "training", "weights_sha256"),
    "save_trained",
    data_file="weights.safetensors",
    digest_key="weights_sha256",
    max_bytes=4_000_000,
    shipped=shipped_folder(Path(__file__).resolve().parents[1], "planners"),
)


def trained_planner(name: str, layers: DenseLayers, hold: int) -> Planner:
    """Return a planner without parameters that commands the outputs of a network.

    The network has 16 inputs, any hidden layers and 2 outputs, with a ``tanh`` after each layer. A
    decision holds for ``hold`` simulation steps of 0.01 s, an even number.
    """
    flat = layers.flat().astype(np.float64)
    check_network_planner(name, layers.sizes, flat, hold)
    return make_network_planner(name, layers.hidden, hold, (), flat.tobytes())


def save_trained(
    folder: str | Path, layers: DenseLayers, *, name: str, hold: int, training: Mapping[str, Any]
) -> Path:
    """Save a trained planner in a folder, which is created if missing.

    ``layers`` and ``hold`` are as for :func:`trained_planner`. ``training`` describes the training:
    texts and numbers by name.
    """
    check_network_planner(name, layers.sizes, layers.flat(), hold)
    fields = {
        "name": name,
        "inputs": list(INPUTS),
        "hidden": list(layers.hidden),
        "hold": int(hold),
        "top_speed": TOP_SPEED,
        "training": dict(training),
    }
    return PLANNER_FORMAT.save(folder, fields, layers_to_bytes(layers))


def read_trained(source: str | Path = NAME) -> tuple[DenseLayers, dict[str, Any]]:
    """Return the layers and manifest of a trained planner, from a shipped name or a folder."""
    folder = PLANNER_FORMAT.find(source)
    fields, content = PLANNER_FORMAT.load(folder)
    if fields["inputs"] != list(INPUTS) or fields["top_speed"] != TOP_SPEED:
        raise InputError(
            f"{folder / MANIFEST}: the driver was made for other inputs or another top speed than"
            " this release has"
        )
    if not isinstance(fields["name"], str) or not isinstance(fields["training"], dict):
        raise InputError(f"{folder / MANIFEST}: name must be a text and training a mapping")
    layers, _ = layers_from_bytes(folder / PLANNER_FORMAT.data_file, content, fields["hidden"])
    check_network_planner(fields["name"], layers.sizes, layers.flat(), fields["hold"])
    return layers, fields


def load_trained(source: str | Path = NAME) -> Planner:
    """Return a trained planner, from a shipped name or a folder; errors as :func:`read_trained`."""
    layers, manifest = read_trained(source)
    return trained_planner(manifest["name"], layers, manifest["hold"])


def __getattr__(name: str) -> Any:
    """Return ``PPO_DRIVE``, the shipped planner, loaded at its first use."""
    if name != "PPO_DRIVE":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = load_trained(NAME)
    return globals()[name]
