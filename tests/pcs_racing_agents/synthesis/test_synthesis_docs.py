"""The code in docs/synthesis.md runs, and the page names every method."""

import pytest
from repository import python_blocks, read_page, run_python

from pcs_racing_agents.synthesis.optimisers import METHODS

PAGE = read_page("synthesis.md")
BLOCKS = python_blocks(PAGE)


@pytest.mark.parametrize("number", range(len(BLOCKS)))
def test_the_page_s_code_runs(number, tmp_path):
    (tmp_path / "block.py").write_text(BLOCKS[number])
    assert run_python("block.py", folder=tmp_path)


def test_every_method_is_on_the_page():
    assert all(f'`"{method}"`' in PAGE and f"| `{method}` |" in PAGE for method in METHODS)
