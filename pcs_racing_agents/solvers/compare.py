"""Comparison of solvers on one tree: value, exploitability, agreement with the exact solution, and
time.
"""

import time
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from pcs_racing.base.errors import UnknownNameError
from pcs_racing_agents.solvers.cfr import VARIANTS, cfr
from pcs_racing_agents.solvers.evaluation import Profile, exploitability, reach_probabilities
from pcs_racing_agents.solvers.exact import ExactResult, solve_exact
from pcs_racing_agents.solvers.game_tree import Floats, GameTree

METHODS = ("exact", *VARIANTS, "argmax-regret")
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
    for method in methods:
        if method not in METHODS:
            raise UnknownNameError(
                f"method {method!r} is unknown; choose from {', '.join(METHODS)}"
            )
    _ready()
    exact = solve_exact(tree)
    rows = []
    for method in methods:
        begin = time.perf_counter()
        profile = _solver(method, iterations)(tree)
        seconds = time.perf_counter() - begin
        judged = exploitability(tree, profile)
        agreed = (agreement(tree, exact, profile), agreement(tree, exact, profile, on_path=True))
        rows.append(MethodRow(method, judged.value, judged.exploitability, *agreed, seconds))
    return rows


def agreement(
    tree: GameTree, exact: ExactResult, profile: Profile, *, on_path: bool = False
) -> float:
    """Return the share of decisions where a profile's likeliest move is optimal.

    A move is optimal if it is a best response to the exact solution. Decisions with equal values of
    all moves do not count; 1 if there are no others. With ``on_path`` joint histories are weighted
    by their probability under the exact solution, else equally.
    """
    game = tree.averaged
    # Equality depends on the unit of the payoffs; a game without differences has none.
    span = float(np.ptp(game.payoffs)) or 1.0
    reach = reach_probabilities(game, exact.profile)
    agreed = decisions = 0.0
    for k in range(game.depth):
        for strategy, q in zip(profile[k], exact.q[k], strict=True):
            lost = q.max(axis=1, keepdims=True) - q
            weight = (lost.max(axis=1) > INDIFFERENT * span).astype(np.float64)
            if on_path:
                weight *= reach[k][0] * reach[k][1]
            loss = np.take_along_axis(lost, strategy.argmax(axis=1)[:, None], axis=1)[:, 0]
            agreed += float(weight[loss <= INDIFFERENT * span].sum())
            decisions += float(weight.sum())
    return agreed / decisions if decisions > 0.0 else 1.0


def regret_argmax(tree: GameTree, iterations: int) -> Profile:
    """Return the pure profile of the moves with the max cumulative regret, the first among equals.

    The paper clips regrets at 0 and chooses arbitrarily if none is left; this function takes the
    max of all.
    """

    def pure(regrets: Floats) -> Floats:
        return np.eye(regrets.shape[1])[regrets.argmax(axis=1)]

    return [
        (pure(first), pure(second)) for first, second in cfr(tree, iterations, "vanilla").regrets
    ]


def _solver(method: str, iterations: int) -> Callable[[GameTree], Profile]:
    if method == "exact":
        return lambda tree: solve_exact(tree).profile
    if method == "argmax-regret":
        return lambda tree: regret_argmax(tree, iterations)
    return lambda tree: cfr(tree, iterations, method).average


def _ready() -> None:
    """Load or compile the kernels, so that compilation is not timed."""
    cfr(GameTree.from_payoffs(np.zeros((1, 1))), 1)
    solve_exact(GameTree.from_payoffs(np.zeros((1, 1))))
