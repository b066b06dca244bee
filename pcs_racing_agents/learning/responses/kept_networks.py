"""Networks that are trained as tasks of a job, and kept in its folder: a run that resumes does not train them again."""

import json
from collections.abc import Sequence
from concurrent.futures import Executor
from functools import partial
from typing import NamedTuple

import numpy as np

from pcs_racing.base.dense import DenseLayers
from pcs_racing.game.identity import GameIdentity
from pcs_racing_agents.jobs.chunks import Arrays
from pcs_racing_agents.jobs.fingerprint import fingerprint
from pcs_racing_agents.jobs.jobs import Job
from pcs_racing_agents.jobs.tasks import in_other_processes
from pcs_racing_agents.networks import RegretNetwork, Rows, train_network
from pcs_racing_agents.networks.settings import TrainSettings


class _NetworkTask(NamedTuple):
    """One network to train, by what it depends on."""

    rows: str  #: Digest of the rows that it learns from.
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
    """Return a network of advantages for each of several settings, all trained on the same rows.

    Parameters
    ----------
    job : Job
        Keeps the networks.
    part : str
        Name of this part of the job's work.
    name : str
        Of the networks.
    executor : Executor, optional
        Where they are trained, if its tasks run in other processes.
    """
    digest = fingerprint(rows.observations, rows.targets, rows.weights, rows.pair)
    tasks = [_NetworkTask(digest, one) for one in settings]
    kept = job.run(part, partial(_learn, rows, identity, name), tasks, executor=in_other_processes(executor))
    return [_unpacked(arrays, identity, name) for arrays in kept]


def _learn(rows: Rows, identity: GameIdentity, name: str, task: _NetworkTask) -> Arrays:
    network, _ = train_network(rows, identity, task.settings, name=name, target="advantage")
    layers = network.layers
    arrays = {f"weights_{i}": weights for i, weights in enumerate(layers.weights)}
    arrays |= {f"biases_{i}": biases for i, biases in enumerate(layers.biases)}
    training = np.array(json.dumps(dict(network.training)))
    return {**arrays, "mean": network.mean, "scale": network.scale, "training": training}


def _unpacked(arrays: Arrays, identity: GameIdentity, name: str) -> RegretNetwork:
    count = sum(key.startswith("weights_") for key in arrays)
    weights, biases = (tuple(arrays[f"{kind}_{i}"] for i in range(count)) for kind in ("weights", "biases"))
    return RegretNetwork(
        name=name,
        identity=identity,
        target="advantage",
        clipped=False,
        layers=DenseLayers(weights, biases),
        mean=arrays["mean"],
        scale=arrays["scale"],
        training=json.loads(str(arrays["training"])),
    )
