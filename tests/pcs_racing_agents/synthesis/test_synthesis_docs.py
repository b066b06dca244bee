"""The code in docs/synthesis.md runs, and the page names every method."""

import re
import subprocess
import sys

import pytest
from repository import REPOSITORY

from pcs_racing_agents.synthesis.optimisers import METHODS

PAGE = (REPOSITORY / "docs" / "synthesis.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"```python\n(.*?)```", PAGE, flags=re.DOTALL)


@pytest.mark.parametrize("number", range(len(BLOCKS)))
def test_the_page_s_code_runs(number, tmp_path):
    (tmp_path / "block.py").write_text(BLOCKS[number])
    done = subprocess.run([sys.executable, "block.py"], capture_output=True, text=True, cwd=tmp_path, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout


def test_every_method_is_on_the_page():
    assert all(f'`"{method}"`' in PAGE and f"| `{method}` |" in PAGE for method in METHODS)
