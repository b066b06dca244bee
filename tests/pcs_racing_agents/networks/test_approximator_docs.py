"""docs/approximator.md agrees with the code, and its code runs."""

import re

import pytest
from repository import python_blocks, read_page, run_python

from pcs_racing_agents.networks import TARGETS

PAGE = read_page("approximator.md")


def test_the_page_has_the_table_of_targets_and_its_code_runs(tmp_path):
    rows = re.findall(r"^\| `([\w-]+)` \| ([^|]+?) \|$", PAGE, flags=re.MULTILINE)
    assert dict(rows) == {name: target.meaning for name, target in TARGETS.items()}
    pytest.importorskip("torch")
    blocks = python_blocks(PAGE)
    assert len(blocks) == 2
    page = tmp_path / "page.py"
    page.write_text("\n".join(blocks), encoding="utf-8")
    lines = run_python(page).splitlines()
    assert lines[0] == "(2, 2, 4) [[0 0]"
    assert lines[-1].startswith(
        "<RegretNetwork 'mine': 31-16-4, first inputs, archive 'default', preset 'paper'>"
    )
