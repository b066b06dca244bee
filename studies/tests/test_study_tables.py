"""Damaged lines of a study's table: one error that names file, line and value."""

import pytest
from refusal import refused

from pcs_racing_agents.base.tables import write_csv
from studies.tables import KEY, read_comparisons

HEAD = (*KEY, "train", "score")
LINE = ("difference", "Pipkin", "stanley", "ppo", "never-switch", "1", "0.5")


def test_each_line_is_a_comparison(tmp_path):
    write_csv([HEAD, LINE], tmp_path / "table.csv")
    assert read_comparisons(tmp_path / "table.csv", ["score"]) == [
        dict(zip(HEAD, LINE, strict=True))
    ]


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        ([HEAD], "no lines"),
        ([HEAD[:-1], LINE[:-1]], "has no 'score'"),
        ([HEAD, LINE, LINE], "line 3: the comparison .* is there twice"),
        ([HEAD, (*LINE[:-2], "True", "0.5")], "line 2: train is 'True'"),
        ([HEAD, (*LINE[:-1], "nan")], "line 2: score is 'nan'; it must be 0 to 1"),
        ([HEAD, (*LINE[:-1], "7")], "line 2: score is '7'"),
        ([HEAD, (*LINE[:-1], "x")], "line 2: score is 'x'"),
    ],
)
def test_a_damaged_table_is_refused(tmp_path, rows, said):
    write_csv(rows, tmp_path / "table.csv")
    refused(said, read_comparisons, tmp_path / "table.csv", ["score"])
