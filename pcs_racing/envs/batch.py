"""What batches of episodes have in common, over which all environments are written.

:class:`pcs_racing.envs.drive_batch.DriveBatch` and :class:`pcs_racing.envs.game_batch.GameBatch` have the same methods,
and an environment takes either. A batch advances E episodes at once, each with one or more players: an environment is
one player's view of an episode. Environment ``i`` belongs to player ``i % players`` of episode ``i // players``. Each
episode draws from a generator of its own, so a batch of any size gives the same numbers. What happens when an episode
ends is not the batch's business: :class:`pcs_racing.envs.single.SingleEnv` and
:class:`pcs_racing.envs.vector.BatchVectorEnv` see to that.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.checks import check_whole

Rows = NDArray[np.int64]
"""Numbers of episodes, or a number for each."""

Generators = Sequence[np.random.Generator]
"""A generator for each episode."""

MOST_EPISODES = 100_000


class BatchStep(NamedTuple):
    """What a step of n environments returns, in fresh arrays."""

    observations: NDArray[np.float32]  #: shape (n, D)
    rewards: NDArray[np.float64]  #: shape (n,)
    terminated: NDArray[np.bool_]  #: shape (n,)
    truncated: NDArray[np.bool_]  #: shape (n,)


def check_batch_size(episodes: int, threads: int | None) -> None:
    """Check the number of environments of a batch, and of threads."""
    check_whole("num_envs", episodes, 1, MOST_EPISODES)
    if threads is not None:
        check_whole("threads", threads, 1)
