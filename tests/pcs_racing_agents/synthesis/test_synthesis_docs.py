"""The code in docs/synthesis.md and docs/archives.md runs, and the former names every method."""

import pytest
from repository import python_blocks, read_page, run_block, run_python

from pcs_racing_agents.synthesis.optimisers import METHODS

PAGE = read_page("synthesis.md")
SEARCHES, ARCHIVES = python_blocks(PAGE), python_blocks(read_page("archives.md"))


@pytest.mark.parametrize("number", range(len(SEARCHES)))
def test_code_on_searches_runs(number, tmp_path):
    (tmp_path / "block.py").write_text(SEARCHES[number])
    assert run_python("block.py", folder=tmp_path)


@pytest.mark.parametrize("number", range(len(ARCHIVES)))
def test_code_on_archives_runs(number, tmp_path, monkeypatch, capsys):
    pytest.importorskip("cma")
    monkeypatch.chdir(tmp_path)
    run_block(ARCHIVES[number])
    out = capsys.readouterr().out
    assert ("search 2 " in out and "measurement 2 " in out) if number == 0 else "chosen: [" in out


def test_every_method_is_on_the_page():
    assert all(f'`"{method}"`' in PAGE and f"| `{method}` |" in PAGE for method in METHODS)
