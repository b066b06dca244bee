"""Disk cache for results of slow computations on maps, keyed by the content of map and code.

The folder is ``$PCS_RACING_CACHE``, else ``~/.cache/pcs_racing``; it may be deleted at any time. A
damaged or misnamed file counts as missing; a file that can't be written is skipped.
"""

import contextlib
import hashlib
import io
import re
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

# Modules whose code, imports included, decides the content: a code change outdates the cache.
_ALGORITHMS = {TRACK: "pcs_racing.track.loading", CALIBRATION: "pcs_racing.race.calibration"}
_IMPORT = re.compile(r"^ *from (pcs_racing[\w.]*) import (\([^)]*\)|.*)", re.MULTILINE)


def cache_key(parts: Mapping[str, bytes], kind: str) -> str:
    """Return a hash of named inputs and of the code that processes them."""
    digest = hashlib.sha256(algorithm_digest(_ALGORITHMS[kind]))
    for name in sorted(parts):
        digest.update(f"{name}\0{len(parts[name])}\0".encode())
        digest.update(parts[name])
    return digest.hexdigest()


@cache
def algorithm_digest(module: str) -> bytes:
    """Return a digest of a module's source and of its imports in this package, recursively."""
    digest = hashlib.sha256()
    for name, content in sorted(_sources(module, {}).items()):
        digest.update(f"{name} {len(content)}\n".encode() + content)
    return digest.digest()


def _sources(module: str, found: dict[str, bytes]) -> dict[str, bytes]:
    """Add the sources of a module and of its imports; a name that is no module adds nothing."""
    path = Path(__file__).parents[2].joinpath(*module.split("."))
    for file in (path.with_suffix(".py"), path / "__init__.py"):
        # The package's own file imports nothing: it lists the exported names.
        if module not in found and module != "pcs_racing" and file.is_file():
            found[module] = file.read_bytes()
            for origin, names in _IMPORT.findall(found[module].decode()):
                for name in (origin, *(f"{origin}.{name}" for name in re.findall(r"\w+", names))):
                    _sources(name, found)
    return found


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
        write_atomically(folder / f"{kind}-{key[:40]}.npz", lambda file: file.write(sealed))


def _seal(key: str, content: bytes) -> bytes:
    """Return a file's end: a digest of arrays and full key (the file name is the key's start)."""
    return hashlib.sha256(key.encode() + content).digest()
