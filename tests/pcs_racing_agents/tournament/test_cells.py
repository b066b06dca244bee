import numpy as np
import pytest

from pcs_racing import CONTEST, InputError, make_game
from pcs_racing_agents.agents import make_setting
from pcs_racing_agents.agents.zoo import build
from pcs_racing_agents.jobs.jobs import make_executor, open_job
from pcs_racing_agents.tournament.cells import draw_units, play_cell
from pcs_racing_agents.tournament.statistics import compare, match_units

SIZE = {"egos": 4, "opponents": 3, "lines": 2, "seed": 5}


@pytest.fixture(scope="module")
def contest(oval, archive):
    return make_game(oval, archive, CONTEST, step_seconds=0.8)


@pytest.fixture(scope="module")
def zoo(contest):
    setting = make_setting(contest.archive, contest.config)
    return {name: build(name, setting) for name in ("never-switch", "random-moves", "random-policy", "lane-switcher")}


def test_a_cell_crosses_everything(contest, zoo):
    units = draw_units(contest, zoo["random-moves"], zoo["lane-switcher"], **SIZE)
    assert len(units) == 4 * 3 * 2 * 2 == len(set(units.ids))
    egos, opponents, lines, sides = (np.unique(column) for column in np.array(units.ids).T)
    assert (len(egos), len(opponents), lines.tolist(), sides.tolist()) == (4, 3, list(range(16)), [0, 1])
    assert egos.max() < 12
    assert opponents.max() < 20
    # Every pair has two lines of its own out of sixteen, each of them from both sides.
    for pair in np.unique(units.variants, axis=0):
        of_pair = units.line[(units.variants == pair).all(axis=1)]
        assert sorted(np.unique(of_pair, return_counts=True)[1].tolist()) == [2, 2]
    assert len(np.unique(units.starts.s)) == 16
    assert len(np.unique(units.seeds)) == 48
    paper = draw_units(contest, zoo["random-moves"], zoo["lane-switcher"])
    assert len(paper) == 12 * 20 * 5 * 2  # this archive has 12 policies to start with; with 20 it were 4,000


def test_lines_of_a_short_circuit_share_places(archive):
    """Tarnfjord has 27 places to start side by side, and a cell draws from 40 lines; a place is one cluster."""
    game = make_game("Tarnfjord", archive, "paper")
    policies = build("never-switch", make_setting(archive, game.config))
    units = draw_units(game, policies, policies, egos=4, opponents=4, lines=5)
    assert len(np.unique(units.place)) == len(np.unique(units.starts.s)) < len(np.unique(units.line)) == 40
    for label in np.unique(units.place):
        assert np.ptp(units.starts.s[units.place == label]) == 0.0


def test_arms_pair_up_race_by_race(contest, zoo):
    """Two egos against one opponent: the same units in the same order, and the opponent starts alike."""
    for opponent in ("never-switch", "random-policy", "random-moves"):
        arms = [play_cell(contest, zoo[ego], zoo[opponent], **SIZE) for ego in ("never-switch", "random-moves")]
        one, other = (arm.units for arm in arms)
        np.testing.assert_array_equal(match_units(one.ids, other.ids), np.arange(48))
        np.testing.assert_array_equal(one.starts.s, other.starts.s)
        np.testing.assert_array_equal(arms[0].matches.noise, arms[1].matches.noise)
        np.testing.assert_array_equal(arms[0].matches.policy[:, :, 0], arms[1].matches.policy[:, :, 0])
        found = compare(arms[1].score, arms[0].score, one.variants[:, 0], one.variants[:, 1])
        assert found.difference == pytest.approx(arms[1].score.mean() - arms[0].score.mean())
    same = play_cell(contest, zoo["never-switch"], zoo["never-switch"], **SIZE)
    again = play_cell(contest, build("never-switch", zoo["never-switch"].setting, seed=9), zoo["never-switch"], **SIZE)
    np.testing.assert_array_equal(same.score, again.score)


def test_rows_of_a_cell(contest, zoo):
    cell = play_cell(contest, zoo["random-moves"], zoo["random-policy"], **SIZE)
    rows = cell.rows()
    assert [(row.ego_variant, row.opponent_variant) for row in rows] == [tuple(pair) for pair in cell.units.variants]
    assert {(row.ego, row.opponent, row.track, row.seed) for row in rows} == {
        ("random-moves", "random-policy", "oval", 5)
    }
    scores = [1.0 if row.winner == "ego" else 0.5 if row.winner == row.crash == "" else 0.0 for row in rows]
    np.testing.assert_array_equal(scores, cell.score)


def test_a_cell_in_a_job_is_played_once(contest, zoo, tmp_path, monkeypatch):
    monkeypatch.setattr("pcs_racing_agents.tournament.runner.BLOCK", 20)
    here = play_cell(contest, zoo["random-moves"], zoo["lane-switcher"], **SIZE)
    counts: list[tuple[int, int]] = []
    for _ in range(2):
        with open_job(tmp_path / "job", "cells", {}) as job, make_executor("threads", 2) as executor:
            cell = play_cell(
                contest, zoo["random-moves"], zoo["lane-switcher"], **SIZE, job=job, executor=executor,
                progress=lambda done, total, _: counts.append((done, total)),
            )  # fmt: skip
        for name, array in cell.matches._asdict().items():
            np.testing.assert_array_equal(array, getattr(here.matches, name), err_msg=name)
    assert counts == [(0, 48), (16, 48), (32, 48), (48, 48), (48, 48)]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"egos": 0}, "egos is 0; a cell needs at least one variant"),
        ({"egos": [1, 1]}, r"egos is \[1, 1\]; it must be"),
        ({"egos": [12]}, "there are variants 0 to 11"),
        ({"opponents": [20]}, "there are variants 0 to 19"),
        ({"opponents": 2.5}, r"opponents is 2\.5"),
        ({"lines": 0}, "lines is 0"),
        ({"seed": -1}, "seed is -1"),
    ],
)
def test_bad_cells_are_refused(contest, zoo, change, message):
    with pytest.raises(InputError, match=message):
        draw_units(contest, zoo["random-moves"], zoo["lane-switcher"], **(SIZE | change))


def test_chosen_variants(contest, zoo):
    units = draw_units(contest, zoo["never-switch"], zoo["never-switch"], egos=[7, 2], opponents=[1], lines=1)
    assert units.variants.tolist() == [[7, 1], [7, 1], [2, 1], [2, 1]]
