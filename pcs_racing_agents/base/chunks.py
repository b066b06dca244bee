"""Chunks: files with the result of one task each; damage and results of other tasks are detected.

A chunk is an ordinary ``.npz`` file of arrays. Its zip comment holds two SHA-256 digests: the
digest of its task, and the digest of the file itself, which is compared before any content of the
file is interpreted.
"""

import hashlib
import io
import struct
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.errors import InputError
from pcs_racing.base.files import read_limited, unpack_arrays, write_atomically

Arrays = dict[str, NDArray[Any]]

_MARK = b"pcs-racing chunk "
_COMMENT = len(_MARK) + 128
_MAX_BYTES = 4_000_000_000


def chunk_file(folder: str | Path, name: str, index: int) -> Path:
    """Return the path of a task's chunk in a job's folder."""
    return Path(folder) / "chunks" / f"{name}-{index:05d}.npz"


def write_chunk(path: Path, arrays: Arrays, task: str) -> None:
    """Write a chunk atomically: arrays without objects; equal arrays make equal files.

    ``task`` is the digest of the task, 64 hexadecimal digits
    (:func:`~pcs_racing_agents.base.fingerprint.fingerprint`).
    """
    buffer = io.BytesIO()
    np.savez(buffer, allow_pickle=False, **arrays)
    # A zip file ends with the length of its comment, which np.savez leaves at 0.
    body = buffer.getvalue()[:-2] + struct.pack("<H", _COMMENT)
    comment = _MARK + task.encode() + _digest(body, task).encode()
    write_atomically(path, lambda file: (file.write(body), file.write(comment)))


def read_chunk(path: Path, task: str | None = None) -> Arrays:
    """Read a chunk after a check that its bytes are as written and that it belongs to ``task``."""
    try:
        content = read_limited(path, _MAX_BYTES, "a chunk")
    except OSError as error:
        raise InputError(f"{path} can't be read: {error.strerror}") from None
    # The digest is compared before any content is interpreted: a damaged zip file can mislead its
    # reader.
    body, comment = content[:-_COMMENT], content[-_COMMENT:]
    written_for = comment[len(_MARK) : len(_MARK) + 64].decode("latin-1")
    if (
        not comment.startswith(_MARK)
        or _digest(body, written_for).encode() != comment[len(_MARK) + 64 :]
    ):
        raise InputError(f"{path} is damaged: its content has changed")
    if task is not None and written_for != task:
        raise InputError(f"{path} belongs to another task or another run")
    try:
        return unpack_arrays(content, _MAX_BYTES)
    except InputError as error:
        raise InputError(f"{path} holds no arrays: {error}") from None


def _digest(body: bytes, task: str) -> str:
    return hashlib.sha256(body + task.encode("latin-1")).hexdigest()
