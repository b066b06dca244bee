"""Long commands that are killed, run out of disk, or meet each other: nothing is lost, and the
results are the same.
"""

import os
import signal
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from subprocess import PIPE, Popen

import numpy as np
import pytest
from long_jobs import SETTINGS, TREES, commands, files
from warm_start import call_python

from pcs_racing_agents.base.folders import hold_folder
from pcs_racing_agents.cli.main import main

pytestmark = [
    pytest.mark.cluster,
    pytest.mark.skipif(
        sys.platform != "linux", reason="needs SIGKILL, flock and a limit on the size of files"
    ),
]

TORCH = pytest.mark.skipif(find_spec("torch") is None, reason="torch is not installed")
LONG = [
    "synthesize",
    "tree",
    pytest.param("train", marks=TORCH),
    "tournament",
    pytest.param("study", marks=TORCH),
]
KILLS = 2  # of a folder
SEEDS = range(int(os.environ.get("PCS_RACING_KILLED_FOLDERS", "1")))  # of each command

KILLED = """
import os, signal, sys, threading, time

from pcs_racing_agents.cli.main import main

def kill_at(seconds):
    while time.process_time() < seconds:
        time.sleep(0.002)
    os.kill(os.getpid(), signal.SIGKILL)

threading.Thread(target=kill_at, args=(float(sys.argv[1]),), daemon=True).start()
code = main(sys.argv[2:])
print(f"processor time {time.process_time():.3f}")
sys.exit(code)
"""
"""Run a command and kill it after some seconds of processor time: they pass alike, however busy the
machine is.
"""


@pytest.fixture(scope="module")
def long_commands(tmp_path_factory) -> dict[str, list[str]]:
    """Every long command; the training is of a network on some trees, without curves, which hold
    times.
    """
    folder = tmp_path_factory.mktemp("settings")
    assert main(["tree", *TREES, "--pairs", "4", "--out", str(folder / "trees")]) == 0
    train = [
        "train",
        "regret",
        str(folder / "trees"),
        "--config",
        "quick",
        "--epochs",
        "12",
        "--name",
        "small",
    ]
    return commands() | {
        "study": ["study", str(SETTINGS / "study.yaml")],
        "train": train,
    }


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("what", LONG)
def test_killed_at_random_moments_and_damaged_the_results_are_the_same(
    long_commands, tmp_path, what, seed, capsys
):
    command = long_commands[what]
    whole = call_python("-c", KILLED, "inf", *command, "--out", tmp_path / "whole")
    assert whole.returncode == 0, whole.stderr
    seconds = float(whole.stdout.split("processor time ")[1])
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(len(what),)))
    killed = 0
    while killed < KILLS:
        moment = rng.uniform(0.05, 0.7) * seconds
        done = call_python("-c", KILLED, moment, *command, "--out", tmp_path / "killed")
        assert done.returncode in (0, -signal.SIGKILL), done.stderr
        killed += done.returncode != 0
        seconds *= 1.0 if done.returncode else 0.5  # less was left, or the whole run had to compile
    left = sorted(
        file for file in (tmp_path / "killed").rglob("*") if file.is_file() and file.stat().st_size
    )
    struck = rng.choice(left) if left else tmp_path / "nothing was written"
    if left:
        content = bytearray(struck.read_bytes())
        content[rng.integers(len(content))] ^= 1 << int(rng.integers(8))
        struck.write_bytes(content)
    capsys.readouterr()
    if main([*command, "--out", str(tmp_path / "killed")]) == 0:
        assert files(tmp_path / "killed") == files(tmp_path / "whole"), struck
    else:  # whether it was meant is not known: the file is named, once
        (error,) = [line for line in capsys.readouterr().err.splitlines() if "error" in line]
        assert str(struck) in error


def test_sigterm_ends_a_command_and_its_workers_as_ctrl_c_does(long_commands, tmp_path):
    command = [
        *long_commands["tree"],
        "--workers",
        "1",
        "--out",
        tmp_path,
    ]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    # A new interpreter: its own tracker of semaphores reports leaks.
    with Popen(
        [sys.executable, "-m", "pcs_racing_agents", *command],
        stderr=PIPE,
        text=True,
        env=environment,
    ) as run:
        while run.poll() is None and not list(tmp_path.glob("chunks/*.npz")):
            time.sleep(0.02)
        run.terminate()
        said = run.communicate()[1]
    assert run.returncode == 143
    assert said.endswith("pcs-racing: terminated\n")


@contextmanager
def largest_file(size: int) -> Iterator[None]:
    """A limit on the size of files replaces a full disk: the write itself fails."""
    import resource

    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.parametrize("size", [0, 2500])
@pytest.mark.parametrize("what", LONG[1:3])
def test_a_full_disk_is_one_clear_error_and_loses_nothing(
    long_commands, tmp_path, what, size, capsys
):
    with largest_file(size):
        assert main([*long_commands[what], "--out", str(tmp_path / "out")]) == 2
    (error,) = [line for line in capsys.readouterr().err.splitlines() if "rror" in line]
    assert error.startswith("pcs-racing: error: can't ")
    assert str(tmp_path / "out") in error
    assert "File too large" in error
    assert not list((tmp_path / "out").rglob(".*.????????"))  # no half-written file is left


@pytest.mark.parametrize("what", LONG[1:2])
def test_the_second_of_two_in_one_folder_is_refused(long_commands, tmp_path, what, capsys):
    place = tmp_path / "out"
    with hold_folder(place):
        assert main([*long_commands[what], "--out", str(tmp_path / "out")]) == 2
        assert [file.name for file in place.iterdir()] == [".lock"]
    error = capsys.readouterr().err.splitlines()[-1]
    assert error.endswith("in use by another process; wait until it ends, or choose another folder")
