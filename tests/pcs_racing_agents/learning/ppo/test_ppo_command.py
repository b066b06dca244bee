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
    captured = capsys.readouterr()
    assert "320 with seed 3: " in captured.out
    assert "Pipkin short" in captured.out
    assert "320/320 steps" in captured.err
    created = {path.name for path in (tmp_path / "out").iterdir() if not path.name.startswith(".")}
    assert created == {"job.yaml", "chunks", "updates.csv", "curve.png", "policy"}
    assert yaml.safe_load((tmp_path / "out" / "policy" / "manifest.yaml").read_text())["name"] == "mine"
    assert main(arguments) == 0  # finished: it is only read
    assert capsys.readouterr().out == captured.out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--config", "nonsense"], "ppo settings 'nonsense' are unknown"),
        (["--config", "drive", "--steps", "0"], "steps is 0"),
        (["--config", "drive", "--seeds", "-1"], "seeds is (-1,)"),
        (
            ["--config", "drive", "--scheduler", "tcp://x:1"],
            "a scheduler's address (tcp://x:1) goes with the executor dask",
        ),
    ],
)
def test_errors_are_one_line_before_any_work(arguments, message, tmp_path, capsys):
    assert main(["ppo", *arguments, "--out", str(tmp_path / "out")]) == 2
    captured = capsys.readouterr().err
    assert captured.startswith("pcs-racing: error: ")
    assert message in captured
    assert captured.count("\n") == 1
    assert not (tmp_path / "out").exists()
