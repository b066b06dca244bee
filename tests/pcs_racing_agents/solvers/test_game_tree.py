import copy
import re

import numpy as np
import pytest
from refusal import refused
from small_games import kuhn_poker, random_profile, random_tree

from pcs_racing_agents import solvers
from pcs_racing_agents.solvers import GameTree, play_value


def test_nodes_stand_in_the_order_of_their_history_in_a_tree_that_is_a_value():
    payoffs = np.arange(2 * 3 * 4 * 2, dtype=float).reshape(2, 3, 4, 2)
    tree = GameTree.from_payoffs(payoffs)
    assert tree.depth == 2
    assert tree.moves == ((2, 3), (4, 2))
    assert [tree.nodes(k) for k in range(3)] == [1, 6, 48]
    # Pure strategies pick one leaf: history (1, 2), then (3, 0) at that node.
    node = 1 * 3 + 2
    second = np.zeros((6, 4)), np.zeros((6, 2))
    second[0][:, 0] = second[1][:, 1] = 1.0
    second[0][node], second[1][node] = [0, 0, 0, 1], [1, 0]
    assert (
        play_value(tree, [(np.array([[0.0, 1.0]]), np.array([[0.0, 0.0, 1.0]])), second])
        == payoffs[1, 2, 3, 0]
    )
    given = np.zeros((2, 2))
    tree = GameTree.from_payoffs(given)
    given[0, 0] = 5.0
    assert tree.payoffs[0, 0] == 0.0
    refused("read-only", tree.payoffs.fill, 1.0, error=ValueError)
    assert copy.deepcopy(tree) is tree


def test_hidden_chance_is_averaged_out():
    payoffs = np.random.default_rng(1).normal(size=(3, 2, 2, 3, 2))
    weights = np.array([0.5, 0.2, 0.3])
    tree = GameTree.from_payoffs(payoffs, weights)
    assert tree.averaged.payoffs[0] == pytest.approx(
        np.einsum("s,s...->...", weights, payoffs).reshape(-1)
    )
    profile = random_profile(tree)
    each = [play_value(GameTree.from_payoffs(table), profile) for table in payoffs]
    assert play_value(tree, profile) == pytest.approx(weights @ each)


def test_infosets_are_numbered_as_they_come():
    tree = GameTree.from_payoffs(np.zeros((2, 2, 2, 2)))
    seen = tree.with_infosets([([7], [7]), ([9, 9, 4, 4], [8, 3, 8, 3])])
    assert seen.infosets[1][0].tolist() == [0, 0, 1, 1]
    assert seen.infosets[1][1].tolist() == [0, 1, 0, 1]
    assert seen.rows(1, 0) == 2
    # Labels that distinguish all nodes change nothing, in any order.
    same = tree.with_infosets([([0], [0]), ([5, 2, 9, 1], [3, 2, 1, 0])])
    assert same.perfect
    assert same.infosets[1][0].tolist() == [0, 1, 2, 3]


def test_impossible_trees_and_what_no_player_can_see():
    for payoffs, chance, message in [
        (np.zeros(4), None, r"payoffs have shape \(4,\)"),
        (np.zeros((2, 2, 2)), None, "an axis for each move"),
        (np.zeros((2, 0)), None, "none may be empty"),
        (5.0, None, r"payoffs have shape \(\)"),
        ([[1.0, np.nan], [0.0, 1.0]], None, r"payoff \(0, 1\) is nan"),
        ([[1.0, 2.0], [0.0, -np.inf]], None, r"payoff \(1, 1\) is -inf"),
        ([[1.0, 1e200]], None, r"payoff \(0, 1\) is 1e\+200"),
        ([[1.0, 2.0], [3.0]], None, "rows differ in length"),
        ([["a", "b"]], None, "they must be real numbers"),
        (np.zeros((3, 2, 2)), [0.5, 0.5], "payoffs of 3 roots"),
        (np.zeros((2, 2, 2)), [0.5, 0.6], "sum up to 1"),
        (np.zeros((2, 2, 2)), [1.5, -0.5], "at least 0"),
        (np.zeros((2, 2, 2)), [np.nan, 1.0], "at least 0"),
        (np.full((2, 1, 1), np.inf), [0.5, 0.5], r"payoff \(0, 0, 0\) is inf"),
    ]:
        refused(message, GameTree.from_payoffs, payoffs, chance)
    for labels, message in [
        ([([0], [0])], "must be 2 pairs"),
        ([([0], [0]), ([0, 0, 1], [0] * 4)], "must be 4 whole numbers"),
        ([([0], [0]), ([0.0] * 4, [0] * 4)], "type float64"),
        # These forget their own move.
        (
            [([0], [0]), ([0, 1, 0, 1], [0, 1, 0, 1])],
            "level 1, car 0: node 2",
        ),
        (
            [([0], [0]), ([0, 0, 1, 1], [0, 0, 1, 1])],
            "level 1, car 1: node 1",
        ),
    ]:
        refused(message, TWO_STEPS.with_infosets, labels)


