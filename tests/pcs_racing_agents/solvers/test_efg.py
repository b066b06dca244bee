import re

import numpy as np
import pytest
from refusal import refused
from small_games import kuhn_poker, random_tree

from pcs_racing_agents import solvers

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
