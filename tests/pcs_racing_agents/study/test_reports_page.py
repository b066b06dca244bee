"""docs/reports.md: its code runs, its commands parse, and the columns that it names are there."""

import re
import shlex

import pytest
from repository import python_blocks, read_page, run_block
from toy_cells import toy_cells

from pcs_racing_agents.cli.main import _parser
from pcs_racing_agents.study.table_text import CSV_COLUMNS

PAGE = read_page("reports.md")
BLOCKS = python_blocks(PAGE)
COMMANDS = re.findall(r"^pcs-racing (.*)$", PAGE, flags=re.MULTILINE)


@pytest.mark.parametrize("number", range(len(BLOCKS)))
def test_code_runs(number, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    results = tmp_path / "out" / "my-study" / "results.csv"
    results.parent.mkdir(parents=True)
    results.write_text(as_results(toy_cells(tracks=("Tarnfjord",), egos=3, variants=3)))
    run_block(BLOCKS[number])
    assert capsys.readouterr().out.strip() not in ("", "False")
    if "write_table" in BLOCKS[number]:
        assert (results.parent / "table-again.csv").is_file()


def as_results(cells) -> str:
    """The races of cells as the lines of a results.csv."""
    lines = ["track,opponent,ego,winner,crash,fault,ego_variant,opponent_variant,start_s,side,seed"]
    for (track, opponent, arm), races in cells.items():
        for score, crash, own, ego, other, line, side in zip(*races, strict=True):
            outcome = ("ego" if score else "" if crash else "opponent", "car" if crash else "", "ego" if own else "")
            lines.append(",".join(map(str, (track, opponent, arm, *outcome, ego, other, f"{line:.4f}", side, 0))))
    return "\n".join(lines)


def test_commands_are_those_of_the_command_line():
    assert len(COMMANDS) == 4
    for command in COMMANDS:
        assert callable(_parser().parse_args(shlex.split(command)).run)


def test_columns_that_are_named_are_there():
    named = {name for name in re.findall(r"`([a-z_]+)`", PAGE) if name in CSV_COLUMNS or name.endswith(("low", "high"))}
    assert named == {"low", "high", "two_way_low", "two_way_high"}
    assert named <= set(CSV_COLUMNS)
