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

_IMPORT = re.compile(r"^\s*(?:from|import)\s+(pcs_racing[\w.]*)([^\n(]*(?:\([^)]*\))?)", re.MULTILINE)
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
        sources = sorted({*package.rglob("*.py"), *Path(__file__).parents[1].rglob("*.py")})
        stamps = {str(source): [(status := source.stat()).st_size, status.st_mtime_ns] for source in sources}
        noted = _read(note)
        if noted.get("stamps") == stamps:  # reading them takes a third of a second at every start
            return
        now, before = _digests(sources), noted.get("digests", {})
        for source in sources:
            module = _module(source)
            if source.is_relative_to(package) and before.get(module) != now[module]:
                for cached in _place(source.parent).glob(f"{source.stem}.*.nb[ci]"):
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
    texts = {_module(source): source.read_text(encoding="utf-8") for source in sources}
    imports = {name: _imported(text) & texts.keys() for name, text in texts.items()}
    digests = {}
    for name in texts:
        reached, new = {name}, [name]
        while new:
            new = [other for other in {o for n in new for o in imports[n]} if other not in reached]
            reached.update(new)
        digests[name] = hashlib.sha256("".join(texts[other] for other in sorted(reached)).encode()).hexdigest()
    return digests


def _module(source: Path) -> str:
    """Dotted name of a source below a folder whose name begins with ``pcs_racing``: ``pcs_racing.race.kernel``."""
    parts = source.with_suffix("").parts
    start = max((i for i, part in enumerate(parts[:-1]) if part.startswith("pcs_racing")), default=len(parts) - 1)
    return ".".join(parts[start:]).removesuffix(".__init__")


def _imported(text: str) -> set[str]:
    """Dotted names of what a source imports, modules and members alike."""
    names = set()
    for module, members in _IMPORT.findall(text):
        names.add(module)
        names.update(f"{module}.{member}" for member in _WORD.findall(members))
    return names


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
