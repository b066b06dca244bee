"""The fuzzer itself: it runs, and it tells a finding from an answer."""

import json
import os
import subprocess
import sys
import warnings
from dataclasses import replace

import pytest
from repository import REPOSITORY, load_tool

from pcs_racing import InputError


@pytest.fixture(scope="module")
def fuzz():
    return load_tool("fuzz")


def refuse(data):
    raise InputError(data.decode())


def fail(data):
    raise KeyError("height")


def warn(data):
    warnings.warn("overflow", RuntimeWarning, stacklevel=1)


def test_an_answer_is_told_from_a_finding(fuzz):
    for target, data, word, where in [
        (len, b"", "accepted", ""),
        (refuse, b"it is too long", "refused", ""),
        (refuse, b"", "CRASH", "message"),
        (fail, b"", "CRASH", "KeyError in test_fuzzer.py"),
        (warn, b"", "CRASH", "RuntimeWarning in test_fuzzer.py"),
    ]:
        found, place = fuzz.judge(target, data)
        assert found == word
        assert where in place


def test_a_campaign_writes_a_line_for_each_turn_and_goes_on_where_it_was(tmp_path):
    command = [
        sys.executable,
        str(REPOSITORY / "dev" / "tools" / "fuzz.py"),
        "run",
        "--targets",
        "map yaml",
    ]
    options = ["--turns", "2", "--slice", "0.2", "--out", str(tmp_path)]
    done = subprocess.run(
        [*command, *options], capture_output=True, text=True, timeout=300, check=False
    )
    assert done.returncode == 0, done.stderr[-2000:]
    lines = [json.loads(text) for text in (tmp_path / "log.jsonl").read_text().splitlines()]
    assert [line["target"] for line in lines] == ["map yaml", "map yaml"]
    assert [line["first"] for line in lines] == [0, lines[0]["inputs"]]
    for line in lines:
        assert line["inputs"] == sum(line["counts"].values()) >= 1
        assert set(line["counts"]) <= {"accepted", "refused"}, done.stdout


def test_an_input_that_ends_the_process_is_kept(fuzz, tmp_path, monkeypatch):
    """The valid input ends nothing; the first broken one does."""
    target = fuzz.TARGETS["map yaml"]
    (valid,) = target.seeds()[:1]
    run = lambda data: None if data == valid else os._exit(7)  # noqa: E731
    monkeypatch.setitem(fuzz.TARGETS, "map yaml", replace(target, run=run, seeds=lambda: [valid]))
    assert fuzz.take_turn("map yaml", 0, 1.0, tmp_path)
    (line,) = fuzz.read_log(tmp_path)
    assert line["counts"]["DEAD"] == 1
    (kept,) = (tmp_path / "findings").glob("*.bin")
    assert kept.read_bytes() == fuzz.broken_input(
        "map yaml", 0, line["counts"]["not counted"], [valid]
    )
