"""Random draws of moves from a mixed strategy without a generator: a draw is a hash of the observation and a seed.

The same agent makes the same move for the same observation, in a batch of any size and in any order, so that a race
can be simulated again to the last bit. To an opponent who does not know the seed the moves are as good as random.
"""

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.compilation import compiled, kernel


@compiled(inline="always")
def _mix(x):  # type: ignore[no-untyped-def]
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return x ^ (x >> np.uint64(31))


@kernel
def _hash(words, seed, out):  # type: ignore[no-untyped-def]
    golden = np.uint64(0x9E3779B97F4A7C15)
    first = _mix((seed + np.uint64(1)) * golden)
    for row in range(words.shape[0]):
        state = first
        for column in range(words.shape[1]):
            state = _mix((state ^ np.uint64(words[row, column])) + golden)
        out[row] = state


def hash_rows(rows: NDArray[np.float32], seed: int) -> NDArray[np.uint64]:
    """Return 64 bits for the bytes of each row of shape (B, D): splitmix64 (Steele et al. 2014) over its words."""
    words = np.ascontiguousarray(rows + np.float32(0.0)).view(np.uint32)  # -0 and 0 are the same number
    out = np.empty(len(rows), np.uint64)
    _hash(words, np.uint64(seed), out)
    return out


def draw(probabilities: NDArray[np.float64], observations: NDArray[np.float32], seed: int) -> NDArray[np.int64]:
    """Draw a column of each row of probabilities (B, M) by the hash of the observation (B, D), shape (B,)."""
    share = (hash_rows(observations, seed) >> np.uint64(11)).astype(np.float64) * 2.0**-53
    edges = np.cumsum(probabilities, axis=1)
    # In units of the total, so that rounding in the sum never leaves a gap at the end.
    column = (edges <= (share * edges[:, -1])[:, None]).sum(axis=1)
    last = probabilities.shape[1] - 1 - np.argmax(probabilities[:, ::-1] > 0.0, axis=1)
    return np.minimum(column, last)
