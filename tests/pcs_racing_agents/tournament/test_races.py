"""Race tables: columns of small whole numbers that read like rows of words."""

from dataclasses import fields

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pcs_racing_agents.tournament.race_files import race_table
from pcs_racing_agents.tournament.races import Categorical, RaceRow, concatenate_races, series_of

words = st.sampled_from(["a", "b, c", "", "d"])
steps = st.integers(0, 3)
rows = st.builds(
    RaceRow,
    preset=words,
    ego=words,
    opponent=words,
    track=words,
    lead=st.sampled_from([0.0, -1.5, 99.1234]),
    seed=st.integers(0, 2**70),
    race=st.integers(0, 1000),
    start_s=st.integers(-1000, 1000).map(lambda tenths: tenths / 10),
    side=st.integers(0, 1),
    winner=st.sampled_from(["none", "ego", "opponent"]),
    crash=st.sampled_from(["none", "wall", "car"]),
    fault=st.sampled_from(["none", "ego", "opponent", "both"]),
    ego_overtakes=st.integers(0, 300),
    duration=st.integers(0, 400).map(lambda tenths: tenths / 10),
    opponent_variant=st.integers(0, 300),
    ego_best_lap=st.sampled_from([-1.0, 7.25]),
    opponent_best_lap=st.just(8.5),
    ego_path=st.lists(st.integers(0, 300), max_size=5).map(tuple),
    ego_variant=steps,
    opponent_overtakes=steps,
    opponent_path=st.just(()),
    ego_moves=st.just(("stay",)),
    opponent_moves=st.lists(st.sampled_from(["stay", "pace +"]), max_size=4).map(tuple),
)


@settings(max_examples=50, deadline=None)
@given(st.lists(rows, min_size=1, max_size=20))
def test_rows_come_back_as_they_were(given_rows):
    table = race_table(given_rows)
    assert list(table) == given_rows
    assert [table[k] for k in range(len(table))] == given_rows
    for column in (getattr(table, field.name) for field in fields(table)):
        if column is not None:  # observations, which a file does not hold
            assert len(column.codes if isinstance(column, Categorical) else column) == len(
                given_rows
            )


@settings(max_examples=50, deadline=None)
@given(st.lists(rows, min_size=1, max_size=20), st.lists(rows, min_size=1, max_size=20))
def test_tables_are_joined_row_by_row(first, second):
    table = concatenate_races([race_table(first), race_table(second)])
    assert list(table) == [*first, *second]
    assert list(table.take(np.arange(len(table)) % 2 == 0)) == [*first, *second][::2]


def test_a_pair_is_a_track_two_agents_and_a_seed():
    table = race_table(
        [
            RaceRow(ego="a", opponent="b", seed=7),
            RaceRow(ego="b", opponent="a", seed=7),
            RaceRow(ego="a", opponent="b", seed=9),
            RaceRow(ego="a", opponent="b", seed=7),
        ]
    )
    assert {pair: rows.tolist() for pair, rows in table.pairs.items()} == {
        ("", "a", "b", "7"): [0, 3],
        ("", "b", "a", "7"): [1],
        ("", "a", "b", "9"): [2],
    }
    assert [row.seed for row in table.with_seeds([9, 11])] == [9]
    assert len(table.with_seeds([])) == 0
    assert table.with_seeds([]).pairs == {}


def test_a_series_is_won_by_who_won_more_of_its_races():
    rows = [
        RaceRow(race=k, winner=winner, crash="wall")
        for k, winner in enumerate(("opponent", "ego", "ego"))
    ]
    series = series_of(race_table([*rows, RaceRow(race=3, winner="opponent"), RaceRow(race=4)]), 3)
    assert [(row.race, row.winner, row.crash) for row in series] == [
        (0, "ego", "none"),
        (3, "opponent", "none"),
    ]


def test_worth_switches_places_and_missing_words_of_races():
    table = race_table(
        [RaceRow(winner="ego"), RaceRow(winner="opponent"), RaceRow(), RaceRow(crash="car")]
    )
    assert table.score.tolist() == [1.0, 0.0, 0.5, 0.0]
    assert table.tie.tolist() == [False, False, True, False]
    assert table.crashed.tolist() == [False, False, False, True]
    table = race_table([RaceRow(ego_path=(3, 3, 5, 3), opponent_path=(1, 2)), RaceRow()])
    assert table.switches.tolist() == [[2, 1], [0, 0]]
    table = race_table(
        [RaceRow(track=track, start_s=s) for track, s in (("t", 10.0), ("u", 10.0), ("t", 9.0))]
    )
    close = table.take([0, 0, 1, 2])
    close.start_s[1] += 4e-5
    # in the order of the labels "t 10.0000", "t 9.0000", "u 10.0000"
    assert close.places.tolist() == [0, 0, 2, 1]
    one, other = Categorical(("x",), np.array([0, -1])), Categorical(("y", "x"), np.array([-1, 0]))
    joined = Categorical.concatenate([one, other])
    assert (joined.words, joined.codes.tolist()) == (("x", "y"), [0, -1, -1, 1])
    with pytest.raises(IndexError):
        race_table([RaceRow()])[1]
