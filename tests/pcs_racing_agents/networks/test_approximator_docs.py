"""docs/approximator.md says what the code says, and its code runs."""

import re
import subprocess
import sys

import pytest
from repository import REPOSITORY

from pcs_racing_agents.networks import TARGETS

PAGE = (REPOSITORY / "docs" / "approximator.md").read_text(encoding="utf-8")


def test_the_table_of_targets_is_the_targets():
    rows = re.findall(r"^\| `([\w-]+)` \| ([^|]+?) \|$", PAGE, flags=re.MULTILINE)
    assert dict(rows) == {name: target.meaning for name, target in TARGETS.items()}


def test_the_pages_code_runs(tmp_path):
    pytest.importorskip("torch")
    blocks = re.findall(r"```python\n(.*?)```", PAGE, flags=re.DOTALL)
    assert len(blocks) == 2
    page = tmp_path / "page.py"
    page.write_text("\n".join(blocks), encoding="utf-8")
    done = subprocess.run([sys.executable, page], capture_output=True, text=True, cwd=REPOSITORY, check=False)
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert lines[0] == "(2, 2, 4) [[0 0]"
    assert lines[-1].startswith("<RegretNetwork 'mine': 31-16-4, first inputs, archive 'default', preset 'paper'>")


def test_every_measured_figure_names_its_command():
    for table in re.findall(r"(?:^\|.*\n)+", PAGE, flags=re.MULTILINE):
        before = PAGE[: PAGE.index(table)].rstrip().splitlines()[-4:]
        measured = re.search(r"\d\.\d", table)
        assert not measured or any("`python benchmarks/" in line or "`pcs-racing study" in line for line in before)
