"""Atomic writing of files, and safe reading of untrusted files: no content is executed.

A few bytes can request much memory: YAML with aliases of aliases, an array header with a size of
terabytes, a zip file that unpacks to terabytes. The readers here check the size before they build
the content.
"""

import io
import json
import math
import os
import secrets
import shutil
import stat
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import IO, Any

import numpy as np
import yaml
from numpy.typing import NDArray

from pcs_racing.base.errors import InputError, check_path

NEXT = ".next"
"""Folder of new files until all of them are at their places (:func:`write_together`)."""

MAX_YAML = 200_000
"""Maximum size of a YAML file in bytes; larger files would take seconds to parse."""

_FLOATS = yaml.SafeLoader("")
_MAX_VALUES = 2_000_000  # in a YAML text, aliases expanded; a letter counts as a tenth
_MAX_DEPTH = 50
_MAX_DIGITS = 100  # characters
_MAX_ARRAYS = 1000  # arrays in a file
_KINDS = "biufcUS"  # types of arrays: booleans, numbers and texts


def write_atomically(path: Path, content: bytes | str | Callable[[IO[bytes]], object]) -> None:
    """Write a file completely or not at all, through a temporary file that then replaces ``path``.

    ``content``: bytes, a text (UTF-8), or a function that fills the temporary file.
    """
    check_path("the path of a file", path)
    if not path.parent.is_dir():
        raise InputError(f"can't write {path}: there is no folder {path.parent}")
    if path.is_dir():
        raise InputError(f"can't write {path}: it is a folder")
    _move_next(path.parent)
    # In the same folder, because a file can only be renamed within one file system; shortened,
    # because names have a limit.
    temporary = path.with_name(f".{path.name[:100]}.{secrets.token_hex(4)}")
    try:
        with open(temporary, "xb") as file:
            if callable(content):
                content(file)
            else:
                file.write(content.encode() if isinstance(content, str) else content)
        os.replace(temporary, path)
    except OSError as error:
        if error.strerror is None:
            raise
        raise OSError(error.errno, error.strerror, str(path)) from None
    finally:
        temporary.unlink(missing_ok=True)


def write_together(folder: Path, files: Mapping[str, bytes]) -> None:
    """Write files of a folder so that all of them appear at once, or none.

    They are first written into a new folder, which is then renamed: to ``folder`` if that is
    missing, else to ``folder/.next``. From the renaming on, :func:`read_limited` takes files in
    ``.next`` in place of the files above it. At last they are moved there, by this call or, if it
    was killed, by the next one.
    """
    target = folder / NEXT if folder.is_dir() else folder
    temporary = target.with_name(f".{target.name[:100]}.{secrets.token_hex(4)}")
    try:
        temporary.parent.mkdir(parents=True, exist_ok=True)
        temporary.mkdir()
        for name, data in files.items():
            (temporary / name).parent.mkdir(exist_ok=True)
            (temporary / name).write_bytes(data)
        _move_next(folder)
        temporary.rename(target)
        _move_next(folder)
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(folder)) from None
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def _move_next(folder: Path) -> None:
    """Move the files in ``.next`` to their places."""
    for file in sorted((folder / NEXT).rglob("*")):
        place = folder / file.relative_to(folder / NEXT)
        if file.is_dir():
            place.mkdir(exist_ok=True)
        else:
            file.replace(place)
    shutil.rmtree(folder / NEXT, ignore_errors=True)


def _current(path: str | os.PathLike[str]) -> str | os.PathLike[str]:
    """Return the place of a file: its path, or a place in ``.next`` of one of the folders above."""
    given = Path(path)
    for above in given.parents[:2]:
        pending = above / NEXT / given.relative_to(above)
        if pending.is_file():
            return pending
    return path


def read_limited(
    path: str | os.PathLike[str], limit: int, kind: str, error: type[InputError] | None = None
) -> bytes:
    """Return the content of a regular file of at most ``limit`` bytes.

    ``kind`` ("an archive") is for the message. All problems raise ``error``; without ``error``, an
    :class:`OSError` is passed on.
    """
    refused = error or InputError
    check_path("the path of a file", path, refused)
    try:
        with open(_current(path), "rb", opener=_open_at_once) as file:
            status = os.fstat(file.fileno())
            # A pipe or a device may never end.
            if not stat.S_ISREG(status.st_mode):
                raise refused(f"{path} is no ordinary file")
            # Not the limit alone: ``read`` allocates the requested size at once.
            content = file.read(min(status.st_size, limit) + 1)
    except OSError as problem:
        if error is None:
            raise
        raise error(f"can't read {path}: {problem.strerror or problem}") from None
    if len(content) > limit:
        raise refused(f"{path} has more than {limit} bytes; that is not {kind}")
    return content


def _open_at_once(path: str, flags: int) -> int:
    """Open a file without blocking on a pipe that has no writer."""
    return os.open(path, flags | getattr(os, "O_NONBLOCK", 0))


