import re

import numpy as np
import pytest
from refusal import refused
from small_games import kuhn_poker, random_profile, random_tree

from pcs_racing_agents import solvers
from pcs_racing_agents.solvers.efg import efg_game, efg_policy, efg_profile

# Two and three steps, seeds that nobody sees, and any infosets.
TREES = {
    "two steps": random_tree(0, 3, 3, 3, 3),
    "three steps": random_tree(1, 2, 3, 3, 2, 2, 2),
    "moves of one": random_tree(2, 1, 3, 3, 1, 2, 2),
    "hidden seeds": random_tree(3, 3, 2, 2, 3, chance=4),
    "blurred": random_tree(4, 3, 2, 2, 3, blur=2),
    "blurred chance": random_tree(5, 2, 2, 3, 2, 2, 2, chance=3, blur=2),
    "kuhn": kuhn_poker(),
}


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
    """Exploitability of its CFR, as it measures it and as we do for ours, after 9 iterations."""
    pyspiel = pytest.importorskip("pyspiel", reason="OpenSpiel is not installed")
    tree = TREES[name]
    game = efg_game(tree)
    for variant, solver in (
        ("alternating", pyspiel.CFRSolver(game)),
        ("alternating+", pyspiel.CFRPlusSolver(game)),
    ):
        for _ in range(9):
            solver.evaluate_and_update_policy()
        policy = solver.tabular_average_policy()
        theirs = pytest.approx(pyspiel.exploitability(game, policy), rel=1e-10, abs=1e-12)
        for ours in (
            solvers.cfr(tree, 9, variant).average,
            efg_profile(tree, policy.policy_table()),
        ):
            assert solvers.exploitability(tree, ours).exploitability == theirs


@pytest.mark.parametrize("name", TREES)
def test_openspiel_judges_profiles_alike(name):
    pyspiel = pytest.importorskip("pyspiel", reason="OpenSpiel is not installed")
    tree = TREES[name]
    game = efg_game(tree)
    for seed in range(3):
        profile = random_profile(tree, seed, sharp=0.3)
        policy = efg_policy(tree, profile)
        expected = solvers.exploitability(tree, profile)
        assert pyspiel.nash_conv(game, policy) == pytest.approx(expected.nash_conv, rel=1e-10)
        assert pyspiel.exploitability(game, policy) == pytest.approx(
            expected.exploitability, rel=1e-10
        )
        back = solvers.play_value(tree, efg_profile(tree, policy))
        assert back == pytest.approx(solvers.play_value(tree, profile), abs=1e-12)


@pytest.mark.compare
@pytest.mark.parametrize("name", ["two steps", "hidden seeds"])
def test_gambit_finds_the_same_value(name, tmp_path):
    gambit = pytest.importorskip("pygambit", reason="pygambit is not installed")
    tree = TREES[name]
    rounded = solvers.GameTree(np.round(tree.payoffs, 2), tree.moves, tree.chance, tree.infosets)
    game = gambit.read_efg(solvers.write_efg(rounded, tmp_path / "game.efg"))
    solved = gambit.nash.lp_solve(game, rational=False).equilibrium
    value = float(solved.payoffs["car_0"])
    assert value == pytest.approx(solvers.solve_exact(rounded).value, abs=1e-8)


def test_uneven_chance_adds_up_to_one_and_what_cant_be_converted_is_told(tmp_path, monkeypatch):
    tree = solvers.GameTree.from_payoffs(
        np.zeros((7, 1, 2)), np.random.default_rng(0).dirichlet(np.ones(7))
    )
    text = solvers.efg_text(tree.with_infosets([(np.arange(7), np.arange(7))]))
    shares = re.findall(r'"\d" (0\.\d+)', text)
    assert len(shares) == 7
    assert sum(int(share[2:].ljust(20, "0")) for share in shares) == 10**20
    for call, named in [
        (lambda: solvers.efg_text(FLAT, move_names=[(("a",), ("a", "b"))]), "do not fit the tree"),
        (lambda: solvers.efg_text(FLAT, move_names=[(("a", "a"), ("a", "b"))]), "the same name"),
        (lambda: solvers.efg_text(FLAT, move_names=[(('"', "a"), ("a", "b"))]), "can't be a name"),
        (lambda: solvers.efg_text(FLAT, title="two\nlines"), "can't be a name"),
        (lambda: solvers.write_efg(FLAT, "game.txt"), r"\.efg"),
        (lambda: solvers.write_efg(FLAT, "no/game.efg"), "no folder"),
        (lambda: efg_profile(TREES["two steps"], {}), "'0-0-1-0:0'"),
    ]:
        monkeypatch.chdir(tmp_path)
        refused(named, call)
        assert not list(tmp_path.iterdir())


FLAT = solvers.GameTree.from_payoffs(np.zeros((2, 2)))
