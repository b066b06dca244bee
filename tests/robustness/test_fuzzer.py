"""The fuzzer itself: all its engines run, and it tells a finding from an answer."""

import importlib
import json
import subprocess
import sys
import warnings

import pytest
from repository import REPOSITORY

from pcs_racing import InputError

TOOLS = REPOSITORY / "tools"


@pytest.fixture(scope="module")
def fuzz():
    sys.path.insert(0, str(TOOLS))
    yield importlib.import_module("fuzz")
    sys.path.remove(str(TOOLS))


def refuse(data):
    raise InputError(data.decode())


def fail(data):
    raise KeyError("height")


def warn(data):
    warnings.warn("overflow", RuntimeWarning, stacklevel=1)


@pytest.mark.parametrize(
    ("target", "data", "word", "where"),
    [
        (len, b"", "accepted", ""),
        (refuse, b"it is too long", "refused", ""),
        (refuse, b"", "CRASH", "message"),
        (fail, b"", "CRASH", "KeyError in test_fuzzer.py"),
        (warn, b"", "CRASH", "RuntimeWarning in test_fuzzer.py"),
    ],
)
def test_an_answer_is_told_from_a_finding(fuzz, target, data, word, where):
    found, place = fuzz.judge(target, data)
    assert found == word
    assert where in place


@pytest.mark.parametrize("engine", ["mutations", "hypothesis", "atheris"])
def test_every_engine_runs_and_writes_its_line(engine, tmp_path):
    if engine == "atheris":
        pytest.importorskip("atheris")
    command = [sys.executable, str(TOOLS / "fuzz.py"), "run", "--engine", engine, "--targets", "map yaml"]
    options = ["--turns", "1", "--slice", "0.2", "--out", str(tmp_path)]
    done = subprocess.run([*command, *options], capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    (line,) = (json.loads(text) for text in (tmp_path / "log.jsonl").read_text().splitlines())
    assert (line["target"], line["engine"]) == ("map yaml", engine)
    assert line["inputs"] == sum(line["counts"].values()) >= 1
    assert set(line["counts"]) <= {"accepted", "refused"}, done.stdout
    assert f"| all | {line['inputs'] if engine == 'mutations' else 0:,} |" in done.stdout


def test_the_short_table_holds_every_target(fuzz):
    targets = importlib.import_module("fuzz_targets")
    listed = [name for names in targets.GROUPS.values() for name in names]
    assert sorted(listed) == sorted(targets.TARGETS)
