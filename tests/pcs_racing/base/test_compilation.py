import gc
import os
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace

import pytest
from numba.core.caching import IndexDataCacheFile
from repository import REPOSITORY, run_python

from pcs_racing.base import code_cache
from pcs_racing.base.compilation import compiled, first_call, inner_kernel, kernel


@compiled
def divide(a, b):
    return a / b


def test_compiled_code_divides_as_ieee_says():
    assert divide(1.0, 0.0) == float("inf")
    assert divide(-1.0, 0.0) == float("-inf")


@inner_kernel
def half(a):
    return 0.5 * a


@kernel
def quarter(a):
    return half(half(a))


def test_inner_kernels_are_for_compiled_functions_alone():
    assert quarter(2.0) == 0.5
    with pytest.raises(TypeError, match="half"):
        half(2.0)


def dispatcher(cache: Path, signatures: tuple = ()) -> SimpleNamespace:
    """What the announcement looks at."""
    return SimpleNamespace(signatures=signatures, py_func=divide.py_func, stats=SimpleNamespace(cache_path=str(cache)))


def test_the_first_compilation_says_what_it_does(tmp_path, capsys):
    answers = []
    for _ in range(2):
        with first_call(dispatcher(tmp_path / "empty"), "the test itself", 7) as compiling:
            answers.append(compiling)
    assert answers == [True, False]
    assert capsys.readouterr().err == (
        "pcs-racing: compiling the test itself (about 7 s, once; it is cached on disk)\n"
    )


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


def test_what_is_compiled_already_is_not_announced(tmp_path, capsys):
    with first_call(dispatcher(tmp_path, signatures=("f8",)), "what is in memory", 7) as compiling:
        assert not compiling
    (tmp_path / "test_compilation.divide-13.py311.nbi").touch()
    with first_call(dispatcher(tmp_path), "what is on disk", 7) as compiling:
        assert not compiling
    assert capsys.readouterr().err == ""


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
        subprocess.Popen([*command, str(i)], stderr=subprocess.PIPE, text=True, env=environment) for i in range(3)
    ]
    said = [worker.communicate(timeout=120)[1] for worker in workers]
    assert [worker.returncode for worker in workers] == [0, 0, 0]
    assert len(list(cache.glob("compiled-by-*"))) == 1
    assert sum("compiling the test" in text for text in said) == 1


MODULES = ("base", "top", "other")


@pytest.fixture
def package(tmp_path) -> Path:
    """A package of three modules, each with cached code; ``top`` imports ``base``."""
    folder = tmp_path / "pcs_racing_example"
    (folder / "__pycache__").mkdir(parents=True)
    (folder / "__init__.py").touch()
    (folder / "base.py").write_text("A = 1\n")
    (folder / "top.py").write_text("from pcs_racing_example import (\n    base,\n)\n")
    (folder / "other.py").write_text("B = 1\n")
    start(folder)
    for module in MODULES:
        for ending in ("nbi", "1.nbc"):
            (folder / "__pycache__" / f"{module}.f-1.py311.{ending}").touch()
    return folder


def start(package: Path) -> set[str]:
    """Do what a new process does when it compiles something of each module; return those that still have code."""
    for function in (code_cache._stamp, code_cache._imported_names, code_cache._file_of):
        function.cache_clear()
    for module in MODULES:
        code_cache.forget_stale_code(package / f"{module}.py", package / "__pycache__")
    return {path.name.split(".")[0] for path in (package / "__pycache__").glob("*.nb[ci]")}


def test_cached_code_stays_while_nothing_changes(package):
    os.utime(package / "base.py")  # touched, not changed
    assert start(package) == {"base", "top", "other"}


def test_sources_are_read_again_only_when_size_or_time_of_one_changed(package):
    base = package / "base.py"
    status = base.stat()
    base.write_text("A = 3\n")
    os.utime(base, ns=(status.st_atime_ns, status.st_mtime_ns))
    assert start(package) == {"base", "top", "other"}
    os.utime(base)
    assert start(package) == {"other"}


