"""``pcs-racing headroom``, ``solve``, ``export`` and ``study``."""

import csv

import numpy as np
import pytest

from pcs_racing import make_game
from pcs_racing.base.errors import InputError
from pcs_racing.game.archive_files import save_archive
from pcs_racing_agents.cli.main import main
from pcs_racing_agents.solvers import METHODS
from pcs_racing_agents.trees import build_trees

# Of three policies the fastest beats the others.
POOL = ["--policies", "lattice:pace=0.2", "lattice:pace=0.5", "lattice:pace=1.0"]
SHORT = ["--duration", "4", "--races", "32", "--track", "Tarnfjord"]


def test_it_prints_the_table_and_writes_files(tmp_path, capsys):
    out = tmp_path / "headroom"
    assert main(["headroom", *POOL, *SHORT, "--out", str(out)]) == 0
    printed = capsys.readouterr().out
    assert "Tarnfjord: the best fixed policy is lattice:pace=1.0" in printed
    with open(out / "headroom.csv", newline="") as file:
        (row,) = csv.DictReader(file)
    assert row["track"] == "Tarnfjord"
    assert abs(float(row["H"])) < 0.1
    with open(out / "payoffs.csv", newline="") as file:
        payoffs = {(line["policy"], line["opponent"]): float(line["payoff"]) for line in csv.DictReader(file)}
    assert len(payoffs) == 6
    assert payoffs["lattice:pace=1.0", "lattice:pace=0.2"] == -payoffs["lattice:pace=0.2", "lattice:pace=1.0"] > 0.0


def test_without_a_size_a_small_archive_races_as_a_whole(archive, tmp_path):
    folder = save_archive(archive, tmp_path / "toy")
    assert main(["headroom", "--archive", str(folder), *SHORT, "--out", str(tmp_path / "headroom")]) == 0
    with open(tmp_path / "headroom" / "payoffs.csv", newline="") as file:
        assert len({line["policy"] for line in csv.DictReader(file)}) == len(archive)


@pytest.fixture
def begun(monkeypatch):
    """The settings of studies that were begun, in place of their work."""
    studies = []

    def begin(config, *_arguments, **_options):
        studies.append(config)
        raise InputError("begun")

    monkeypatch.setattr("pcs_racing_agents.study.run_study", begin)
    return studies


def test_options_replace_archive_and_seed_and_add_circuits_to_the_table(begun, tmp_path):
    options = ["--archive", "default", "--seed", "7", "--unseen", "Vellindra"]
    assert main(["study", "contest-table", *options, "--out", str(tmp_path / "out")]) == 2
    (study,) = begun
    assert (study.archive, study.seed) == ("default", 7)
    assert study.tracks[-1] == "Vellindra"
    assert "Vellindra" not in study.circuits


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
    with open(tmp_path / "solved.csv", newline="") as file:
        rows = list(csv.DictReader(file))
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
