from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from random_layers import random_layers
from refusal import refused
from safetensors.numpy import load as load_tensors
from safetensors.numpy import save as save_tensors

from pcs_racing.base.dense import (
    DenseLayers,
    dense_forward,
    dense_rows,
    layers_from_bytes,
    layers_to_bytes,
)

FILE = Path("net/weights.safetensors")


def formula(own: DenseLayers, x: np.ndarray, tanh: bool) -> np.ndarray:
    for i, (weight, bias) in enumerate(zip(own.weights, own.biases, strict=True)):
        x = weight.astype(np.float64) @ x + bias
        x = np.tanh(x) if tanh else np.maximum(x, 0.0) if i < len(own.weights) - 1 else x
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


@given(st.integers(1, 30), st.integers(0, 2**32 - 1))
def test_a_row_has_the_same_bits_in_a_batch_of_any_size(rows, seed):
    own = random_layers(7, 9, 4)
    x = np.random.default_rng(seed).normal(size=(rows, 7)).astype(np.float32)

    def outputs(some: np.ndarray) -> np.ndarray:
        out = np.empty((len(some), 4), np.float32)
        assert dense_rows(some, own.flat(), np.array(own.sizes), np.empty((2, 9), np.float32), out)
        return out

    np.testing.assert_array_equal(
        outputs(x), np.concatenate([outputs(x[i : i + 1]) for i in range(rows)])
    )


def test_infinite_inputs_are_noticed_and_impossible_layers_refused():
    own, out = random_layers(3, 2), np.empty((1, 2), np.float32)
    rows = np.array([[0.0, np.inf, 0.0]], np.float32)
    assert not dense_rows(rows, own.flat(), np.array(own.sizes), np.empty((2, 3), np.float32), out)
    for weights, biases, message in [
        ((), (), "weights of 0 layers"),
        ([np.zeros((2, 3))], [], "1 layers and biases of 0"),
        ([np.zeros((2, 3)), np.zeros((2, 3))], [np.zeros(2)] * 2, r"layer 1 have shape \(2, 3\)"),
        ([np.zeros((2, 3))], [np.zeros(3)], r"biases of layer 0 have shape \(3,\)"),
        ([np.zeros((0, 3))], [np.zeros(0)], r"layer 0 have shape \(0, 3\)"),
        ([np.full((2, 3), np.nan)], [np.zeros(2)], "weights of layer 0 hold NaN"),
        ([np.zeros((2000, 2001))], [np.zeros(2000)], "4004000 weights"),
    ]:
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
