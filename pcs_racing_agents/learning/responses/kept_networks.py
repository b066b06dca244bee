"""Networks trained as tasks of a job and cached in its folder: a resumed run does not retrain them.

The mean of several networks is a wider network with block-diagonal layers.
"""

import json
from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.dense import DenseLayers, layers_from_bytes, layers_to_bytes
from pcs_racing.game.identity import GameIdentity
from pcs_racing_agents.base.chunks import Arrays
from pcs_racing_agents.base.fingerprint import fingerprint
from pcs_racing_agents.base.jobs import Job
from pcs_racing_agents.base.tasks import in_other_processes
from pcs_racing_agents.networks import RegretNetwork, Rows, train_network
from pcs_racing_agents.networks.settings import TrainSettings


def merge_networks(networks: Sequence[RegretNetwork], name: str) -> RegretNetwork:
    """Return a network that outputs the mean of the outputs of networks of one kind and shape."""
    from scipy.linalg import block_diag

    first = networks[0]
    weights, biases = [], []
    last = len(first.layers.weights) - 1
    for layer in range(last + 1):
        # Members have different input scalings; the merged network has the first member's scaling.
        blocks, shifts = zip(*(_layer(network, layer, first) for network in networks), strict=True)
        if layer == last:
            share = np.float64(1.0 / len(networks))
            weights.append(np.concatenate(blocks, axis=1) * share)
            biases.append(np.sum(shifts, axis=0) * share)
        else:
            weights.append(np.concatenate(blocks, axis=0) if layer == 0 else block_diag(*blocks))
            biases.append(np.concatenate(shifts))
    if last == 0:
        weights = [np.mean([_layer(network, 0, first)[0] for network in networks], axis=0)]
    return replace(
        first,
        name=name,
        layers=DenseLayers(tuple(weights), tuple(biases)),
        training={**first.training, "members": len(networks)},
    )


def _layer(
    network: RegretNetwork, layer: int, like: RegretNetwork
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    weight, bias = (
        network.layers.weights[layer].astype(np.float64),
        network.layers.biases[layer].astype(np.float64),
    )
    if layer > 0:
        return weight, bias
    # (x - mean) / scale of this network, in terms of the scaled inputs of the first network.
    ratio = like.scale.astype(np.float64) / network.scale
    shift = (like.mean.astype(np.float64) - network.mean) / network.scale
    return weight * ratio, bias + (weight * shift).sum(axis=1)


class _NetworkTask(NamedTuple):
    """One network to train, identified by its inputs."""

    rows: str  #: Digest of the training rows.
    settings: TrainSettings


def train_kept(
    job: Job,
    part: str,
    rows: Rows,
    identity: GameIdentity,
    settings: Sequence[TrainSettings],
    name: str,
    executor: Executor | None = None,
) -> list[RegretNetwork]:
    """Return an advantage network for each of several settings, all trained on the same rows.

    ``job``: cache of the networks. ``executor``: executor of the training, if its tasks run in
    other processes.
    """
    # Rows are large and common to all members: a task holds their digest, the function holds them.
    digest = fingerprint(rows.observations, rows.targets, rows.weights, rows.pair)
    tasks = [_NetworkTask(digest, one) for one in settings]
    kept = job.run(
        part, partial(_learn, rows, identity, name), tasks, executor=in_other_processes(executor)
    )
    return [
        _unpacked(arrays, identity, name, one) for arrays, one in zip(kept, settings, strict=True)
    ]


def _learn(rows: Rows, identity: GameIdentity, name: str, task: _NetworkTask) -> Arrays:
    network, _ = train_network(rows, identity, task.settings, name=name, target="advantage")
    return {
        "layers": np.frombuffer(layers_to_bytes(network.layers), np.uint8),
        "mean": network.mean,
        "scale": network.scale,
        "training": np.array(json.dumps(dict(network.training))),
    }


def _unpacked(
    arrays: Arrays, identity: GameIdentity, name: str, settings: TrainSettings
) -> RegretNetwork:
    content = arrays["layers"].tobytes()
    return RegretNetwork(
        name=name,
        identity=identity,
        target="advantage",
        clipped=False,
        layers=layers_from_bytes(Path(name), content, list(settings.hidden))[0],
        mean=arrays["mean"],
        scale=arrays["scale"],
        training=json.loads(str(arrays["training"])),  # losses may be NaN
    )
