"""Compiled exact solver for many zero-sum matrix games.

An agent that looks ahead solves thousands of small games for one decision, so the simplex method is
compiled here: a game of 5 x 5 moves takes 1 microsecond, with scipy's HiGHS 4 milliseconds. It does
the same operations on every processor, so that agents make the same moves everywhere.

A saddle point is taken if there is one. Otherwise the simplex method solves the linear program of
Dantzig (1951): with all payoffs made positive, the column player finds max sum(y) subject to P y <=
1, y >= 0; the game's value is 1 / sum(y), and the dual solution is the row player's strategy. The
remaining gains of both players are measured on every solution. If rounding fails on a game with
nearly equal moves (payoffs that differ by a billionth of their range), the payoffs are rounded, so
that these moves become equal, and the game is solved once more; both players together can then
gain a ten millionth of the range.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from pcs_racing.base.compilation import compiled, first_call, kernel
from pcs_racing.base.errors import InputError
from pcs_racing_agents.solvers.game_tree import Floats

TOLERANCE = 1e-14
"""Min reduced cost of a move, in units of the payoffs' range, for another simplex step."""

MIN_PIVOT = 1e-11
"""Min pivot, in units of the payoffs' range."""

GOOD_GAP = 1e-12
"""Gap, in units of the payoffs' range, above which a game is solved again with rounded payoffs."""

PARTS = 2.0**24
"""Number of steps of rounded payoffs in their range."""


class MatrixSolution(NamedTuple):
    """Equilibria of B matrix games."""

    values: Floats  #: shape (B,): Payoff to the row player.
    #: shapes (B, A) and (B, C): Strategies of the row player (``rows``), who maximises, and of the
    #: column player (``columns``), who minimises.
    rows: Floats
    columns: Floats
    #: shape (B,): Sum of both players' possible gains by best responses: rounding errors.
    gaps: Floats


def solve_matrix_games(payoffs: ArrayLike) -> MatrixSolution:
    """Solve zero-sum matrix games.

    If a game has several equilibria, one of them is returned, always the same.

    Parameters
    ----------
    payoffs : array, shape (B, A, C) or (A, C)
        Payoffs to the row player, with A moves against C; the column player gets minus the payoffs.
    """
    # Writeable, although nothing is written: numba compiles read-only arrays, such as a tree's, as
    # a type of their own.
    games = np.require(payoffs, np.float64, ["C", "W"])
    if games.ndim not in (2, 3) or 0 in games.shape:
        raise InputError(
            f"payoffs have shape {games.shape}; they must have (B, A, C) or (A, C), none of them 0"
        )
    if not np.isfinite(games).all():
        raise InputError("payoffs of a matrix game must be finite")
    games = games.reshape(-1, *games.shape[-2:])
    count, a, c = games.shape
    solution = MatrixSolution(
        np.empty(count), np.empty((count, a)), np.empty((count, c)), np.empty(count)
    )
    with first_call(_solve_games, "the solver of matrix games", 28.0):
        _solve_games(games, *solution)
    low = games.min(axis=(1, 2))
    span = games.max(axis=(1, 2)) - low
    # Written so that a gap of NaN counts as too large.
    for g in np.flatnonzero(~(solution.gaps <= GOOD_GAP * span)):
        above, own = games[g] - low[g], slice(g, g + 1)
        _solve_games(
            np.round(above[None] / span[g] * PARTS) / PARTS, *(part[own] for part in solution)
        )
        rows, columns = solution.rows[g], solution.columns[g]
        solution.values[g] = low[g] + rows @ above @ columns
        solution.gaps[g] = max(0.0, (above @ columns).max() - (rows @ above).min())
    return solution


@compiled
def _solve_games(games, values, rows, columns, gaps):
    """Solve games of shape (B, A, C) into the arrays of a :class:`MatrixSolution`."""
    count, a, c = games.shape
    table = np.empty((a + 1, c + 1))
    labels = np.empty(a + c, np.int64)
    for g in range(count):
        game, row, column = games[g], rows[g], columns[g]
        low, high = bounds(game)
        gaps[g] = 0.0
        if not _saddle_point(game, row, column):
            _simplex(game, low, high, table, labels, row, column)
            gaps[g] = abs(_duality_gap(game, low, row, column))
        values[g] = _expected(game, low, row, column)


@kernel
def _saddle_point(game, row, column):
    """Return whether a pure equilibrium exists; write the first one into ``row`` and ``column``."""
    a, c = game.shape
    best, best_row = -np.inf, 0
    for i in range(a):
        worst = game[i, 0]
        for j in range(1, c):
            worst = min(worst, game[i, j])
        if worst > best:
            best, best_row = worst, i
    least, least_column = np.inf, 0
    for j in range(c):
        most = game[0, j]
        for i in range(1, a):
            most = max(most, game[i, j])
        if most < least:
            least, least_column = most, j
    if best < least:
        return False
    for i in range(row.size):
        row[i] = 0.0
    for i in range(column.size):
        column[i] = 0.0
    row[best_row] = 1.0
    column[least_column] = 1.0
    return True


