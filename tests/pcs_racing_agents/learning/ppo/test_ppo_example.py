import subprocess
import sys

from repository import REPOSITORY

EXAMPLE = REPOSITORY / "examples" / "ppo_against_cfr.py"


def test_train_save_race(tmp_path):
    arguments = ["--track", "Pipkin", "--steps", "100", "--rival", "always-aggressiveness+", "--egos", "2"]
    done = subprocess.run(
        [sys.executable, EXAMPLE, *arguments, "--variants", "2"],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    created = tmp_path / "out" / "ppo_against_cfr"
    assert {path.name for path in (created / "training" / "policy").iterdir()} == {
        "weights.safetensors",
        "manifest.yaml",
        "curve.csv",
    }
    assert "always-aggressiveness+     24 " in done.stdout
    assert (created / "race.html").is_file()


def test_an_unknown_rival_is_told_before_training(tmp_path):
    done = subprocess.run(
        [sys.executable, EXAMPLE, "--rival", "nobody"], capture_output=True, text=True, cwd=tmp_path, check=False
    )
    assert done.returncode == 1
    assert done.stderr.startswith("ppo_against_cfr: error: agent 'nobody' is unknown")
    assert not (tmp_path / "out").exists()
