"""``pcs-racing headroom``, ``tree``, ``solve``, ``export`` and ``study``."""

import csv
import re

import numpy as np
import pytest

from pcs_racing import InputError, make_game
from pcs_racing_agents.solvers import METHODS
from pcs_racing_agents.trees import build_trees, load_trees

# Of three policies the fastest beats the others.
POOL = ["--policies", "lattice:pace=0.2", "lattice:pace=0.5", "lattice:pace=1.0"]
SHORT = ["--duration", "4", "--races", "32", "--track", "Tarnfjord"]
TREES = ["tree", "--track", "Tarnfjord", "--moves", 2, "--step", 2, "--executor", "serial"]


def rows_of(file):
    return list(csv.DictReader(file.read_text().splitlines()))


def test_it_prints_the_table_and_writes_files(tmp_path, printed):
    out = tmp_path / "headroom"
    text = printed("headroom", *POOL, *SHORT, "--out", out)
    assert "Tarnfjord: the best fixed policy is lattice:pace=1.0" in text
    (row,) = rows_of(out / "headroom.csv")
    assert row["track"] == "Tarnfjord"
    assert abs(float(row["H"])) < 0.1
    rows = rows_of(out / "payoffs.csv")
    payoffs = {(row["policy"], row["opponent"]): float(row["payoff"]) for row in rows}
    assert len(payoffs) == 6
    assert payoffs["lattice:pace=1.0", "lattice:pace=0.2"] == -payoffs["lattice:pace=0.2", "lattice:pace=1.0"] > 0.0


def test_without_a_size_a_small_archive_races_as_a_whole(archive, saved_archive, tmp_path, printed):
    printed("headroom", "--archive", saved_archive, *SHORT, "--out", tmp_path)
    assert len({row["policy"] for row in rows_of(tmp_path / "payoffs.csv")}) == len(archive)


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
    options = ["--archive", "default", "--seed", 7, "--unseen", "Vellindra"]
    assert "begun" in told("study", "contest-table", *options, "--out", tmp_path / "out")
    (study,) = begun
    assert (study.archive, study.seed) == ("default", 7)
    assert study.tracks[-1] == "Vellindra"
    assert "Vellindra" not in study.circuits


def test_trees_are_played_and_taken_up(run, saved_archive, tmp_path):
    out = tmp_path / "trees"
    command = [*TREES, "--archive", saved_archive, "--pairs", 2, "--out", out]
    code, text, told = run(*command)
    assert code == 0
    assert "2/2 trees" in told
    assert text.endswith(f"\n2 trees in {out}\n")
    trees = load_trees(out)
    driven = sum(tree.statistics.driven for tree in trees)
    assert f"{driven} segments driven of " in text
    assert f"of the {2 * 273} of trees that share only beginnings" in text
    assert f"of the {2 * 768} of races from the start" in text
    assert run(*command)[1] == text


def test_trees_that_can_not_be_built_end_in_one_line(run, saved_archive, tmp_path):
    """The game is told before."""
    for option, value, message in [
        ("--pairs", 0, "pairs is 0; it must be a whole number"),
        ("--seeds", 3, "seeds_per_pair is 3, but there is no steering noise"),
    ]:
        code, _, told = run(*TREES, "--archive", saved_archive, option, value, "--out", tmp_path / "trees")
        assert code == 2
        assert re.fullmatch(f"pcs-racing: error: .*{message}.*\n", told)
        assert not (tmp_path / "trees").exists()


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Two small trees of short races."""
    made = tmp_path_factory.mktemp("trees") / "played"
    build_trees(make_game("Pipkin", moves=2, step_seconds=2.0), made, pairs=np.array([[0, 3], [2, 1]]))
    return made


def test_solve_prints_and_writes_every_method_on_every_tree(folder, tmp_path, run, printed):
    out = printed("solve", folder, "--iterations", 50, "--out", tmp_path / "solved.csv")
    assert "2 trees of archive default on Pipkin, preset paper; CFR with 50 iterations" in out
    assert "\n0     0, 3      exact " in out
    assert "\n1     2, 1      exact " in out
    assert "\nmean            exact " in out
    rows = rows_of(tmp_path / "solved.csv")
    assert [row["method"] for row in rows] == [*METHODS, *METHODS]
    exact = [row for row in rows if row["method"] == "exact"]
    assert all(abs(float(row["exploitability"])) < 1e-12 for row in exact)
    assert all(float(row["agreement"]) == float(row["on_path"]) == 1.0 for row in exact)
    out = run("solve", folder, "--methods", "linear", "exact")[1]
    assert "vanilla" not in out
    assert out.count("linear") == 3
    assert "iterations is 0" in run("solve", folder, "--iterations", 0)[2]


def test_export_writes_what_openspiel_loads(folder, tmp_path, run, printed):
    pyspiel = pytest.importorskip("pyspiel", reason="OpenSpiel is not installed")
    path = tmp_path / "tree.efg"
    out = printed("export", folder, "--tree", 1, "--format", "efg", "--out", path)
    assert f"written: {path} (256 leaves" in out
    game = pyspiel.load_efg_game(path.read_text())
    state = game.new_initial_state()
    assert state.action_to_string(state.legal_actions()[0]) == "aggressiveness +"
    assert 'EFG 2 R "pcs-racing: default 2 and 1 on Pipkin"' in path.read_text()
    assert "there is no tree 2 in" in run("export", folder, "--tree", 2, "--out", path)[2]