@kernel
def bounds(game):
    """Return min and max payoff."""
    low, high = game[0, 0], game[0, 0]
    for i in range(game.shape[0]):
        for j in range(game.shape[1]):
            low, high = min(low, game[i, j]), max(high, game[i, j])
    return low, high


@kernel
def _expected(game, low, row, column):
    """Return the expected payoff to the row player.

    It is summed above the min payoff: a large common offset costs no digits.
    """
    total = 0.0
    for i in range(row.size):
        for j in range(column.size):
            total += row[i] * (game[i, j] - low) * column[j]
    return low + total


@kernel
def _duality_gap(game, low, row, column):
    """Return the max payoff against the column player minus the min payoff against the row player.

    Each is the payoff of a best response.
    """
    most, least = -np.inf, np.inf
    for i in range(row.size):
        total = 0.0
        for j in range(column.size):
            total += (game[i, j] - low) * column[j]
        most = max(most, total)
    for j in range(column.size):
        total = 0.0
        for i in range(row.size):
            total += (game[i, j] - low) * row[i]
        least = min(least, total)
    return most - least


@kernel
def _simplex(game, low, high, table, labels, row, column):
    """Solve a game that has no saddle point by the simplex method on a condensed tableau.

    ``labels`` holds the variable of each row of the tableau, then the variable of each column: 0 to
    C - 1 are the column player's moves, C + i is the slack of the row player's move i. Moves enter
    by the max gain, and after a while by the min label (Bland 1977), which never cycles.
    """
    a, c = game.shape
    _begin(game, low, high, table, labels)
    for step in range(50 * (a + c)):
        # The max gain is the faster rule, but it can cycle if many moves are equal.
        bland = step >= 4 * (a + c)
        enter = _entering(table, labels, a, c, bland)
        if enter < 0:
            break
        leave = _leaving(table, labels, a, c, enter, bland)
        if leave < 0:
            break
        _pivot(table, labels, a, c, leave, enter)
    for i in range(row.size):
        row[i] = 0.0
    for i in range(column.size):
        column[i] = 0.0
    for i in range(a):
        if labels[i] < c:
            column[labels[i]] = max(table[i, c], 0.0)
    for j in range(c):
        if labels[a + j] >= c:
            row[labels[a + j] - c] = max(table[a, j], 0.0)
    _normalise(row)
    _normalise(column)


@kernel
def _begin(game, low, high, table, labels):
    """Write the tableau of the basis of slacks, with payoffs scaled into [1, 2]."""
    a, c = game.shape
    scale = 1.0 / (high - low)
    for i in range(a):
        for j in range(c):
            table[i, j] = 1.0 + (game[i, j] - low) * scale
        table[i, c] = 1.0
        labels[i] = c + i
    for j in range(c):
        table[a, j] = -1.0
        labels[a + j] = j
    table[a, c] = 0.0


@kernel
def _entering(table, labels, a, c, bland):
    """Return the column of the variable to enter, or -1 at the optimum."""
    column = -1
    for j in range(c):
        if table[a, j] < -TOLERANCE:
            if column < 0:
                column = j
            elif bland:
                if labels[a + j] < labels[a + column]:
                    column = j
            elif table[a, j] < table[a, column]:
                column = j
    return column


@kernel
def _leaving(table, labels, a, c, enter, bland):
    """Return the row of the variable that reaches 0 first.

    Among equals it takes the max pivot, or by Bland the min label.
    """
    row, best = -1, np.inf
    for i in range(a):
        size = table[i, enter]
        if size > MIN_PIVOT:
            ratio = max(table[i, c], 0.0) / size
            if row < 0 or ratio < best - 1e-13:
                row, best = i, ratio
            elif ratio <= best + 1e-13:
                if bland:
                    better = labels[i] < labels[row]
                else:
                    better = size > table[row, enter]
                if better:
                    row, best = i, min(ratio, best)
    return row


@kernel
def _pivot(table, labels, a, c, leave, enter):
    """Exchange the variables of a row and a column."""
    inverse = 1.0 / table[leave, enter]
    for j in range(c + 1):
        if j != enter:
            table[leave, j] *= inverse
    for i in range(a + 1):
        if i != leave:
            factor = table[i, enter]
            if factor != 0.0:
                for j in range(c + 1):
                    if j != enter:
                        table[i, j] -= factor * table[leave, j]
            table[i, enter] = -factor * inverse
    table[leave, enter] = inverse
    labels[leave], labels[a + enter] = labels[a + enter], labels[leave]


@kernel
def _normalise(weights):
    """Divide weights by their sum."""
    total = 0.0
    for i in range(weights.size):
        total += weights[i]
    for i in range(weights.size):
        weights[i] /= total
