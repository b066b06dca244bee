"""Numba's cache on disk: deleted when sources change or a file is broken, and written by one process at a time.

Numba looks at the file of the function that it loads, but not at the files of the functions which that one calls: after
an edit or an update it would go on running parts of the old code. Here the cached code of a folder has a digest of all
sources that it may be made of beside it, and is deleted when that digest is another one.

Numba ends with an error if it can't read a cached file (after a full disk or a power cut), in every later run, and
runs machine code in which bits have changed. Here each file ends with a digest of its name and content. If it is wrong,
the files of that function are deleted, and it is compiled again.

Numba reads the index of a function's code, adds a line and writes it back. Two processes that do so at the same time
may end with a line of one that points to the code of the other. Here they take turns.
"""

import glob
import hashlib
import io
import os
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import IO, Any

from numba.core.caching import FunctionCache, IndexDataCacheFile

from pcs_racing.base.errors import say_once

SIMULATOR = ("base", "track", "car", "planners", "race")
"""The lowest floors of ``pcs_racing``, which import nothing from the others: they have a digest of their own, so that
an edit of an environment does not compile the race kernel again."""

NOTE = "sources.sha256"
"""Name of the file beside cached code that says which sources it is made of."""

_PACKAGE = Path(__file__).resolve().parents[1]


class _CheckedFiles(IndexDataCacheFile):
    """Numba's files of one function. What follows a pickle is not read by numba: there the digest stands."""

    @contextmanager
    def _open_for_write(self, path: str) -> Iterator[IO[bytes]]:
        with super()._open_for_write(path) as file:
            content = io.BytesIO()
            yield content
            file.write(content.getvalue() + _seal(path, content.getvalue()))

    def _load_index(self) -> Any:
        with suppress(FileNotFoundError):
            _check_seal(self._index_path)
        return super()._load_index()

    def _load_data(self, name: str) -> Any:
        _check_seal(self._data_path(name))
        return super()._load_data(name)


def _seal(path: str, content: bytes) -> bytes:
    return hashlib.sha256(os.path.basename(path).encode() + content).digest()


def _check_seal(path: str) -> None:
    content = Path(path).read_bytes()
    if content[-32:] != _seal(path, content[:-32]):
        raise ValueError("damaged")


class CodeCache(FunctionCache):
    """Numba's cache of one function's compiled code."""

    def __init__(self, function: Any) -> None:
        super().__init__(function)
        self._cache_file.__class__ = _CheckedFiles
        forget_stale_code(os.path.dirname(function.__code__.co_filename), self.cache_path)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the code for a signature; None if there is none that can be read."""
        try:
            return super().load_overload(sig, target_context)
        except Exception:  # damaged pickles raise a dozen kinds
            say_once("cached code can't be read; it is compiled again")
            for file in Path(self.cache_path).glob(f"{glob.escape(self._impl.filename_base)}.*"):
                with suppress(OSError):
                    file.unlink()
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Store the code for a signature, one process at a time in each folder."""
        from filelock import FileLock  # only where something is compiled

        with ExitStack() as turn:
            with suppress(OSError):  # a file system without locks
                turn.enter_context(FileLock(Path(self.cache_path) / ".lock"))
            try:
                super().save_overload(sig, data)
            except OSError as error:
                say_once(f"compiled code can't be kept in {self.cache_path}: {error.strerror}")


@cache
def forget_stale_code(sources: str, code: str) -> None:
    """Delete the cached code in the folder ``code`` if anything has changed of which it may be made.

    ``sources`` is the folder of the modules whose code it is.
    """
    note, digest = Path(code, NOTE), digest_of(Path(sources).resolve())
    with suppress(OSError):  # nowhere to write to: then numba keeps nothing either
        if note.is_file() and note.read_bytes() == digest:
            return
        for file in Path(code).glob("*.nb[ci]"):
            file.unlink(missing_ok=True)
        # The note comes after the deletion: a process that ends between the two leaves nothing old under a new note.
        temporary = note.with_suffix(f".{os.getpid()}.tmp")
        temporary.write_bytes(digest)
        os.replace(temporary, note)


def digest_of(folder: Path) -> bytes:
    """Digest, in hexadecimal, of all sources that compiled code of the modules in a folder may be made of.

    Those are the simulator for modules of the simulator, and the whole of ``pcs_racing`` for its other modules. For all
    others they are the files beside them, and both packages.
    """
    if any(folder.is_relative_to(_PACKAGE / floor) for floor in SIMULATOR):
        parts = [sources_digest(_PACKAGE / floor) for floor in SIMULATOR]
    elif folder.is_relative_to(_PACKAGE):
        parts = [sources_digest(_PACKAGE)]
    else:
        parts = [sources_digest(folder, deep=False), *map(sources_digest, sorted(_PACKAGE.parent.glob("pcs_racing*/")))]
    return hashlib.sha256(b"".join(parts)).hexdigest().encode()


@cache
def sources_digest(folder: Path, deep: bool = True) -> bytes:
    """Digest of the Python files in a folder, and in those below it."""
    found = hashlib.sha256()
    for entry in sorted(os.scandir(folder), key=lambda entry: entry.name):
        if entry.name.endswith(".py"):
            # With its length, so that a line can't move from one file to the next unnoticed.
            content = Path(entry.path).read_bytes()
            found.update(f"{entry.name} {len(content)}\n".encode() + content)
        elif deep and entry.is_dir() and entry.name != "__pycache__":
            found.update(sources_digest(Path(entry.path)))
    return found.digest()
