from itertools import product

import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays
from refusal import refused
from small_games import PENNIES, kuhn_poker, random_profile, random_tree

from pcs_racing_agents import solvers
from pcs_racing_agents.solvers import GameTree, best_response, cfr, exploitability, solve_exact
from pcs_racing_agents.solvers.compare import (
    METHODS,
    agreement,
    compare_methods,
    regret_argmax,
    solve,
)


def test_network_strategies_and_impossible_profiles():
    fair = solvers.uniform_profile(PENNIES)
    assert solvers.play_value(PENNIES, fair) == 0.0
    assert solvers.exploitability(PENNIES, fair).nash_conv == 0.0
    biased = [(np.array([[0.75, 0.25]]), np.array([[0.5, 0.5]]))]
    result = solvers.exploitability(PENNIES, biased)
    assert result.value == 0.0
    assert result.gains.tolist() == [0.0, 0.5]  # the other one shows the side that car 0 shows less
    assert result.nash_conv == 0.5
    assert result.exploitability == 0.25
    assert solvers.best_response(PENNIES, biased, 1).strategy[0].tolist() == [[0.0, 1.0]]
    assert solvers.best_response(PENNIES, biased, 1).q[0].tolist() == [[-0.5, 0.5]]
    tree = random_tree(0, 3, 3)
    third = np.full((1, 3), 1.0 / 3.0, dtype=np.float32)
    assert np.array_equal(solvers.check_profile(tree, [(third, third)])[0][0].sum(axis=1), [1.0])
    for profile, message in [
        ([], "has 1 pairs"),
        ([([[0.5, 0.5]], [[1.0]])], r"level 0, car 1: a strategy has shape \(1, 1\)"),
        ([([[0.5, 0.6]], [[0.5, 0.5]])], "car 0, row 0: .* is no distribution"),
        ([([[1.5, -0.5]], [[0.5, 0.5]])], "is no distribution"),
        ([([[0.5, 0.5]], [[np.nan, 0.5]])], "car 1, row 0"),
    ]:
        refused(message, solvers.play_value, PENNIES, profile)
    refused("player is 2", solvers.best_response, PENNIES, solvers.uniform_profile(PENNIES), 2)


def pure_strategies(tree: solvers.GameTree, player: int):
    """Every plan of a player: a move for each of its infosets."""
    rows = [tree.rows(k, player) for k in range(tree.depth)]
    choices = [range(tree.moves[k][player]) for k in range(tree.depth) for _ in range(rows[k])]
    for plan in product(*choices):
        at, levels = 0, []
        for k, count in enumerate(rows):
            levels.append(np.eye(tree.moves[k][player])[list(plan[at : at + count])])
            at += count
        yield levels


@given(seed=st.integers(0, 10**6), blur=st.integers(1, 2), sharp=st.sampled_from([0.05, 1.0]))
def test_a_best_response_is_the_best_of_all_plans(seed, blur, sharp):
    """Also where it can't distinguish nodes, and where the other player never leads."""
    tree = random_tree(seed, 2, 2, 2, 2, chance=2, blur=blur)
    profile = random_profile(tree, seed, sharp)
    for player in (0, 1):
        values = []
        for plan in pure_strategies(tree, player):
            tried = [
                (own, pair[1]) if player == 0 else (pair[0], own)
                for own, pair in zip(plan, profile, strict=True)
            ]
            values.append((1, -1)[player] * solvers.play_value(tree, tried))
        best = solvers.best_response(tree, profile, player)
        assert best.value == pytest.approx(max(values), abs=1e-12)
        answer = [
            (a, p[1]) if player == 0 else (p[0], a)
            for a, p in zip(best.strategy, profile, strict=True)
        ]
        assert (1, -1)[player] * solvers.play_value(tree, answer) == pytest.approx(
            best.value, abs=1e-12
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


def slow_agreement(tree, exact, profile, on_path):
    """One decision after the other; a joint history has the number that its moves give it."""
    agreed = decisions = 0.0
    span = tree.payoffs.max() - tree.payoffs.min()

    def visit(k, node, reach):
        nonlocal agreed, decisions
        if k == tree.depth:
            return
        for player in (0, 1):
            values = exact.q[k][player][node]
            if values.max() - values.min() > 1e-9 * span:
                weight = reach if on_path else 1.0
                decisions += weight
                agreed += weight * (
                    values[profile[k][player][node].argmax()] >= values.max() - 1e-9 * span
                )
        first, second = exact.profile[k]
        for a, b in np.ndindex(tree.moves[k]):
            child = (node * tree.moves[k][0] + a) * tree.moves[k][1] + b
            visit(k + 1, child, reach * first[node, a] * second[node, b])

    visit(0, 0, 1.0)
    return agreed / decisions if decisions > 0.0 else 1.0


@pytest.mark.parametrize("seed", range(6))
def test_agreement_is_the_share_of_decisions_with_a_best_move(seed):
    tree = random_tree(seed, 3, 2, 2, 3)
    exact = solve_exact(tree)
    for profile in (random_profile(tree, seed), cfr(tree, 3).average, exact.profile):
        slow = [slow_agreement(tree, exact, profile, on_path) for on_path in (False, True)]
        assert agreement(tree, exact, profile) == pytest.approx(slow)
    assert agreement(tree, exact, exact.profile) == pytest.approx((1.0, 1.0))


def test_the_table_has_each_methods_exploitability():
    tree = random_tree(2, 3, 2, 2, 2)
    rows = compare_methods(tree, 20)
    assert [row.method for row in rows] == list(METHODS)
    for row in rows:
        judged = exploitability(tree, solve(tree, row.method, 20))
        assert (row.value, row.exploitability) == (judged.value, judged.exploitability)
    assert rows[0].exploitability < 1e-9
    assert (rows[0].agreement, rows[0].on_path) == pytest.approx((1.0, 1.0))


def test_the_papers_rule_takes_the_largest_regret_and_unknown_methods_are_named():
    tree = random_tree(4, 2, 3, 3, 2)
    regrets = cfr(tree, 15, "vanilla").regrets
    for pure, pair in zip(regret_argmax(tree, 15), regrets, strict=True):
        for strategy, regret in zip(pure, pair, strict=True):
            assert (strategy.sum(axis=1) == 1.0).all()
            np.testing.assert_array_equal(strategy.argmax(axis=1), regret.argmax(axis=1))
            assert set(np.unique(strategy)) == {0.0, 1.0}
    refused("method is 'guess'", compare_methods, PENNIES, 1, ["exact", "guess"])
