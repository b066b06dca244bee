"""The comparison with the F1TENTH gym: our half, the errors, and the half that runs there, with a stand-in."""

import stat
import sys

import pytest
from repository import load_tool


@pytest.fixture(scope="module")
def beside():
    return load_tool("beside_f1tenth_gym", "benchmarks")


@pytest.mark.parametrize(
    "arguments", ["--checkout .", f"--checkout nowhere --python {sys.executable}", "--seconds 0", "--track nowhere"]
)
def test_what_cannot_be_compared_is_one_line(beside, arguments, capsys):
    assert beside.main(arguments.split()) == 2
    printed = capsys.readouterr()
    assert (printed.out, printed.err.count("\n")) == ("", 1)


def test_the_gym_is_run_by_its_own_python_and_named_if_it_fails(beside, tmp_path, capsys):
    """A stand-in for the other Python takes the task and answers as the gym's half does."""
    (tmp_path / "f1tenth_gym" / "envs").mkdir(parents=True)
    python = tmp_path / "python"
    given = ["--checkout", str(tmp_path), "--python", str(python), "--seconds", "2", "--races", "1", "--cars", "2"]
    answer = '{"spent": 4.0, "driven": task["seconds"], "crashed": False}'
    python.write_text(
        f"#!{sys.executable}\nimport json, sys\ntask = json.load(sys.stdin)\nprint(json.dumps({answer}))\n"
    )
    python.chmod(python.stat().st_mode | stat.S_IXUSR)
    assert beside.main(given) == 0
    row = next(line for line in capsys.readouterr().out.splitlines() if "| F1TENTH gym" in line)
    assert [cell.strip() for cell in row.split("|")[3:6]] == ["2", "0.5", "1.0"]
    python.write_text(f"#!{sys.executable}\nraise SystemExit('no gym here')\n")
    assert beside.main(given) == 2
    assert "no gym here" in capsys.readouterr().err
