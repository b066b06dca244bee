"""The configurations of the contest: what the studies share, so that they can be pooled and compared."""

from pcs_racing_agents.learning.responses import load_response_settings
from pcs_racing_agents.study import load_study_config

FULL, TABLE, WIDE = (load_study_config(name) for name in ("contest", "contest-table", "contest-wide"))


def assert_equal(first, second, *keys) -> None:
    for key in keys:
        assert getattr(first, key) == getattr(second, key), key


def test_the_table_is_the_main_table_of_the_study_with_an_archive_that_exists():
    assert_equal(FULL, TABLE, "game", "circuits", "responses", "response_pool", "best", "sampled_cfr", "fitting_games")
    assert_equal(FULL, TABLE, "tracks", "opponents", "egos", "variants", "lines")
    assert list(TABLE.tables) == ["main"]
    assert set(TABLE.arms) < set(FULL.arms)
    assert (TABLE.synthesis, TABLE.archive, TABLE.pairs) == (None, "contest", 0)


def test_the_wide_one_learns_from_as_many_games_on_more_circuits():
    assert_equal(WIDE, TABLE, "game", "response_pool", "opponents", "egos", "variants")
    games = [study.fitting_games * len(study.circuits) for study in (TABLE, WIDE)]
    starts = [load_response_settings(study.best).starts * len(study.circuits) for study in (TABLE, WIDE)]
    assert games[0] == games[1]
    assert starts[0] == starts[1]
    assert load_response_settings(FULL.best).starts > load_response_settings("response").starts  # the paper's answer
