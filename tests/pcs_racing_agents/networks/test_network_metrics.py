import numpy as np
import pytest
from toy_networks import identity, plain_network
from toy_trees import ToyTree, random_tree

from pcs_racing_agents.networks import Rows, metrics
from pcs_racing_agents.solvers import exploitability, solve_exact, uniform_profile

MOVES = ("a", "b", "c")


def linear(race_tree, seed=0):
    """A network without hidden layers that sees a toy tree."""
    inputs = race_tree.observations(0).shape[-1]
    return plain_network(
        np.random.default_rng(seed).normal(size=(3, inputs)), identity=identity(inputs, MOVES)
    )


def test_choices_are_compared_with_targets_and_clipped_with_clipped():
    network = plain_network(np.eye(4, 3))
    rows = Rows(  # the network chooses 0, 1, 2
        observations=np.eye(3),
        targets=np.array([[5.0, 1.0, 5.0, 0.0], [0.0, -3.0, 1.0, 0.0], [0.0, 0.0, 2.0, 9.0]]),
        weights=np.array([1.0, 2.0, 1.0]),
        pair=np.zeros(3, int),
        step=np.array([0, 0, 1]),
    )
    score = metrics.score_rows(network, rows)
    assert (score.rows, score.agreement) == (3, pytest.approx(1 / 4))
    assert score.chance == pytest.approx((0.5 + 2 * 0.25 + 0.25) / 4)
    assert score.constant == pytest.approx(3 / 4)  # move 2 is best in two rows
    assert score.shortfall == pytest.approx((2 * 4 + 7) / 4)
    network = plain_network(np.zeros((4, 1)), [-2.0, -1.0, -3.0, -4.0], clipped=True)
    rows = Rows(
        np.zeros((1, 1)),
        np.array([[-8.0, -5.0, -9.0, -9.0]]),
        np.ones(1),
        np.zeros(1, int),
        np.zeros(1, int),
    )
    score = metrics.score_rows(network, rows)
    assert (score.agreement, score.shortfall) == (1.0, 0.0)


def test_a_strategy_is_followed_in_both_roles_and_one_of_probabilities_drawn_from():
    race_tree = random_tree(moves=2, seeds=2, sees_seed=True)
    network = linear(race_tree)
    profile = metrics.play_profile(metrics.follow(network), race_tree)
    seen = race_tree.observations(1)
    for player in (0, 1):
        assert profile[1][player].shape == (2 * 9, 3)
        assert profile[1][player][9 + 4].argmax() == network.choose(seen[1, 4, player])
        np.testing.assert_array_equal(profile[1][player].sum(axis=1), 1.0)
    network = plain_network([[3.0, -2.0], [1.0, -1.0], [-1.0, -3.0], [0.0, -4.0]], target="nash")
    np.testing.assert_allclose(
        metrics.follow(network)(np.eye(2)), [[0.75, 0.25, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0]]
    )


@pytest.mark.parametrize("moves", [1, 2])
def test_on_one_seed_the_loss_is_half_the_nash_conv(moves):
    race_tree = random_tree(moves=moves)
    tree = race_tree.game_tree()
    exact = solve_exact(tree)
    for seed in range(5):
        profile = metrics.play_profile(metrics.follow(linear(race_tree, seed)), race_tree)
        score = metrics.score_tree(profile, race_tree, exact)
        expected = exploitability(tree, profile).exploitability
        assert score.lost_to_best_response == pytest.approx(expected)
        assert score.lost_to_best_response >= score.lost_to_equilibrium - 1e-9 >= -2e-9
    equilibrium = metrics.score_tree(exact.profile, race_tree, exact)
    np.testing.assert_allclose(equilibrium, 0.0, atol=1e-8)


def test_a_constant_move_in_pennies_loses_everything_and_random_moves_nothing():
    race_tree = ToyTree(np.array([[3.0, -3.0, -3.0, 3.0]]), moves=1, options=2)
    scores = metrics.score_trees(metrics.blind_plays(("heads", "tails")), [race_tree])
    assert list(scores) == ["always heads", "always tails", "random moves"]
    np.testing.assert_allclose(scores["random moves"], [[0.0, 0.0]], atol=1e-9)
    for side in ("heads", "tails"):
        np.testing.assert_allclose(scores[f"always {side}"], [[3.0, 0.0]], atol=1e-9)


def test_a_strategy_that_sees_the_seed_may_win_and_seeds_without_influence_are_their_mean():
    """Two seeds of opposite sign: a car that sees which gets 1 from any opponent that does not."""
    race_tree = ToyTree(
        np.array([[1.0, 1.0, -1.0, -1.0], [-1.0, -1.0, 1.0, 1.0]]), 1, 2, sees_seed=True
    )
    profile = [(np.eye(2), np.full((2, 2), 0.5))]
    score = metrics.score_tree(profile, race_tree, solve_exact(race_tree.game_tree()))
    # 1 won as car 0, nothing lost as car 1
    assert score.lost_to_best_response == pytest.approx(-0.5)
    race_tree = random_tree(seeds=3)
    mean = ToyTree(race_tree.payoffs.mean(axis=0, keepdims=True))
    play = {"net": metrics.follow(linear(race_tree))}
    scores = [metrics.score_trees(play, [tree])["net"] for tree in (race_tree, mean)]
    np.testing.assert_allclose(*scores, atol=1e-9)


def test_scores_on_several_trees_are_a_table():
    race_trees = [random_tree(seed=seed) for seed in range(4)]
    network = linear(race_trees[0])
    plays = {"network": metrics.follow(network), **metrics.blind_plays(MOVES)}
    scores = metrics.score_trees(plays, race_trees)
    assert all(array.shape == (4, 2) for array in scores.values())
    assert (scores["network"][:, 0] > 1.0).all()
    uniform = uniform_profile(race_trees[2].game_tree())
    expected = exploitability(race_trees[2].game_tree(), uniform).exploitability
    assert scores["random moves"][2, 0] == pytest.approx(expected)
    observations = race_trees[0].observations(0)[0, 0]
    rows = Rows(observations, np.eye(3)[:2], np.ones(2), np.zeros(2, int), np.zeros(2, int))
    found = metrics.score_rows(network, rows)
    lines = metrics.score_table(found, scores).splitlines()
    assert f"{scores['network'][:, 0].mean():.3f}" in lines[6]
    assert len(lines) == 6 + 5
    assert "nan" in metrics.score_table(found, metrics.score_trees(plays, race_trees[:1]))
    assert metrics.score_table(found, {}).splitlines() == lines[:3]
