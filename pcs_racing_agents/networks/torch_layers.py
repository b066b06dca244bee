"""Dense layers in torch for training; torch for one training at a time.

torch's number of threads and its random generator belong to the whole process, so trainings run one
after another.
"""

import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import pairwise
from typing import Any

import numpy as np

from pcs_racing.base.dense import DenseLayers
from pcs_racing.base.errors import require

_TURN = threading.RLock()


@contextmanager
def torch_alone() -> Iterator[Any]:
    """Provide torch, limited to one thread, to one thread of this process at a time.

    Several threads gain nothing for networks of this size, and would change the order of sums.
    """
    require("torch", extra="learning")
    import torch

    with _TURN:
        before = torch.get_num_threads()
        torch.set_num_threads(1)
        try:
            yield torch
        finally:
            torch.set_num_threads(before)


def initial_layers(sizes: Sequence[int], rng: np.random.Generator) -> list[Any]:
    """Draw the parameters of layers before any training: weights as in He et al. 2015, biases 0.

    Returns
    -------
    list of tensor
        Weight and bias of each layer, alternating; they take gradients.
    """
    import torch

    parameters = []
    for i, (below, above) in enumerate(pairwise(sizes)):
        gain = 2.0 if i < len(sizes) - 2 else 1.0  # no ReLU follows the last layer
        weight = rng.normal(0.0, np.sqrt(gain / below), (above, below)).astype(np.float32)
        parameters += [torch.from_numpy(weight), torch.zeros(above, dtype=torch.float32)]
    for parameter in parameters:
        parameter.requires_grad_(True)
    return parameters


def relu_forward(parameters: Sequence[Any], x: Any) -> Any:
    """Return outputs of layers with ReLUs; ``parameters`` as from :func:`initial_layers`."""
    from torch import relu
    from torch.nn.functional import linear

    for i in range(0, len(parameters) - 2, 2):
        x = relu(linear(x, parameters[i], parameters[i + 1]))
    return linear(x, parameters[-2], parameters[-1])


def layers_from_torch(parameters: Sequence[Any]) -> DenseLayers:
    """Return a copy of parameters (alternating weights and biases) as layers without torch."""
    arrays = [parameter.detach().cpu().numpy() for parameter in parameters]
    return DenseLayers(tuple(arrays[::2]), tuple(arrays[1::2]))