def plain_yaml(data: bytes | str) -> Any:
    """Parse a YAML text of mappings, lists, texts and numbers."""
    try:
        # As a stream: for a text, PyYAML's errors would quote the line, possibly of a linked file.
        loader = yaml.SafeLoader(
            io.StringIO(data.decode("utf-8") if isinstance(data, bytes) else data)
        )
        node = loader.get_single_node()
        if node is None:
            return None
        if _size(node, {}, 0) > _MAX_VALUES:
            raise InputError("its aliases expand to too many values")
        return loader.construct_document(node)
    except InputError:
        raise
    except RecursionError:
        raise InputError("it is nested too deeply") from None
    # Values that look like dates or numbers but are not fail in a dozen ways.
    except Exception as error:
        raise InputError(" ".join(str(error).split())[:200] or type(error).__name__) from None


def parse_yaml(
    file: str | os.PathLike[str], content: bytes, error: type[InputError] = InputError
) -> Any:
    """Parse the content of a YAML file like :func:`plain_yaml`; the error names the file."""
    try:
        return plain_yaml(content)
    except InputError as problem:
        raise error(f"{file} is not valid YAML: {problem}") from None


def parse_json(file: str | os.PathLike[str], content: bytes | str) -> Any:
    """Parse a JSON text; NaN, Infinity and numbers beyond the range of a float are refused."""

    def finite(number: str) -> float:
        value = float(number)
        if not math.isfinite(value):
            raise InputError(f"{file} holds {number:.20}; its numbers must be finite")
        return value

    try:
        return json.loads(content, parse_float=finite, parse_constant=finite)
    except InputError:
        raise
    # Bytes of another encoding, integers of thousands of digits, deep nesting.
    except (ValueError, RecursionError) as error:
        raise InputError(f"{file} is not valid JSON: {' '.join(str(error).split()):.100}") from None


def _size(node: yaml.Node, sizes: dict[int, float], depth: int) -> float:
    """Return the number of values of a node with all aliases expanded; visit every node once."""
    if isinstance(node, yaml.ScalarNode):
        kind = node.tag.rpartition(":")[2]
        if kind in ("int", "float", "timestamp") and len(node.value) > _MAX_DIGITS:
            raise InputError(f"the number {node.value[:20]}... has {len(node.value)} characters")
        if kind == "float" and not math.isfinite(_FLOATS.construct_yaml_float(node)):
            raise InputError(
                f"line {node.start_mark.line + 1} holds {node.value:.20}; numbers must be finite"
            )
        return 1.0 + 0.1 * len(node.value)
    if id(node) not in sizes:
        if depth > _MAX_DEPTH:
            raise InputError(f"it is nested more than {_MAX_DEPTH} levels deep")
        # For a node that contains itself: its size is requested during its own computation.
        sizes[id(node)] = math.inf
        pairs = isinstance(node, yaml.MappingNode)
        children = [child for pair in node.value for child in pair] if pairs else node.value
        sizes[id(node)] = 1.0 + sum(_size(child, sizes, depth + 1) for child in children)
    return sizes[id(node)]


def unpack_arrays(content: bytes, limit: int = 1_000_000_000) -> dict[str, NDArray[Any]]:
    """Return the arrays of an ``.npz`` file by name, ``limit`` bytes at most; refuse objects."""
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as file:
            members = file.infolist()
            # Check the announced sizes before unpacking any member.
            if len(members) > _MAX_ARRAYS or sum(member.file_size for member in members) > limit:
                raise InputError(f"it unpacks to more than {limit} bytes or {_MAX_ARRAYS} arrays")
            return {
                member.filename.removesuffix(".npy"): _array(file.read(member))
                for member in members
            }
    except InputError:
        raise
    # zipfile and zlib raise a dozen types of errors for damaged files.
    except Exception as error:
        raise InputError(" ".join(str(error).split())[:200] or type(error).__name__) from None


def _array(content: bytes) -> NDArray[Any]:
    """Return the array of an ``.npy`` file: numbers or texts, without trailing bytes."""
    stream = io.BytesIO(content)
    # Numpy reserves the announced memory, but touches no more of it than the content fills.
    array: NDArray[Any] = np.lib.format.read_array(stream, allow_pickle=False)
    if (
        array.dtype.kind not in _KINDS
        or array.dtype.itemsize == 0
        or max(array.shape, default=0) > 2**40
    ):
        raise InputError(
            f"an array is of type {array.dtype} and shape {array.shape}; there may be numbers and"
            " texts"
        )
    if stream.read(1):
        raise InputError(f"more follows an array of type {array.dtype} and shape {array.shape}")
    return array


def shipped_folder(package: Path, name: str) -> Path:
    """Return the folder ``data/NAME`` of a package; in a checkout, tracks are in the top ``maps``.

    The top folder also holds the drawings and the page of the tracks; readers look for them there.
    """
    inside = package / "data" / name
    return inside if inside.is_dir() else package.parent / name
