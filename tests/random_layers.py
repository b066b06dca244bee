"""Layers that have learned nothing."""

from itertools import pairwise

import numpy as np

from pcs_racing.base.dense import DenseLayers


def random_layers(*sizes: int, seed: int = 0) -> DenseLayers:
    """Layers of these sizes, of the inputs first, whose outputs are of the inputs' order of
    magnitude.
    """
    rng = np.random.default_rng(seed)
    return DenseLayers(
        tuple(rng.normal(0.0, below**-0.5, (above, below)) for below, above in pairwise(sizes)),
        tuple(rng.normal(0.0, 0.3, above) for above in sizes[1:]),
    )
