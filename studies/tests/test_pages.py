"""Commands of the experiments on pages parse."""

import contextlib
import io
import re
import shlex

import pytest
from repository import REPOSITORY

from studies import __main__

PAGES = [*(REPOSITORY / "docs").glob("*.md"), *(REPOSITORY / "docs" / "reports").glob("*.md")]
COMMANDS = [
    (page.name, line.strip())
    for page in PAGES
    for block in re.findall(r"```console\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)
    for line in block.replace("\\\n", " ").splitlines()
    if line.startswith("python -m studies ")
]


def parsed(arguments: list[str], monkeypatch) -> bool:
    monkeypatch.setattr(__main__, "run_parsed", lambda parsed: callable(parsed.run))
    with contextlib.redirect_stderr(io.StringIO()):
        try:
            return __main__.main(arguments)
        except SystemExit:
            return False


@pytest.mark.parametrize(("page", "line"), COMMANDS)
def test_commands_are_those_of_the_experiments(page, line, monkeypatch):
    assert parsed(shlex.split(line, comments=True)[3:], monkeypatch)


def test_there_are_commands_and_impossible_ones_are_found(monkeypatch):
    named = {line.split()[3] for _, line in COMMANDS}
    assert {"all", "field", "overtaking", "ppo-against-cfr", "reading", "rows"} <= named
    assert not parsed(["reading", "--trak", "Pipkin"], monkeypatch)
