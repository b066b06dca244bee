"""Exact solutions: backward induction or the sequence-form linear program.

Backward induction needs observed past moves: every node is a zero-sum matrix game over the values
of its children.
"""

from typing import Any, NamedTuple

import numpy as np

from pcs_racing.base.errors import InputError
from pcs_racing_agents.solvers.evaluation import Profile
from pcs_racing_agents.solvers.game_tree import Floats, GameTree, Integers
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
            " moves; use solve_sequence_form or cfr"
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


class SequenceSolution(NamedTuple):
    """An equilibrium of a tree."""

    value: float  #: Value of the game to car 0.
    #: Equilibrium; infosets that a player's own moves never reach have the uniform distribution.
    profile: Profile


class _Sequences(NamedTuple):
    """Sequences of a player: an infoset and a move there; number 0 is the empty sequence."""

    begin: list[int]  #: Number of the first sequence of each level.
    parents: list[Integers]  #: shape (rows,): Sequence that leads to each infoset.
    size: int
    leaves: Integers  #: shape (roots * leaves,): Sequence that leads to each leaf.


def solve_sequence_form(tree: GameTree) -> SequenceSolution:
    """Solve any tree by linear programming (Koller, Megiddo and von Stengel 1996).

    The solver is scipy's HiGHS. The size of the program grows with the infosets, not with plans for
    all of them. The solution is exact to about 1e-9 of the max payoff;
    :func:`~pcs_racing_agents.solvers.exploitability` measures its error. The method is slow on
    large trees; for observed past moves :func:`~pcs_racing_agents.solvers.solve_exact` is a
    thousand times faster.
    """
    from scipy.sparse import coo_array

    game = tree.averaged
    # HiGHS has absolute tolerances: payoffs are scaled to the size of 1.
    scale = float(np.abs(game.payoffs).max()) or 1.0
    weighted = (game.chance[:, None] * game.payoffs / scale).reshape(-1)
    first, second = _sequences(game, 0), _sequences(game, 1)
    payoffs = coo_array(
        (weighted, (first.leaves, second.leaves)), shape=(first.size, second.size)
    ).tocsr()
    plans = []
    for own, other, gains in ((first, second, payoffs), (second, first, -payoffs.T)):
        plans.append(_best_plan(own, other, gains))
    profile = [
        (_behaviour(game, k, 0, first, plans[0][1]), _behaviour(game, k, 1, second, plans[1][1]))
        for k in range(game.depth)
    ]
    # Each player has a program; both give the value, each with its own rounding error.
    return SequenceSolution(float(plans[0][0] - plans[1][0]) / 2.0 * scale, profile)


def _sequences(game: GameTree, player: int) -> _Sequences:
    begin, parents, count = [], [], 1
    # Sequence that leads to each node.
    reached = np.zeros(game.roots, dtype=np.int64)
    for k in range(game.depth):
        rows = game.infosets[k][player]
        parent = np.zeros(game.rows(k, player), dtype=np.int64)
        parent[rows] = reached
        begin.append(count)
        parents.append(parent)
        moves = game.moves[k]
        own = np.arange(moves[player])
        sequence = count + rows[:, None] * moves[player] + own
        sequence = sequence[:, :, None] if player == 0 else sequence[:, None, :]
        reached = np.broadcast_to(sequence, (len(rows), *moves)).reshape(-1)
        count += len(parent) * moves[player]
    return _Sequences(begin, parents, count, reached)


def _flow(player: _Sequences) -> Any:
    """Return the matrix E of the plans x >= 0 with E x = (1, 0, 0, ...).

    A row says that the outflow of an infoset is its inflow.
    """
    from scipy.sparse import coo_array

    rows: list[Any] = [[0]]
    columns: list[Any] = [[0]]
    values: list[Any] = [[1.0]]
    line = 1
    ends = [*player.begin[1:], player.size]
    for begin, end, parent in zip(player.begin, ends, player.parents, strict=True):
        lines = line + np.arange(len(parent))
        own = np.arange(begin, end)
        rows += [np.repeat(lines, len(own) // len(parent)), lines]
        columns += [own, parent]
        values += [np.ones(len(own)), -np.ones(len(parent))]
        line += len(parent)
    places = (np.concatenate(rows), np.concatenate(columns))
    return coo_array((np.concatenate(values), places), shape=(line, player.size)).tocsr()


def _best_plan(own: _Sequences, other: _Sequences, gains: Any) -> tuple[float, Floats]:
    """Maximise the value against the best response over plans x: max q_0 with F' q <= G' x."""
    from scipy.optimize import linprog
    from scipy.sparse import block_array, coo_array

    flow, replies = _flow(own), _flow(other)
    lines = replies.shape[0]
    objective = np.zeros(own.size + lines)
    objective[own.size] = -1.0
    bound = np.zeros(flow.shape[0])
    bound[0] = 1.0
    solved = linprog(
        objective,
        A_ub=block_array([[-gains.T, replies.T]]),
        b_ub=np.zeros(other.size),
        A_eq=block_array([[flow, coo_array((flow.shape[0], lines))]]),
        b_eq=bound,
        bounds=[(0.0, None)] * own.size + [(None, None)] * lines,
        method="highs",
        options={"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10},
    )
    if solved.x is None:
        raise InputError(f"the sequence-form program could not be solved: {solved.message}")
    return -float(solved.fun), solved.x[: own.size]


def _behaviour(
    game: GameTree, level: int, player: int, sequences: _Sequences, plan: Floats
) -> Floats:
    """Return the probabilities of the moves at each infoset of a level, from a plan."""
    begin, count = sequences.begin[level], game.moves[level][player]
    weights = np.maximum(
        plan[begin : begin + game.rows(level, player) * count].reshape(-1, count), 0.0
    )
    total = weights.sum(axis=1, keepdims=True)
    return np.divide(weights, total, out=np.full_like(weights, 1.0 / count), where=total > 1e-12)
