"""Values of the moves of ego trees, and training rows with them as targets.

The value of a move depends on what follows. ``"best"`` takes the best moves in hindsight: it knows the opponent's
moves and the noise to come, as no driver does, so it is an upper bound. A continuation policy that sees observations
only has no such bias; with policies learned from the rows of later steps it is fitted value iteration.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.errors import InputError
from pcs_racing_agents.networks.rows import Rows, pair_number
from pcs_racing_agents.trees.ego import EgoTrees

Floats = NDArray[np.float64]

Continuation = str | Callable[[NDArray[np.float32]], ArrayLike]


def ego_values(trees: EgoTrees, continuation: Continuation = "best") -> list[tuple[Floats, Floats]]:
    """Return the values of all moves and situations under a continuation.

    Parameters
    ----------
    continuation : "best" or callable
        Car 0's further moves: the best in hindsight, or with the probabilities ``continuation(observations (n, D)) ->
        (n, A)``.

    Returns
    -------
    list of (ndarray (R, A**k, A), ndarray (R, A**k))
        For each step ``k`` the value of each move, and the return of the continuation from there.
    """
    if isinstance(continuation, str) and continuation != "best":
        raise InputError(f'continuation is {continuation!r}; it must be "best" or a function of observations')
    value = np.asarray(trees.payoffs, np.float64)
    values: list[tuple[Floats, Floats]] = []
    for level in range(trees.moves - 1, -1, -1):
        q = value.reshape(len(trees), -1, trees.options)
        if callable(continuation):
            observations = trees.observations(level)
            policy = np.asarray(continuation(observations.reshape(-1, observations.shape[-1])), np.float64)
            if policy.shape != (q.size // trees.options, trees.options) or not np.isfinite(policy).all():
                raise InputError(
                    f"the continuation returned shape {policy.shape} for {q.size // trees.options} observations; it "
                    f"must return finite probabilities of {trees.options} moves"
                )
            if (policy < 0.0).any() or not np.allclose(policy.sum(axis=1), 1.0, atol=1e-4):
                raise InputError("the continuation's probabilities must be 0 or above and sum up to 1")
            value = (q * policy.reshape(q.shape)).sum(axis=-1)
        else:
            value = q.max(axis=-1)
        values.append((q, value))
    return values[::-1]


def ego_rows(trees: EgoTrees, continuation: Continuation = "best") -> Rows:
    """Return training rows: car 0's observations, and the values of its moves (:func:`ego_values`).

    Situations that histories of the same policies share are one row; its weight is the probability to get there with
    moves at random. Races that are over give none.
    """
    blocks = []
    for level, (q, _) in enumerate(ego_values(trees, continuation)):
        paths = trees.paths[level]
        first = np.zeros(paths.shape, np.bool_)
        weight = np.zeros(paths.shape)
        for r, numbers in enumerate(paths):
            _, begin, times = np.unique(numbers, return_index=True, return_counts=True)
            first[r, begin] = True
            weight[r, begin] = times / paths.shape[1]
        at = np.nonzero(first & ~trees.over[level])
        pair = pair_number(trees.policies)[at[0]]
        blocks.append((trees.observations(level)[at], q[at], weight[at], pair, np.full(len(pair), level, np.int64)))
    observations, targets, weights, pair, step = (np.concatenate(arrays) for arrays in zip(*blocks, strict=True))
    if len(targets) == 0:
        raise InputError("every race is over before the first move; no ego tree gives a row")
    return Rows(observations, targets, weights, pair, step)
