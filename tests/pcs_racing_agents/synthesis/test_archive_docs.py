"""The code of docs/archives.md runs."""

import re

import pytest
from repository import REPOSITORY

PAGE = (REPOSITORY / "docs" / "archives.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)


@pytest.mark.parametrize("number", range(len(BLOCKS)))
def test_the_code_runs(number, tmp_path, monkeypatch, capsys):
    pytest.importorskip("cma")
    monkeypatch.chdir(tmp_path)
    exec(compile(BLOCKS[number], "docs/archives.md", "exec"), {"__name__": "snippet"})
    out = capsys.readouterr().out
    assert "search 2 " in out
    assert "measurement 2 " in out


def test_the_commands_are_commands():
    from pcs_racing_agents.cli.main import _parser

    for line in re.findall(r"^pcs-racing (.*)$", PAGE, re.MULTILINE):
        assert _parser().parse_args(line.split()).run is not None


def test_the_pictures_are_there():
    for picture in re.findall(r"!\[.*\]\((.*)\)", PAGE):
        assert (REPOSITORY / "docs" / picture).is_file()
