"""Counterfactual regret minimisation on a dense tree: vanilla, alternating, CFR+, linear and
discounted.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pcs_racing.base.compilation import first_call
from pcs_racing.base.errors import check_choice, check_whole
from pcs_racing_agents.solvers.cfr_kernels import (
    Layout,
    initial_state,
    iterate,
    node_order,
    tree_layout,
)
from pcs_racing_agents.solvers.evaluation import Profile
from pcs_racing_agents.solvers.game_tree import Floats, GameTree, Integers

CHUNK = 200
"""Iterations of one compiled call; Ctrl-C is handled in between."""

MAX_ITERATIONS = 10_000_000


class Variant(NamedTuple):
    """A variant of discounted CFR.

    Source: Brown and Sandholm 2019, "Solving imperfect-information games via discounted regret
    minimization". After iteration t cumulative regrets are multiplied by t^e / (t^e + 1), where e
    is ``alpha`` for positive regrets and ``beta`` for the others. The strategies of iteration t
    have the weight t^gamma in the average.
    """

    #: True if the second player already responds to the first player's new strategy.
    alternating: bool
    #: Exponents ``alpha`` and ``beta``: infinity keeps regrets as they are, minus infinity removes
    #: them.
    alpha: float
    beta: float
    gamma: float  #: Exponent of the weight in the average, at least 0.


VARIANTS = {
    "vanilla": Variant(alternating=False, alpha=math.inf, beta=math.inf, gamma=0.0),
    "alternating": Variant(alternating=True, alpha=math.inf, beta=math.inf, gamma=0.0),
    "alternating+": Variant(alternating=True, alpha=math.inf, beta=-math.inf, gamma=1.0),
    "linear": Variant(alternating=True, alpha=1.0, beta=1.0, gamma=1.0),
    "discounted": Variant(alternating=True, alpha=1.5, beta=0.0, gamma=2.0),
}
"""Variants by name.

``vanilla``: both players at once (Zinkevich et al. 2007). ``alternating``: players alternately, as
in OpenSpiel's ``CFRSolver``. ``alternating+``: CFR+ (Tammelin 2014), OpenSpiel's ``CFRPlusSolver``.
``linear``, ``discounted``: Brown and Sandholm (2019), as OpenSpiel's ``LCFRSolver`` and
``DCFRSolver``.
"""


@dataclass(frozen=True, eq=False)
class CFRResult:
    """Average strategies and regrets after some iterations of CFR.

    Lists hold a pair for each level: car 0, car 1.
    """

    average: Profile  #: Average strategies, which approach an equilibrium.
    #: Cumulative counterfactual regrets, shapes (rows, A_k) and (rows, B_k), in units of the
    #: payoffs. The weight of an iteration is the probability that chance and the other player lead
    #: to the infoset.
    regrets: list[tuple[Floats, Floats]]
    #: Sum of these probabilities over the iterations, shape (rows,) each; regrets divided by it are
    #: per visit. It is discounted like positive regrets.
    opponent_reach: list[tuple[Floats, Floats]]


def cfr(tree: GameTree, iterations: int, variant: str = "alternating+") -> CFRResult:
    """Run counterfactual regret minimisation.

    Parameters
    ----------
    iterations : int
        1 to 10 million.
    variant : str
        One of :data:`VARIANTS`.
    """
    check_choice("CFR variant", variant, VARIANTS)
    check_whole("iterations", iterations, 1, MAX_ITERATIONS)
    tree = tree.averaged
    layout = tree_layout(tree)
    state = initial_state(tree, layout)
    last = int(iterations) + 1
    # In chunks: a compiled call can't be interrupted.
    with first_call(iterate, "counterfactual regret minimisation", 85.0):
        for begin in range(1, last, CHUNK):
            iterate(layout, state, begin, min(begin + CHUNK, last), *VARIANTS[variant])
    regrets = _copy_out(tree, layout, state.regrets, layout.regret_at)
    sums = _copy_out(tree, layout, state.sums, layout.regret_at)
    average = [(_shares(first), _shares(second)) for first, second in sums]
    reach = _copy_out(tree, layout, state.opponent_reach, layout.row_at, moves=False)
    # A number of each infoset has the form of a single move.
    opponent_reach = [(first[:, 0], second[:, 0]) for first, second in reach]
    return CFRResult(average, regrets, opponent_reach)


def _shares(weights: Floats) -> Floats:
    """Return each row divided by its sum; the uniform distribution where the sum is 0."""
    total = weights.sum(axis=1, keepdims=True)
    even = np.full_like(weights, 1.0 / weights.shape[1])
    return np.divide(weights, total, out=even, where=total > 0.0)


def _copy_out(
    tree: GameTree, layout: Layout, flat: Floats, at: Integers, *, moves: bool = True
) -> list[tuple[Floats, Floats]]:
    """Return an array of the kernels by level and player, with rows in the tree's order."""
    result = []
    for k in range(tree.depth):
        pair = []
        for player in (0, 1):
            rows, count = tree.rows(k, player), tree.moves[k][player] if moves else 1
            begin = int(at[player, k])
            array = np.empty((rows, count))
            # The kernels hold the numbers of one move together, and number nodes in another order
            # than the tree.
            order = node_order(tree, k) if layout.single[player, k] else np.arange(rows)
            array[order] = flat[begin : begin + rows * count].reshape(count, rows).T
            pair.append(array)
        result.append((pair[0], pair[1]))
    return result
