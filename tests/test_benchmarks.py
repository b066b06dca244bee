"""Every script of ``benchmarks/`` runs in a bare clone, here as small as it can be; or it says what it needs."""

import pytest
from repository import REPOSITORY
from warm_start import call_python

# Of those that compile for a minute, or race the whole zoo; the first one has tests of its own.
HELP = ("--help", "python benchmarks/")
SMALL = {
    "beside_f1tenth_gym": HELP,
    "bits": ("--parts vehicles", "vehicle, target"),
    "circuits": HELP,
    "driving": ("--only stability", "stability"),
    "environment_speed": ("--only duel --envs 2 --seconds 0.01", "duel"),
    "field": HELP,
    "first_race": ("--track Pipkin --seeds 1", ""),
    "load": ("drive --envs 2 --steps 40", "time of a unit: "),
    "planner_figure": ("--out made.png", "made.png"),
    "pooled_studies": ("out/one out/two", "error: there is no out/one/table.csv, out/two/table.csv"),
    "ppo_baselines": ("--lines 0", ""),
    "race_speed": ("--track Pipkin --races 2", "ms"),
    "racing_quality": ("--tracks Pipkin --race paper --policies 4 --opponents 2", "Pipkin"),
    "record": ("--show", "race"),
    "scan_speed": ("--track Pipkin", "us"),
    "solver_speed": HELP,
    "start_time": HELP,
    "statistics_coverage": ("--datasets 4", "true"),
    "tuned_ppo": ("--only", ""),
    "zoo": HELP,
}


@pytest.mark.parametrize("file", sorted((REPOSITORY / "benchmarks").glob("*.py")), ids=lambda file: file.stem)
def test_a_script_runs_where_it_says_that_it_runs(file, tmp_path):
    arguments, said = SMALL[file.stem]
    done = call_python(file, *arguments.split(), cwd=tmp_path)
    assert (done.returncode, "Traceback" in done.stderr) == (2 if "error" in said else 0, False), done.stderr
    assert said in (done.stderr if "error" in said else done.stdout)
