"""Compiled code on disk: it follows its sources, can be broken, and is written by one process at a
time.
"""

import os
import runpy
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace

import pytest
from numba.core.caching import FunctionCache, IndexDataCacheFile

import pcs_racing
from pcs_racing.base import code_cache
from pcs_racing.base.code_cache import SIMULATOR, CodeCache, digest_of

FLOORS = (*SIMULATOR, "track/building", "game")


@pytest.fixture
def packages(tmp_path, monkeypatch) -> Path:
    """A folder with the two packages, and beside them modules of a user."""
    monkeypatch.setattr(code_cache, "_PACKAGE", tmp_path / "pcs_racing")
    for folder in (
        *(f"pcs_racing/{floor}" for floor in FLOORS),
        "pcs_racing_agents/trees",
        "user",
        "user/below",
    ):
        (tmp_path / folder).mkdir(parents=True, exist_ok=True)
        (tmp_path / folder / "module.py").write_text("A = 1\n")
    return tmp_path


def changed_by(packages: Path, edited: str) -> set[str]:
    """Folders whose code is made of something else after an edit of a file."""
    folders = ("pcs_racing/race", "pcs_racing/game", "pcs_racing_agents/trees", "user")

    def digests() -> dict[str, bytes]:
        code_cache.sources_digest.cache_clear()
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
    assert changed_by(packages, "pcs_racing_agents/trees/module.py") == {
        "pcs_racing_agents/trees",
        "user",
    }
    assert changed_by(packages, "user/module.py") == {"user"}
    assert not changed_by(packages, "user/below/module.py")
    assert not changed_by(packages, "user/notes.txt")


def test_another_name_is_a_change(packages):
    digest = digest_of(packages / "user")
    (packages / "user" / "module.py").rename(packages / "user" / "other.py")
    code_cache.sources_digest.cache_clear()
    assert digest_of(packages / "user") != digest


def test_the_order_in_which_a_system_lists_files_does_not_matter(packages, monkeypatch):
    (packages / "user" / "other.py").touch()
    digest, glob = digest_of(packages / "user"), Path.glob

    def backwards(folder):
        return sorted(os.scandir(folder), key=lambda entry: entry.name)[::-1]

    monkeypatch.setattr(code_cache, "os", SimpleNamespace(scandir=backwards))
    monkeypatch.setattr(Path, "glob", lambda self, pattern: sorted(glob(self, pattern))[::-1])
    code_cache.sources_digest.cache_clear()
    assert digest_of(packages / "user") == digest


def test_the_simulator_is_where_the_package_is():
    assert Path(pcs_racing.__file__).resolve().parent == code_cache._PACKAGE
    assert [
        floor for floor in SIMULATOR if not (code_cache._PACKAGE / floor / "__init__.py").is_file()
    ] == []


@pytest.fixture
def code(packages) -> Path:
    """Cached code of the user's modules."""
    folder = packages / "user" / "__pycache__"
    folder.mkdir()
    forget(folder)
    for ending in ("nbi", "1.nbc"):
        (folder / f"module.f-1.py311.{ending}").touch()
    return folder


def forget(code: Path) -> int:
    """Do what a new process does before it looks for code; return the number of files that are
    left.
    """
    code_cache.sources_digest.cache_clear()
    code_cache.forget_stale_code.cache_clear()
    code_cache.forget_stale_code(str(code.parent), str(code))
    return len(list(code.glob("*.nb[ci]")))


def test_cached_code_stays_until_its_sources_change(code):
    os.utime(code.parent / "module.py")  # touched, not changed
    assert forget(code) == 2
    (code.parent / "module.py").write_text("A = 2\n")
    assert forget(code) == 0


@pytest.mark.parametrize("note", [None, b"", b"0" * 64])
def test_without_its_note_the_code_is_deleted(code, note):
    (code / code_cache.NOTE).unlink()
    if note is not None:
        (code / code_cache.NOTE).write_bytes(note)
    assert forget(code) == 0


PLANNER = """
from pcs_racing.base.compilation import compiled
from pcs_racing_example.base import three

@compiled
def answer():
    return three() + 1

print(answer(), answer.stats.cache_path)
"""


