"""Counterfactual regret minimisation on a dense tree: vanilla, alternating, CFR+, linear and
discounted.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pcs_racing.base.checks import check_whole
from pcs_racing.base.compilation import first_call
from pcs_racing.base.errors import InputError, UnknownNameError
from pcs_racing_agents.solvers.cfr_kernels import (
    Layout,
    State,
    initial_state,
    iterate,
    node_order,
    tree_layout,
)
from pcs_racing_agents.solvers.evaluation import Profile
from pcs_racing_agents.solvers.game_tree import Floats, GameTree

CHUNK = 200
"""Iterations of one compiled call; Ctrl-C is handled in between."""

MOST_ITERATIONS = 10_000_000


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
    current: Profile  #: Strategies of the next iteration.
    #: Cumulative counterfactual regrets, shapes (rows, A_k) and (rows, B_k), in units of the
    #: payoffs. The weight of an iteration is the probability that chance and the other player lead
    #: to the infoset.
    regrets: list[tuple[Floats, Floats]]
    #: Sum of these probabilities over the iterations, shape (rows,) each; regrets divided by it are
    #: per visit. It is discounted like positive regrets.
    opponent_reach: list[tuple[Floats, Floats]]
    #: Numerators of ``average``: strategies summed with the weights of the player's own reach.
    strategy_sums: list[tuple[Floats, Floats]]
    iterations: int  #: Number of iterations of all runs together.
    variant: Variant


def cfr(
    tree: GameTree,
    iterations: int,
    variant: str | Variant = "alternating+",
    resume: CFRResult | None = None,
) -> CFRResult:
    """Run counterfactual regret minimisation.

    Parameters
    ----------
    iterations : int
        1 to 10 million.
    variant : str or Variant
        One of :data:`VARIANTS`, or your own.
    resume : CFRResult, optional
        Earlier result to resume; ``iterations`` are additional. The result is bit-identical to one
        long run.
    """
    rules = _variant(variant)
    check_whole("iterations", iterations, 1, MOST_ITERATIONS)
    tree = tree.averaged
    layout = tree_layout(tree)
    state = initial_state(tree, layout)
    done = 0
    if resume is not None:
        done = resume.iterations
        _check_resumed(tree, resume, rules)
        _copy_in(tree, layout, state.regrets, layout.regret_at, resume.regrets)
        _copy_in(tree, layout, state.sums, layout.regret_at, resume.strategy_sums)
        _copy_in(tree, layout, state.opponent_reach, layout.row_at, resume.opponent_reach)
    last = done + int(iterations) + 1
    # In chunks: a compiled call can't be interrupted.
    with first_call(iterate, "counterfactual regret minimisation", 5):
        for begin in range(done + 1, last, CHUNK):
            end = min(begin + CHUNK, last)
            iterate(
                layout, state, begin, end, rules.alternating, rules.alpha, rules.beta, rules.gamma
            )
    return _result(tree, layout, state, done + int(iterations), rules)


def _variant(variant: str | Variant) -> Variant:
    if isinstance(variant, str):
        if variant not in VARIANTS:
            raise UnknownNameError(
                f"CFR variant {variant!r} is unknown; choose from {', '.join(VARIANTS)}"
            )
        return VARIANTS[variant]
    if math.isnan(variant.alpha) or math.isnan(variant.beta) or not 0.0 <= variant.gamma < math.inf:
        raise InputError(
            f"{variant} is impossible: alpha and beta must be numbers, gamma finite and at least 0"
        )
    return Variant(
        bool(variant.alternating), float(variant.alpha), float(variant.beta), float(variant.gamma)
    )


def _check_resumed(tree: GameTree, resume: CFRResult, variant: Variant) -> None:
    if resume.variant != variant:
        raise InputError(f"the run to resume is of {resume.variant}, not of {variant}")
    wanted = [
        tuple((tree.rows(k, player), tree.moves[k][player]) for player in (0, 1))
        for k in range(tree.depth)
    ]
    shapes = [(first.shape, second.shape) for first, second in resume.regrets]
    if shapes != wanted:
        raise InputError(
            f"the run to resume is of a tree with other infosets: its regrets have shapes {shapes}"
        )


def _result(
    tree: GameTree, layout: Layout, state: State, iterations: int, variant: Variant
) -> CFRResult:
    regrets = _copy_out(tree, layout, state.regrets, layout.regret_at, True)
    sums = _copy_out(tree, layout, state.sums, layout.regret_at, True)
    reach = _copy_out(tree, layout, state.opponent_reach, layout.row_at, False)
    return CFRResult(
        average=[(_shares(first), _shares(second)) for first, second in sums],
        current=[
            (_shares(np.maximum(r0, 0.0)), _shares(np.maximum(r1, 0.0))) for r0, r1 in regrets
        ],
        regrets=regrets,
        opponent_reach=reach,
        strategy_sums=sums,
        iterations=iterations,
        variant=variant,
    )


def _shares(weights: Floats) -> Floats:
    """Return each row divided by its sum; the uniform distribution where the sum is 0."""
    total = weights.sum(axis=1, keepdims=True)
    even = np.full_like(weights, 1.0 / weights.shape[1])
    return np.divide(weights, total, out=even, where=total > 0.0)


def _order(
    tree: GameTree, layout: Layout, level: int, player: int
) -> "np.ndarray[tuple[int], np.dtype[np.int64]]":
    """Return the row of the tree for each row of the kernels' arrays."""
    if layout.single[player, level]:
        return node_order(tree, level)
    return np.arange(tree.rows(level, player))


def _copy_out(
    tree: GameTree, layout: Layout, flat: Floats, at: object, moves: bool
) -> list[tuple[Floats, Floats]]:
    """Return an array of the kernels by level and player, with rows in the tree's order."""
    result = []
    for k in range(tree.depth):
        pair = []
        for player in (0, 1):
            rows, count = tree.rows(k, player), tree.moves[k][player] if moves else 1
            begin = int(at[player, k])  # type: ignore[index]
            array = np.empty((rows, count))
            # The kernels hold the numbers of one move together, and number nodes in another order
            # than the tree.
            array[_order(tree, layout, k, player)] = (
                flat[begin : begin + rows * count].reshape(count, rows).T
            )
            pair.append(array if moves else array[:, 0])
        result.append((pair[0], pair[1]))
    return result


def _copy_in(
    tree: GameTree, layout: Layout, flat: Floats, at: object, pairs: list[tuple[Floats, Floats]]
) -> None:
    """Write arrays by level and player into a kernel array: the inverse of :func:`_copy_out`."""
    for k in range(tree.depth):
        for player in (0, 1):
            order = _order(tree, layout, k, player)
            begin = int(at[player, k])  # type: ignore[index]
            array = pairs[k][player].reshape(len(order), -1)[order].T
            flat[begin : begin + array.size] = array.reshape(-1)
