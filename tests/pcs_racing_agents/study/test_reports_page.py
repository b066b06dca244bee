"""docs/reports.md: its code runs, its commands parse, and the columns that it names are there."""

import re
import shlex

import pytest
from repository import python_blocks, read_page, run_block
from toy_races import toy_races

from pcs_racing_agents.cli.main import _parser
from pcs_racing_agents.results.race_files import write_results
from pcs_racing_agents.study.table_text import CSV_COLUMNS

PAGE = read_page("reports.md")
BLOCKS = python_blocks(PAGE)
COMMANDS = re.findall(r"^pcs-racing (.*)$", PAGE, flags=re.MULTILINE)


@pytest.mark.parametrize("number", range(len(BLOCKS)))
def test_code_runs(number, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    results = tmp_path / "out" / "my-study" / "results.csv"
    results.parent.mkdir(parents=True)
    write_results(toy_races(tracks=("Tarnfjord",), egos=3, variants=3), results)
    run_block(BLOCKS[number])
    assert capsys.readouterr().out.strip() not in ("", "False")
    if "write_table" in BLOCKS[number]:
        assert (results.parent / "table-again.csv").is_file()


def test_commands_are_those_of_the_command_line():
    assert len(COMMANDS) == 4
    for command in COMMANDS:
        assert callable(_parser().parse_args(shlex.split(command)).run)


def test_columns_that_are_named_are_there():
    named = {name for name in re.findall(r"`([a-z_]+)`", PAGE) if name in CSV_COLUMNS or name.endswith(("low", "high"))}
    assert named == {"low", "high", "two_way_low", "two_way_high"}
    assert named <= set(CSV_COLUMNS)
