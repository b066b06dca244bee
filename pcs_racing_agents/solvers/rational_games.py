"""Exact solver of a zero-sum matrix game in rational numbers, for rare games with rounding errors.

Every float is a fraction with a power of two as denominator, so a game of floats can be scaled to
whole numbers. The simplex method then runs on a tableau of whole numbers with one common
denominator (Edmonds' integer pivoting; see Avis 2000, "lrs: a revised implementation of the reverse
search vertex enumeration algorithm"), with Bland's rule against cycles.
"""

from fractions import Fraction

import numpy as np

from pcs_racing_agents.solvers.game_tree import Floats


def solve_rationally(game: Floats) -> tuple[float, Floats, Floats]:
    """Solve a matrix game, shape (A, C): return the value, and strategies of row and column.

    Only the result is rounded.
    """
    a, c = game.shape
    exact = [[Fraction(value) for value in line] for line in game.tolist()]
    low = min(min(line) for line in exact)
    unit = (max(max(line) for line in exact) - low) or Fraction(1)
    # All payoffs are above 0, and so is the game's value.
    table = [[value - low + unit for value in line] for line in exact]
    # All denominators are powers of two, so the max is their common multiple.
    scale = max(value.denominator for line in table for value in line)
    rows = [[int(value * scale) for value in line] + [1] for line in table]
    rows.append([-1] * c + [0])
    down, across = [c + i for i in range(a)], list(range(c))
    denominator = 1
    while True:
        gaining = [j for j in range(c) if rows[a][j] < 0]
        if not gaining:
            break
        # Bland's rule: always the min label, which never cycles.
        enter = min(gaining, key=lambda j: across[j])
        limits = [
            (Fraction(rows[i][c], rows[i][enter]), down[i], i)
            for i in range(a)
            if rows[i][enter] > 0
        ]
        leave = min(limits)[2]
        size = rows[leave][enter]
        for i in range(a + 1):
            factor = rows[i][enter]
            if i != leave:
                if factor:
                    rows[i] = [
                        (x * size - factor * y) // denominator
                        for x, y in zip(rows[i], rows[leave], strict=True)
                    ]
                else:
                    # The division leaves no remainder: all entries are determinants of the original
                    # matrix (Edmonds).
                    rows[i] = [x * size // denominator for x in rows[i]]
                rows[i][enter] = -factor
        rows[leave][enter] = denominator
        denominator = size
        down[leave], across[enter] = across[enter], down[leave]
    total = rows[a][c]
    row, column = np.zeros(a), np.zeros(c)
    for i in range(a):
        if down[i] < c:
            column[down[i]] = Fraction(rows[i][c], total)
    for j in range(c):
        if across[j] >= c:
            row[across[j] - c] = Fraction(rows[a][j], total)
    return float(Fraction(denominator, total) / scale + low - unit), row, column
