"""The reports hold: their code runs, and their commands parse."""

import contextlib
import io
import re
import shlex

import pytest
from repository import REPOSITORY, python_blocks, run_block

from studies import __main__

REPORTS = {
    page.name: page.read_text(encoding="utf-8")
    for page in (REPOSITORY / "docs" / "reports").glob("*.md")
}
OTHERS = {
    page.name: page.read_text(encoding="utf-8") for page in (REPOSITORY / "docs").glob("*.md")
}
BLOCKS = [(name, block) for name, text in REPORTS.items() for block in python_blocks(text)]
COMMANDS = [
    (name, line.strip())
    for name, text in [*REPORTS.items(), *OTHERS.items()]
    for block in re.findall(r"```console\n(.*?)```", text, flags=re.DOTALL)
    for line in block.replace("\\\n", " ").splitlines()
    if line.startswith("python -m studies ")
]


@pytest.mark.usefixtures("own_registry")
@pytest.mark.parametrize(("page", "code"), BLOCKS)
def test_the_code_runs(page, code):
    run_block(code)


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
