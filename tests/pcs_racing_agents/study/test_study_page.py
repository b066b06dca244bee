"""docs/run_the_study.md: its code runs, and the columns that it names are there."""

import re

from repository import python_blocks, read_page, run_block
from toy_races import toy_races

from pcs_racing_agents.results.race_files import write_results
from pcs_racing_agents.study.table_text import CSV_COLUMNS

PAGE = read_page("run_the_study.md")


def test_a_table_is_made_again_from_the_races(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    results = tmp_path / "out" / "my-study" / "results.csv"
    results.parent.mkdir(parents=True)
    write_results(toy_races(tracks=("Tarnfjord",), egos=3, variants=3), results)
    (code,) = python_blocks(PAGE)
    run_block(code)
    assert capsys.readouterr().out.strip() != ""
    assert (results.parent / "table-again.csv").is_file()


def test_columns_that_are_named_are_there():
    named = {name for name in re.findall(r"`([a-z_]+)`", PAGE) if name in CSV_COLUMNS or name.endswith(("low", "high"))}
    assert named == {"races", "low", "high", "two_way_low", "two_way_high"}
    assert named <= set(CSV_COLUMNS)
