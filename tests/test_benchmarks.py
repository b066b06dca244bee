"""Every script of ``dev/benchmarks`` runs in a bare clone; the history of speed; a stand-in of the
F1TENTH gym.
"""

import stat
import sys

import pytest
from repository import REPOSITORY, load_tool, run_python
from warm_start import call_python

record, beside, start_time = (
    load_tool(name, "dev/benchmarks") for name in ("record", "beside_f1tenth_gym", "start_time")
)

# of those that compile for a minute, or race the whole zoo
HELP = ("--help", "python dev/benchmarks/")
SMALL = {
    "beside_f1tenth_gym": ("--seconds 2 --races 2 --cars 2", "| here"),
    "bits": ("--parts vehicles", "vehicle, target"),
    "decision_delay": ("--seconds 0.2", "| lidar-ppo.onnx | 100 |"),
    "driving": ("--only stability", "stability"),
    "environment_speed": ("--only duel --envs 2 --seconds 0.01", "duel"),
    "imperfect_cars": ("--out out --races 2", "error: --races 2"),
    "race_speed": ("--track Pipkin --races 2", "ms"),
    "sb3_speed": ("--steps 64", "limit by the products"),
    "scan_speed": ("--track Pipkin", "us"),
    **dict.fromkeys(
        ("circuits", "line_learning", "record", "solver_speed", "start_time", "zoo"), HELP
    ),
}


SCRIPTS = sorted((REPOSITORY / "dev" / "benchmarks").glob("*.py"))


@pytest.mark.parametrize("name", [file.stem for file in SCRIPTS])
def test_a_script_finds_what_it_imports(name):
    assert load_tool(name, "dev/benchmarks").__doc__


@pytest.mark.benchmarks
@pytest.mark.parametrize("file", SCRIPTS, ids=lambda file: file.stem)
def test_a_script_runs_where_it_says_that_it_runs(file, tmp_path):
    arguments, said = SMALL[file.stem]
    done = call_python(file, *arguments.split(), cwd=tmp_path)
    assert (done.returncode, "Traceback" in done.stderr) == (
        2 if "error" in said else 0,
        False,
    ), done.stderr
    assert said in (done.stderr if "error" in said else done.stdout)


@pytest.mark.parametrize(
    ("program", "most"),
    [
        ("one car alone", 90),
        *(
            pytest.param(*row, marks=pytest.mark.benchmarks)
            for row in [
                ("README", 190),
                ("duel", 150),
                ("pcs-racing race", 150),
                ("batch with lidar", 190),
            ]
        ),
    ],
)
def test_a_first_step_compiles_no_more_functions(program, most, tmp_path, monkeypatch):
    """What a program does not use is not compiled for it."""
    text = start_time.PROGRAMS[program]
    run_python("-c", text, folder=tmp_path)  # builds and keeps the circuit
    monkeypatch.setenv("NUMBA_OPT", "0")  # the same functions in less time
    assert start_time.first_step(text, REPOSITORY)[1] <= most


def lines(*values: float, processor: str = "here") -> list[dict[str, str]]:
    return [{"processor": processor, "race": str(value)} for value in values]


@pytest.mark.parametrize(
    ("ratio", "history", "processor", "slower"),
    [
        (14.0, lines(10.0, 10.2, 9.8), "here", True),
        (12.5, lines(10.0, 10.2, 9.8), "here", False),
        (14.0, lines(*[1.0] * 20, 10.0, 10.0, 10.0, 100.0, 10.0), "here", True),
        (11.0, lines(5.0, processor="there") + lines(10.0), "here", False),
        (11.0, lines(5.0, processor="there") + lines(10.0), "elsewhere", True),
        (3.0, [], "here", False),
    ],
)
def test_a_ratio_far_above_the_last_ones_of_this_machine_is_slower(
    ratio, history, processor, slower
):
    assert bool(record.slower({"race": ratio}, history, processor)) == slower


def test_the_history_has_every_ratio():
    assert all(float(record.read_history()[-1][name]) > 0.0 for name in record.RATIOS)


@pytest.mark.benchmarks
@pytest.mark.parametrize(
    "arguments",
    [
        "--checkout .",
        f"--checkout nowhere --python {sys.executable}",
        "--seconds 0",
        "--track nowhere",
    ],
)
def test_what_cannot_be_compared_is_one_line(arguments, capsys):
    assert beside.main(arguments.split()) == 2
    printed = capsys.readouterr()
    assert (printed.out, printed.err.count("\n")) == ("", 1)


@pytest.mark.benchmarks
def test_the_gym_is_run_by_its_own_python_and_named_if_it_fails(tmp_path, capsys):
    """A substitute of the other Python takes the task and answers as the gym's half does."""
    (tmp_path / "f1tenth_gym" / "envs").mkdir(parents=True)
    python = tmp_path / "python"
    given = f"--checkout {tmp_path} --python {python} --seconds 2 --races 1 --cars 2".split()
    answer = '{"spent": 4.0, "driven": task["seconds"], "crashed": False}'
    python.write_text(
        f"#!{sys.executable}\nimport json, sys\ntask ="
        f" json.load(sys.stdin)\nprint(json.dumps({answer}))\n"
    )
    python.chmod(python.stat().st_mode | stat.S_IXUSR)
    assert beside.main(given) == 0
    row = next(line for line in capsys.readouterr().out.splitlines() if "| F1TENTH gym" in line)
    assert [cell.strip() for cell in row.split("|")[3:6]] == ["2", "0.5", "1.0"]
    python.write_text(f"#!{sys.executable}\nraise SystemExit('no gym here')\n")
    assert beside.main(given) == 2
    assert "no gym here" in capsys.readouterr().err
