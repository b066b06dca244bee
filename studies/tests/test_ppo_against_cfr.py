"""PPO against counterfactual regret: equal races for all, scores and intervals, one command."""

import csv

import numpy as np
import pytest
from refusal import refused

from studies.__main__ import main
from studies.ppo_against_cfr import races
from studies.ppo_against_cfr.tables import Cell, difference, score_of


def cell(score, places):
    """Cell of races against two opponents, half of them against each."""
    half = len(score) // 2
    strata = np.repeat(["Saltmere lattice", "Saltmere ppo"], half)
    score = np.array(score, float)
    labels = tuple(map(np.array, (places, ["ppo 0"] * len(score), strata)))
    return Cell(score, 1.0 - score, strata, labels)


def test_a_planner_that_does_not_exist_yet_is_left_out(monkeypatch):
    monkeypatch.setitem(races.LEVELS, "PPO, control", ("line-ppo", "ppo-of-tomorrow"))
    monkeypatch.setattr(races, "CONTROL", races.LEVELS["PPO, control"])
    assert list(races.racers())[:2] == ["line-ppo", "ppo"]
    assert ("line-ppo", "lattice") in races.pairs()
    assert not any("ppo-of-tomorrow" in pair for pair in races.pairs())


def test_all_pairs_have_equal_races(tmp_path):
    refused("lacks the circuits Austin", races.circuits, "contest", True, tmp_path)
    tracks = races.circuits("contest", small=True, maps=None)
    drawn = [pairing for _, pairing in races.make_pairings("contest", tracks, races.SMALL)]
    assert len(drawn) == 2 * len(races.pairs())
    for track in ("Brackwater", "Saltmere"):
        same = [one for one in drawn if one.game.track.name == track]
        assert len({one.starts.s.tobytes() + one.noise.tobytes() for one in same}) == 1
        agents = [one for one in same if set(one.names) <= {"ppo", "cfr-argmax", "never-switch"}]
        assert len({one.variants.tobytes() for one in agents}) == 1
        assert all(one.starts.side.tolist() == [0, 1, 0, 1] for one in same)


def test_an_interval_is_about_its_opponents_and_not_about_others():
    """Always beaten by one opponent and never by the other, the score is certain."""
    places = ["a", "a", "b", "b"] * 2
    certain = score_of(cell([1, 1, 1, 1, 0, 0, 0, 0], places))
    assert certain == pytest.approx((0.5, 0.5, 0.5))
    mixed = score_of(cell([1, 1, 0, 0, 0, 0, 1, 1], places))
    assert mixed.mean == 0.5
    assert mixed.low < 0.4


def test_equal_races_have_a_certain_difference():
    places = ["a", "a", "b", "b"] * 2
    one, other = cell([1, 1, 0, 0, 1, 1, 0, 0], places), cell([0.5, 0.5, 0, 0] * 2, places)
    assert difference(one, one) == (0.0, 0.0, 0.0)
    assert difference(one, other).mean == pytest.approx(0.25)


def test_the_small_study_writes_its_tables_and_resumes(tmp_path, capsys):
    arguments = ["ppo-against-cfr", "--small", "--out", str(tmp_path)]
    assert main(arguments) == 0
    first = capsys.readouterr().out
    with open(tmp_path / "scores.csv", newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    # Two sets of rules, two kinds of circuits, each racer against six opponents and all of them.
    assert len(rows) == 2 * 2 * len(races.racers()) * 7
    assert {row["races"] for row in rows} == {"4", "24"}
    assert {row["level"] for row in rows} == set(races.LEVELS)
    chunks = {file: file.stat().st_mtime_ns for file in (tmp_path / "chunks").iterdir()}
    assert main(arguments) == 0
    assert capsys.readouterr().out == first
    assert chunks == {file: file.stat().st_mtime_ns for file in (tmp_path / "chunks").iterdir()}
