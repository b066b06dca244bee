"""Ensembles as single networks: the mean of several networks is a wider network with block-diagonal layers."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.dense import DenseLayers
from pcs_racing.base.errors import InputError
from pcs_racing_agents.networks import RegretNetwork


def merge_networks(networks: Sequence[RegretNetwork], name: str) -> RegretNetwork:
    """Return a network whose output is the mean of the outputs of several networks."""
    if len(networks) == 0:
        raise InputError("there is no network to merge; give at least one")
    first = networks[0]
    for network in networks:
        for key in ("identity", "target", "clipped"):
            if getattr(network, key) != getattr(first, key):
                raise InputError(f"networks {first.name!r} and {network.name!r} differ in {key}; they can't be merged")
        if len(network.layers.weights) != len(first.layers.weights):
            raise InputError(f"networks {first.name!r} and {network.name!r} have different numbers of layers")
    if first.clipped and len(networks) > 1:
        raise InputError("the mean of clipped networks is no network; merge networks that are not clipped")
    weights, biases = [], []
    last = len(first.layers.weights) - 1
    for layer in range(last + 1):
        # Each member scales its inputs in its own way; the merged network has the scaling of the first.
        blocks, shifts = zip(*(_layer(network, layer, first) for network in networks), strict=True)
        if layer == last:
            share = np.float64(1.0 / len(networks))
            weights.append(np.concatenate(blocks, axis=1) * share)
            biases.append(np.sum(shifts, axis=0) * share)
        else:
            weights.append(np.concatenate(blocks, axis=0) if layer == 0 else _diagonal(blocks))
            biases.append(np.concatenate(shifts))
    if last == 0:
        weights = [np.mean([_layer(network, 0, first)[0] for network in networks], axis=0)]
    return replace(
        first,
        name=name,
        layers=DenseLayers(tuple(weights), tuple(biases)),
        training={**first.training, "members": len(networks)},
    )


def _layer(network: RegretNetwork, layer: int, like: RegretNetwork) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    weight, bias = network.layers.weights[layer].astype(np.float64), network.layers.biases[layer].astype(np.float64)
    if layer > 0:
        return weight, bias
    ratio = like.scale.astype(np.float64) / network.scale
    shift = (like.mean.astype(np.float64) - network.mean) / network.scale
    return weight * ratio, bias + (weight * shift).sum(axis=1)


def _diagonal(blocks: Sequence[NDArray[np.float64]]) -> NDArray[np.float64]:
    out = np.zeros((sum(len(block) for block in blocks), sum(block.shape[1] for block in blocks)))
    row = column = 0
    for block in blocks:
        out[row : row + len(block), column : column + block.shape[1]] = block
        row, column = row + len(block), column + block.shape[1]
    return out
