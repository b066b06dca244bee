import numpy as np
import pytest
from hypothesis import given, strategies as st
from refusal import refused
from toy_trees import ToyTree, random_tree

from pcs_racing.base.errors import UnknownNameError
from pcs_racing_agents.networks import Rows, join_rows
from pcs_racing_agents.networks.rows import (
    TARGETS,
    best_moves,
    get_target,
    node_targets,
    pair_number,
    solve_for,
    split_by_pair,
    tree_rows,
)
from pcs_racing_agents.solvers import GameTree


def targets_of(payoffs, target):
    return node_targets(solve_for(GameTree.from_payoffs(payoffs), target), target)


def test_targets_of_matching_pennies_by_hand():
    """Payoff 3 instead of 1 in a corner; both begin with even moves, so the first regrets are q -
    v.
    """
    payoffs = np.array([[3.0, -1.0], [-1.0, 1.0]])
    tree = GameTree.from_payoffs(payoffs)
    ((r0, r1),) = node_targets(solve_for(tree, "regret", iterations=1), "regret")
    np.testing.assert_allclose(r0, [[1.0 - 0.5, 0.0 - 0.5]])  # q (1, 0), value 0.5
    np.testing.assert_allclose(r1, [[-1.0 + 0.5, 0.0 + 0.5]])
    for target, first, second in (
        ("advantage", [0.0, 0.0], [0.0, 0.0]),  # mixed: no move is better
        ("nash", [1 / 3, 2 / 3], [1 / 3, 2 / 3]),
    ):
        ((one, two),) = targets_of(payoffs, target)
        np.testing.assert_allclose([one[0], two[0]], [first, second], atol=1e-9)


def test_regrets_fade_with_the_opponents_reach_and_are_unknown_where_cfr_never_was():
    """Car 1 has to choose first; its second move leads to a lower game for car 0, so car 1 keeps to
    it.
    """
    # car 0 has one move, then car 0 chooses between 0 and the rest
    payoffs = np.zeros((1, 2, 2, 1))
    payoffs[0, 0, :, 0] = [10.0, 13.0]  # car 1 avoids this one ...
    payoffs[0, 1, :, 0] = [0.0, 3.0]  # ... for this one; at both car 0 loses 3 by its first move
    tree = GameTree.from_payoffs(payoffs)
    solution = solve_for(tree, "regret", iterations=400)
    (_, (raw, _)) = node_targets(solution, "regret")
    (_, (normalised, _)) = node_targets(solution, "normalised")
    assert raw[1].min() < 50.0 * raw[0].min() < 0.0
    np.testing.assert_allclose(normalised, raw / np.abs(raw).max(axis=1, keepdims=True))
    np.testing.assert_allclose(normalised[:, 0], -1.0)
    tree = GameTree.from_payoffs(np.arange(16.0).reshape(2, 2, 2, 2))
    solution = solve_for(tree, "normalised", iterations=3)
    solution.opponent_reach[1][0][2] = 0.0
    (_, (first, _)) = node_targets(solution, "normalised")
    assert np.isnan(first[2]).all()
    assert np.isfinite(np.delete(first, 2, axis=0)).all()


@given(st.integers(0, 10_000))
def test_every_target_treats_both_roles_alike(seed):
    """The same game with the cars' names exchanged has the targets exchanged."""
    payoffs = np.random.default_rng(seed).normal(size=(3, 3, 3, 3))
    for target in TARGETS:
        if target in ("advantage", "nash"):
            continue  # of several equilibria the solver may find another one
        here = targets_of(payoffs, target)
        there = targets_of(-payoffs.transpose(1, 0, 3, 2), target)
        nodes = np.arange(9).reshape(3, 3).T.ravel()  # history (a, b) becomes (b, a)
        for k, order in enumerate([[0], nodes]):
            np.testing.assert_allclose(here[k][0], there[k][1][order], rtol=1e-6, atol=1e-6)
            np.testing.assert_allclose(here[k][1], there[k][0][order], rtol=1e-6, atol=1e-6)


def test_advantages_are_zero_for_moves_of_the_equilibrium():
    tree = random_tree().game_tree()
    exact = solve_for(tree, "advantage")
    for pair, played in zip(node_targets(exact, "advantage"), exact.profile, strict=True):
        for values, strategy in zip(pair, played, strict=True):
            assert values.max() < 1e-9
            np.testing.assert_allclose(values[strategy > 1e-9], 0.0, atol=1e-9)


def test_rounding_is_forgiven_among_the_best_moves():
    targets = np.array([[1.0, 1.0 + 1e-8, 0.5], [-1e4, -1e4 - 1e-3, -2e4], [0.0, 0.0, -1e-3]])
    np.testing.assert_array_equal(best_moves(targets), [[1, 1, 0], [1, 1, 0], [1, 1, 0]])


def test_impossible_targets_and_trees_without_rows_are_one_clear_error():
    refused("unknown target 'joy'", get_target, "joy", error=UnknownNameError)
    race_tree = random_tree(ended={0: np.ones((1, 1), bool), 1: np.ones((1, 9), bool)})
    refused(r"policies \[0, 1\] has no node", rows_of, race_tree)


def rows_of(race_tree, target="advantage", **options):
    solution = solve_for(race_tree.game_tree(), target)
    return tree_rows(race_tree, solution, target, **options)


def values_at(rows, race_tree, level, node, player, seed=0):
    """Targets of the rows of a node, shape (number of such rows, A)."""
    return rows.targets[
        (rows.observations == race_tree.observations(level)[seed, node, player]).all(axis=1)
    ]


