"""Summary of a round robin: score matrix, ratings, and the meta-game of choosing an agent.

In the meta-game each player chooses an agent, and the score matrix gives the payoffs. A rating is
one number and can't represent cycles (a beats b, b beats c, c beats a); the equilibrium of the
meta-game can.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.errors import InputError
from pcs_racing_agents.solvers.matrix_games import solve_matrix_games
from pcs_racing_agents.tournament.races import RaceTable
from pcs_racing_agents.tournament.ratings import Ratings, rate

Floats = NDArray[np.float64]


def excess(scores: ArrayLike) -> Floats:
    """Return the zero-sum payoffs of a score matrix: half of ``scores - scores.T``.

    ``scores`` (array_like, shape (N, N)): score of the row's agent against the column's agent. The
    diagonal is not used.
    """
    try:
        matrix = np.array(scores, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError("the scores must be a matrix of numbers") from None
    if matrix.ndim != 2 or matrix.size == 0 or matrix.shape[0] != matrix.shape[1]:
        raise InputError(f"the scores have shape {matrix.shape}; they must be a square matrix")
    np.fill_diagonal(matrix, 0.0)
    wrong = np.argwhere(~np.isfinite(matrix))
    if len(wrong):
        i, j = wrong[0]
        raise InputError(
            f"the score of row {i} against column {j} is {matrix[i, j]}; it must be a finite number"
        )
    return 0.5 * (matrix - matrix.T)


MIN_LINES = 5
"""Minimum number of start lines for a bootstrap interval."""


@dataclass(frozen=True, eq=False)
class RoundRobin:
    """Results of a round robin of N agents."""

    names: tuple[str, ...]  #: Names of N agents.
    #: shape (N, N): Score of the row's agent against the column's agent: share of races won, a tie
    #: counting half; NaN for pairs without races.
    scores: Floats
    ratings: Ratings | None  #: Ratings of the agents; None if they can't be estimated.
    #: shape (N,): Probabilities of the agents in an equilibrium of the meta-game; None unless all
    #: pairs met.
    equilibrium: Floats | None

    def rating(self, name: str) -> tuple[float, float, float]:
        """Return an agent's Elo-scale rating and both ends of its interval; NaN if unknown."""
        ratings = self.ratings
        if ratings is None or name not in ratings.names:
            return np.nan, np.nan, np.nan
        i = ratings.names.index(name)
        return tuple(
            float(value)
            for value in ratings.to_elo([ratings.strength[i], ratings.low[i], ratings.high[i]])
        )  # type: ignore[return-value]


def round_robin(names: Sequence[str], races: RaceTable, *, seed: int = 0) -> RoundRobin:
    """Summarise the races of a round robin.

    ``races``: races with the same start lines for all pairs. A crash without a winner is no tie.
    """
    first, second = drivers(names, races).T
    # A winner of -1 (a tie or a no-contest) indexes the last element.
    won = np.array([1.0, -1.0, 0.0])[races.winner]
    # No-contests count in a score (as lost for both), but contain no information for ratings.
    unpaid = races.crashed & (won == 0.0)
    total, count = np.zeros((len(names),) * 2), np.zeros((len(names),) * 2)
    paid = np.where(unpaid, 0.0, 0.5)
    np.add.at(total, (first, second), paid * (1.0 + won))
    np.add.at(total, (second, first), paid * (1.0 - won))
    np.add.at(count, (first, second), 1.0)
    np.add.at(count, (second, first), 1.0)
    scores = np.divide(total, count, out=np.full_like(total, np.nan), where=count > 0.0)
    # A game with a missing payoff has no equilibrium; a mean as a substitute would invent a result.
    met = bool((count[~np.eye(len(names), dtype=bool)] > 0.0).all())
    return RoundRobin(
        names=tuple(names),
        scores=scores,
        ratings=_ratings(
            np.array(names)[first], np.array(names)[second], won, unpaid, races.places, seed
        ),
        equilibrium=solve_matrix_games(excess(scores)).rows[0] if met else None,
    )


def drivers(names: Sequence[str], races: RaceTable) -> NDArray[np.intp]:
    """Return the agent in each car of each race as an index into ``names``, shape (N, 2)."""
    words = races.agents.words
    unknown = sorted({words[code] for code in np.unique(races.agents.codes).tolist()} - set(names))
    if unknown:
        raise InputError(f"{unknown[0]!r} raced, but is not one of {', '.join(names)}")
    index = np.array([names.index(word) if word in names else -1 for word in words], np.intp)
    return index[races.agents.codes]


def _ratings(
    ego: NDArray[np.str_],
    opponent: NDArray[np.str_],
    won: Floats,
    unpaid: NDArray[np.bool_],
    line: NDArray[np.intp],
    seed: int,
) -> Ratings | None:
    """Fit the ratings, with intervals if there are enough start lines."""
    # A bootstrap over few lines draws almost the same lines again: its interval is too short.
    several = len(np.unique(line[~unpaid])) >= MIN_LINES
    rng = (
        np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(6_000_000,)))
        if several
        else None
    )
    try:
        return rate(ego.tolist(), opponent.tolist(), won, unpaid=unpaid, unit=line, rng=rng)
    except InputError:  # no race counts, or groups of agents never met
        return None
