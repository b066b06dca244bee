"""The meta-game of a tournament: each player chooses an agent, and the score matrix gives the payoffs.

A rating is one number and can't represent cycles (a beats b, b beats c, c beats a). The equilibrium of this game and
alpha-rank can.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.errors import InputError
from pcs_racing.base.optional import require
from pcs_racing_agents.solvers.matrix_games import solve_matrix_games

Floats = NDArray[np.float64]


class Equilibrium(NamedTuple):
    """An equilibrium of a two-player zero-sum game."""

    value: float  #: Payoff of the row player.
    row: Floats  #: shape (R,): Probabilities of the row player.
    column: Floats  #: shape (C,): Probabilities of the column player.
    exploitability: float  #: Sum of both players' gains from a best response: 0 up to rounding.


def excess(scores: ArrayLike) -> Floats:
    """Return the zero-sum payoffs of a score matrix: half of ``scores - scores.T``.

    Parameters
    ----------
    scores : array_like, shape (N, N)
        Score of the row's agent against the column's. The diagonal is not used.
    """
    matrix = _matrix(scores, square=True)
    return 0.5 * (matrix - matrix.T)


def zero_sum_equilibrium(payoffs: ArrayLike) -> Equilibrium:
    """Solve a matrix game exactly (:func:`pcs_racing_agents.solvers.solve_matrix_games`).

    If several equilibria exist, for instance because two agents are equal, it is one of them; the value is the same for
    all.

    Parameters
    ----------
    payoffs : array_like, shape (R, C)
        Payoff of the row player, who maximises it; the column player minimises it.
    """
    solution = solve_matrix_games(_matrix(payoffs))
    return Equilibrium(float(solution.values[0]), solution.rows[0], solution.columns[0], float(solution.gaps[0]))


def alpha_rank(scores: ArrayLike, *, epsilon: float = 0.001, tolerance: float = 0.0) -> Floats:
    """Return the stationary distribution over agents of alpha-rank (Omidshafiei et al. 2019), by OpenSpiel.

    A population of one agent changes to another one that beats it, or, with probability ``epsilon``, to one that it
    beats (the limit of strong selection). Only the sign of a difference in score counts, so differences within the
    noise should count as none.

    Parameters
    ----------
    scores : array_like, shape (N, N)
        Score of the row's agent against the column's, N at least 2; the diagonal is not used.
    epsilon : float
        From 1e-6 to 0.5.
    tolerance : float
        Differences in score up to this one count as none.

    Returns
    -------
    ndarray, shape (N,)
        Shares, which sum up to 1.
    """
    gain = 2.0 * excess(scores)
    if len(gain) < 2:
        raise InputError("there is 1 agent; a ranking needs at least 2")
    if not 1e-6 <= epsilon <= 0.5:
        raise InputError(f"epsilon is {epsilon!r}; it must be from 1e-6 to 0.5")
    if not 0.0 <= tolerance < np.inf:
        raise InputError(f"tolerance is {tolerance!r}; it must be a difference in score, 0 or more")
    require("pyspiel", "networkx", extra="games")
    from open_spiel.python.egt import alpharank

    decided = np.where(np.abs(gain) > tolerance, gain, 0.0)
    return np.asarray(alpharank.compute([decided], use_inf_alpha=True, inf_alpha_eps=epsilon)[2], dtype=np.float64)


def _matrix(values: ArrayLike, *, square: bool = False) -> Floats:
    try:
        matrix = np.array(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError("the payoffs must be a matrix of numbers") from None
    if matrix.ndim != 2 or matrix.size == 0 or (square and matrix.shape[0] != matrix.shape[1]):
        raise InputError(f"the payoffs have shape {matrix.shape}; they must be a {'square ' if square else ''}matrix")
    if square:
        np.fill_diagonal(matrix, 0.0)
    wrong = np.argwhere(~np.isfinite(matrix))
    if len(wrong):
        i, j = wrong[0]
        raise InputError(f"the payoff of row {i} against column {j} is {matrix[i, j]}; it must be a finite number")
    return matrix
