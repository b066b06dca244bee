import os
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace

import pytest
from numba.core import caching, config
from numba.core.caching import IndexDataCacheFile

from pcs_racing.base.code_cache import forget_stale_code
from pcs_racing.base.compilation import announce_compilation, compiled


@compiled
def divide(a, b):
    return a / b


def test_compiled_code_divides_as_ieee_says():
    assert divide(1.0, 0.0) == float("inf")
    assert divide(-1.0, 0.0) == float("-inf")


def dispatcher(cache: Path, signatures: tuple = ()) -> SimpleNamespace:
    """What the announcement looks at."""
    return SimpleNamespace(signatures=signatures, py_func=divide.py_func, stats=SimpleNamespace(cache_path=str(cache)))


def test_the_first_compilation_says_what_it_does(tmp_path, capsys):
    for _ in range(2):
        with announce_compilation(dispatcher(tmp_path / "empty"), "the test itself", 7):
            pass
    assert capsys.readouterr().err == (
        "pcs-racing: compiling the test itself (about 7 s, once; it is cached on disk)\n"
    )


def test_what_is_compiled_already_is_not_announced(tmp_path, capsys):
    with announce_compilation(dispatcher(tmp_path, signatures=("f8",)), "what is in memory", 7):
        pass
    (tmp_path / "test_compilation.divide-13.py311.nbi").touch()
    with announce_compilation(dispatcher(tmp_path), "what is on disk", 7):
        pass
    assert capsys.readouterr().err == ""


@pytest.fixture
def package(tmp_path, monkeypatch) -> Path:
    """A package of three modules, each with cached code; ``top`` imports ``base``."""
    monkeypatch.setattr(config, "CACHE_DIR", "")  # numba keeps code beside the sources
    folder = tmp_path / "pcs_racing_example"
    cache = folder / "__pycache__"
    cache.mkdir(parents=True)
    (folder / "base.py").write_text("A = 1\n")
    (folder / "top.py").write_text("from pcs_racing_example import (\n    base,\n)\n")
    (folder / "other.py").write_text("B = 1\n")
    forget_stale_code(folder)
    for module in ("base", "top", "other"):
        for ending in ("nbi", "1.nbc"):
            (cache / f"{module}.f-1.py311.{ending}").touch()
    return folder


def cached(package: Path) -> set[str]:
    return {path.name.split(".")[0] for path in (package / "__pycache__").glob("*.nb[ci]")}


def test_cached_code_stays_while_nothing_changes(package):
    os.utime(package / "base.py")  # touched, not changed
    forget_stale_code(package)
    assert cached(package) == {"base", "top", "other"}


def test_sources_are_read_again_only_when_size_or_time_of_one_changed(package):
    base = package / "base.py"
    status = base.stat()
    base.write_text("A = 3\n")
    os.utime(base, ns=(status.st_atime_ns, status.st_mtime_ns))
    forget_stale_code(package)
    assert cached(package) == {"base", "top", "other"}
    os.utime(base)
    forget_stale_code(package)
    assert cached(package) == {"other"}


def test_a_change_drops_the_module_and_those_that_import_it(package):
    (package / "base.py").write_text("A = 2\n")
    forget_stale_code(package)
    assert cached(package) == {"other"}


def test_a_change_at_the_top_drops_no_more_than_that(package):
    (package / "top.py").write_text("from pcs_racing_example import base\n")
    forget_stale_code(package)
    assert cached(package) == {"base", "other"}


@pytest.mark.parametrize("note", ["{", "[]", ""])
def test_without_a_readable_note_everything_is_dropped(package, note):
    (package / "__pycache__" / "numba_sources.json").write_text(note)
    forget_stale_code(package)
    assert cached(package) == set()


@pytest.mark.parametrize("why", ["the folder that was asked for", "sources that can't be written to"])
def test_code_that_numba_keeps_elsewhere_is_dropped_as_well(package, tmp_path_factory, monkeypatch, why):
    """Code is put where numba puts that of a function in this package, not where this test thinks that it does."""
    folder = tmp_path_factory.mktemp("elsewhere")
    if why == "the folder that was asked for":
        monkeypatch.setattr(config, "CACHE_DIR", str(folder))
        locator = caching.UserProvidedCacheLocator
    else:
        monkeypatch.setenv("XDG_CACHE_HOME", str(folder))
        monkeypatch.setattr("pcs_racing.base.code_cache.os.access", lambda path, mode: False)
        locator = caching.UserWideCacheLocator
    found = locator(lambda: None, str(package / "base.py"))
    kept = Path(found.get_cache_path())
    forget_stale_code(package)
    for module in ("base", "other"):
        (kept / f"{module}.f-1.py311.nbi").touch()
    (package / "base.py").write_text("A = 2\n")
    forget_stale_code(package)
    assert [path.name for path in kept.glob("*.nbi")] == ["other.f-1.py311.nbi"]


def test_a_folder_that_is_not_ours_is_no_error(package):
    forget_stale_code(package / "nowhere" / "at all")


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
    said = [
        subprocess.run([sys.executable, "-c", RACES, before], capture_output=True, text=True, check=True).stdout
        for before in ("nothing first", "spirals first")
    ]
    assert said[0] == said[1]
