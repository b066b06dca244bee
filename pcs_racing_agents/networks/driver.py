"""A trained driver as a planner: in memory, as a folder, and ``ppo-drive``, which comes with the package.

A folder holds ``weights.safetensors`` (``layers.N.weight`` and ``layers.N.bias``, float32) and ``driver.yaml``, which
says what the numbers mean. Unlike those of :func:`pcs_racing.planners.network.network_planner`, the weights of a
trained driver are constants of its compiled code: it has no parameters, and the state of a race does not grow with it.
"""

import hashlib
import os
from collections.abc import Mapping
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.numpy import load as load_tensors
from safetensors.numpy import save as save_tensors

from pcs_racing.base.compilation import compiled
from pcs_racing.base.errors import InputError, UnknownNameError
from pcs_racing.base.files import write_atomically
from pcs_racing.base.reading import MAX_YAML, parse_manifest, read_limited
from pcs_racing.planners.network import (
    INPUTS,
    SIGHT,
    TOP_SPEED,
    WEIGHT_LIMIT,
    network_inputs,
    tanh_layer,
    weight_count,
)
from pcs_racing.planners.planner import COMMAND_SLOTS, STEER_MAX, TIME, Parameter, Planner
from pcs_racing_agents.networks.layers import Layers
from pcs_racing_agents.networks.network_files import shipped_folder

__all__ = [
    "driver_folder",
    "driver_planner",
    "flat_weights",
    "learning_planner",
    "load_driver",
    "read_driver",
    "save_driver",
]

FORMAT = "pcs-racing driver"
VERSION = 1
NAME = "ppo-drive"
MAX_BYTES = 4_000_000
_KEYS = ("format", "version", "name", "inputs", "hidden", "hold", "top_speed", "training", "weights_sha256")


@cache
def _control(hidden: tuple[int, ...], hold: int, frozen: bytes | None) -> Any:
    """Compile a network that decides every ``hold`` steps of 0.01 s; with its own weights, or those of ``theta``."""
    inputs = len(INPUTS)
    layers = (*hidden, 2)
    widest = max(inputs, *layers)
    constant = np.frombuffer(frozen or b"", np.float64)
    from_theta = frozen is None

    @compiled
    def control(track, theta, view, memory, scratch, path, command):  # type: ignore[no-untyped-def]
        if int(view[TIME] * 100.0 + 0.5) % hold == 0:
            x = scratch[:widest]
            y = scratch[widest : 2 * widest]
            network_inputs(track, view, x)
            size = inputs
            at = 0
            for width in layers:
                if from_theta:
                    at = tanh_layer(theta, at, x, size, y, width)
                else:
                    at = tanh_layer(constant, at, x, size, y, width)
                x, y = y, x
                size = width
            memory[0] = view[STEER_MAX] * x[0]
            memory[1] = 0.5 * TOP_SPEED * (1.0 + x[1])
        command[0] = memory[0]
        command[1] = memory[1]

    return control


def _planner(name: str, hidden: tuple[int, ...], parameters: tuple[Parameter, ...], control: Any) -> Planner:
    widest = max(len(INPUTS), 2, *hidden)
    return Planner(
        name=name,
        parameters=parameters,
        control=control,
        memory_size=COMMAND_SLOTS,
        scratch_size=2 * widest,
        sight=SIGHT,
    )


@cache
def learning_planner(hidden: tuple[int, ...], hold: int) -> Planner:
    """Return a planner whose parameters are the weights (:func:`flat_weights`), for a driver that still learns.

    Parameters
    ----------
    hidden : tuple of int
        Widths of the hidden layers.
    hold : int
        Simulation steps of 0.01 s for which a decision holds, an even number.
    """
    parameters = tuple(
        Parameter(f"weight{i}", -WEIGHT_LIMIT, WEIGHT_LIMIT, 0.0, "weight") for i in range(weight_count(hidden))
    )
    return _planner("ppo-learner", hidden, parameters, _control(hidden, hold, None))


