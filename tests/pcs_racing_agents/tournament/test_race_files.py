"""Results files: the same bytes for the same races, and refusals."""

import csv
from dataclasses import fields

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from refusal import refused

from pcs_racing.base.errors import InputError
from pcs_racing.race.config import ROBORACER
from pcs_racing_agents.tournament.race_files import race_table, read_results, write_results
from pcs_racing_agents.tournament.races import Categorical, RaceRow, concatenate_races, series_of

EXAMPLE = """\
rules,ego,opponent,track,race,start_s,side,seed,lead,winner,crash,fault,ego_overtakes,opponent_overtakes,duration,\
ego_variant,opponent_variant,ego_path,opponent_path,ego_moves,opponent_moves,ego_best_lap,opponent_best_lap
paper,a,"b, c",Oval,0,12.5000,0,7,-1.2346,opponent,none,none,0,1,40.0000,3,0,3; 5; 5,,\
pace +; stay,,17.2500,-1.0000
paper,"b, c",a,Oval,1,12.5000,1,7,0.0000,none,car,both,2,0,3.1000,0,3,,3,,,-1.0000,-1.0000
"""


@pytest.fixture
def rows() -> list[dict[str, str]]:
    """Lines of a file, to be spoilt."""
    made = [
        RaceRow("paper", "a", "b", "Oval", k, 1.5 * k, k % 2, 3, 0.1 * k, "ego", duration=40.0)
        for k in range(12)
    ]
    lists = ("", "3; 5", "", "stay")
    return [
        dict(zip(RaceRow._fields, (*map(str, row[:17]), *lists, *map(str, row[21:])), strict=True))
        for row in made
    ]


def as_file(rows, path):
    """Write lines with the columns of the first."""
    with open(path, "w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    return path


def test_a_race_is_one_line(tmp_path):
    lost = (12.5, 0, 7, -1.23456, "opponent", "none", "none", 0, 1, 40.0, 3, 0)
    crashed = (12.5, 1, 7, 0.0, "none", "car", "both", 2, 0, 3.1, 0, 3)
    moves = ((3, 5, 5), (), ("pace +", "stay"), ())
    races = race_table(
        [
            RaceRow("paper", "a", "b, c", "Oval", 0, *lost, *moves, ego_best_lap=17.25),
            RaceRow("paper", "b, c", "a", "Oval", 1, *crashed, (), (3,)),
        ]
    )
    path = write_results(races, tmp_path / "results.csv")
    assert path.read_text(encoding="utf-8") == EXAMPLE
    assert (
        write_results(read_results(path), tmp_path / "again.csv").read_bytes() == path.read_bytes()
    )
    assert write_results(list(races), tmp_path / "rows.csv").read_bytes() == path.read_bytes()
    refused("there is no folder", write_results, races, tmp_path / "missing" / "results.csv")


def test_empty_lines_are_left_out_and_counted(tmp_path):
    path = tmp_path / "results.csv"
    head, first, second, _ = EXAMPLE.split("\n")
    path.write_text("\n".join([head, first, "", second.replace("both", "me")]))
    refused(r"line 4 \(race 1\), .*fault is 'me'", read_results, path)
    path.write_text("\n".join([head, first, "a,1.5"]))
    refused(r"line 3 .*2 values, .*23", read_results, path)
    refused(
        r"the table, line 2 \(race 0\), .*fault is 'me'",
        race_table,
        [RaceRow("paper", "a", "b", fault="me")],
    )


def test_seeds_may_be_larger_than_any_number_of_the_machine(tmp_path, rows):
    rows[3]["seed"] = rows[4]["seed"] = str(2**80)
    races = read_results(as_file(rows, tmp_path / "results.csv"))
    assert races[3].seed == races[4].seed == 2**80
    assert len(races.pairs) == 2


@pytest.mark.parametrize(
    ("column", "value", "message"),
    [
        ("lead", "far", "line 7 (race 5), is damaged: lead is 'far'; it must be a number from"),
        ("lead", "nan", "lead is 'nan'"),
        ("lead", "inf", "lead is 'inf'"),
        ("winner", "me", "winner is 'me'; it must be ego, opponent, none"),
        ("crash", "tree", "crash is 'tree'"),
        ("fault", "nobody", "fault is 'nobody'"),
        ("side", "2", "side is '2'; it must be a number from 0 to 1"),
        ("race", "-1", "race is '-1'"),
        ("ego_variant", "1e9", "ego_variant is '1e9'"),
        ("ego", "x" * 301, "ego is 301 characters long"),
        ("race", "1.5", "race is '1.5'; it must be a whole number"),
        ("seed", "minus one", "seed is 'minus one'; it must be a whole number"),
        ("seed", "03", "seed is '03'"),
        ("seed", "٣", "seed is '٣'; it must be a whole number"),
        ("duration", "soon", "duration is 'soon'"),
        ("opponent_path", "3; x", "opponent_path is '3; x'; it must be a list of policies"),
    ],
)
def test_a_damaged_line_is_named(rows, column, value, message, tmp_path):
    path = tmp_path / "results.csv"
    for number in (5, 9):  # the first of them is reported
        rows[number][column] = value
    with pytest.raises(InputError) as refused:
        read_results(as_file(rows, path))
    assert message in str(refused.value)
    assert f"{path}, line 7 (race 5), is damaged: " in str(refused.value)


def test_files_that_hold_no_races_are_refused(tmp_path, rows):
    refused("can't read", read_results, tmp_path / "nothing.csv")
    path = tmp_path / "results.csv"
    path.write_bytes(b"\xff\xfe\x00")
    refused("is damaged", read_results, path)
    path.write_text("a,b\n" + '"' + "x" * (csv.field_size_limit() + 1) + '",1\n')
    refused("is damaged", read_results, path)
    for text in ("", ",".join(RaceRow._fields) + "\n"):
        path.write_text(text)
        refused(r"has no column 'ego'|holds no races", read_results, path)
    bare = [{name: row[name] for name in row if name != "lead"} for row in rows]
    refused("has no column 'lead'", read_results, as_file(bare, path))


words = st.sampled_from(["a", "b, c", "", "d"])
steps = st.integers(0, 3)
table_rows = st.builds(
    RaceRow,
    rules=words,
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
@given(st.lists(table_rows, min_size=1, max_size=20))
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
@given(st.lists(table_rows, min_size=1, max_size=20), st.lists(table_rows, min_size=1, max_size=20))
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
    assert {pair: numbers.tolist() for pair, numbers in table.pairs.items()} == {
        ("", "a", "b", "7"): [0, 3],
        ("", "b", "a", "7"): [1],
        ("", "a", "b", "9"): [2],
    }
    assert [row.seed for row in table.with_seeds([9, 11])] == [9]
    assert len(table.with_seeds([])) == 0
    assert table.with_seeds([]).pairs == {}


def test_a_series_is_won_by_who_won_more_of_its_races():
    races = [
        RaceRow(race=k, winner=winner, crash="wall")
        for k, winner in enumerate(("opponent", "ego", "ego"))
    ]
    series = series_of(
        race_table([*races, RaceRow(race=3, winner="opponent"), RaceRow(race=4)]), ROBORACER
    )
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
