import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from small_games import kuhn_poker, random_tree

from pcs_racing_agents.solvers import GameTree, exploitability, solve_exact, solve_sequence_form


def test_kuhn_poker():
    """Worth -1/18 to the first player (Kuhn 1950), who never bets the middle card and bluffs at most a third."""
    tree = kuhn_poker()
    solution = solve_sequence_form(tree)
    assert solution.value == pytest.approx(-1.0 / 18.0, abs=1e-9)
    assert exploitability(tree, solution.profile).nash_conv == pytest.approx(0.0, abs=1e-9)
    jack, queen, king = (solution.profile[0][0][tree.infosets[0][0][deal]] for deal in (0, 2, 4))
    assert queen == pytest.approx([1.0, 0.0], abs=1e-9)
    assert jack[1] <= 1.0 / 3.0 + 1e-9
    assert king[1] == pytest.approx(3.0 * jack[1], abs=1e-9)


def test_it_agrees_with_backward_induction():
    tree = random_tree(0, 3, 3, 2, 4)
    assert solve_sequence_form(tree).value == pytest.approx(solve_exact(tree).value, abs=1e-9)


@settings(max_examples=15)
@given(seed=st.integers(0, 10**6), chance=st.sampled_from([0, 2]), blur=st.integers(1, 3))
def test_nobody_can_gain_whatever_they_see(seed, chance, blur):
    tree = random_tree(seed, 2, 3, 2, 2, chance=chance, blur=blur)
    solution = solve_sequence_form(tree)
    judged = exploitability(tree, solution.profile)
    assert judged.nash_conv == pytest.approx(0.0, abs=1e-8)
    assert judged.value == pytest.approx(solution.value, abs=1e-8)


def test_what_it_is_worth_to_see():
    """Matching pennies twice: whoever sees nothing loses nothing; who alone sees the coins of chance wins."""
    payoffs = np.array([[[1.0, -1.0], [-1.0, 1.0]], [[-1.0, 1.0], [1.0, -1.0]]])
    tree = GameTree.from_payoffs(payoffs, [0.5, 0.5])
    assert solve_sequence_form(tree).value == pytest.approx(0.0, abs=1e-9)
    assert solve_sequence_form(tree.with_infosets([([0, 1], [0, 0])])).value == pytest.approx(0.0, abs=1e-9)
    biased = GameTree.from_payoffs([[[1.0, 0.0], [0.0, 0.0]], [[0.0, 0.0], [0.0, 1.0]]], [0.5, 0.5])
    blind, seeing = solve_sequence_form(biased), solve_sequence_form(biased.with_infosets([([0, 1], [0, 0])]))
    assert blind.value == pytest.approx(0.25, abs=1e-9)
    assert seeing.value == pytest.approx(0.5, abs=1e-9)
