from dataclasses import replace

import pytest
import yaml
from refusal import refused
from repository import read_page

from pcs_racing.base.errors import ConfigError
from pcs_racing.base.settings import plain_settings
from pcs_racing_agents.base.configurations import shipped_configs
from pcs_racing_agents.learning.ppo.settings import DuelSettings, load_ppo_settings


def test_shipped_settings_are_on_the_page_and_a_file_changes_what_it_names(tmp_path):
    result = {name: load_ppo_settings(name) for name in shipped_configs("ppo")}
    assert all(f"`{name}`" in read_page("ppo.md") for name in result)
    assert result["duel-contest"].archive == "contest"
    file = tmp_path / "mine.yaml"
    file.write_text("envs: 10\nopponents: {pure-pursuit: 3}\nseeds: [4, 5]\n")
    settings = load_ppo_settings(file, steps=77)
    assert settings == DuelSettings(envs=10, opponents={"pure-pursuit": 3}, seeds=(4, 5), steps=77)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("hold: 2", r"unknown ppo setting 'hold'"),
        ("final_learning_rate: -1.0", r"final_learning_rate is -1"),
        ("opponents: never-switch", r"opponents is 'never-switch'"),
        ("opponents: {never-switch: 0.5}", r"opponents holds 'never-switch': 0.5"),
    ],
)
def test_impossible_settings_are_named(text, message, tmp_path):
    file = tmp_path / "mine.yaml"
    file.write_text(text)
    refused(message, load_ppo_settings, file, error=ConfigError)


def test_training_from_the_command_line(duel_settings, tmp_path, run):
    config = tmp_path / "mine.yaml"
    values = plain_settings(replace(duel_settings, steps=32))
    config.write_text(yaml.safe_dump({**values, "opponents": dict(duel_settings.opponents)}))
    place = tmp_path / "out"
    arguments = ["ppo", "--config", config, "--out", place, "--seeds", 3, "--name", "mine"]
    code, out, err = run(*arguments)
    assert code == 0
    assert "32 with seed 3: " in out
    assert "Pipkin paper" in out
    assert "32/32 steps" in err
    created = {path.name for path in place.iterdir() if not path.name.startswith(".")}
    assert created == {"job.yaml", "chunks", "curve.png", "policy"}
    assert yaml.safe_load((place / "policy" / "manifest.yaml").read_text())["name"] == "mine"
    assert run(*arguments)[:2] == (0, out)  # finished: it is only read
