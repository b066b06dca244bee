"""Compiled code on disk: it follows its sources, can be broken, and is written by one process at a
time.
"""

import os
import runpy
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from numba.core.caching import FunctionCache, IndexDataCacheFile

from pcs_racing.base import code_cache, compilation, numba_parts
from pcs_racing.base.code_cache import SIMULATOR, code_folder, digest_of

FLOORS = (*SIMULATOR, "track/building", "game")


@pytest.fixture
def packages(tmp_path, monkeypatch) -> Path:
    """A folder with the two packages and modules of a user."""
    monkeypatch.setattr(code_cache, "_PACKAGE", tmp_path / "pcs_racing")
    monkeypatch.setattr(code_cache, "_CHOSEN", "")
    monkeypatch.setenv("PCS_RACING_CACHE", str(tmp_path / "home"))
    for folder in (
        *(f"pcs_racing/{floor}" for floor in FLOORS),
        "pcs_racing_agents/trees",
        "user",
        "user/below",
    ):
        (tmp_path / folder).mkdir(parents=True, exist_ok=True)
        (tmp_path / folder / "module.py").write_text("A = 1\n")
    new_process()
    return tmp_path


def new_process() -> None:
    """Forget the sources and messages of this process."""
    for known in (code_cache.sources_digest, code_cache.code_folder, numba_parts.say_once):
        known.cache_clear()


def changed_by(packages: Path, edited: str) -> set[str]:
    """Folders whose code is made of something else after an edit of a file."""
    folders = ("pcs_racing/race", "pcs_racing/game", "pcs_racing_agents/trees", "user")

    def digests() -> dict[str, str]:
        new_process()
        return {folder: digest_of(packages / folder) for folder in folders}

    before = digests()
    (packages / edited).write_text("A = 2\n")
    return {folder for folder, digest in digests().items() if digest != before[folder]}


def test_an_edit_of_the_simulator_changes_all_code_and_one_above_it_only_what_is_there(packages):
    for floor in [*SIMULATOR, "track/building"]:
        everything = {"pcs_racing/race", "pcs_racing/game", "pcs_racing_agents/trees", "user"}
        assert changed_by(packages, f"pcs_racing/{floor}/module.py") == everything
    above = {"pcs_racing/game", "pcs_racing_agents/trees", "user"}
    assert changed_by(packages, "pcs_racing/game/module.py") == above
    assert changed_by(packages, "pcs_racing/game/new.py") == above
    trees = "pcs_racing_agents/trees"
    assert changed_by(packages, f"{trees}/module.py") == {trees, "user"}
    assert changed_by(packages, "user/module.py") == {"user"}
    assert not changed_by(packages, "user/below/module.py")
    assert not changed_by(packages, "user/notes.txt")


def test_code_is_in_the_first_writable_place_and_unused_folders_go(packages, monkeypatch):
    place = packages / "pcs_racing" / "__pycache__" / "compiled"
    first = code_folder(packages / "user")
    assert first.parent == place
    for k in range(code_cache.MAX_FOLDERS):
        (place / f"{k}").mkdir()
        os.utime(place / f"{k}", (k, k))
    changed_by(packages, "user/module.py")
    assert code_folder(packages / "user") != first
    assert first.is_dir()
    assert len(list(place.iterdir())) == code_cache.MAX_FOLDERS
    monkeypatch.setattr(os, "access", lambda folder, mode: place not in Path(folder).parents)
    new_process()
    assert code_folder(packages / "user").parent == packages / "home" / "compiled"
    monkeypatch.setattr(code_cache, "_CHOSEN", str(packages / "chosen"))
    new_process()
    assert code_folder(packages / "user").parent == packages / "chosen" / "compiled"


MODULE = """
from pcs_racing.base.compilation import compiled

@compiled
def answer(n):
    total = 0.0
    for i in range(n):
        total += 0.5 * i
    return total

value = answer(10)
found = len(answer.stats.cache_hits)
"""


@pytest.fixture
def module(packages) -> Path:
    """A module of a user with a compiled function."""
    file = packages / "user" / "module.py"
    file.write_text(MODULE)
    return file


def run(module: Path) -> tuple[float, int]:
    """Result of a new process, and how often it finds code on disk."""
    new_process()
    names = runpy.run_path(str(module))
    return names["value"], names["found"]


def test_code_of_a_user_s_module_follows_what_it_imports(packages, module, monkeypatch):
    monkeypatch.syspath_prepend(module.parent)
    assert [run(module), run(module)] == [(22.5, 0), (22.5, 1)]
    (module.parent / "imported.py").write_text("A = 1\n")
    assert [run(module), run(module)] == [(22.5, 0), (22.5, 1)]


BROKEN = {
    "empty": lambda content: b"",
    "truncated": lambda content: content[: len(content) // 2],
    "zeroed at the end": lambda content: content[: len(content) // 2].ljust(len(content), b"\0"),
    "of a module that is gone": lambda content: b"cno_such_module\nno_such_name\n.",
}


@pytest.mark.parametrize("how", BROKEN)
@pytest.mark.parametrize("ending", ["nbi", "nbc"])
def test_cached_code_that_is_broken_is_compiled_again(module, capsys, ending, how):
    assert run(module) == (22.5, 0)
    (file,) = code_folder(module.parent).glob(f"*/*.{ending}")
    file.write_bytes(BROKEN[how](file.read_bytes()))
    assert run(module) == (22.5, 0)
    told = "pcs-racing: cached code can't be read; it is compiled again\n"
    assert capsys.readouterr().err == told
    assert run(module) == (22.5, 1)
    assert capsys.readouterr().err == ""


def test_code_that_can_not_be_kept_is_compiled_and_said_once(module, capsys, monkeypatch):
    module.write_text(MODULE + MODULE.replace("answer", "answer_2"))
    full = OSError(28, "No space left on device")

    def save(self, name, data):
        raise full

    with monkeypatch.context() as patch:
        patch.setattr(IndexDataCacheFile, "_save_data", save)
        assert run(module)[0] == 22.5
    (folder,) = code_folder(module.parent).iterdir()
    told = f"pcs-racing: compiled code can't be kept in {folder}: No space left on device\n"
    assert capsys.readouterr().err == told
    monkeypatch.setattr(compilation, "code_folder", lambda sources: None)
    assert run(module)[0] == 22.5
    assert capsys.readouterr().err.count("no folder for it can be written") == 1


def add(a):
    return a + 1


def test_two_writers_of_one_index_take_turns(monkeypatch):
    """Without turns both read the index before the other has written it, and a line is lost or
    points elsewhere.
    """
    load_index = IndexDataCacheFile._load_index

    def slowly(self):
        index = load_index(self)
        time.sleep(0.02)
        return index

    with monkeypatch.context() as patch:
        patch.setattr(IndexDataCacheFile, "_load_index", slowly)

        def save(self, sig, data):
            self._cache_file.save(sig, data)

        patch.setattr(FunctionCache, "_save_overload", save)
        caches = [numba_parts.CodeCache(add) for _ in range(6)]
        with ThreadPoolExecutor(6) as pool:
            list(pool.map(lambda k: caches[k].save_overload(f"type {k}", f"code {k}"), range(6)))
    file = numba_parts.CodeCache(add)._cache_file
    assert [file.load(f"type {k}") for k in range(6)] == [f"code {k}" for k in range(6)]
    file.flush()
