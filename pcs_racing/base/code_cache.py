"""Numba's disk cache: deleted if sources change or a file is damaged, with one writer at a time.

Numba checks the file of the loaded function, but not the files of the functions that it calls:
after an edit or an update it would continue to run parts of the old code. This module saves a
digest of all possible sources next to a folder's cached code, and deletes the code when the digest
changes.

After a full disk or a power cut, numba fails in every later run on an unreadable cached file, and
runs machine code with changed bits. Here each file ends with a digest of its name and content. If
the digest is wrong, the files of that function are deleted, and the function is compiled again.

Numba reads the index of a function's code, adds a line and writes it back. If two processes do so
at the same time, a line of one process may point to the code of the other. Here a lock admits one
process at a time.
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
"""Lowest floors of ``pcs_racing``, without imports from the others. Their digest is separate: an
edit of an environment does not recompile the race kernel."""

NOTE = "sources.sha256"
"""Name of the file with the digest of the sources, next to the cached code."""

_PACKAGE = Path(__file__).resolve().parents[1]


class _CheckedFiles(IndexDataCacheFile):
    """Numba's files of one function. Numba ignores bytes after a pickle: the digest is there."""

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
        """Return the code for a signature, or None without readable code."""
        try:
            return super().load_overload(sig, target_context)
        except Exception:  # damaged pickles raise a dozen types of errors
            say_once("cached code can't be read; it is compiled again")
            for file in Path(self.cache_path).glob(f"{glob.escape(self._impl.filename_base)}.*"):
                with suppress(OSError):
                    file.unlink()
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Save the code for a signature; one process at a time writes to a folder."""
        from filelock import FileLock  # needed only for compilation

        with ExitStack() as turn:
            with suppress(OSError):  # a file system without locks
                turn.enter_context(FileLock(Path(self.cache_path) / ".lock"))
            try:
                super().save_overload(sig, data)
            except OSError as error:
                say_once(f"compiled code can't be kept in {self.cache_path}: {error.strerror}")


@cache
def forget_stale_code(sources: str, code: str) -> None:
    """Delete the cached code in the folder ``code`` if any of its possible sources has changed.

    ``sources`` is the folder of the compiled modules.
    """
    note, digest = Path(code, NOTE), digest_of(Path(sources).resolve())
    with suppress(OSError):  # without a writable folder numba saves nothing either
        if note.is_file() and note.read_bytes() == digest:
            return
        for file in Path(code).glob("*.nb[ci]"):
            file.unlink(missing_ok=True)
        # The note comes after the deletion: an interruption leaves no old code with a new note.
        temporary = note.with_suffix(f".{os.getpid()}.tmp")
        temporary.write_bytes(digest)
        os.replace(temporary, note)


def digest_of(folder: Path) -> bytes:
    """Return the hexadecimal digest of all possible sources of the compiled code of a folder.

    For modules of the simulator, the sources are the simulator; for other modules of
    ``pcs_racing``, the whole of ``pcs_racing``. For all other modules they are the files in the
    folder, and both packages.
    """
    if any(folder.is_relative_to(_PACKAGE / floor) for floor in SIMULATOR):
        parts = [sources_digest(_PACKAGE / floor) for floor in SIMULATOR]
    elif folder.is_relative_to(_PACKAGE):
        parts = [sources_digest(_PACKAGE)]
    else:
        parts = [
            sources_digest(folder, deep=False),
            *map(sources_digest, sorted(_PACKAGE.parent.glob("pcs_racing*/"))),
        ]
    return hashlib.sha256(b"".join(parts)).hexdigest().encode()


@cache
def sources_digest(folder: Path, deep: bool = True) -> bytes:
    """Return the digest of the Python files in a folder and, if ``deep``, in its subfolders."""
    found = hashlib.sha256()
    for entry in sorted(os.scandir(folder), key=lambda entry: entry.name):
        if entry.name.endswith(".py"):
            # With the length, so that moving a line from one file to the next changes the digest.
            content = Path(entry.path).read_bytes()
            found.update(f"{entry.name} {len(content)}\n".encode() + content)
        elif deep and entry.is_dir() and entry.name != "__pycache__":
            found.update(sources_digest(Path(entry.path)))
    return found.digest()
