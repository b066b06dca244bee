"""Every client library has one example, which names the versions that it was tried with."""

import re

import pytest
from repository import load_tool, read_page

try_clients = load_tool("try_clients")
PAGE = read_page("reports/clients.md")
SCRIPTS = try_clients.scripts(None)
TABLE = PAGE[PAGE.index(try_clients.HEAD) :].partition("\n\n")[0].splitlines()[2:]
"""The rows of the table that the tool printed."""

NOT_RUN = re.findall(
    r"`(\w+\.py)`", "".join(re.findall(r"^Not run with these versions yet: (.*)$", PAGE, re.M))
)
"""Files that the page says are not in the table."""


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda script: script.stem)
def test_the_page_says_what_it_does_and_which_versions_it_was_tried_with(script):
    about, *rows = [line for line in PAGE.splitlines() if line.startswith(f"| `{script.name}`")]
    assert about not in TABLE
    assert len(rows) == (script.name not in NOT_RUN)
    if not rows:
        return
    (row,) = rows
    assert row in TABLE
    assert row.split(" | ")[-2] == "yes"
    for library in try_clients.dependencies(script):
        name, version = library.partition("[")[0].partition("==")[0], library.partition("==")[2]
        at = try_clients.SHARED.index(name) + 2 if name in try_clients.SHARED else 1
        assert (
            f"{name} {version}".removeprefix(f"{name} " if at > 1 else "") in row.split(" | ")[at]
        )


def test_the_table_is_what_the_tool_prints(tmp_path):
    script = tmp_path / "tried.py"
    script.write_text(
        '# /// script\n# dependencies = ["ray[rllib]==2.60.0", "gymnasium==1.2.2"]\n# ///\n'
    )
    installed = {"ray": "2.60.0", "gymnasium": "1.2.2", "pettingzoo": "1.27.0", "numpy": "2.4.6"}
    printed = try_clients.row(script, installed, "yes", 41.7)
    assert printed == "| `tried.py` | ray 2.60.0 | 1.2.2 | 1.27.0 | 2.4.6 |  | yes | 42 |"
    assert printed.count("|") == try_clients.HEAD.splitlines()[0].count("|")
