"""docs/agents.md: its code runs, and what the zoo says of itself stands there."""

import re
from pathlib import Path

import pytest

from pcs_racing_agents.strategies.describe import MARK, option_meanings, zoo_sections
from pcs_racing_agents.strategies.zoo import ZOO, options
from pcs_racing_agents.tournament import RaceRow

PAGE = (Path(__file__).resolve().parents[3] / "docs" / "agents.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)


@pytest.mark.parametrize("number", range(len(BLOCKS)))
def test_the_code_runs(number, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    exec(compile(BLOCKS[number], "docs/agents.md", "exec"), {"__name__": "snippet"})


def test_every_agent_has_its_section():
    assert PAGE.partition(MARK)[2].strip() == zoo_sections(), f"do as the page says: {MARK}"
    for name in ZOO:
        assert f"\n### `{name}`\n" in PAGE


def test_every_option_is_explained():
    for name, entry in ZOO.items():
        assert set(options(name)) <= set(option_meanings(entry.build)), name


def test_every_column_of_the_results_is_explained():
    for column in ("preset", *RaceRow._fields):
        assert f"`{column}`" in PAGE
