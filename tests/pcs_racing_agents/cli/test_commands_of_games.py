"""``pcs-racing tree``, ``solve`` and ``study``."""

import re
from types import SimpleNamespace

import numpy as np
import pytest

from pcs_racing import InputError, make_game
from pcs_racing_agents.cli.trees import solve_table, tree_table
from pcs_racing_agents.solvers import METHODS
from pcs_racing_agents.solvers.compare import MethodRow
from pcs_racing_agents.trees import build_trees, load_trees
from pcs_racing_agents.trees.tree import TreeStatistics

TREES = ["tree", "--track", "Tarnfjord", "--moves", 2, "--step", 2, "--workers", 1]


def test_tables_of_trees_hold_their_figures_and_means():
    """By hand."""
    statistics = TreeStatistics(2, 50, 60, 100, 400, 0.125, 0.5)
    tree = SimpleNamespace(policies=(3, 7), start_s=12.34, side=1, statistics=statistics)
    assert tree_table([tree]).splitlines()[:2] == [
        "tree  policies   start  side  seeds  driven  of shared  crashes",
        "   0       3 7  12.3 m     1      2      50      50.0%    12.5%",
    ]
    one = [
        MethodRow("exact", 0.5, 0.0, 1.0, 0.9, 0.002),
        MethodRow("linear", 0.4, 0.0123, 0.75, 0.5, 0.0504),
    ]
    other = [
        MethodRow("exact", -0.5, 2e-4, 0.5, 0.7, 0.004),
        MethodRow("linear", 0.0, 1e-3, 0.25, 0.3, 0.0496),
    ]
    table = solve_table([(3, 7), (0, 1)], [one, other]).split("\n\n")[0]
    assert [re.split(r"  +", line) for line in table.splitlines()] == [
        ["tree", "policies", "method", "value", "exploitability", "agreement", "on path", "ms"],
        ["0", "3, 7", "exact", "0.5000", "0.00e+00", "100.0%", "90.0%", "2.0"],
        ["", "linear", "0.4000", "0.0123", "75.0%", "50.0%", "50.4"],
        ["1", "0, 1", "exact", "-0.5000", "2.00e-04", "50.0%", "70.0%", "4.0"],
        ["", "linear", "0.0000", "0.0010", "25.0%", "30.0%", "49.6"],
        ["mean", "exact", "0.0000", "1.00e-04", "75.0%", "80.0%", "3.0"],
        ["", "linear", "0.2000", "0.0066", "50.0%", "40.0%", "50.0"],
    ]


@pytest.fixture
def begun(monkeypatch):
    """The settings of studies that were begun, in place of their work."""
    studies = []

    def begin(config, *_arguments, **_options):
        studies.append(config)
        raise InputError("begun")

    monkeypatch.setattr("pcs_racing_agents.study.run_study", begin)
    return studies


def test_options_replace_archive_and_seed_and_add_circuits_to_the_table(begun, tmp_path, told):
    options = ["--archive", "default", "--seed", 7, "--test-track", "Larkmoor"]
    assert "begun" in told("study", "contest", *options, "--out", tmp_path / "out")
    (study,) = begun
    assert (study.archive, study.seed) == ("default", 7)
    assert study.table.tracks[-1] == "Larkmoor"
    assert "Larkmoor" not in study.learning.tracks


def test_trees_are_played_and_taken_up(run, saved_archive, tmp_path):
    out = tmp_path / "trees"
    command = [*TREES, "--archive", saved_archive, "--pairs", 2, "--out", out]
    code, text, told = run(*command)
    assert code == 0
    assert "2/2 trees" in told
    assert text.endswith(f"\n2 trees in {out}\n")
    driven = [tree.statistics.driven for tree in load_trees(out)]
    rows = [line.split() for line in text.splitlines()]
    assert [f"{number / 273:.1%}" for number in driven] == [row[-2] for row in rows[2:4]]
    assert run(*command)[1] == text


def test_trees_that_can_not_be_built_end_in_one_line(run, saved_archive, tmp_path):
    """The game is announced before."""
    for option, value, message in [
        ("--pairs", 0, "pairs is 0; it must be a whole number"),
        ("--seeds", 3, "seeds_per_pair is 3, but there is no steering noise"),
    ]:
        code, _, told = run(
            *TREES, "--archive", saved_archive, option, value, "--out", tmp_path / "trees"
        )
        assert code == 2
        assert re.fullmatch(f"pcs-racing: error: .*{message}.*\n", told)
        assert not (tmp_path / "trees").exists()


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Two small trees of short races."""
    made = tmp_path_factory.mktemp("trees") / "played"
    build_trees(make_game("Pipkin", steps=(2.0,) * 3), made, pairs=np.array([[0, 3], [2, 1]]))
    return made


def test_solve_prints_every_method_on_every_tree(folder, run, printed):
    out = printed("solve", folder, "--iterations", 50)
    assert "2 trees of archive default on Pipkin, rules paper; CFR with 50 iterations" in out
    for method in METHODS:
        assert out.count(f"  {method} ") == 3
    assert "\n1     2, 1      exact " in out
    assert "\nmean            exact " in out
    exact = next(
        line.split() for line in out.splitlines() if line.startswith("0     0, 3      exact")
    )
    assert float(exact[5]) < 1e-12
    assert exact[6:8] == ["100.0%", "100.0%"]
    out = run("solve", folder, "--methods", "linear", "exact")[1]
    assert "vanilla" not in out
    assert out.count("linear") == 3
    assert "iterations is 0" in run("solve", folder, "--iterations", 0)[2]


def test_export_writes_what_openspiel_loads(folder, tmp_path, run, printed):
    pyspiel = pytest.importorskip("pyspiel", reason="OpenSpiel is not installed")
    path = tmp_path / "tree.efg"
    out = printed("solve", folder, "--export", path, "--tree", 1)
    assert f"written: {path} (256 leaves" in out
    game = pyspiel.load_efg_game(path.read_text())
    state = game.new_initial_state()
    assert state.action_to_string(state.legal_actions()[0]) == "aggressiveness +"
    assert 'EFG 2 R "pcs-racing: default 2 and 1 on Pipkin"' in path.read_text()
    assert (
        "there is no tree 2; there are trees 0 to 1"
        in run("solve", folder, "--export", path, "--tree", 2)[2]
    )
