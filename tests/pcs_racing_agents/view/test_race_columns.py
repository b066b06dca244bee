"""Results files as columns: what stands in them, and what is refused."""

import csv
from itertools import pairwise

import numpy as np
import pytest

from pcs_racing.base.errors import InputError
from pcs_racing.base.packing import unpack
from pcs_racing_agents.tournament.result_lines import lines_of, read_lines
from pcs_racing_agents.view.race_columns import packed_columns, race_columns


@pytest.fixture
def lines(tournament_folder):
    return read_lines(tournament_folder[0] / "results.csv")


@pytest.fixture
def rows(lines):
    """The lines one by one, to be spoilt."""
    return list(lines)


def test_columns_hold_what_was_raced(lines, tournament_folder):
    columns = race_columns(lines)
    rows = tournament_folder[1].rows
    assert len(columns) == len(rows) == 18
    for number, row in enumerate(rows):
        assert [columns.agents.words[i] for i in columns.agents.places[:, number]] == [row.ego, row.opponent]
        assert columns.lead[number] == pytest.approx(row.lead, abs=1e-4)
        assert ["", "ego", "opponent"][columns.winner[number]] == row.winner
        assert ["", "wall", "car"][columns.crash[number]] == row.crash
        assert ["", "ego", "opponent", "both"][columns.fault[number]] == row.fault
        assert columns.variants[:, number].tolist() == [row.ego_variant, row.opponent_variant]
        assert columns.moves.words[columns.moves.places[0, number]] == "; ".join(row.ego_moves)
        path = row.opponent_path
        assert columns.switches[1, number] == sum(a != b for a, b in pairwise(path))


def test_packing_loses_nothing_that_is_shown(lines):
    columns = race_columns(lines)
    packed = packed_columns(columns)
    assert packed["length"] == 18
    values = {name: unpack(column) for name, column in packed["columns"].items()}
    assert values["lead"] == pytest.approx(columns.lead, abs=0.00051)
    assert values["start_s"] == pytest.approx(columns.start_s, abs=0.005)
    assert np.array_equal(values["ego"], columns.agents.places[0])
    assert np.array_equal(values["overtakes1"], columns.overtakes[1])
    assert np.array_equal(values["moves0"], columns.moves.places[0])
    assert packed["seeds"] == ["2"]


def test_what_only_tells_details_may_be_missing(rows):
    bare = [
        {name: row[name] for name in row if not name.endswith(("moves", "path", "variant", "overtakes"))}
        for row in rows
    ]
    for line in bare:
        del line["duration"], line["preset"]
    columns = race_columns(lines_of(bare, "here"))
    assert np.isnan(columns.duration).all()
    assert columns.overtakes.sum() == 0
    assert (unpack(packed_columns(columns)["columns"]["duration"]) == -1).all()


@pytest.mark.parametrize(
    ("column", "value", "message"),
    [
        ("lead", "far", "line 7 (race 5), is damaged: lead is 'far'; it must be a number from"),
        ("lead", "nan", "lead is 'nan'"),
        ("lead", "inf", "lead is 'inf'"),
        ("winner", "me", "winner is 'me'; it must be nothing, ego, opponent"),
        ("crash", "tree", "crash is 'tree'"),
        ("fault", "nobody", "fault is 'nobody'"),
        ("side", "2", "side is '2'; it must be a number from 0 to 1"),
        ("race", "-1", "race is '-1'"),
        ("ego_variant", "1e9", "ego_variant is '1e9'"),
        ("ego", "x" * 301, "ego is 301 characters long"),
    ],
)
def test_a_damaged_line_is_named(rows, column, value, message):
    for number in (5, 9):  # the first of them is told
        rows[number][column] = value
    with pytest.raises(InputError) as refused:
        race_columns(lines_of(rows, "results.csv"))
    assert message in str(refused.value)
    assert "results.csv, line 7 (race 5), is damaged: " in str(refused.value)


def test_files_that_hold_no_races_are_refused(tmp_path, rows):
    with pytest.raises(InputError, match="can't read"):
        read_lines(tmp_path / "nothing.csv")
    path = tmp_path / "results.csv"
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="is damaged"):
        read_lines(path)
    path.write_text("a,b\n" + '"' + "x" * (csv.field_size_limit() + 1) + '",1\n')
    with pytest.raises(InputError, match="is damaged"):
        read_lines(path)
    with pytest.raises(InputError, match="here holds no races"):
        race_columns(lines_of([], "here"))
    with pytest.raises(InputError, match="here has no column 'lead'"):
        race_columns(lines_of([{name: row[name] for name in row if name != "lead"} for row in rows], "here"))
