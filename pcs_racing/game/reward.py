"""Reward of a game of moves, paid once, when it ends; the two cars' rewards add up to 0."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.race.config import Rules
from pcs_racing.race.races import winners
from pcs_racing.race.state import RaceState


def reward(rules: Rules, races: RaceState, moves: ArrayLike) -> NDArray[np.float64]:
    """Return the reward of car 0 for finished games, shape (B,); car 1 gets the negative of it.

    ``moves`` are the numbers of moves made. Only progress, crashes and faults of the races count.
    """
    if rules.payoff == "win":
        winner = winners(rules, races)
        first = np.where(winner == 0, 1.0, np.where(winner == 1, -1.0, 0.0))
    elif rules.payoff == "lead":
        first = np.where(races.crashed, 0.0, races.lead)
    else:  # "lead-at-crash"
        first = races.lead
    fault = races.fault.astype(np.float64)
    first = first + rules.fault_penalty * (fault[:, 1] - fault[:, 0])
    made = np.asarray(moves)
    # A running product instead of "**": the last bits of "**" depend on the processor.
    factors = np.full(made.max(initial=0) + 1, rules.discount)
    factors[0] = 1.0
    return np.asarray(first * np.cumprod(factors)[made], np.float64)
