"""Numba's code on disk: thrown away when the sources behind it change, and written by one process at a time.

Numba looks at the file of the function that it loads, but not at the files of the functions which that one calls: after
an edit or an update it would go on running parts of the old code. This module knows which file imports which.

Numba reads the index of a function's code, adds a line and writes it back. Two processes that do so at the same time
may end with a line of one that points to the code of the other. Here they take turns.
"""

import hashlib
import json
import os
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import wraps
from pathlib import Path
from typing import Any

from numba.core import caching, config
from numba.misc.appdirs import AppDirs

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

__all__ = ["forget_stale_code"]

_IMPORT = re.compile(r"^\s*(?:from|import)\s+pcs_racing[^\n(]*(?:\([^)]*\))?", re.MULTILINE)
_WORD = re.compile(r"\w+")


def forget_stale_code(package: Path) -> None:
    """Delete numba's cached code of those modules whose source, or that of a module they import, has changed.

    Parameters
    ----------
    package : Path
        Folder of a package whose compiled functions may call each other and those of ``pcs_racing``.
    """
    note = _place(package) / "numba_sources.json"
    try:
        sources = sorted({*package.rglob("*.py"), *Path(__file__).parent.rglob("*.py")})
        stamps = {str(source): [(status := source.stat()).st_size, status.st_mtime_ns] for source in sources}
        noted = _read(note)
        if noted.get("stamps") == stamps:  # reading them takes a third of a second at every start
            return
        now, before = _digests(sources), noted.get("digests", {})
        for module in now:
            if before.get(module) != now[module]:
                for folder in {source.parent for source in sources if source.is_relative_to(package)}:
                    for cached in _place(folder).glob(f"{module}.*.nb[ci]"):
                        cached.unlink(missing_ok=True)
        note.parent.mkdir(parents=True, exist_ok=True)
        temporary = note.with_suffix(f".{os.getpid()}.tmp")
        temporary.write_text(json.dumps({"stamps": stamps, "digests": now}))
        os.replace(temporary, note)
    except OSError:
        return  # nowhere to write to: then numba keeps nothing either


def _place(folder: Path) -> Path:
    """Where numba keeps the code of the modules in a folder: it looks for the first of three that may be written to."""
    elsewhere = caching._CacheLocator.get_suitable_cache_subpath(str(folder / "module.py"))
    named = getattr(config, "CACHE_DIR", "")  # NUMBA_CACHE_DIR
    if named:
        return Path(named) / elsewhere
    beside = folder / "__pycache__"
    if os.access(beside if beside.exists() else folder, os.W_OK):
        return beside
    return Path(AppDirs(appname="numba", appauthor=False).user_cache_dir) / elsewhere


def _read(note: Path) -> dict[str, dict[str, Any]]:
    """What was noted last time; nothing if it can't be read."""
    try:
        found = json.loads(note.read_text())
    except (OSError, ValueError):
        return {}
    return found if isinstance(found, dict) and all(isinstance(part, dict) for part in found.values()) else {}


def _digests(sources: Sequence[Path]) -> dict[str, str]:
    """For every module: a digest of its source and of all sources that it imports."""
    texts: dict[str, str] = {}
    for source in sources:
        # Modules of one name in two folders are taken for one: a little too much is thrown away then, never too little.
        texts[source.stem] = texts.get(source.stem, "") + source.read_text(encoding="utf-8")
    imports = {
        name: {word for line in _IMPORT.findall(text) for word in _WORD.findall(line)} & texts.keys()
        for name, text in texts.items()
    }
    digests = {}
    for name in texts:
        reached, new = {name}, [name]
        while new:
            new = [other for other in {o for n in new for o in imports[n]} if other not in reached]
            reached.update(new)
        digests[name] = hashlib.sha256("".join(texts[other] for other in sorted(reached)).encode()).hexdigest()
    return digests


def _one_at_a_time(save: Callable[..., None]) -> Callable[..., None]:
    """Let those who add to a folder of cached code take turns, whatever process they are in."""

    @wraps(save)
    def save_alone(cache: Any, key: Any, data: Any) -> None:
        with _turn(Path(cache._cache_path) / ".lock"):
            save(cache, key, data)

    return save_alone


@contextmanager
def _turn(path: Path) -> Iterator[None]:
    if fcntl is None:
        yield
        return
    with open(path, "ab") as lock:
        with suppress(OSError):  # a file system without locks
            fcntl.flock(lock, fcntl.LOCK_EX)
        yield  # closing the file ends the turn


caching.IndexDataCacheFile.save = _one_at_a_time(caching.IndexDataCacheFile.save)
