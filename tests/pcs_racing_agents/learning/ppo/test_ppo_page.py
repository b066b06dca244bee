"""docs/ppo.md: its code runs, and the settings it names are there."""

import re

import pytest
from repository import REPOSITORY

from pcs_racing_agents.jobs.configuration import shipped_configs

PAGE = (REPOSITORY / "docs" / "ppo.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)


@pytest.mark.parametrize("number", range(len(BLOCKS)))
def test_the_code_runs(number, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    exec(compile(BLOCKS[number], "docs/ppo.md", "exec"), {"__name__": "snippet"})


def test_settings_are_named():
    for name in shipped_configs("ppo"):
        assert f"`{name}`" in PAGE
