from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st
from random_layers import random_layers
from refusal import refused
from safetensors.numpy import load as load_tensors, save as save_tensors

from pcs_racing.base.dense import (
    DenseLayers,
    dense_forward,
    layers_from_bytes,
    layers_to_bytes,
)

FILE = Path("net/weights.safetensors")


def formula(own: DenseLayers, x: np.ndarray, tanh: bool) -> np.ndarray:
    for i, (weight, bias) in enumerate(zip(own.weights, own.biases, strict=True)):
        x = weight.astype(np.float64) @ x + bias
        if i < len(own.weights) - 1:
            x = np.tanh(x) if tanh else np.maximum(x, 0.0)
    return x


@pytest.mark.parametrize("sizes", [(7, 4), (7, 5, 4), (16, 64, 64, 2), (3, 50, 7, 1)])
@pytest.mark.parametrize("tanh", [False, True])
def test_the_forward_pass_is_the_formula(sizes, tanh):
    own, x = random_layers(*sizes), np.random.default_rng(1).normal(size=sizes[0])
    first, second = np.zeros((2, max(sizes)))
    first[: sizes[0]] = x
    dense_forward(own.flat().astype(np.float64), sizes, first, second, tanh)
    outputs = (second if len(sizes) % 2 == 0 else first)[: sizes[-1]]
    np.testing.assert_allclose(outputs, formula(own, x, tanh), atol=1e-12)
    for squash in (False, True):
        found = own.forward(x[None, None], tanh=tanh, squash=squash)
        assert (found.shape, found.dtype) == ((1, 1, sizes[-1]), np.float32)
        expected = np.tanh(outputs) if squash else outputs
        np.testing.assert_allclose(found[0, 0], expected, atol=1e-5)


@given(st.integers(0, 30), st.integers(0, 2**32 - 1))
def test_a_row_has_the_same_bits_in_a_batch_of_any_size(rows, seed):
    own = random_layers(7, 9, 4)
    x = np.random.default_rng(seed).normal(size=(rows, 7)).astype(np.float32)
    alone = [own.forward(x[i : i + 1]) for i in range(rows)]
    np.testing.assert_array_equal(own.forward(x), np.concatenate([*alone, np.empty((0, 4), "f")]))


@pytest.mark.parametrize(
    ("weights", "biases", "message"),
    [
        ((), (), "weights of 0 layers"),
        ([np.zeros((2, 3))], [], "1 layers and biases of 0"),
        ([np.zeros((2, 3)), np.zeros((2, 3))], [np.zeros(2)] * 2, r"layer 1 have shape \(2, 3\)"),
        ([np.zeros((2, 3))], [np.zeros(3)], r"biases of layer 0 have shape \(3,\)"),
        ([np.zeros((0, 3))], [np.zeros(0)], r"layer 0 have shape \(0, 3\)"),
        ([np.full((2, 3), np.nan)], [np.zeros(2)], "weights of layer 0 hold NaN"),
        ([np.zeros((2000, 2001))], [np.zeros(2000)], "4004000 weights"),
    ],
)
def test_impossible_layers_are_refused(weights, biases, message):
    refused(message, DenseLayers, weights, biases)


def test_layers_are_a_value_that_reads_back_exactly():
    own = random_layers(5, 3, 2)
    assert (own.sizes, own.hidden) == ((5, 3, 2), (3,))
    assert own.flat().tolist()[:4] == [*own.biases[0].tolist(), own.weights[0][0, 0]]
    assert len(own.flat()) == 6 * 3 + 4 * 2
    for array in (*own.weights, *own.biases):
        assert array.dtype == np.float32
        refused("read-only", array.fill, 0.0, error=ValueError)
    own, scale = random_layers(5, 3, 2), np.arange(5, dtype=np.float32)
    found, others = layers_from_bytes(FILE, layers_to_bytes(own, {"scale": scale}), [3], ["scale"])
    np.testing.assert_array_equal(found.flat(), own.flat())
    np.testing.assert_array_equal(others["scale"], scale)


@pytest.mark.parametrize(
    ("change", "hidden", "message"),
    [
        ({}, [4], r"has hidden layers \[3\]"),
        ({}, [3, 3], r"layers.2.bias, layers.2.weight"),
        ({}, "3", "hidden is '3'"),
        ({}, [3] * 16, "16 hidden layers"),
        ({"extra": np.zeros(3, np.float32)}, [3], "unknown or missing extra"),
        ({"layers.0.bias": np.zeros(3)}, [3], "layers.0.bias is of type float64"),
        ({"layers.0.bias": np.full(3, np.nan, "f")}, [3], "biases of layer 0 hold NaN"),
    ],
)
def test_files_of_something_else_are_refused(change, hidden, message):
    content = save_tensors({**load_tensors(layers_to_bytes(random_layers(5, 3, 2))), **change})
    refused(message, layers_from_bytes, FILE, content, hidden)
    refused("no safetensors file", layers_from_bytes, FILE, content[:-4], [3])
