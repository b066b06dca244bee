"""The configurations of the contest: what the two studies share, so that they can be compared."""

import pytest

from pcs_racing_agents.learning.responses import load_response_settings
from pcs_racing_agents.study import load_study_config
from pcs_racing_agents.synthesis.config import load_archive_config


@pytest.fixture(scope="module")
def studies():
    return [load_study_config(name) for name in ("contest", "contest-second")]


def test_they_race_on_two_circuits_that_were_learned_on_and_one_that_nothing_was(studies):
    for study in studies:
        learned = {*study.circuits, *load_archive_config(study.synthesis).tracks}
        assert [track in study.circuits for track in study.tracks] == [True, True, False]
        assert study.tracks[2] not in learned


def test_the_second_is_the_first_with_another_archive(studies):
    first, second = studies
    for key in ("game", "circuits", "responses", "response_pool", "tracks", "opponents", "arms", "best"):
        assert getattr(first, key) == getattr(second, key), key
    archives = [load_archive_config(study.synthesis) for study in studies]
    changed = {
        key for key in archives[0].__dataclass_fields__ if getattr(archives[0], key) != getattr(archives[1], key)
    }
    assert changed == {"name", "seed"}


def test_the_answer_of_the_contest_learns_from_more_games_than_that_of_the_paper(studies):
    settings = [load_response_settings(name) for name in (studies[0].best, "response")]
    assert settings[0].starts > settings[1].starts