def driver_planner(name: str, layers: Layers, hold: int) -> Planner:
    """Return a planner without parameters that drives as a network says.

    Parameters
    ----------
    name : str
    layers : Layers
        16 inputs, any hidden layers, 2 outputs; ``tanh`` behind each layer.
    hold : int
        Simulation steps of 0.01 s for which a decision holds, an even number.

    Raises
    ------
    InputError
        If the layers do not fit each other, or a weight is not finite or too large.
    """
    hidden = _check_layers(name, layers)
    if isinstance(hold, bool) or not isinstance(hold, int) or not 2 <= hold <= 100 or hold % 2:
        raise InputError(f"driver {name!r} holds its decisions for {hold!r} steps; it must be an even number, 2 to 100")
    return _planner(name, hidden, (), _control(hidden, hold, flat_weights(layers).tobytes()))


def flat_weights(layers: Layers) -> NDArray[np.float64]:
    """Weights in the order of :func:`pcs_racing.planners.network.network_planner`: neuron by neuron, its bias
    last.
    """
    rows = [np.column_stack(pair).ravel() for pair in zip(layers.weights, layers.biases, strict=True)]
    return np.concatenate(rows).astype(np.float64)


def _check_layers(name: str, layers: Layers) -> tuple[int, ...]:
    sizes = [len(INPUTS)]
    if not layers.weights or len(layers.weights) != len(layers.biases):
        raise InputError(f"driver {name!r} has {len(layers.weights)} layers and {len(layers.biases)} biases")
    for i, (weight, bias) in enumerate(zip(layers.weights, layers.biases, strict=True)):
        if weight.ndim != 2 or weight.shape[1] != sizes[-1] or bias.shape != weight.shape[:1] or not len(bias):
            raise InputError(
                f"driver {name!r}: layer {i} has weights of shape {weight.shape} and biases of shape {bias.shape}; "
                f"they must have (n, {sizes[-1]}) and (n,)"
            )
        for value in (weight, bias):
            if not (np.abs(value) <= WEIGHT_LIMIT).all():  # false for NaN, too
                raise InputError(
                    f"driver {name!r}: layer {i} has a weight of {value[~(np.abs(value) <= WEIGHT_LIMIT)][0]:g}; it "
                    f"must lie in [{-WEIGHT_LIMIT:g}, {WEIGHT_LIMIT:g}]"
                )
        sizes.append(len(bias))
    if sizes[-1] != 2:
        raise InputError(f"driver {name!r} puts out {sizes[-1]} numbers; it must be 2, steering and speed")
    if sum((below + 1) * above for below, above in pairwise(sizes)) > 100_000:
        raise InputError(f"driver {name!r} has more than 100000 weights")
    return tuple(sizes[1:-1])


# As files


def save_driver(folder: str | Path, layers: Layers, *, name: str, hold: int, training: Mapping[str, Any]) -> Path:
    """Write a driver into a folder, which is made if need be.

    Parameters
    ----------
    folder : str or Path
    layers, name, hold
        As for :func:`driver_planner`.
    training : mapping
        How it was trained: texts and numbers by name.
    """
    folder = Path(folder)
    hidden = _check_layers(name, layers)
    tensors: dict[str, NDArray[np.float32]] = {}
    for i, (weight, bias) in enumerate(zip(layers.weights, layers.biases, strict=True)):
        tensors |= {f"layers.{i}.weight": weight, f"layers.{i}.bias": bias}
    content = save_tensors({key: np.ascontiguousarray(value, np.float32) for key, value in tensors.items()})
    manifest = {
        "format": FORMAT,
        "version": VERSION,
        "name": name,
        "inputs": list(INPUTS),
        "hidden": list(hidden),
        "hold": hold,
        "top_speed": TOP_SPEED,
        "training": dict(training),
        "weights_sha256": hashlib.sha256(content).hexdigest(),
    }
    text = yaml.safe_dump(manifest, sort_keys=False, allow_unicode=True, width=110)
    folder.mkdir(parents=True, exist_ok=True)
    write_atomically(folder / "weights.safetensors", lambda file: file.write(content))
    write_atomically(folder / "driver.yaml", lambda file: file.write(text.encode("utf-8")))
    return folder


