"""Numba's cache on disk: deleted when a source file changes, and written by one process at a time.

Numba looks at the file of the function that it loads, but not at the files of the functions which that one calls: after
an edit or an update it would go on running parts of the old code. Here the file of every module with compiled functions
is known together with the files that it imports.

Numba reads the index of a function's code, adds a line and writes it back. Two processes that do so at the same time
may end with a line of one that points to the code of the other. Here they take turns; numba offers no setting for that,
so this module wraps the method that writes.
"""

import hashlib
import json
import os
import re
from collections.abc import Callable
from contextlib import ExitStack, suppress
from functools import cache, wraps
from pathlib import Path
from typing import Any

from numba.core import caching

_IMPORT = re.compile(r"^\s*(?:from|import)\s+(pcs_racing[\w.]*)([^\n(]*(?:\([^)]*\))?)", re.MULTILINE)
_WORD = re.compile(r"\w+")


def forget_stale_code(source: Path, cache: Path) -> None:
    """Delete the cached code of a module if its source, or that of a module that it imports, has changed.

    Parameters
    ----------
    source : Path
        File of the module.
    cache : Path
        Folder where numba keeps its code.
    """
    note = cache / f"{source.stem}.sources.json"
    try:
        noted = _read(note)
        stamps = noted.get("stamps", {})
        if stamps and all(_stamp(Path(file)) == stamp for file, stamp in stamps.items()):
            return  # reading and searching the files would take a third of a second at every start
        files = _imported_files(source)
        digest = hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()
        if noted.get("digest") != digest:
            for cached in cache.glob(f"{source.stem}.*.nb[ci]"):
                cached.unlink(missing_ok=True)
        cache.mkdir(parents=True, exist_ok=True)
        temporary = note.with_suffix(f".{os.getpid()}.tmp")
        temporary.write_text(json.dumps({"digest": digest, "stamps": {str(file): _stamp(file) for file in files}}))
        os.replace(temporary, note)
    except OSError:
        return  # nowhere to write to: then numba keeps nothing either


def _read(note: Path) -> dict[str, Any]:
    """Return the stored digest and stamps; empty if they can't be read."""
    try:
        noted = json.loads(note.read_text())
    except (OSError, ValueError):
        return {}
    return noted if isinstance(noted, dict) and isinstance(noted.get("stamps"), dict) else {}


@cache
def _stamp(file: Path) -> list[int] | None:
    try:
        status = file.stat()
    except OSError:
        return None
    return [status.st_size, status.st_mtime_ns]


def _imported_files(source: Path) -> list[Path]:
    """Return the files of a module and of all modules of these packages that it imports, also indirectly."""
    roots = {source.parents[len(_packages(source))], Path(__file__).parents[2]}
    reached, new = {source}, [source]
    while new:
        names = {name for file in new for name in _imported_names(file)}
        files = {file for name in names for root in roots if (file := _file_of(root, name)) is not None}
        new = sorted(files - reached)
        reached.update(new)
    return sorted(reached)


def _packages(source: Path) -> list[Path]:
    """The folders above a file that are packages."""
    return [folder for folder in source.parents if (folder / "__init__.py").is_file()]


@cache
def _imported_names(file: Path) -> frozenset[str]:
    """Return the dotted names of all modules and members that a source imports."""
    names = set()
    for module, members in _IMPORT.findall(file.read_text(encoding="utf-8")):
        names.add(module)
        names.update(f"{module}.{member}" for member in _WORD.findall(members))
    return frozenset(names)


@cache
def _file_of(root: Path, name: str) -> Path | None:
    place = root.joinpath(*name.split("."))
    for file in (place.with_name(f"{place.name}.py"), place / "__init__.py"):
        if file.is_file():
            return file
    return None


def _locked(save: Callable[..., None]) -> Callable[..., None]:
    """Decorate numba's method so that one process at a time writes to a folder of cached code."""

    @wraps(save)
    def save_alone(cache: Any, key: Any, data: Any) -> None:
        from filelock import FileLock

        with ExitStack() as turn:
            with suppress(OSError):  # a file system without locks
                turn.enter_context(FileLock(Path(cache._cache_path) / ".lock"))
            save(cache, key, data)

    return save_alone


caching.IndexDataCacheFile.save = _locked(caching.IndexDataCacheFile.save)
