"""Which move in which situation: a summary of many races."""

import csv

import numpy as np
import pytest
from refusal import refused

from pcs_racing.game.moves import move_names
from pcs_racing.game.observation import encode_observation
from pcs_racing_agents.explain import situations
from pcs_racing_agents.pictures.style import picture_bytes


@pytest.fixture(scope="module")
def races(archive):
    """300 races whose agent keeps to a rule: behind a fast opponent move 0, else move 2; a tenth crash after a move."""
    rng = np.random.default_rng(0)
    leads, estimates = 10.0 * rng.normal(size=(300, 5)), rng.uniform(-0.5, 1.5, size=(300, 2, 5, 2))
    own = np.zeros((300, 2, 5, 2))
    seen = encode_observation(own, estimates, leads, np.full(300, 4))[:, 0]
    actions = np.where((leads[:, :4] < 0.0) & (estimates[:, 1, :4, 0] > 0.5), 0, 2)
    actions[:30, 1:] = -1
    return seen, actions, leads, estimates[:, 1, :, 0]


@pytest.fixture(scope="module")
def found(races, archive):
    return situations.summarise(*races[:2], archive, move_names(archive, 0.5, True), "somebody")


def test_every_race_is_counted_once_within_the_edges_of_what_was_seen(found, races):
    assert found.counts.shape == (4, 3, 3, 5)
    assert found.counts.sum(axis=(1, 2, 3)).tolist() == [300, 270, 270, 270]
    assert found.axis == "aggressiveness"
    third = found.counts[0].sum(axis=(1, 2))
    assert third.tolist() == [100, 100, 100]
    assert found.counts[0].sum(axis=(0, 2)).tolist() == [100, 100, 100]
    _, actions, leads, pace = races
    for k in range(4):
        rows = actions[:, k] >= 0
        assert found.lead_edges[k] == pytest.approx(np.quantile(leads[rows, k], [1 / 3, 2 / 3]), abs=1e-4)
        assert found.pace_edges[k] == pytest.approx(np.quantile(pace[rows, k], [1 / 3, 2 / 3]), abs=1e-4)


def test_a_rule_is_seen_in_the_shares_and_what_can_not_be_summarised_is_named(found, races, archive):
    behind_fast, ahead, behind_slow = found.shares[:, 0, 2], found.shares[:, 2], found.shares[:, 0, 0]
    assert behind_fast[:, 0] == pytest.approx([1.0] * 4)
    assert ahead[..., 2] == pytest.approx(np.ones((4, 3)))
    assert behind_slow[:, 2] == pytest.approx([1.0] * 4)
    text = situations.situations_text(found)
    assert "somebody: moves by step, lead and aggressiveness of the opponent, in 300 races" in text
    assert "behind most  opponent high" in text
    assert text.count("move ") == 4
    seen, actions, *_ = races
    names = move_names(archive, 0.5, True)
    refused("300 races", situations.summarise, seen, np.full_like(actions, -1), archive, names, "driver")
    refused(r"observations .*\(300, 0\)", situations.summarise, seen[:, :0], actions, archive, names, "somebody")


def test_the_csv_holds_every_count_and_the_heat_map_the_shares(tmp_path, found):
    path = situations.write_situations(found, tmp_path / "situations.csv")
    rows = list(csv.DictReader(path.read_text().splitlines()))
    assert len(rows) == found.counts.size
    assert sum(int(row["races"]) for row in rows) == found.counts.sum()
    assert {row["lead"] for row in rows} == set(situations.LEADS)
    assert {row["opponent"] for row in rows} == set(situations.PACES)
    first = rows[0]
    assert (first["lead_low_m"], first["pace_low"]) == ("", "")
    assert float(first["lead_high_m"]) == pytest.approx(found.lead_edges[0, 0], abs=1e-4)
    assert situations.write_situations(found, tmp_path / "again.csv").read_bytes() == path.read_bytes()
    figure = situations.situations_picture(found)
    panel = figure.axes[0]
    assert panel.images[0].get_array()[0, 2] == pytest.approx(found.shares[0, 0, 2, 0])
    assert "100" in {text.get_text() for text in panel.texts}
    assert picture_bytes(figure) == picture_bytes(situations.situations_picture(found))
