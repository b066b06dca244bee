"""Dense networks: their weights as one value, the compiled forward pass, and their tensors in
files.

The forward pass computes one row at a time, so that a row's outputs are bit-identical in a batch of
any size. A matrix product of numpy would be shorter, but its rounding depends on the number of
rows, and a policy's decisions must not depend on the batch size.
"""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from safetensors import SafetensorError
from safetensors.numpy import load as load_tensors, save as save_tensors

from pcs_racing.base.compilation import kernel
from pcs_racing.base.elementary import hyperbolic_tangent
from pcs_racing.base.errors import InputError
from pcs_racing.base.typing import Singles

MAX_WEIGHTS = 4_000_000
MAX_LAYERS = 16


@dataclass(frozen=True, eq=False)
class DenseLayers:
    """Weights and biases of fully connected layers."""

    #: shape (out, in), float32: Weights of each layer; read-only.
    weights: tuple[NDArray[np.floating[Any]], ...]  # float32; other numbers are converted
    biases: tuple[NDArray[np.floating[Any]], ...]  #: shape (out,), float32: Biases.

    def __post_init__(self) -> None:
        if not 1 <= len(self.weights) <= MAX_LAYERS or len(self.biases) != len(self.weights):
            raise InputError(
                f"there are weights of {len(self.weights)} layers and biases of {len(self.biases)};"
                f" give both of 1 to {MAX_LAYERS} layers"
            )
        inputs = None  # inputs of the next layer; any number for the first layer
        weights, biases = [], []
        for i, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            shape = np.shape(weight)
            if len(shape) != 2 or 0 in shape or shape[1] != (inputs or shape[1]):
                raise InputError(
                    f"weights of layer {i} have shape {shape}; they must have (any,"
                    f" {inputs or 'any'})"
                )
            inputs = shape[0]
            weights.append(_array(f"weights of layer {i}", weight, shape))
            biases.append(_array(f"biases of layer {i}", bias, shape[:1]))
        object.__setattr__(self, "weights", tuple(weights))
        object.__setattr__(self, "biases", tuple(biases))
        if weight_count(self.sizes) > MAX_WEIGHTS:
            raise InputError(
                f"the layers have {weight_count(self.sizes)} weights; {MAX_WEIGHTS} is the limit"
            )

    @property
    def sizes(self) -> tuple[int, ...]:
        """Number of inputs, then the number of outputs of each layer."""
        return (self.weights[0].shape[1], *(len(bias) for bias in self.biases))

    @property
    def hidden(self) -> tuple[int, ...]:
        """Widths of the hidden layers."""
        return self.sizes[1:-1]

    def flat(self) -> Singles:
        """Return all numbers as one vector.

        For each layer: its biases, then for each input the weights to all outputs.
        """
        return flat_layers(zip(self.weights, self.biases, strict=True))

    @cached_property
    def _compiled(self) -> tuple[Singles, NDArray[np.int64]]:
        return self.flat(), np.array(self.sizes)

    def forward(self, inputs: Singles, *, tanh: bool = False, squash: bool = False) -> Singles:
        """Return outputs, shape (..., A), of inputs, shape (..., D).

        A tanh or a ReLU follows each layer but the last, and ``squash`` adds a tanh after the last.
        The outputs of a row do not depend on the rest of the batch, not even in the last bit.
        """
        flat, sizes = self._compiled
        rows = np.ascontiguousarray(inputs.reshape(-1, sizes[0]), np.float32)
        out = np.empty((len(rows), sizes[-1]), np.float32)
        scratch = np.empty((2, sizes.max()), np.float32)
        dense_rows(rows, flat, sizes, tanh, squash, scratch, out)
        return out.reshape(*inputs.shape[:-1], sizes[-1])


def flat_layers(layers: Iterable[tuple[Singles, Singles]]) -> Singles:
    """Return the numbers of layers (weight, bias) of any shapes as one vector, in the order of
    `DenseLayers.flat`.
    """
    return np.concatenate(
        [numbers for weight, bias in layers for numbers in (bias, weight.T.ravel())]
    )


def weight_count(sizes: Sequence[int]) -> int:
    """Return the number of weights and biases for layer sizes (:attr:`DenseLayers.sizes`)."""
    return sum((below + 1) * above for below, above in pairwise(sizes))


def _array(name: str, values: ArrayLike, shape: tuple[int, ...]) -> Singles:
    with np.errstate(over="ignore"):  # infinity is refused below
        array = np.array(values, np.float32)
    if array.shape != shape:
        raise InputError(f"{name} have shape {array.shape}; they must have {shape}")
    if not np.isfinite(array).all():
        raise InputError(f"{name} hold NaN or infinity")
    array.setflags(write=False)
    return array


# The forward pass


