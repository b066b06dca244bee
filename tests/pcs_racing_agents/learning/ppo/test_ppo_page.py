"""docs/ppo.md: its code runs, and the settings it names are there."""

import pytest
from repository import python_blocks, read_page, run_block

from pcs_racing_agents.jobs.configuration import shipped_configs

PAGE = read_page("ppo.md")
BLOCKS = python_blocks(PAGE)


@pytest.mark.parametrize("number", range(len(BLOCKS)))
def test_the_code_runs(number, tmp_path, monkeypatch):
    pytest.importorskip("stable_baselines3")
    monkeypatch.chdir(tmp_path)
    run_block(BLOCKS[number].replace("model.learn(tuned.steps)", "model.learn(1)"))


def test_settings_are_named():
    for name in shipped_configs("ppo"):
        assert f"`{name}`" in PAGE
