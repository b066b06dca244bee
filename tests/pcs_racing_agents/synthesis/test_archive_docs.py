"""The code of docs/archives.md runs."""

import pytest
from repository import python_blocks, read_page, run_block

PAGE = read_page("archives.md")
BLOCKS = python_blocks(PAGE)


@pytest.mark.parametrize("number", range(len(BLOCKS)))
def test_the_code_runs(number, tmp_path, monkeypatch, capsys):
    pytest.importorskip("cma")
    monkeypatch.chdir(tmp_path)
    run_block(BLOCKS[number])
    out = capsys.readouterr().out
    assert ("search 2 " in out and "measurement 2 " in out) if number == 0 else "chosen: [" in out
