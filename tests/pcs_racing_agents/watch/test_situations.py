"""Which move in which situation: a summary of many races."""

import csv

import numpy as np
import pytest
from refusal import refused

from pcs_racing.game.moves import move_names
from pcs_racing.game.observation import encode_observation
from pcs_racing_agents.base.style import INK, picture_bytes
from pcs_racing_agents.watch import situations


@pytest.fixture(scope="module")
def races(archive):
    """300 races whose agent keeps to a rule: behind a fast opponent move 0, else move 2; a tenth
    crash after a move.
    """
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
        assert found.lead_edges[k] == pytest.approx(
            np.quantile(leads[rows, k], [1 / 3, 2 / 3]), abs=1e-4
        )
        assert found.pace_edges[k] == pytest.approx(
            np.quantile(pace[rows, k], [1 / 3, 2 / 3]), abs=1e-4
        )


def test_a_rule_is_seen_in_the_shares_and_what_can_not_be_summarised_is_named(
    found, races, archive
):
    behind_fast, ahead, behind_slow = (
        found.shares[:, 0, 2],
        found.shares[:, 2],
        found.shares[:, 0, 0],
    )
    assert behind_fast[:, 0] == pytest.approx([1.0] * 4)
    assert ahead[..., 2] == pytest.approx(np.ones((4, 3)))
    assert behind_slow[:, 2] == pytest.approx([1.0] * 4)
    seen, actions, *_ = races
    names = move_names(archive, 0.5, True)
    refused(
        "300 races", situations.summarise, seen, np.full_like(actions, -1), archive, names, "driver"
    )
    refused(
        r"observations .*\(300, 0\)",
        situations.summarise,
        seen[:, :0],
        actions,
        archive,
        names,
        "somebody",
    )


@pytest.fixture
def few():
    """Two moves of a few races; none made a third or a fourth one."""
    counts = np.zeros((4, 3, 3, 3), np.int64)
    counts[0, 0, 2], counts[0, 1, 0], counts[1, 2, 1] = [1, 18, 1], [0, 0, 1], [5, 0, 5]
    edges = np.array(
        [
            [[-1.26, 2.0], [0.0, 3.5], *[[np.nan] * 2] * 2],
            [[0.2, 0.4], [0.25, 0.5], *[[np.nan] * 2] * 2],
        ]
    )
    return situations.Situations("somebody", ("a", "b", "stay"), "speed", *edges, counts)


def test_the_text_and_the_csv_hold_every_count_and_the_heat_map_the_shares(tmp_path, found, few):
    assert situations.situations_text(few).splitlines() == [
        (
            "somebody: moves by step, lead and speed of the opponent, in 21 races (thirds of what"
            " occurred at each step)"
        ),
        "move 1: lead up to -1.3 m, to +2.0 m, more; opponent's speed up to 0.20, to 0.40, more",
        "  behind most  opponent high       20 races: b 90%",
        "  between      opponent low         1 race: stay 100%",
        "move 2: lead up to +0.0 m, to +3.5 m, more; opponent's speed up to 0.25, to 0.50, more",
        "  ahead most   opponent middle     10 races: a 50%, stay 50%",
    ]
    path = situations.write_situations(few, tmp_path / "situations.csv")
    header, *rows = csv.reader(path.read_text().splitlines())
    assert (
        ",".join(header)
        == "agent,move_number,lead,lead_low_m,lead_high_m,opponent,pace_low,pace_high,move,races,share"
    )
    leads = [
        ("behind most", "", "-1.2600"),
        ("between", "-1.2600", "2.0000"),
        ("ahead most", "2.0000", ""),
    ]
    paces = [("low", "", "0.2000"), ("middle", "0.2000", "0.4000"), ("high", "0.4000", "")]
    places = [(*lead, *pace, move) for lead in leads for pace in paces for move in few.moves]
    assert [tuple(row[:9]) for row in rows[:27]] == [("somebody", "1", *place) for place in places]
    assert [int(row[9]) for row in rows] == few.counts.ravel().tolist()
    assert [row[10] for row in rows[6:12]] == [
        "0.0500",
        "0.9000",
        "0.0500",
        "0.0000",
        "0.0000",
        "1.0000",
    ]
    assert (rows[3][10], rows[-1][3:11]) == ("", ["nan", "", "high", "nan", "", "stay", "0", ""])
    figure = situations.situations_picture(few)
    panels = np.reshape(figure.axes, (3, 4))
    for (move, step), panel in np.ndenumerate(panels):
        shares = few.shares[step, :, :, move]
        np.testing.assert_array_equal(np.ma.filled(panel.images[0].get_array(), np.nan), shares)
        assert {
            (*text.get_position(), text.get_text(), text.get_color()) for text in panel.texts
        } == {
            (j, i, f"{100 * shares[i, j]:.0f}", "white" if shares[i, j] > 0.55 else INK)
            for i, j in np.argwhere(~np.isnan(shares))
        }
        assert panel.get_title("left") == (f"move {step + 1}" if move == 0 else "")
        assert panel.images[0].get_clim() == (0.0, 1.0)
        assert panel.get_ylim() == (-0.5, 2.5)  # ahead is up
    assert [panel.get_ylabel() for panel in panels[:, 0]] == ["a", "b", "stay"]
    assert [label.get_text() for label in panels[-1, 0].get_xticklabels()] == list(situations.PACES)
    assert [label.get_text() for label in panels[0, 0].get_yticklabels()] == ["behind", "", "ahead"]
    assert figure.get_suptitle() == "somebody: which move in which situation, % of 21 races"
    figures = [picture_bytes(situations.situations_picture(found)) for _ in range(2)]
    assert figures[0] == figures[1]
