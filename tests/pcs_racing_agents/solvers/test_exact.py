import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from refusal import refused
from small_games import kuhn_poker, random_tree

from pcs_racing_agents.solvers import (
    GameTree,
    best_response,
    exploitability,
    solve_exact,
)

SMALL = st.sampled_from([(2, 2), (3, 2), (1, 3), (2, 2, 2, 2), (3, 2, 2, 1), (2, 3, 1, 2, 2, 2)])
METRES = st.integers(-4, 4) | st.floats(-60.0, 60.0, width=32)
PAYOFFS = SMALL.flatmap(lambda shape: arrays(np.float64, shape, elements=METRES))


def pure_security(tree: GameTree) -> tuple[float, float]:
    """Payoffs that car 0 can secure with observed moves, and by observing the other's: bounds of
    the value.
    """
    low = high = tree.payoffs[0]
    for a, b in reversed(tree.moves):
        low = low.reshape(-1, a, b).min(axis=2).max(axis=1)
        high = high.reshape(-1, a, b).max(axis=1).min(axis=1)
    return float(low[0]), float(high[0])


@given(PAYOFFS)
def test_nobody_can_gain_and_the_value_lies_between_the_security_levels(payoffs):
    tree = GameTree.from_payoffs(payoffs)
    solution = solve_exact(tree)
    judged = exploitability(tree, solution.profile)
    error = 1e-11 * (float(np.ptp(payoffs)) + 1e-12) + 2.0 * solution.gap
    assert abs(judged.nash_conv) <= tree.depth * error
    assert judged.value == pytest.approx(solution.value, abs=error)
    low, high = pure_security(tree)
    assert low - error <= solution.value <= high + error


def test_moves_are_rated_against_the_equilibrium():
    tree = random_tree(1, 3, 4, 2, 3)
    solution = solve_exact(tree)
    for k in range(2):
        for player in (0, 1):
            answer = best_response(tree, solution.profile, player)
            assert solution.q[k][player] == pytest.approx(answer.q[k])
            mine, value = solution.advantages[k][player], (1, -1)[player] * solution.node_values[k]
            assert mine == pytest.approx(answer.q[k] - value[:, None], abs=1e-12)
            assert (mine < 1e-12).all()
            assert mine[solution.profile[k][player] > 1e-12] == pytest.approx(0.0, abs=1e-12)


def test_seeds_that_nobody_sees_and_moves_that_need_another_solver():
    payoffs = np.random.default_rng(2).normal(size=(3, 2, 2, 2, 2))
    weights = [0.5, 0.25, 0.25]
    hidden = GameTree.from_payoffs(payoffs, weights)
    mean = GameTree.from_payoffs(np.einsum("s,s...->...", weights, payoffs))
    assert solve_exact(hidden).value == pytest.approx(solve_exact(mean).value)
    seen = hidden.with_infosets([(np.arange(3), np.arange(3)), (np.arange(12), np.arange(12))])
    apart = [solve_exact(GameTree.from_payoffs(table)).value for table in payoffs]
    assert solve_exact(seen).value == pytest.approx(np.dot(weights, apart))
    assert abs(exploitability(seen, solve_exact(seen).profile).nash_conv) < 1e-13
    refused("use cfr", solve_exact, kuhn_poker())
