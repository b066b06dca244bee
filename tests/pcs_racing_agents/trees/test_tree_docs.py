"""The code of docs/trees.md runs."""

import pytest
from repository import python_blocks, read_page, run_block

PAGE = read_page("trees.md")
BLOCKS = python_blocks(PAGE)


@pytest.mark.parametrize("number", range(len(BLOCKS)))
def test_the_code_runs(number, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    run_block(BLOCKS[number])
    out = capsys.readouterr().out
    assert ("RaceTree: policies" in out) if number == 0 else ("\n0 [" in out)
