from pathlib import Path
from types import SimpleNamespace

from filelock import FileLock
from refusal import refused
from repository import run_python

from pcs_racing.base import compilation
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


def dispatcher(cache: Path | None, signatures: tuple = ()) -> SimpleNamespace:
    """Inputs of the announcement."""
    return SimpleNamespace(
        signatures=signatures,
        py_func=divide.py_func,
        stats=SimpleNamespace(cache_path=cache and str(cache)),
    )


def test_the_first_compilation_is_announced_and_no_other(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(compilation, "_compile_sample", lambda: 0.5)
    monkeypatch.setattr(compilation, "LONG", 0.0)
    answers = []
    for _ in range(2):
        with first_call(dispatcher(tmp_path / "empty"), "the test itself", 14) as compiling:
            answers.append(compiling)
    assert answers == [True, False]
    told = (
        "pcs-racing: compiling the test itself (about 7 s, once; it is cached on disk)\n"
        "pcs-racing: compiled the test itself in 0 s\n"
    )
    assert capsys.readouterr().err == told
    with first_call(dispatcher(tmp_path, signatures=("f8",)), "what is in memory", 7) as compiling:
        assert not compiling
    (tmp_path / "test_compilation.divide-13.py311.nbi").touch()
    with first_call(dispatcher(tmp_path), "what is on disk", 7) as compiling:
        assert not compiling
    assert capsys.readouterr().err == ""
    with first_call(dispatcher(None), "what has no folder", 14) as compiling:
        assert compiling
    assert "what has no folder (about 7 s, in each process)" in capsys.readouterr().err


def test_one_process_compiles_and_the_others_wait(tmp_path, monkeypatch):
    name, said = f"{Path(__file__).stem}.divide-", []
    lock = FileLock(tmp_path / f".{name}lock")
    lock.acquire()

    def say(line: str) -> None:
        """Let the other process finish while this one says that it waits."""
        said.append(line)
        (tmp_path / f"{name}15.py311.nbi").touch()
        lock.release()

    monkeypatch.setattr(compilation, "say", say)
    with first_call(dispatcher(tmp_path), "what another compiles", 7):
        pass
    assert said == ["waiting for another process that compiles what another compiles"]


RACES = """
import hashlib
import sys

from pcs_racing import CONTEST, load_track, racer, run_races
from pcs_racing.track import frenet

track = load_track("Pipkin")
if sys.argv[1] == "projections first":
    frenet.project(track.arrays, 1.0, 2.0, 0.0)
    frenet.to_cartesian(track.arrays, 1.0, 0.5)
result = run_races(track, ["pure-pursuit"] * 20, "lane-switcher", CONTEST, seed=1)
print(hashlib.sha256(result.state.cars.tobytes()).hexdigest())
"""


def test_races_do_not_depend_on_what_was_loaded_before():
    """A process binds all callers to the copies of these two functions that it loaded first."""
    said = [run_python("-c", RACES, before) for before in ("nothing first", "projections first")]
    assert len(said[0]) == 65
    assert said[0] == said[1]
