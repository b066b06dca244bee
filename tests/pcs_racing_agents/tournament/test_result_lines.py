"""Results files as columns of text: the same lines, every text once."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcs_racing.base.errors import InputError
from pcs_racing_agents.tournament.result_lines import lines_of, read_lines

TEXT = 'ego,lead,moves\na,1.5,stay\n\n"b, c",-2.0,stay\na,1.5,"stay; stay"\n'


def test_a_text_is_kept_once(tmp_path):
    path = tmp_path / "results.csv"
    path.write_text(TEXT)
    lines = read_lines(path)
    assert len(lines) == 3
    assert lines[1] == {"ego": "b, c", "lead": "-2.0", "moves": "stay"}
    assert [line["ego"] for line in lines] == ["a", "b, c", "a"]
    assert lines.columns["ego"].words == ("a", "b, c")
    assert lines.columns["ego"].places.tolist() == [0, 1, 0]
    assert lines.columns["ego"].places.itemsize == 1
    assert lines.at.tolist() == [2, 4, 5]  # as an editor counts, with the empty line


def test_errors_name_the_first_line_that_says_so(tmp_path):
    path = tmp_path / "results.csv"
    path.write_text(TEXT)
    error = read_lines(path).damaged("ego", "b, c", "wrong")
    assert str(error) == f"{path}, line 4 (race 1), is damaged: ego is wrong"
    path.write_text(TEXT + "a,1.5\n")
    with pytest.raises(InputError, match="line 6 is damaged: it has 2 values, more or fewer than the 3"):
        read_lines(path)


def test_nothing_is_no_line(tmp_path):
    for text in ("", "ego,lead\n"):
        (tmp_path / "results.csv").write_text(text)
        assert len(read_lines(tmp_path / "results.csv")) == 0
    assert list(lines_of([], "here")) == []


@given(st.lists(st.fixed_dictionaries({"a": st.text(max_size=3), "b": st.sampled_from("xyz")}), max_size=300))
def test_lines_come_back_as_they_were(rows):
    lines = lines_of(rows, "here")
    assert list(lines) == rows
    for column in lines.columns.values():
        assert len(set(column.words)) == len(column.words)
        assert np.array_equal(np.unique(column.places), np.arange(len(column.words)))
