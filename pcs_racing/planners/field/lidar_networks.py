"""Folders of lidar planners with a network: ``residual`` and ``lidar-ppo``.

A manifest names the network, one of :data:`PLANNERS`; the weights are a safetensors file.
"""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.numpy import load as load_tensors
from safetensors.numpy import save as save_tensors

from pcs_racing.base.artifacts import MANIFEST, ArtifactFormat
from pcs_racing.base.dense import flat_layers
from pcs_racing.base.errors import InputError
from pcs_racing.planners.field import lidar_ppo as _ppo
from pcs_racing.planners.field import residual as _residual
from pcs_racing.planners.planner import Planner
from pcs_racing.planners.scanning import BEAMS, follow_scan
from pcs_racing.planners.trained import PLANNER_FORMAT

KINDS, MAX_WEIGHT = ("weight", "bias"), 100.0
PLANNERS: Mapping[str, Any] = {"residual": _residual, "ppo": _ppo}
"""Modules of the networks' planners."""
LAYERS = {network: module.LAYERS for network, module in PLANNERS.items()}
"""Numbers of inputs and outputs of the layers of each network."""

LIDAR_FORMAT = ArtifactFormat(
    "lidar driver",
    ("name", "network", "beams", "training", "weights_sha256"),
    "save_lidar_planner",
    data_file=PLANNER_FORMAT.data_file,
    digest_key="weights_sha256",
    max_bytes=PLANNER_FORMAT.max_bytes,
    shipped=PLANNER_FORMAT.shipped,
)


def save_lidar_planner(
    folder: str | Path,
    network: str,
    layers: Sequence[Any],
    *,
    name: str,
    training: Mapping[str, Any],
) -> Path:
    """Save a lidar planner in a folder, created if missing.

    ``network`` is one of :data:`LAYERS`, ``layers`` are weight (out, in) and bias (out,) of each of
    its layers, and ``training`` describes the training: texts and numbers by name.
    """
    pairs = enumerate(layers)
    tensors = {
        f"layers.{i}.{kind}": a for i, pair in pairs for kind, a in zip(KINDS, pair, strict=True)
    }
    content = save_tensors(
        {key: np.ascontiguousarray(value, np.float32) for key, value in tensors.items()}
    )
    _flat(Path(folder), network, content)
    fields = {
        "name": name,
        "network": network,
        "beams": BEAMS,
        "training": dict(training),
    }
    return LIDAR_FORMAT.save(folder, fields, content)


def flat_weights(layers: Iterable[Any]) -> NDArray[np.float64]:
    """Return all numbers of layers (weight, bias) as one vector for the compiled networks."""
    return flat_layers(layers).astype(np.float64)


def _flat(folder: Path, network: Any, content: bytes) -> NDArray[np.float64]:
    if not isinstance(network, str) or network not in LAYERS:
        raise InputError(f"{folder}: network is {network!r}; it must be one of {', '.join(LAYERS)}")
    try:
        tensors = load_tensors(content)
    except (SafetensorError, KeyError, TypeError, ValueError) as error:
        raise InputError(
            f"{folder}: the weights are no safetensors file of numbers: {error}"
        ) from None
    shapes: dict[str, tuple[int, ...]] = {}
    for i, (below, above) in enumerate(LAYERS[network]):
        shapes |= {f"layers.{i}.weight": (above, below), f"layers.{i}.bias": (above,)}
    found = {key: tensor.shape for key, tensor in tensors.items()}
    if found != shapes or not all(
        t.dtype == np.float32 and (np.abs(t) <= MAX_WEIGHT).all() for t in tensors.values()
    ):
        raise InputError(
            f"{folder}: a network {network!r} has float32 weights within {MAX_WEIGHT:g} of the"
            f" shapes {shapes}"
        )
    return flat_weights(
        [
            (tensors[f"layers.{i}.weight"], tensors[f"layers.{i}.bias"])
            for i in range(len(shapes) // 2)
        ]
    )


def read_lidar_planner(source: str | Path) -> tuple[str, str, NDArray[np.float64]]:
    """Return name, network and weights of a lidar planner, from its shipped name or its folder."""
    folder = LIDAR_FORMAT.find(source)
    fields, content = LIDAR_FORMAT.load(folder)
    flat = _flat(folder, fields["network"], content)
    if (
        not isinstance(fields["name"], str)
        or fields["beams"] != BEAMS
        or not isinstance(fields["training"], dict)
    ):
        raise InputError(
            f"{folder / MANIFEST}: name must be a text, beams {BEAMS} and training a mapping"
        )
    return fields["name"], fields["network"], flat


def load_lidar_planner(source: str | Path) -> Planner:
    """Return a lidar planner; source and errors as for :func:`read_lidar_planner`."""
    name, network, flat = read_lidar_planner(source)
    module = PLANNERS[network]
    return Planner(
        name=name,
        parameters=module.PARAMETERS,
        plan=module.frozen_plan(flat.tobytes()),
        control=follow_scan,
        memory_size=module.MEMORY,
        scratch_size=module.SCRATCH,
        variants=module.VARIANTS,
    )


def __getattr__(name: str) -> Any:
    """Return ``LIDAR_PPO`` or ``RESIDUAL``, shipped planners loaded at first use."""
    if name not in ("LIDAR_PPO", "RESIDUAL"):
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = load_lidar_planner(name.lower().replace("_", "-"))
    return globals()[name]
