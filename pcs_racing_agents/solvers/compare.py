"""Comparison of solvers on one tree: value, exploitability, agreement with the exact solution, and time."""

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
"""``exact`` is backward induction; then the average strategies of the variants of CFR; ``argmax-regret`` is the
decision rule of the paper: always the move of largest cumulative regret (of ``vanilla``)."""

INDIFFERENT = 1e-9
"""Moves whose value differs by less, in units of the payoffs' range, are equally good."""


class MethodRow(NamedTuple):
    """The scores of one method on one tree."""

    method: str
    value: float  #: What its profile pays to car 0.
    exploitability: float  #: Half of what both players could gain by best responses.
    #: ``agreement``, ``on_path``: See :func:`agreement`; the second weights histories with how often the exact solution
    #: leads to them.
    agreement: float
    on_path: float
    seconds: float  #: What it took.


def compare_methods(tree: GameTree, iterations: int = 100, methods: Sequence[str] = METHODS) -> list[MethodRow]:
    """Solve a tree whose players see all past moves with several of :data:`METHODS`."""
    for method in methods:
        if method not in METHODS:
            raise UnknownNameError(f"method {method!r} is unknown; choose from {', '.join(METHODS)}")
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


def agreement(tree: GameTree, exact: ExactResult, profile: Profile, *, on_path: bool = False) -> float:
    """Share of the decisions at which a profile's likeliest move is a best one against the exact solution.

    Decisions at which all moves have the same value do not count; 1 if there are no others. With ``on_path`` joint
    histories count as often as the exact solution leads to them, else equally.
    """
    game = tree.averaged
    # What counts as equal depends on the unit of the payoffs; a game without differences has none.
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
    """Return the pure profile that takes the move of largest cumulative regret everywhere, the first among equals.

    The paper clips regrets at 0 and chooses arbitrarily where none is left; this takes the largest of all.
    """

    def pure(regrets: Floats) -> Floats:
        return np.eye(regrets.shape[1])[regrets.argmax(axis=1)]

    return [(pure(first), pure(second)) for first, second in cfr(tree, iterations, "vanilla").regrets]


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
