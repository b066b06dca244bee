"""Folder of numba's compiled code; a digest of all possible sources is its name.

Numba checks the file of a loaded function, but not the files of the functions that it calls: after
an edit or an update it would continue to run parts of the old code.
"""

import hashlib
import os
import shutil
from contextlib import suppress
from functools import cache
from pathlib import Path

from pcs_racing.base.numba_parts import config

SIMULATOR = ("base", "track", "car", "planners", "race")
"""Lowest floors of ``pcs_racing``, without imports from the others. Their digest is separate: an
edit of an environment does not recompile the race kernel."""

MAX_FOLDERS = 20
"""Max number of kept folders, the last used: one for each digest of the last edits."""

_PACKAGE = Path(__file__).resolve().parents[1]
_CHOSEN = config.CACHE_DIR  # NUMBA_CACHE_DIR


def cache_folder() -> Path | None:
    """Return the folder of cached results, ``$PCS_RACING_CACHE``, else ``~/.cache/pcs_racing``.

    Return None if there is no home directory.
    """
    named = os.environ.get("PCS_RACING_CACHE")
    if named:
        return Path(named)
    try:
        return Path.home() / ".cache" / "pcs_racing"
    except RuntimeError:
        return None


@cache
def code_folder(sources: Path) -> Path | None:
    """Return the folder of the code compiled from the modules in a folder.

    It is in the first writable place: ``$NUMBA_CACHE_DIR``, or the package and then the user's
    cache. Return None without a writable place.
    """
    user, name = cache_folder(), digest_of(sources.resolve())
    places = [Path(_CHOSEN)] if _CHOSEN else [_PACKAGE / "__pycache__", *([user] if user else [])]
    for place in places:
        folder = place / "compiled" / name
        with suppress(OSError):
            if not folder.is_dir():
                folder.mkdir(parents=True)
                _forget_unused(folder.parent)
            os.utime(folder)
            if os.access(folder, os.W_OK):
                return folder
    return None


def _forget_unused(place: Path) -> None:
    """Delete all but the last used folders of code."""
    folders = sorted(place.iterdir(), key=lambda folder: folder.stat().st_mtime)
    for folder in folders[:-MAX_FOLDERS]:
        shutil.rmtree(folder, ignore_errors=True)


def digest_of(folder: Path) -> str:
    """Return the digest of all possible sources of the compiled code of a folder.

    For modules of the simulator, the sources are the simulator; for other modules of
    ``pcs_racing``, the whole of ``pcs_racing``. For all other modules they are the files in the
    folder, and both packages.
    """
    if any(folder.is_relative_to(_PACKAGE / floor) for floor in SIMULATOR):
        parts = [sources_digest(_PACKAGE / floor) for floor in SIMULATOR]
    elif folder.is_relative_to(_PACKAGE):
        parts = [sources_digest(_PACKAGE)]
    else:
        packages = sorted(_PACKAGE.parent.glob("pcs_racing*/"))
        parts = [sources_digest(folder, deep=False), *map(sources_digest, packages)]
    return hashlib.sha256(b"".join(parts)).hexdigest()[:32]


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