def test_a_change_drops_the_module_and_those_that_import_it(package):
    (package / "base.py").write_text("A = 2\n")
    assert start(package) == {"other"}


def test_a_change_at_the_top_drops_no_more_than_that(package):
    (package / "top.py").write_text("from pcs_racing_example import base\n")
    assert start(package) == {"base", "other"}


def test_a_module_that_is_gone_is_a_change(package):
    (package / "base.py").rename(package / "basis.py")
    (package / "base.py").symlink_to(package / "basis.py")
    assert start(package) == {"base", "top", "other"}
    (package / "base.py").unlink()
    code_cache._stamp.cache_clear()
    code_cache._file_of.cache_clear()
    code_cache.forget_stale_code(package / "top.py", package / "__pycache__")
    assert not list((package / "__pycache__").glob("top.*.nb[ci]"))


@pytest.mark.parametrize("note", ["{", "[]", "", '{"stamps": []}'])
def test_without_a_readable_note_the_code_is_dropped(package, note):
    (package / "__pycache__" / "top.sources.json").write_text(note)
    assert start(package) == {"base", "other"}


def test_a_folder_that_does_not_exist_is_no_error(package):
    code_cache.forget_stale_code(package / "nowhere.py", package / "at all")
    assert not (package / "at all").exists()


PLANNER = """
from pcs_racing.base.compilation import compiled
from pcs_racing_example.base import three

@compiled
def answer():
    return three() + 1

print(answer(), answer.stats.cache_path)
"""


def test_numba_s_own_code_of_a_user_s_module_follows_what_it_imports(package, tmp_path):
    """Wherever numba keeps it: here beside the sources, and in a folder of the user's choice."""
    base = "from pcs_racing.base.compilation import compiled\n\n@compiled\ndef three():\n    return {}\n"
    (package / "planner.py").write_text(PLANNER)
    for folder in ("", str(tmp_path / "elsewhere")):
        environment = {
            **os.environ,
            "NUMBA_CACHE_DIR": folder,
            "PYTHONPATH": os.pathsep.join([str(tmp_path), *sys.path]),
        }
        for number in (3, 4):
            (package / "base.py").write_text(base.format(number))
            command = [sys.executable, "-m", "pcs_racing_example.planner"]
            said = subprocess.run(command, capture_output=True, text=True, check=True, env=environment).stdout.split()
            assert said[0] == str(number + 1)
            assert said[1].startswith(folder or str(package))


def test_two_writers_of_one_index_take_turns(tmp_path, monkeypatch):
    """Without turns both read the index before the other has written it, and a line is lost or points elsewhere."""
    load_index = IndexDataCacheFile._load_index

    def slowly(self):
        index = load_index(self)
        time.sleep(0.02)
        return index

    def write(number):
        IndexDataCacheFile(str(tmp_path), "f-1.py311", "stamp").save(f"signature {number}", f"code {number}")

    monkeypatch.setattr(IndexDataCacheFile, "_load_index", slowly)
    with ThreadPoolExecutor(6) as pool:
        list(pool.map(write, range(6)))
    monkeypatch.undo()
    for number in range(6):
        found = IndexDataCacheFile(str(tmp_path), "f-1.py311", "stamp").load(f"signature {number}")
        assert found == f"code {number}"


RACES = """
import hashlib
import sys

import numpy as np

from pcs_racing import make_game
from pcs_racing.planners import spiral

if sys.argv[1] == "spirals first":
    spiral.solve_spirals(np.ones(10_000), 0.1)
    spiral.sample_spirals(np.ones(10_000), 0.1, 0.0, 0.0, 0.0)
game = make_game("Pipkin")
state = game.reset(games=20, seed=1)
for _ in range(2):
    state = game.step(state, np.zeros((20, 2), dtype=int))
print(hashlib.sha256(state.race.cars.tobytes()).hexdigest())
"""


def test_races_do_not_depend_on_what_was_loaded_before():
    """A process binds all callers to the copies of these two functions that it loaded first."""
    said = [run_python("-c", RACES, before) for before in ("nothing first", "spirals first")]
    assert len(said[0]) == 65
    assert said[0] == said[1]