@pytest.mark.parametrize("target", list(TARGETS))
def test_every_decision_of_both_cars_is_a_row(target):
    race_tree = random_tree(policies=(7, 3))
    rows = rows_of(race_tree, target)
    assert len(rows) == 2 * (1 + 9)
    assert set(rows.pair) == {pair_number([3, 7])}
    assert rows.step.tolist().count(0) == 2
    targets = node_targets(solve_for(race_tree.game_tree(), target), target)
    for k, pair in enumerate(targets):
        for player in (0, 1):
            found = [
                values_at(rows, race_tree, k, node, player) for node in range(race_tree.nodes(k))
            ]
            np.testing.assert_allclose(np.concatenate(found), pair[player], rtol=1e-5, atol=1e-6)


def test_crashed_nodes_are_left_out_and_the_rest_is_as_if_they_were_not_there():
    """Two seeds; one has crashed in a node: targets there come from the other seed alone."""
    whole = random_tree(seeds=2, sees_seed=True)
    payoffs = whole.payoffs.copy()
    # the payoff of the crash in seed 1, for any later moves
    payoffs[1].reshape(9, 9)[4] = 0.7
    over = np.zeros((2, 9), bool)
    over[1, 4] = True
    crashed = ToyTree(payoffs, ended={1: over}, sees_seed=True)
    alone = ToyTree(payoffs[:1], sees_seed=True)
    rows, expected = rows_of(crashed), rows_of(alone)
    assert len(rows) == 2 * 2 * (1 + 9) - 2
    for player in (0, 1):
        assert len(values_at(rows, crashed, 1, 4, player, seed=1)) == 0
        here = values_at(rows, crashed, 1, 4, player)
        there = values_at(expected, alone, 1, 4, player)
        np.testing.assert_allclose(here, there, rtol=1e-5, atol=1e-5)
        assert here.shape == (1, 3)


@pytest.mark.parametrize("seeds", [1, 3])
def test_every_step_has_the_same_weight_and_every_node_for_regrets(seeds):
    race_tree = random_tree(seeds=seeds)
    np.testing.assert_allclose(rows_of(race_tree, "regret").weights, 1.0 / seeds)
    rows = rows_of(race_tree)
    by_step = [rows.weights[rows.step == k].sum() for k in range(2)]
    np.testing.assert_allclose(by_step, 2.0)  # one for each player


def test_a_sample_of_nodes_has_the_weight_of_all():
    race_tree = random_tree(moves=3, seeds=2)
    everything = rows_of(race_tree)
    some = rows_of(race_tree, rows_per_step=5, seed=1)
    assert [int(np.sum(some.step == k)) for k in range(3)] == [4, 20, 20]
    for k in range(3):
        assert some.weights[some.step == k].sum() == pytest.approx(
            everything.weights[everything.step == k].sum()
        )
    again = rows_of(race_tree, rows_per_step=5, seed=1)
    np.testing.assert_array_equal(some.observations, again.observations)
    other = rows_of(race_tree, rows_per_step=5, seed=2)
    assert not np.array_equal(some.observations, other.observations)
    known, drawn = (
        {row.tobytes() for row in np.column_stack([rows.observations, rows.targets])}
        for rows in (everything, some)
    )
    assert drawn <= known


def rows(count=12, pairs=4, seed=0, **changes) -> Rows:
    rng = np.random.default_rng(seed)
    values = {
        "observations": rng.normal(size=(count, 5)),
        "targets": rng.normal(size=(count, 3)),
        "weights": rng.uniform(0.5, 2.0, count),
        "pair": np.arange(count) % pairs,
        "step": np.arange(count) % 2,
    }
    return Rows(**{**values, **changes})


def test_rows_are_compact_and_impossible_ones_one_clear_error():
    made = rows()
    assert (made.observations.dtype, made.targets.dtype, made.weights.dtype) == (
        np.float32,
        np.float32,
        np.float64,
    )
    assert len(made) == 12
    for changes, message in [
        ({"targets": np.zeros((0, 3))}, r"targets have shape \(0, 3\)"),
        ({"targets": np.zeros(12)}, r"targets have shape \(12,\)"),
        ({"observations": np.zeros((11, 5))}, r"observations have shape \(11, 5\)"),
        ({"observations": np.full((12, 5), "a")}, "observations have shape"),
        (
            {"targets": np.where(np.arange(36).reshape(12, 3) == 13, np.nan, 1.0)},
            r"targets .* row 4",
        ),
        ({"observations": np.full((12, 5), np.inf)}, r"observations .* row 0"),
        ({"weights": np.zeros(12)}, "some must be above 0"),
        ({"weights": np.linspace(-1.0, 1.0, 12)}, "weights lie in -1 to 1"),
        ({"pair": np.zeros(12)}, "type float64"),
    ]:
        refused(message, rows, **changes)


def test_rows_that_can_not_be_joined_or_split_are_refused():
    refused("no rows to join", join_rows, [])
    refused("one starting pair", split_by_pair, rows(pairs=1), 0.2, 0)
    refused("weights of 0", split_by_pair, rows(pairs=2, weights=np.arange(12) % 2 + 0.0), 0.5, 0)


@given(st.integers(2, 30), st.floats(0.01, 0.9), st.integers(0, 1000))
def test_no_pair_is_on_both_sides_of_the_split(pairs, share, seed):
    made = rows(count=90, pairs=pairs)
    held_out, chosen = split_by_pair(made, share, seed)
    assert not set(made.pair[held_out]) & set(made.pair[~held_out])
    assert set(made.pair[held_out]) == set(chosen.tolist())
    assert 1 <= len(chosen) <= pairs - 1
    assert abs(len(chosen) - share * pairs) <= 1.0
    np.testing.assert_array_equal(split_by_pair(made, share, seed)[0], held_out)
