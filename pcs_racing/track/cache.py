"""Disk cache for results of slow computations on maps, keyed by the content of map and code.

The folder is ``$PCS_RACING_CACHE``, else ``~/.cache/pcs_racing``; it may be deleted at any time. A
damaged or misnamed file counts as missing; a file that can't be written is skipped.
"""

import contextlib
import hashlib
import io
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.code_cache import cache_folder
from pcs_racing.base.errors import InputError
from pcs_racing.base.files import read_limited, unpack_arrays, write_atomically

TRACK, CALIBRATION = "track", "calibration"  # kinds of results

MAX_BYTES = 256_000_000
_SEAL = 32  # bytes at the end of a file

# Rooms whose code decides the content: a change of the code outdates the cache.
_ROOMS = {
    TRACK: ("base", "track"),
    CALIBRATION: ("base", "track", "car", "planners", "race"),
}


def cache_key(parts: Mapping[str, bytes], kind: str) -> str:
    """Return a hash of named inputs and of the code that processes them."""
    digest = hashlib.sha256(algorithm_digest(_ROOMS[kind]))
    for name in sorted(parts):
        digest.update(f"{name}\0{len(parts[name])}\0".encode())
        digest.update(parts[name])
    return digest.hexdigest()


@cache
def algorithm_digest(rooms: tuple[str, ...]) -> bytes:
    """Return a digest of the sources of some rooms of this package."""
    package = Path(__file__).parents[1]
    digest = hashlib.sha256()
    for file in sorted(file for room in rooms for file in (package / room).rglob("*.py")):
        content = file.read_bytes()
        digest.update(f"{file.relative_to(package).as_posix()} {len(content)}\n".encode())
        digest.update(content)
    return digest.digest()


def load_cached(kind: str, key: str) -> dict[str, NDArray[Any]] | None:
    """Return the arrays stored under a key; None if missing, damaged or stored for another key."""
    folder = cache_folder()
    if folder is None:
        return None
    try:
        content = read_limited(folder / f"{kind}-{key[:40]}.npz", MAX_BYTES, f"a {kind}")
        arrays, seal = content[:-_SEAL], content[-_SEAL:]
        return unpack_arrays(arrays, 4 * MAX_BYTES) if seal == _seal(key, arrays) else None
    except (OSError, InputError):
        return None


def store(kind: str, key: str, arrays: Mapping[str, Any]) -> None:
    """Store arrays under a key, atomically."""
    folder = cache_folder()
    if folder is None:
        return
    content = io.BytesIO()
    np.savez(content, **arrays)
    sealed = content.getvalue() + _seal(key, content.getvalue())
    with contextlib.suppress(OSError, InputError):
        folder.mkdir(parents=True, exist_ok=True)
        write_atomically(folder / f"{kind}-{key[:40]}.npz", sealed)


def _seal(key: str, content: bytes) -> bytes:
    """Return a file's end: a digest of arrays and full key (the file name is the key's start)."""
    return hashlib.sha256(key.encode() + content).digest()
