"""Small networks and trees without races."""

import numpy as np
from random_layers import random_layers

from pcs_racing.base.dense import DenseLayers
from pcs_racing.game.identity import GameIdentity
from pcs_racing_agents.networks import RegretNetwork

MOVES = ("aggressiveness +", "aggressiveness -", "restraint +", "restraint -")


def identity(inputs=7, moves=MOVES, **changes) -> GameIdentity:
    values = {
        "elements": tuple(f"x{i}" for i in range(inputs)),
        "moves": moves,
        "epsilon": (0.5,),
        "archive": "toy",
        "archive_sha256": "0" * 64,
        "rules": "paper",
    }
    return GameIdentity(**{**values, **changes})


def random_network(inputs=7, hidden=(16, 16), seed=0, clipped=False, **changes) -> RegretNetwork:
    rng = np.random.default_rng(seed)
    values = {
        "name": "toy",
        "identity": identity(inputs),
        "target": "regret" if clipped else "advantage",
        "clipped": clipped,
        "layers": random_layers(inputs, *hidden, len(MOVES), seed=seed),
        "mean": rng.normal(0.0, 1.0, inputs),
        "scale": rng.uniform(0.2, 2.0, inputs),
        "training": {"rows": 10, "validation_loss": 0.5, "setting_target": "advantage"},
    }
    return RegretNetwork(**{**values, **changes})


def plain_network(weight, bias=None, **changes) -> RegretNetwork:
    """A network without hidden layers that takes observations as they are."""
    outputs, inputs = np.shape(weight)
    layers = DenseLayers((weight,), (np.zeros(outputs) if bias is None else bias,))
    return random_network(
        inputs, layers=layers, mean=np.zeros(inputs), scale=np.ones(inputs), **changes
    )
