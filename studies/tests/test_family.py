"""Races of two families, and their judge."""

import csv

from studies.__main__ import main
from studies.family import LATTICE, archive_policies
from studies.judge import judge

POLICIES = ("lattice:early,pace=0.2", "lattice:early")


def test_the_judge_gives_all_policies_the_same_races():
    both = judge(POLICIES, POLICIES, ["Pipkin"], races=2)
    alone = judge(POLICIES[1:], POLICIES, ["Pipkin"], races=2)
    assert both.points.shape == (2, 4)
    assert (both.points[1] == alone.points[0]).all()
    assert both.opponent.tolist() == [0, 0, 1, 1]
    assert both.score().clusters == (2, 2)  # policies, opponents; one start line is no cluster


def test_the_champion_is_the_first_of_an_archives_policies():
    assert len(archive_policies("contest")) > 8
    assert archive_policies("contest")[0].partition(":")[0] in ("line-ppo", "lattice")
    assert len(LATTICE.read_text().split()) == 16


def test_a_small_study_writes_its_table(tmp_path):
    assert main(["family", "--small", "--out", str(tmp_path)]) == 0
    with (tmp_path / "family.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    # Two circuits: 4 races of the champions, 2 of each of 9 pairs of policies.
    assert [row["races"] for row in rows] == ["8", "36"]