def test_numba_s_own_code_of_a_user_s_module_follows_what_it_imports(tmp_path):
    """Wherever numba keeps it: here beside the sources, and in a folder of the user's choice."""
    base = (
        "from pcs_racing.base.compilation import compiled\n\n@compiled\ndef three():\n    return"
        " {}\n"
    )
    package = tmp_path / "pcs_racing_example"
    package.mkdir()
    (package / "__init__.py").touch()
    (package / "planner.py").write_text(PLANNER)
    for folder in ("", str(tmp_path / "elsewhere")):
        paths = os.pathsep.join([str(tmp_path), *sys.path])
        environment = {**os.environ, "NUMBA_CACHE_DIR": folder, "PYTHONPATH": paths}
        for number in (3, 4):
            (package / "base.py").write_text(base.format(number))
            command = [sys.executable, "-m", "pcs_racing_example.planner"]
            said = subprocess.run(
                command, capture_output=True, text=True, check=True, env=environment
            ).stdout.split()
            assert said[0] == str(number + 1)
            assert said[1].startswith(folder or str(package))


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

BROKEN = {
    "empty": lambda content: b"",
    "truncated": lambda content: content[: len(content) // 2],
    "zeroed": lambda content: bytes(len(content)),
    "zeroed at the end": lambda content: content[: len(content) // 2].ljust(len(content), b"\0"),
    "of a module that is gone": lambda content: b"cno_such_module\nno_such_name\n.",
    "text": lambda content: b"not a pickle",
    "with another bit": lambda content: content[:-99] + bytes([content[-99] ^ 1]) + content[-98:],
}


@pytest.mark.parametrize("how", BROKEN)
@pytest.mark.parametrize("ending", ["nbi", "nbc"])
def test_cached_code_that_is_broken_is_compiled_again(tmp_path, capsys, ending, how):
    module = tmp_path / "module.py"
    module.write_text(MODULE)

    def run() -> tuple[float, int, str]:
        """What a new process computes, how often it finds code on disk, and what it says of it."""
        code_cache.say_once.cache_clear()
        names = runpy.run_path(str(module))
        return names["value"], names["found"], capsys.readouterr().err

    assert run() == (22.5, 0, "")
    assert run() == (22.5, 1, "")
    (file,) = tmp_path.glob(f"__pycache__/*.{ending}")
    file.write_bytes(BROKEN[how](file.read_bytes()))
    assert run() == (22.5, 0, "pcs-racing: cached code can't be read; it is compiled again\n")
    assert run() == (22.5, 1, "")


@pytest.mark.parametrize("ending", ["nbi", "nbc"])
def test_code_of_another_function_is_not_taken_and_that_one_keeps_its_own(tmp_path, capsys, ending):
    module = tmp_path / "module.py"
    module.write_text(MODULE + MODULE.replace("answer", "answer_2").replace("0.5", "0.7"))
    code_cache.say_once.cache_clear()
    runpy.run_path(str(module))
    (file,) = tmp_path.glob(f"__pycache__/module.answer-*.{ending}")
    (other,) = tmp_path.glob(f"__pycache__/module.answer_2-*.{ending}")
    own = file.read_bytes()
    other.write_bytes(own)
    assert runpy.run_path(str(module))["value"] == pytest.approx(31.5)
    assert "compiled again" in capsys.readouterr().err
    assert (file.read_bytes(), len(list(tmp_path.glob("__pycache__/module.answer*.nb[ci]")))) == (
        own,
        4,
    )


def test_a_full_disk_is_told_once_and_the_function_runs(tmp_path, capsys, monkeypatch):
    def full(self, name, data):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(IndexDataCacheFile, "_save_data", full)
    code_cache.say_once.cache_clear()
    (tmp_path / "module.py").write_text(MODULE + MODULE.replace("answer", "answer_2"))
    assert runpy.run_path(str(tmp_path / "module.py"))["value"] == 22.5
    cached = tmp_path / "__pycache__"
    assert (
        capsys.readouterr().err
        == f"pcs-racing: compiled code can't be kept in {cached}: No space left on device\n"
    )


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

    monkeypatch.setattr(IndexDataCacheFile, "_load_index", slowly)
    monkeypatch.setattr(
        FunctionCache, "_save_overload", lambda self, sig, data: self._cache_file.save(sig, data)
    )
    with ThreadPoolExecutor(6) as pool:
        list(
            pool.map(
                lambda number: CodeCache(add).save_overload(
                    f"signature {number}", f"code {number}"
                ),
                range(6),
            )
        )
    monkeypatch.undo()
    file = CodeCache(add)._cache_file
    assert [file.load(f"signature {number}") for number in range(6)] == [
        f"code {number}" for number in range(6)
    ]
    file.flush()
