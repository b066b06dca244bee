from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from refusal import refused
from small_games import PENNIES, random_profile, random_tree

from pcs_racing_agents import solvers


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
