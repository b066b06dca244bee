"""The forward pass of a small network, compiled: a row's result is the same to the bit in a batch of any size.

A matrix product of numpy would be shorter, but its rounding depends on the number of rows, and a driver must not
decide otherwise because it raced in a larger batch.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.compilation import kernel

__all__ = ["forward", "pack_layers"]

Floats = NDArray[np.float32]


def pack_layers(weights: Sequence[Floats], biases: Sequence[Floats]) -> tuple[NDArray[np.int64], Floats]:
    """Put layers into one vector: of each layer its biases, then for each input the weights to all outputs.

    Parameters
    ----------
    weights : sequence of ndarray, shape (out, in)
    biases : sequence of ndarray, shape (out,)

    Returns
    -------
    sizes : ndarray, shape (L + 1,), int64
        Numbers going in, and coming out of each layer.
    packed : ndarray, float32
    """
    sizes = np.array([weights[0].shape[1], *(len(bias) for bias in biases)], np.int64)
    parts = [part for weight, bias in zip(weights, biases, strict=True) for part in (bias, weight.T.ravel())]
    return sizes, np.concatenate(parts).astype(np.float32)


@kernel
def forward(x, sizes, packed, scratch, out):  # type: ignore[no-untyped-def]
    """Compute ``out = W_L relu(... relu(W_1 x + b_1) ...) + b_L`` row by row; says whether all inputs are finite.

    Parameters
    ----------
    x : float32 array, shape (R, D)
    sizes, packed
        See :func:`pack_layers`.
    scratch : float32 array, shape (2, largest of ``sizes``)
    out : float32 array, shape (R, A)
        Written.
    """
    layers = len(sizes) - 1
    finite = True
    for r in range(len(x)):
        for i in range(sizes[0]):
            finite &= np.isfinite(x[r, i])
            scratch[0, i] = x[r, i]
        at = 0
        for layer in range(layers):
            width = sizes[layer + 1]
            below = scratch[layer % 2]
            above = scratch[(layer + 1) % 2]
            for j in range(width):
                above[j] = packed[at + j]
            at += width
            count = sizes[layer]
            whole = count - count % 4
            for i in range(0, whole, 4):  # four inputs at a time: the sums in ``above`` are loaded and stored once
                a, b, c, d = below[i], below[i + 1], below[i + 2], below[i + 3]
                w0 = packed[at : at + width]
                w1 = packed[at + width : at + 2 * width]
                w2 = packed[at + 2 * width : at + 3 * width]
                w3 = packed[at + 3 * width : at + 4 * width]
                for j in range(width):
                    above[j] = (((above[j] + a * w0[j]) + b * w1[j]) + c * w2[j]) + d * w3[j]
                at += 4 * width
            for i in range(whole, count):
                for j in range(width):
                    above[j] += below[i] * packed[at + j]
                at += width
            if layer < layers - 1:
                for j in range(width):
                    above[j] = max(above[j], np.float32(0.0))
        for j in range(sizes[layers]):
            out[r, j] = scratch[layers % 2, j]
    return finite
