"""Convolutions and recurrent units against their formulas."""

import numpy as np
from random_layers import random_layers

from pcs_racing.planners.lidar_networks import convolve, recur


def test_a_convolution_is_a_dense_layer_on_every_window():
    layers = random_layers(6, 4, seed=1)
    x, y = np.random.default_rng(2).normal(size=20), np.zeros(5 * 4)
    convolve(layers.flat().astype(float), (6, 4), 3, x, y)
    windows = np.lib.stride_tricks.sliding_window_view(x, 6)[::3]
    expected = np.maximum(windows @ layers.weights[0].T + layers.biases[0], 0.0)
    np.testing.assert_allclose(y.reshape(5, 4), expected, rtol=1e-6, atol=1e-9)


def test_recurrent_units_move_on_by_their_gates():
    from_inputs, from_state = random_layers(5, 9, seed=3), random_layers(3, 9, seed=4)
    flat = np.concatenate([from_inputs.flat(), from_state.flat()]).astype(float)
    rng = np.random.default_rng(5)
    x, state = rng.normal(size=5), rng.normal(size=3)
    a = (from_inputs.weights[0] @ x + from_inputs.biases[0]).reshape(3, 3)
    b = (from_state.weights[0] @ state + from_state.biases[0]).reshape(3, 3)
    reset, keep = 1.0 / (1.0 + np.exp(-(a + b)[:2]))
    expected = (1.0 - keep) * np.tanh(a[2] + reset * b[2]) + keep * state
    recur(flat, 5, 3, x, state, np.zeros(18))
    np.testing.assert_allclose(state, expected, rtol=1e-6)
