"""Methods side by side: the result of each by itself, and agreement counted decision by
decision.
"""

import numpy as np
import pytest
from refusal import refused
from small_games import PENNIES, random_profile, random_tree

from pcs_racing_agents.solvers import GameTree, cfr, exploitability, solve_exact
from pcs_racing_agents.solvers.compare import (
    METHODS,
    agreement,
    compare_methods,
    regret_argmax,
    solve,
)


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


def test_agreement_has_no_unit_and_is_1_where_nothing_matters():
    tree = random_tree(5, 3, 3, 2, 2)
    profile = random_profile(tree, 1)
    expected = agreement(tree, solve_exact(tree), profile)
    assert 0.0 < expected[0] < 1.0
    for unit in (1e-12, 1e9):
        scaled = GameTree.from_payoffs(unit * tree.payoffs.reshape(3, 3, 2, 2))
        assert agreement(scaled, solve_exact(scaled), profile) == pytest.approx(expected)
    # All moves are best ones.
    assert agreement(PENNIES, solve_exact(PENNIES), random_profile(PENNIES)) == (1.0, 1.0)


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
