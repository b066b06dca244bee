"""The gain by family of opponents, pooled over opponents and circuits."""

import csv

import pytest
from toy_races import toy_races

from pcs_racing.base.errors import InputError
from pcs_racing_agents.base.tables import table_rows
from pcs_racing_agents.study.family_gains import COLUMNS, families, family_gains, write_family_gains
from pcs_racing_agents.tournament.races import concatenate_races


@pytest.fixture(scope="module")
def races():
    return toy_races(
        tracks=("Oval", "Hut"), opponents=("never-switch", "best-schedule", "ppo", "somebody"),
        strengths={"open-loop": 0.0, "clever": 0.2}, egos=5, variants=5,
    )  # fmt: skip


def test_every_opponent_has_a_line_and_all_drivers_of_a_use_have_one():
    opponents = ["never-switch", "spliner", "lane-switcher:3", "stanley", "pure-pursuit", "ppo"]
    lines = list(families(opponents, ["never-switch", "stanley"]))
    assert [(name, use) for name, use, _ in lines[:2]] == [("never-switch", "training"), ("spliner", "test")]
    assert lines[6:] == [("drivers held out", "test", ["spliner", "lane-switcher:3", "pure-pursuit"])]


def test_the_table_and_the_file_say_the_same_and_nobody_is_compared_with_himself(races, tmp_path):
    gains = family_gains(races, "clever", "open-loop", ["never-switch"])
    assert [gain.use for gain in gains] == ["training", "test", "test", "test"]
    assert {gain.races for gain in gains} == {gains[0].races}
    assert gains[0].tracks == ("Oval", "Hut")
    assert "ppo" not in [gain.family for gain in family_gains(races, "clever", "ppo")]
    lines = write_family_gains(gains, tmp_path / "families.csv").read_text(encoding="utf-8").splitlines()
    rows = list(csv.DictReader(lines))
    _, *cells = table_rows(COLUMNS, gains)
    assert [(row["family"], row["use"], row["races"]) for row in rows] == [(*line[:2], line[4]) for line in cells]
    assert [f"{float(row['gain']):+.3f}" for row in rows] == [line[5] for line in cells]


def test_the_gain_is_the_mean_difference_of_the_scores_of_the_same_races(races):
    archive, *_ = family_gains(races, "clever", "open-loop")
    scores = {}
    for ego in ("clever", "open-loop"):
        played = [i for i, row in enumerate(races) if (row.ego, row.opponent) == (ego, "never-switch")]
        scores[ego] = races.take(played).score
    mean = scores["clever"].mean() - scores["open-loop"].mean()
    assert archive.gain == pytest.approx(mean)
    assert archive.low < mean < archive.high
    clever = [i for i, row in enumerate(races) if row.ego == "clever"]
    others = [i for i, row in enumerate(races) if row.ego == "open-loop"][:-1]
    with pytest.raises(InputError, match="never-switch"):
        family_gains(concatenate_races([races.take(clever), races.take(others[1:])]), "clever", "open-loop")
