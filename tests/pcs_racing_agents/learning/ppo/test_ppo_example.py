from repository import REPOSITORY, run_python
from warm_start import call_python

EXAMPLE = REPOSITORY / "examples" / "ppo_against_cfr.py"


def test_train_save_race(tmp_path):
    arguments = ["--track", "Pipkin", "--steps", "100", "--opponent", "always-aggressiveness+", "--egos", "2"]
    out = run_python(EXAMPLE, *arguments, "--variants", "2", folder=tmp_path)
    created = tmp_path / "out" / "ppo_against_cfr"
    assert {path.name for path in (created / "training" / "policy").iterdir()} == {
        "weights.safetensors",
        "manifest.yaml",
        "curve.csv",
    }
    assert "always-aggressiveness+     24 " in out
    assert (created / "race.html").is_file()


def test_an_unknown_opponent_is_told_before_training(tmp_path):
    done = call_python(EXAMPLE, "--opponent", "nobody", cwd=tmp_path)
    assert done.returncode == 1
    assert done.stderr.startswith("ppo_against_cfr: error: agent 'nobody' is unknown")
    assert not (tmp_path / "out").exists()
