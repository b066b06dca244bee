from dataclasses import replace

import pytest
import yaml
from refusal import refused
from repository import read_page

from pcs_racing.base.errors import ConfigError, UnknownNameError
from pcs_racing.base.settings import plain_settings
from pcs_racing_agents.base.configurations import shipped_configs
from pcs_racing_agents.learning.ppo.settings import DriveSettings, DuelSettings, load_ppo_settings
from pcs_racing_agents.learning.ppo.train import make_task


def test_shipped_settings_are_those_of_the_two_levels_and_a_file_changes_what_it_names(tmp_path):
    result = {name: load_ppo_settings(name) for name in shipped_configs("ppo")}
    assert all(f"`{name}`" in read_page("ppo.md") for name in result)
    assert set(result) == {"drive", "duel-contest", "duel-paper", "study-contest", "study-paper"}
    assert isinstance(result["drive"], DriveSettings)
    assert isinstance(result["duel-contest"], DuelSettings)
    assert result["duel-contest"].archive == "contest"
    assert result["duel-paper"].steps >= 400_000
    assert result["drive"].steps >= 2_000_000
    file = tmp_path / "mine.yaml"
    file.write_text("level: drive\nhold: 10\nopponents: {pure-pursuit: 3}\nseeds: [4, 5]\n")
    settings = load_ppo_settings(file, steps=77)
    assert settings == DriveSettings(hold=10, opponents={"pure-pursuit": 3}, seeds=(4, 5), steps=77)


def test_impossible_settings_are_named(tmp_path):
    for text, message in [
        ("hidden: [4]", r"level is None"),
        ("level: duel\nhold: 2", r"unknown ppo setting 'hold'"),
        ("level: drive\nhold: 3", r"mine.yaml: hold is 3"),
        ("level: drive\narchive: default", r"unknown ppo setting 'archive'"),
        ("level: duel\nopponents: never-switch", r"opponents is 'never-switch'"),
        ("level: duel\nopponents: {never-switch: 0.5}", r"opponents holds 'never-switch': 0.5"),
    ]:
        file = tmp_path / "mine.yaml"
        file.write_text(text)
        refused(message, load_ppo_settings, file, error=ConfigError)


def test_what_settings_name_must_exist_once(duel_settings, drive_settings, tmp_path):
    for changes, message in [
        ({"tracks": ("Nowhere",)}, "Nowhere"),
        ({"archive": "nothing"}, "nothing"),
        ({"race": "sunday"}, "sunday"),
        ({"opponents": {"always-wrong": 1}}, "opponent 'always-wrong' is unknown"),
    ]:
        refused(message, make_task, replace(duel_settings, **changes))
    file = tmp_path / "other.yaml"
    file.write_text("name: short\n")
    refused(
        "the same name",
        make_task,
        replace(drive_settings, races=(*drive_settings.races, str(file))),
    )
    with pytest.raises(UnknownNameError, match="planner 'tortoise' is unknown"):
        make_task(replace(drive_settings, opponents={"tortoise": 1}))


@pytest.fixture
def config(drive_settings, tmp_path):
    file = tmp_path / "mine.yaml"
    values = plain_settings(replace(drive_settings, steps=320))
    file.write_text(yaml.safe_dump({**values, "opponents": dict(drive_settings.opponents)}))
    return str(file)


def test_training_from_the_command_line(config, tmp_path, run):
    arguments = [
        "ppo",
        "--config",
        config,
        "--out",
        tmp_path / "out",
        "--seeds",
        3,
        "--name",
        "mine",
    ]
    code, out, err = run(*arguments)
    assert code == 0
    assert "320 with seed 3: " in out
    assert "Pipkin short" in out
    assert "320/320 steps" in err
    created = {path.name for path in (tmp_path / "out").iterdir() if not path.name.startswith(".")}
    assert created == {"job.yaml", "chunks", "updates.csv", "curve.png", "policy"}
    assert (
        yaml.safe_load((tmp_path / "out" / "policy" / "manifest.yaml").read_text())["name"]
        == "mine"
    )
    assert run(*arguments)[:2] == (0, out)  # finished: it is only read
