"""Exact solution by backward induction, for observed past moves.

Every node is a zero-sum matrix game over the values of its children.
"""

from typing import NamedTuple

import numpy as np

from pcs_racing.base.errors import InputError
from pcs_racing_agents.solvers.evaluation import Profile
from pcs_racing_agents.solvers.game_tree import Floats, GameTree
from pcs_racing_agents.solvers.matrix_games import solve_matrix_games


class ExactResult(NamedTuple):
    """Solution of a tree whose players observe all past moves."""

    value: float  #: Value of the game to car 0.
    #: Equilibrium, also in every subtree (subgame perfect); one of them, if there are several.
    profile: Profile
    #: Value of each joint history of levels 0 to m to car 0, shape (rows,).
    node_values: list[Floats]
    #: Value of each move to its player against the equilibrium, shapes (rows, A_k) and (rows, B_k).
    q: list[tuple[Floats, Floats]]
    #: Values ``q`` minus the node's value: 0 for the moves of the equilibrium, below 0 for
    #: mistakes.
    advantages: list[tuple[Floats, Floats]]
    gap: float  #: Max sum of both players' possible gains in one matrix game: rounding errors.


def solve_exact(tree: GameTree) -> ExactResult:
    """Solve a game of observed past moves exactly.

    Chance that no player observes is averaged out first; rows are then joint histories.
    """
    game = tree.averaged
    if not game.perfect:
        raise InputError(
            "this tree can't be solved by backward induction, since its players do not see all past"
            " moves; use cfr"
        )
    # From the leaves up: the values of a level are the payoffs of the games one level above.
    values = [game.payoffs.reshape(-1)]
    profile, q, advantages, gap = [], [], [], 0.0
    for k in reversed(range(game.depth)):
        games = values[-1].reshape(-1, *game.moves[k])
        solution = solve_matrix_games(games)
        # Sums in a fixed order: the order of BLAS depends on the processor.
        q0 = np.einsum("gab,gb->ga", games, solution.columns)
        q1 = -np.einsum("ga,gab->gb", solution.rows, games)
        values.append(solution.values)
        profile.append((solution.rows, solution.columns))
        q.append((q0, q1))
        advantages.append((q0 - solution.values[:, None], q1 + solution.values[:, None]))
        gap = max(gap, float(solution.gaps.max()))
    value = float((game.chance * values[-1]).sum())
    return ExactResult(value, profile[::-1], values[::-1], q[::-1], advantages[::-1], gap)
