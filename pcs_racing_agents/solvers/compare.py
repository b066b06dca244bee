"""Comparison of solvers on one tree: value, exploitability, agreement with the exact solution, and
time.
"""

import time
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from pcs_racing.base.errors import check_choice
from pcs_racing_agents.solvers.cfr import VARIANTS, cfr
from pcs_racing_agents.solvers.evaluation import Profile, exploitability, reach_probabilities
from pcs_racing_agents.solvers.exact import ExactResult, solve_exact
from pcs_racing_agents.solvers.game_tree import Floats, GameTree

PAPER = "argmax-regret"
METHODS = ("exact", *VARIANTS, PAPER)
"""Solvers by name.

``exact`` is backward induction; then come the average strategies of the variants of CFR;
``argmax-regret`` is the decision rule of the paper: always the move with the max cumulative regret
(of ``vanilla``).
"""

INDIFFERENT = 1e-9
"""Difference in value, in units of the payoffs' range, below which moves are equally good."""


class MethodRow(NamedTuple):
    """Scores of one method on one tree."""

    method: str
    value: float  #: Payoff of the profile to car 0.
    exploitability: float  #: Half of the sum of both players' gains by best responses.
    #: Results of :func:`agreement`; ``on_path`` weights histories by their probability under the
    #: exact solution.
    agreement: float
    on_path: float
    seconds: float  #: Run time, s.


def compare_methods(
    tree: GameTree, iterations: int = 100, methods: Sequence[str] = METHODS
) -> list[MethodRow]:
    """Solve a tree with observed past moves by several of :data:`METHODS`."""
    exact = solve_exact(tree)
    rows = []
    for method in methods:
        # Load or compile the kernels, so that compilation is not timed.
        solve(GameTree.from_payoffs(np.zeros((1, 1))), method, 1)
        begin = time.perf_counter()
        profile = solve(tree, method, iterations)
        seconds = time.perf_counter() - begin
        judged = exploitability(tree, profile)
        agreed = agreement(tree, exact, profile)
        rows.append(MethodRow(method, judged.value, judged.exploitability, *agreed, seconds))
    return rows


def solve(tree: GameTree, method: str = "exact", iterations: int = 1000) -> Profile:
    """Return the solution of a tree by one of :data:`METHODS`."""
    check_choice("method", method, METHODS)
    if method == "exact":
        return solve_exact(tree).profile
    if method == PAPER:
        return regret_argmax(tree, iterations)
    return cfr(tree, iterations, method).average


def agreement(tree: GameTree, exact: ExactResult, profile: Profile) -> tuple[float, float]:
    """Return the shares of decisions where a profile's likeliest move is optimal.

    A move is optimal if it is a best response to the exact solution. Decisions with equal values of
    all moves do not count; the share is 1 if there are no others. In the first share all joint
    histories have equal weights, in the second one their probability under the exact solution.
    """
    game = tree.averaged
    # Equality depends on the unit of the payoffs; a game without differences has none.
    indifferent = INDIFFERENT * (float(np.ptp(game.payoffs)) or 1.0)
    reach = reach_probabilities(game, exact.profile)
    agreed, decisions = np.zeros(2), np.zeros(2)
    for k in range(game.depth):
        for strategy, q in zip(profile[k], exact.q[k], strict=True):
            lost = q.max(axis=1, keepdims=True) - q
            counts = (lost.max(axis=1) > indifferent).astype(np.float64)
            weights = np.stack([counts, counts * reach[k][0] * reach[k][1]])
            loss = np.take_along_axis(lost, strategy.argmax(axis=1)[:, None], axis=1)[:, 0]
            agreed += weights[:, loss <= indifferent].sum(axis=1)
            decisions += weights.sum(axis=1)
    both = np.divide(agreed, decisions, out=np.ones(2), where=decisions > 0.0)
    return float(both[0]), float(both[1])


def regret_argmax(tree: GameTree, iterations: int) -> Profile:
    """Return the pure profile of the moves with the max cumulative regret, the first among equals.

    The paper clips regrets at 0 and chooses arbitrarily if none is left; this function takes the
    max of all.
    """

    def pure(regrets: Floats) -> Floats:
        return np.eye(regrets.shape[1])[regrets.argmax(axis=1)]

    regrets = cfr(tree, iterations, "vanilla").regrets
    return [(pure(first), pure(second)) for first, second in regrets]