TWO_STEPS = GameTree.from_payoffs(np.zeros((2, 2, 2, 2)))


# Two and three steps, unobserved seeds, and any infosets.
TREES = {
    "two steps": random_tree(0, 3, 3, 3, 3),
    "three steps": random_tree(1, 2, 3, 3, 2, 2, 2),
    "moves of one": random_tree(2, 1, 3, 3, 1, 2, 2),
    "hidden seeds": random_tree(3, 3, 2, 2, 3, chance=4),
    "blurred": random_tree(4, 3, 2, 2, 3, blur=2),
    "blurred chance": random_tree(5, 2, 2, 3, 2, 2, 2, chance=3, blur=2),
    "kuhn": kuhn_poker(),
}
FLAT = solvers.GameTree.from_payoffs(np.zeros((2, 2)))


def test_the_text_of_matching_pennies(tmp_path):
    path = solvers.write_efg(
        solvers.GameTree.from_payoffs([[1.0, -1.0], [-1.5e-7, 0.0]]),
        tmp_path / "pennies.efg",
        title="Pennies",
        move_names=[(("heads", "tails"), ("left", "right"))],
    )
    assert path.read_text().splitlines() == [
        'EFG 2 R "Pennies" { "car_0" "car_1" }',
        'p "" 1 1 "0:0" { "heads" "tails" } 0',
        'p "" 2 1 "0:0" { "left" "right" } 0',
        't "" 1 "" { 1.0 -1.0 }',
        't "" 2 "" { -1.0 1.0 }',
        'p "" 2 1 "0:0" { "left" "right" } 0',
        't "" 3 "" { -0.00000015 0.00000015 }',
        't "" 4 "" { 0.0 -0.0 }',
    ]


@pytest.mark.parametrize("name", TREES)
def test_openspiel_plays_the_same_game(name):
    """After 9 iterations its CFR is as exploitable as ours, each measured by its own."""
    pyspiel = pytest.importorskip("pyspiel", reason="OpenSpiel is not installed")
    game = pyspiel.load_efg_game(solvers.efg_text(TREES[name]))
    for variant, solver in (
        ("alternating", pyspiel.CFRSolver(game)),
        ("alternating+", pyspiel.CFRPlusSolver(game)),
    ):
        for _ in range(9):
            solver.evaluate_and_update_policy()
        theirs = pyspiel.exploitability(game, solver.tabular_average_policy())
        ours = solvers.exploitability(TREES[name], solvers.cfr(TREES[name], 9, variant).average)
        assert ours.exploitability == pytest.approx(theirs, rel=1e-10, abs=1e-12)


def test_uneven_chance_adds_up_to_one():
    tree = solvers.GameTree.from_payoffs(
        np.zeros((7, 1, 2)), np.random.default_rng(0).dirichlet(np.ones(7))
    )
    text = solvers.efg_text(tree.with_infosets([(np.arange(7), np.arange(7))]))
    shares = re.findall(r'"\d" (0\.\d+)', text)
    assert len(shares) == 7
    assert sum(int(share[2:].ljust(20, "0")) for share in shares) == 10**20


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"path": "game.txt"}, r"\.efg"),
        ({"path": "no/game.efg"}, "no folder"),
        ({"title": "two\nlines"}, "can't be a name"),
        ({"move_names": [(('"', "a"), ("a", "b"))]}, "can't be a name"),
        ({"move_names": [(("a",), ("a", "b"))]}, "must differ and fit the tree"),
        ({"move_names": [(("a", "a"), ("a", "b"))]}, "must differ and fit the tree"),
    ],
)
def test_what_cannot_be_written_is_refused(options, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    refused(message, solvers.write_efg, FLAT, **{"path": "game.efg", **options})
    assert not list(tmp_path.iterdir())
