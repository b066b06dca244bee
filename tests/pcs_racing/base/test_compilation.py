import gc
import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from refusal import refused
from repository import REPOSITORY, run_python

from pcs_racing.base.compilation import compiled, first_call, inner_kernel, kernel


@compiled
def divide(a, b):
    return a / b


def test_compiled_code_divides_as_ieee_says_and_calls_inner_kernels():
    assert divide(1.0, 0.0) == float("inf")
    assert divide(-1.0, 0.0) == float("-inf")
    assert quarter(2.0) == 0.5
    refused("half", half, 2.0, error=TypeError)


@inner_kernel
def half(a):
    return 0.5 * a


@kernel
def quarter(a):
    return half(half(a))


def dispatcher(cache: Path, signatures: tuple = ()) -> SimpleNamespace:
    """What the announcement looks at."""
    return SimpleNamespace(
        signatures=signatures, py_func=divide.py_func, stats=SimpleNamespace(cache_path=str(cache))
    )


def test_the_first_compilation_is_announced_and_no_other(tmp_path, capsys):
    answers = []
    for _ in range(2):
        with first_call(dispatcher(tmp_path / "empty"), "the test itself", 7) as compiling:
            answers.append(compiling)
    assert answers == [True, False]
    told = "pcs-racing: compiling the test itself (about 7 s, once; it is cached on disk)\n"
    assert capsys.readouterr().err == told
    with first_call(dispatcher(tmp_path, signatures=("f8",)), "what is in memory", 7) as compiling:
        assert not compiling
    (tmp_path / "test_compilation.divide-13.py311.nbi").touch()
    with first_call(dispatcher(tmp_path), "what is on disk", 7) as compiling:
        assert not compiling
    assert capsys.readouterr().err == ""


def failing_call(cache: Path, what: str) -> None:
    with first_call(dispatcher(cache), what, 7):
        assert not gc.isenabled()
        raise ZeroDivisionError


@pytest.mark.parametrize("collects", [True, False])
def test_no_garbage_is_collected_during_a_compilation(tmp_path, collects):
    was = gc.isenabled()
    (gc.enable if collects else gc.disable)()
    try:
        with pytest.raises(ZeroDivisionError):
            failing_call(tmp_path, f"what fails {collects}")
        assert gc.isenabled() is collects
    finally:
        (gc.enable if was else gc.disable)()


WORKER = """
import sys, time
from pathlib import Path
from types import SimpleNamespace
from pcs_racing.base.compilation import first_call

def f(): pass

cache = Path(sys.argv[1])
dispatcher = SimpleNamespace(signatures=(), py_func=f, stats=SimpleNamespace(cache_path=str(cache)))
with first_call(dispatcher, "the test", 1):
    if not list(cache.glob("*.nbi")):
        time.sleep(1.0)  # compiles
        (cache / f"{Path(__file__).stem}.f-1.py311.nbi").touch()
        (cache / f"compiled-by-{sys.argv[2]}").touch()
"""


def test_one_process_compiles_and_the_others_wait(tmp_path):
    script, cache = tmp_path / "worker.py", tmp_path / "cache"
    script.write_text(WORKER)
    command = [sys.executable, str(script), str(cache)]
    environment = {**os.environ, "PYTHONPATH": str(REPOSITORY)}
    workers = [
        subprocess.Popen([*command, str(i)], stderr=subprocess.PIPE, text=True, env=environment)
        for i in range(3)
    ]
    said = [worker.communicate(timeout=120)[1] for worker in workers]
    assert [worker.returncode for worker in workers] == [0, 0, 0]
    assert len(list(cache.glob("compiled-by-*"))) == 1
    assert sum("compiling the test" in text for text in said) == 1


NOWHERE = """
import numba.core.caching

numba.core.caching.CacheImpl._locator_classes = []  # as without a home folder, in a package that is read-only

import pcs_racing_agents.cli.race  # all kernels
from pcs_racing.base.compilation import compiled, first_call, kernel

@compiled
def double(x):
    return x + x

@kernel
def half(x):
    return 0.5 * x

for function, what in ((double, "one"), (half, "two")):
    with first_call(function, what, 7):
        print(function(3.0))
"""


def test_what_can_not_be_kept_is_compiled_and_said_once(tmp_path):
    (tmp_path / "program.py").write_text(NOWHERE)
    command, environment = (
        [sys.executable, "program.py"],
        {**os.environ, "PYTHONPATH": str(REPOSITORY)},
    )
    done = subprocess.run(
        command, capture_output=True, text=True, check=True, cwd=tmp_path, env=environment
    )
    assert done.stdout == "6.0\n1.5\n"
    assert done.stderr.splitlines() == [
        (
            "pcs-racing: compiled code can't be kept: no folder for it can be written;"
            " NUMBA_CACHE_DIR names one"
        ),
        "pcs-racing: compiling one (about 7 s, in each process)",
        "pcs-racing: compiling two (about 7 s, in each process)",
    ]


RACES = """
import hashlib
import sys

from pcs_racing import CONTEST, load_track, parse_policy, run_races
from pcs_racing.track import frenet

track = load_track("Pipkin")
if sys.argv[1] == "projections first":
    frenet.project(track.arrays, 1.0, 2.0, 0.0)
    frenet.to_cartesian(track.arrays, 1.0, 0.5)
result = run_races(track, [parse_policy("pure-pursuit")] * 20, parse_policy("lane-switcher"), CONTEST, seed=1)
print(hashlib.sha256(result.state.cars.tobytes()).hexdigest())
"""


def test_races_do_not_depend_on_what_was_loaded_before():
    """A process binds all callers to the copies of these two functions that it loaded first."""
    said = [run_python("-c", RACES, before) for before in ("nothing first", "projections first")]
    assert len(said[0]) == 65
    assert said[0] == said[1]