@kernel
def dense_forward(flat, sizes, x, y, tanh):
    """Pass ``x[:sizes[0]]`` through all layers with numbers ``flat`` (:meth:`DenseLayers.flat`).

    ``x`` and ``y``, each of length ``max(sizes)``, are overwritten. The outputs are in ``y`` if the
    number of layers is odd, else in ``x``. A tanh or a ReLU follows each layer but the last.
    """
    at = 0
    layers = len(sizes) - 1
    for layer in range(layers):
        count = sizes[layer]
        width = sizes[layer + 1]
        for j in range(width):
            y[j] = flat[at + j]
        at += width
        # Four inputs at a time: the sums in ``y`` are loaded and stored once. Their products are
        # added in order: the rounding is the same as for one input at a time.
        whole = count - count % 4
        for i in range(0, whole, 4):
            a, b, c, d = x[i], x[i + 1], x[i + 2], x[i + 3]
            w0 = flat[at : at + width]
            w1 = flat[at + width : at + 2 * width]
            w2 = flat[at + 2 * width : at + 3 * width]
            w3 = flat[at + 3 * width : at + 4 * width]
            for j in range(width):
                y[j] = (((y[j] + a * w0[j]) + b * w1[j]) + c * w2[j]) + d * w3[j]
            at += 4 * width
        for i in range(whole, count):
            for j in range(width):
                y[j] += x[i] * flat[at + j]
            at += width
        if layer < layers - 1:
            for j in range(width):
                y[j] = hyperbolic_tangent(y[j]) if tanh else max(y[j], np.float32(0.0))
        # The outputs of this layer are the inputs of the next layer.
        x, y = y, x


@kernel
def dense_rows(rows, flat, sizes, tanh, squash, scratch, out):
    """Write the outputs of each row (R, D) into ``out`` (R, A); see :meth:`DenseLayers.forward`.

    ``scratch`` has shape (2, ``max(sizes)``); all are float32.
    """
    last = (len(sizes) - 1) % 2
    for r in range(len(rows)):
        for i in range(sizes[0]):
            scratch[0, i] = rows[r, i]
        dense_forward(flat, sizes, scratch[0], scratch[1], tanh)
        for j in range(out.shape[1]):
            value = scratch[last, j]
            out[r, j] = hyperbolic_tangent(value) if squash else value


# Files


def layers_to_bytes(layers: DenseLayers, others: Mapping[str, Singles] | None = None) -> bytes:
    """Return the content of a safetensors file: ``layers.N.weight``, ``layers.N.bias`` and other
    tensors by name.
    """
    tensors = dict(others or {})
    for i, (weight, bias) in enumerate(zip(layers.weights, layers.biases, strict=True)):
        tensors |= {f"layers.{i}.weight": weight, f"layers.{i}.bias": bias}
    return save_tensors({key: np.ascontiguousarray(value) for key, value in tensors.items()})


def tensors_from_bytes(file: Path, content: bytes) -> dict[str, Singles]:
    """Return the float32 tensors of a safetensors file by name; ``file`` is for messages."""
    try:
        tensors: dict[str, Singles] = load_tensors(content)
    except (SafetensorError, KeyError, TypeError, ValueError) as error:
        raise InputError(f"{file} is no safetensors file of numbers: {error}") from None
    for key, tensor in tensors.items():
        if tensor.dtype != np.float32:
            raise InputError(f"{file}: {key} is of type {tensor.dtype}; it must be float32")
    return tensors


def layers_from_bytes(
    file: Path, content: bytes, hidden: Any, others: Collection[str] = ()
) -> tuple[DenseLayers, dict[str, Singles]]:
    """Read the output of :func:`layers_to_bytes`: the layers, and the other tensors by name.

    ``hidden`` lists the widths of the hidden layers in the manifest, and ``others`` the names of
    the other tensors: the file must have exactly these. ``file`` is for messages.
    """
    if not isinstance(hidden, list) or not all(type(width) is int for width in hidden):
        raise InputError(
            f"{file.parent}: hidden is {hidden!r:.80}; it must be a list of whole numbers"
        )
    if len(hidden) >= MAX_LAYERS:
        raise InputError(
            f"{file.parent}: there are {len(hidden)} hidden layers; {MAX_LAYERS - 1} is the limit"
        )
    tensors = tensors_from_bytes(file, content)
    count = len(hidden) + 1
    odd = set(tensors) ^ {
        *others,
        *(f"layers.{i}.{kind}" for i in range(count) for kind in ("weight", "bias")),
    }
    if odd:
        names = ", ".join(sorted(odd))
        raise InputError(
            f"{file}: unknown or missing {names}; the manifest's hidden layers are {hidden}"
        )
    try:
        layers = DenseLayers(
            tuple(tensors[f"layers.{i}.weight"] for i in range(count)),
            tuple(tensors[f"layers.{i}.bias"] for i in range(count)),
        )
    except InputError as error:
        raise InputError(f"{file}: {error}") from None
    # Matching names do not imply matching widths.
    if list(layers.hidden) != hidden:
        raise InputError(
            f"{file} has hidden layers {list(layers.hidden)}; its manifest says {hidden}"
        )
    return layers, {key: tensors[key] for key in others}
