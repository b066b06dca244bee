import csv

import numpy as np
import pytest

from pcs_racing import make_game
from pcs_racing_agents.cli.main import main
from pcs_racing_agents.solvers import (
    METHODS,
)
from pcs_racing_agents.trees import build_trees


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Two small trees of short races."""
    made = tmp_path_factory.mktemp("trees") / "played"
    build_trees(make_game("Pipkin", moves=2, step_seconds=2.0), made, pairs=np.array([[0, 3], [2, 1]]))
    return made


def run(capsys, *arguments):
    code = main([str(argument) for argument in arguments])
    return (code, *capsys.readouterr())


def test_solve_prints_and_writes_every_method_on_every_tree(folder, tmp_path, capsys):
    code, out, _ = run(capsys, "solve", folder, "--iterations", 50, "--out", tmp_path / "solved.csv")
    assert code == 0
    assert "2 trees of archive default on Pipkin, preset paper; CFR with 50 iterations" in out
    assert "\n0     0, 3      exact " in out
    assert "\n1     2, 1      exact " in out
    assert "\nmean            exact " in out
    with open(tmp_path / "solved.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["method"] for row in rows] == [*METHODS, *METHODS]
    exact = [row for row in rows if row["method"] == "exact"]
    assert all(abs(float(row["exploitability"])) < 1e-12 for row in exact)
    assert all(float(row["agreement"]) == float(row["on_path"]) == 1.0 for row in exact)
    out = run(capsys, "solve", folder, "--methods", "linear", "exact")[1]
    assert "vanilla" not in out
    assert out.count("linear") == 3


def test_export_writes_what_openspiel_loads(folder, tmp_path, capsys):
    pyspiel = pytest.importorskip("pyspiel", reason="OpenSpiel is not installed")
    path = tmp_path / "tree.efg"
    code, out, _ = run(capsys, "export", folder, "--tree", 1, "--format", "efg", "--out", path)
    assert code == 0
    assert f"written: {path} (256 leaves" in out
    game = pyspiel.load_efg_game(path.read_text())
    state = game.new_initial_state()
    assert state.action_to_string(state.legal_actions()[0]) == "aggressiveness +"
    assert 'EFG 2 R "pcs-racing: default 2 and 1 on Pipkin"' in path.read_text()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["solve", "nowhere"], "holds no game trees"),
        (["solve", "FOLDER", "--iterations", "0"], "iterations is 0"),
        (["solve", "FOLDER", "--out", "table.txt"], "must end in .csv"),
        (["export", "nowhere", "--out", "t.efg"], "holds no game trees"),
        (["export", "FOLDER", "--out", "t.gbt"], "must end in .efg"),
        (["export", "FOLDER", "--out", "t.efg", "--tree", "2"], "there is no tree 2 in"),
    ],
)
def test_an_error_is_one_line(arguments, message, folder, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    code, out, err = run(capsys, *(str(folder) if word == "FOLDER" else word for word in arguments))
    assert code == 2
    assert out == ""
    assert err.startswith("pcs-racing: error: ")
    assert message in err
    assert err.count("\n") == 1
    assert not list(tmp_path.iterdir())
