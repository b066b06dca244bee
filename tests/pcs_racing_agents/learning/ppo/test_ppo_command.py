from dataclasses import replace

import pytest
import yaml

from pcs_racing.base.settings import plain_settings
from pcs_racing_agents.cli.main import main


@pytest.fixture
def config(drive_settings, tmp_path):
    file = tmp_path / "mine.yaml"
    values = plain_settings(replace(drive_settings, steps=320))
    file.write_text(yaml.safe_dump({**values, "opponents": dict(drive_settings.opponents)}))
    return str(file)


def test_training_from_the_command_line(config, tmp_path, capsys):
    arguments = ["ppo", "--config", config, "--out", str(tmp_path / "out"), "--seeds", "3", "--name", "mine"]
    assert main(arguments) == 0
    told = capsys.readouterr()
    assert "320 with seed 3: " in told.out
    assert "Pipkin short" in told.out
    assert "320/320 steps" in told.err
    made = {path.name for path in (tmp_path / "out").iterdir() if not path.name.startswith(".")}
    assert made == {"job.yaml", "chunks", "updates.csv", "curve.png", "policy"}
    assert yaml.safe_load((tmp_path / "out" / "policy" / "manifest.yaml").read_text())["name"] == "mine"
    assert main(arguments) == 0  # finished: it is only read
    assert capsys.readouterr().out == told.out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--config", "nonsense"], "ppo settings 'nonsense' are unknown; use drive, duel-contest, duel-paper"),
        (["--config", "drive", "--steps", "0"], "steps is 0; it must be a whole number from 1"),
        (["--config", "drive", "--seeds", "-1"], "seeds is (-1,); it must be a list"),
        (
            ["--config", "drive", "--checkpoint", "-1"],
            "the time between two checkpoints is -1.0 s; it must be 0 or more",
        ),
        (
            ["--config", "drive", "--scheduler", "tcp://x:1"],
            "a scheduler's address (tcp://x:1) goes with the executor dask",
        ),
    ],
)
def test_errors_are_one_line_before_any_work(arguments, message, tmp_path, capsys):
    assert main(["ppo", *arguments, "--out", str(tmp_path / "out")]) == 2
    told = capsys.readouterr().err
    assert told.startswith("pcs-racing: error: ")
    assert message in told
    assert told.count("\n") == 1
    assert not (tmp_path / "out").exists()
