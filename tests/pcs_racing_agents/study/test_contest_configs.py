"""The configurations of the contest: what the two studies share, so that they can be pooled."""

import pytest

from pcs_racing_agents.learning.responses import load_response_settings
from pcs_racing_agents.study import load_study_config
from pcs_racing_agents.synthesis.config import load_archive_config


@pytest.fixture(scope="module")
def studies():
    return [load_study_config(name) for name in ("contest", "contest-table")]


def test_they_race_on_two_circuits_that_were_learned_on_and_one_that_nothing_was(studies):
    chosen_on = load_archive_config(studies[0].synthesis).tracks
    for study in studies:
        assert [track in study.circuits for track in study.tracks] == [True, True, False]
        assert study.tracks[2] not in {*study.circuits, *chosen_on}


def test_the_second_is_the_main_table_of_the_first_with_an_archive_that_exists(studies):
    first, second = studies
    for key in ("game", "circuits", "responses", "response_pool", "best", "sampled_cfr", "fitting_games"):
        assert getattr(first, key) == getattr(second, key), key
    assert list(second.tables) == ["main"]
    for key in ("tracks", "opponents", "egos", "variants", "lines"):
        assert getattr(first, key) == getattr(second, key), key
    assert set(second.arms) < set(first.arms)
    assert (second.synthesis, second.archive, second.pairs) == (None, "contest", 0)


def test_the_wide_one_learns_on_four_circuits_from_as_many_games_and_is_judged_on_four_others():
    table, wide = (load_study_config(name) for name in ("contest-table", "contest-wide"))
    assert set(wide.tracks[:4]) == set(wide.circuits) > set(table.circuits)
    assert not set(wide.tracks[4:]) & set(wide.circuits)
    for key in ("game", "response_pool", "opponents", "egos", "variants"):
        assert getattr(wide, key) == getattr(table, key), key
    games = [study.fitting_games * len(study.circuits) for study in (table, wide)]
    starts = [load_response_settings(study.best).starts * len(study.circuits) for study in (table, wide)]
    assert games[0] == games[1]
    assert starts[0] == starts[1]


def test_the_answer_of_the_contest_learns_from_more_games_than_that_of_the_paper(studies):
    settings = [load_response_settings(name) for name in (studies[0].best, "response")]
    assert settings[0].starts > settings[1].starts
