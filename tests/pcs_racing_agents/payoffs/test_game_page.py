"""The code of docs/game.md runs and prints what the page says."""

import pytest
from repository import python_blocks, read_page, run_block

BLOCKS = python_blocks(read_page("game.md"))


@pytest.mark.parametrize("number", range(len(BLOCKS)))
def test_the_code_runs(number, capsys):
    run_block(BLOCKS[number])
    assert "(16, 4, 4)" in capsys.readouterr().out
