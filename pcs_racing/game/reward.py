"""Rewards of races, for all environments.

A game of moves pays once, when it ends (:func:`reward`); the two cars' rewards add up to 0. An
environment at the level of steering and speed pays in every step (:func:`step_reward`).
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.compilation import inner_kernel
from pcs_racing.game.config import GameConfig
from pcs_racing.race.races import winners
from pcs_racing.race.state import RaceState


def reward(config: GameConfig, races: RaceState, moves: ArrayLike) -> NDArray[np.float64]:
    """Return the reward of car 0 for finished games, shape (B,); car 1 gets the negative of it.

    ``moves`` are the numbers of moves made. Only progress, crashes and faults of the races count.
    """
    if config.utility == "win":
        winner = winners(config.race, races)
        first = np.where(winner == 0, 1.0, np.where(winner == 1, -1.0, 0.0))
    elif config.utility == "lead":
        first = np.where(races.crashed, 0.0, races.lead)
    else:  # "lead-at-crash"
        first = races.lead
    fault = races.fault.astype(np.float64)
    first = first + config.fault_penalty * (fault[:, 1] - fault[:, 0])
    made = np.asarray(moves)
    # A running product instead of "**": the last bits of "**" depend on the processor.
    factors = np.full(made.max(initial=0) + 1, config.discount)
    factors[0] = 1.0
    return np.asarray(first * np.cumprod(factors)[made], np.float64)


@inner_kernel
def step_reward(own, opponent, fault, weights):
    """Return the reward of one step of driving.

    It is the progress, minus a share of the opponent's progress, minus a penalty for a crash by own
    fault. The weights are the reward for a metre, the share of the opponent's progress, and the
    penalty.
    """
    per_metre, rivalry, penalty = weights
    return per_metre * (own - rivalry * opponent) - (penalty if fault == 1 else 0.0)
