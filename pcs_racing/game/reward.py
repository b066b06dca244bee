"""Reward of a game of moves, paid once, when it ends; the two cars' rewards add up to 0."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.race.config import Rules
from pcs_racing.race.races import winners
from pcs_racing.race.state import RaceState

SERIES_TIE = 0.1  # m: sum of the leads of both legs below which a series is a tie


def utility(
    rules: Rules,
    lead: NDArray[np.float64],
    crashed: NDArray[np.bool_],
    fault: NDArray[np.int8],
    winner: NDArray[np.int8] | None,
) -> NDArray[np.float64]:
    """Return the utility of car 0 in finished races before the discount, shape (B,).

    ``winner`` is needed for the utility "win" only.
    """
    first = np.where(crashed, 0.0, lead) if rules.payoff == "lead" else lead
    if rules.payoff == "win":
        first = np.where(winner == 0, 1.0, np.where(winner == 1, -1.0, 0.0))
    blame = fault.astype(np.float64)
    return np.asarray(first + rules.fault_penalty * (blame[:, 1] - blame[:, 0]))


def reward(rules: Rules, races: RaceState, moves: ArrayLike) -> NDArray[np.float64]:
    """Return the reward of car 0 for finished games, shape (B,); car 1 gets the negative of it.

    ``moves`` are the numbers of moves made. Only progress, crashes and faults of the races count.
    """
    winner = winners(rules, races) if rules.payoff == "win" else None
    first = utility(rules, races.lead, races.crashed, races.fault, winner)
    made = np.asarray(moves)
    # A running product instead of "**": the last bits of "**" depend on the processor.
    factors = np.full(made.max(initial=0) + 1, rules.discount)
    factors[0] = 1.0
    return np.asarray(first * np.cumprod(factors)[made], np.float64)


def sum_winners(rules: Rules, sums: NDArray[Any]) -> NDArray[np.int8]:
    """Return the winners of series, -1 for a tie.

    ``sums`` holds car 0's wins less its defeats, or the sums of its utilities in both legs.
    """
    tie = SERIES_TIE if rules.legs == 2 else 0.5
    return np.where(np.abs(sums) < tie, -1, sums < 0.0).astype(np.int8)