def read_driver(folder: str | Path) -> tuple[Layers, dict[str, Any]]:
    """Read what :func:`save_driver` wrote: the layers, and the manifest.

    Raises
    ------
    InputError
        If a file is missing, damaged, too large, from another version, or its contents do not fit each other.
    """
    folder = Path(folder)
    manifest = _read_manifest(folder / "driver.yaml")
    file = folder / "weights.safetensors"
    content = _read(file, MAX_BYTES)
    if hashlib.sha256(content).hexdigest() != manifest["weights_sha256"]:
        raise InputError(f"{file} is not the file that {folder / 'driver.yaml'} describes: its digest differs")
    try:
        tensors = load_tensors(content)
    except (SafetensorError, KeyError, TypeError, ValueError) as error:
        raise InputError(f"{file} is no safetensors file of numbers: {error}") from None
    count = len(manifest["hidden"]) + 1
    names = {f"layers.{i}.{part}" for i in range(count) for part in ("weight", "bias")}
    if set(tensors) != names or any(tensor.dtype != np.float32 for tensor in tensors.values()):
        raise InputError(f"{file} holds {', '.join(sorted(tensors))}; it must hold {', '.join(sorted(names))}, float32")
    layers = Layers(
        tuple(tensors[f"layers.{i}.weight"] for i in range(count)),
        tuple(tensors[f"layers.{i}.bias"] for i in range(count)),
    )
    hidden = _check_layers(manifest["name"], layers)
    if list(hidden) != manifest["hidden"]:
        raise InputError(f"{file} has hidden layers {list(hidden)}; {folder / 'driver.yaml'} says {manifest['hidden']}")
    return layers, manifest


def load_driver(source: str | Path = NAME) -> Planner:
    """Return a driver's planner, from the name of a shipped one or from its folder.

    Raises
    ------
    UnknownNameError
        If there is none of that name and no such folder.
    InputError
        If the folder holds no sound driver.
    """
    layers, manifest = read_driver(driver_folder(source))
    return driver_planner(manifest["name"], layers, manifest["hold"])


def driver_folder(source: str | Path = NAME) -> Path:
    """Return the folder of a driver, from the name of a shipped one or as it is.

    Raises
    ------
    UnknownNameError
        If there is none of that name and no such folder.
    """
    known = sorted(path.parent.name for path in shipped_folder().glob("*/driver.yaml"))
    folder = shipped_folder() / str(source) if str(source) in known else Path(source)
    if not os.path.isdir(folder):
        raise UnknownNameError(
            f"unknown driver {str(source)!r}: neither a folder nor one of those shipped ({', '.join(known) or 'none'})"
        )
    return folder


def __getattr__(name: str) -> Any:
    """``PPO_DRIVE``, the planner that comes with the package, read when it is first asked for."""
    if name != "PPO_DRIVE":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = load_driver(NAME)
    return globals()[name]


def _read(file: Path, limit: int) -> bytes:
    try:
        return read_limited(file, limit, "a driver")
    except OSError as error:
        raise InputError(f"can't read {file}: {error.strerror}; a driver is a folder that save_driver wrote") from None


def _read_manifest(file: Path) -> dict[str, Any]:
    manifest = parse_manifest(file, _read(file, MAX_YAML), "a driver", FORMAT, VERSION, _KEYS)
    if manifest["inputs"] != list(INPUTS) or manifest["top_speed"] != TOP_SPEED:
        raise InputError(f"{file}: the driver was made for other inputs or another top speed than this release has")
    hidden = manifest["hidden"]
    if not isinstance(hidden, list) or len(hidden) > 8 or not all(type(width) is int for width in hidden):
        raise InputError(f"{file}: hidden is {hidden!r:.80}; it must be a list of at most 8 whole numbers")
    if not isinstance(manifest["name"], str) or not isinstance(manifest["training"], dict):
        raise InputError(f"{file}: name must be a text and training a mapping")
    return manifest
