"""The gain by family of opponents, pooled over opponents and circuits."""

import csv

import pytest
from toy_races import toy_races

from pcs_racing.base.errors import InputError
from pcs_racing_agents.agents.zoo import SHIPPED
from pcs_racing_agents.results.races import concatenate_races
from pcs_racing_agents.results.text_table import table_rows
from pcs_racing_agents.study.family_gains import COLUMNS, FAMILIES, family_gains, family_of, write_family_gains


@pytest.fixture(scope="module")
def races():
    return toy_races(
        tracks=("Oval", "Hut"), opponents=("never-switch", "best-schedule", "ppo", "somebody"),
        strengths={"blind": 0.0, "clever": 0.2}, egos=5, variants=5,
    )  # fmt: skip


def test_an_opponent_belongs_to_one_family_and_is_not_compared_with_itself(races):
    members = [member for family in FAMILIES for member in family.members]
    assert len(members) == len(set(members))
    assert set(members) <= set(SHIPPED)
    assert family_of("lane-switcher:3").use == "test"
    assert family_of("always-pace+") is None
    assert {family.name for family in FAMILIES if family.use == "training"} == {
        "archive",
        "random moves",
        "gap follower",
    }
    assert family_gains(races, "clever", "never-switch") == []


def test_a_family_pools_its_opponents_and_the_table_and_the_file_say_the_same(races, tmp_path):
    archive, switching = family_gains(races, "clever", "blind")
    assert (archive.family, archive.use, archive.opponents) == ("archive", "training", ("never-switch",))
    assert (switching.family, switching.use) == ("switching agents", "test")
    assert switching.opponents == ("best-schedule", "ppo")
    assert switching.tracks == archive.tracks == ("Oval", "Hut")
    assert switching.races == 2 * archive.races
    gains = family_gains(races, "clever", "blind")
    with open(write_family_gains(gains, tmp_path / "families.csv"), newline="", encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    _, *cells = table_rows(COLUMNS, gains)
    assert [(row["family"], row["use"], row["races"]) for row in rows] == [(*line[:2], line[4]) for line in cells]
    assert [f"{float(row['gain']):+.3f}" for row in rows] == [line[5] for line in cells]
    assert rows[1]["opponents"] == "best-schedule; ppo"
    assert cells[1][2] == "best-schedule, ppo"


def test_the_gain_is_the_mean_difference_of_the_scores_of_the_same_races(races):
    (archive, _) = family_gains(races, "clever", "blind")
    against = [row for row in races if row.opponent == "never-switch"]
    scores = {
        ego: [
            1.0 if row.winner == "ego" else 0.5 * (row.winner == "" and row.crash == "")
            for row in against
            if row.ego == ego
        ]
        for ego in ("clever", "blind")
    }
    mean = sum(scores["clever"]) / len(scores["clever"]) - sum(scores["blind"]) / len(scores["blind"])
    assert archive.gain == pytest.approx(mean)
    assert archive.low < mean < archive.high
    clever = [i for i, row in enumerate(races) if row.ego == "clever"]
    others = [i for i, row in enumerate(races) if row.ego == "blind"][:-1]
    with pytest.raises(InputError, match="never-switch"):
        family_gains(concatenate_races([races.take(clever), races.take(others[1:])]), "clever", "blind")
