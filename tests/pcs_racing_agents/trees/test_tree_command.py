import re

import pytest

from pcs_racing import save_archive
from pcs_racing_agents.trees import load_ego_trees, load_trees

GAME = ["tree", "--track", "Tarnfjord", "--moves", 2, "--step", 2, "--executor", "serial"]


@pytest.fixture
def small(archive, tmp_path):
    return save_archive(archive, tmp_path / "an archive")


def test_trees_are_played_and_taken_up_with_two_players_or_one(run, printed, small, tmp_path):
    out = tmp_path / "trees"
    code, text, told = run(*GAME, "--archive", small, "--pairs", 2, "--out", out)
    assert code == 0
    assert "2/2 trees" in told
    assert text.endswith(f"\n2 trees in {out}\n")
    trees = load_trees(out)
    driven = sum(tree.statistics.driven for tree in trees)
    assert f"{driven} segments driven of " in text
    assert f"of the {2 * 273} of trees that share only beginnings" in text
    assert f"of the {2 * 768} of races from the start" in text
    assert run(*GAME, "--archive", small, "--pairs", 2, "--out", out)[1] == text
    command = [*GAME, "--archive", small, "--ego", 5, "--opponent", "static", "--out", tmp_path / "ego"]
    text = printed(*command)
    trees = load_ego_trees(tmp_path / "ego")
    assert len(trees) == 5
    assert f"{trees.driven.sum()} segments driven, {trees.driven.mean():.1f} for each root" in text
    assert (trees.replies == -1).all()


def test_impossible_options_end_in_one_line(run, small, tmp_path):
    for options, message in [
        (["--pairs", "0"], "pairs is 0; it must be a whole number"),
        (["--ego", "0"], "roots is 0; it must be a whole number"),
        (["--ego", "3", "--seeds", "2"], "--seeds 2 does not go with --ego: every ego tree has its own noise"),
        (["--epsilon", "0"], r"epsilon is \(0.0,\); it must be a number in \(0, 10\]"),
        (["--seeds", "3"], "seeds_per_pair is 3, but there is no steering noise"),
        (["--moves", "9"], "a tree of 9 moves with 4 choices for each player has"),
        (["--race", "nope"], "race settings 'nope' are unknown"),
    ]:
        code, _, told = run(*GAME, "--archive", small, *options, "--out", tmp_path / "trees")
        assert code == 2
        assert re.fullmatch(rf"pcs-racing: error: .*{message}.*\n", told)
        assert not (tmp_path / "trees").exists()
