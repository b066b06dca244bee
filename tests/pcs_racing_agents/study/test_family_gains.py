"""The gain by family of opponents, pooled over opponents and circuits."""

import csv

import pytest
from toy_races import toy_races

from pcs_racing.base.errors import InputError
from pcs_racing_agents.results.races import concatenate_races
from pcs_racing_agents.study.family_gains import family_gains, family_rows, write_family_gains


@pytest.fixture(scope="module")
def races():
    return toy_races(
        tracks=("Oval", "Hut"),
        opponents=("never-switch", "best-schedule", "ppo", "somebody"),
        strengths={"blind": 0.0, "clever": 0.2},
        egos=5,
        variants=5,
    )


def test_a_family_pools_its_opponents_on_all_circuits(races):
    archive, switching = family_gains(races, "clever", "blind")
    assert (archive.family.name, archive.family.use, archive.opponents) == ("archive", "training", ("never-switch",))
    assert (switching.family.name, switching.family.use) == ("switching agents", "test")
    assert switching.opponents == ("best-schedule", "ppo")
    assert switching.tracks == archive.tracks == ("Oval", "Hut")
    assert switching.gain.units == 2 * archive.gain.units


def test_the_gain_is_the_mean_difference_of_the_scores(races):
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
    assert archive.gain.mean == pytest.approx(mean)
    assert archive.gain.low < mean < archive.gain.high


def test_the_table_and_the_file_say_the_same(races, tmp_path):
    gains = family_gains(races, "clever", "blind")
    file = write_family_gains(gains, tmp_path / "families.csv")
    with open(file, newline="", encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    assert [row["family"] for row in rows] == [cells[0] for cells in family_rows(gains)]
    assert [f"{float(row['gain']):+.3f}" for row in rows] == [cells[5] for cells in family_rows(gains)]


def test_an_agent_is_not_compared_where_it_meets_itself(races):
    assert family_gains(races, "clever", "never-switch") == []


def test_arms_that_drove_other_races_are_refused(races):
    clever = [i for i, row in enumerate(races) if row.ego == "clever"]
    others = [i for i, row in enumerate(races) if row.ego == "blind"][:-1]
    with pytest.raises(InputError, match="never-switch"):
        family_gains(concatenate_races([races.take(clever), races.take(others[1:])]), "clever", "blind")
