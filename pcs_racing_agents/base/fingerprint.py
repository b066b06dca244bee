"""Fingerprint: a digest that identifies equal values in all processes."""

import hashlib
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np


def fingerprint(*values: Any) -> str:
    """Return the SHA-256 of plain values, arrays, sequences, mappings and dataclasses, in hex.

    Equal values give equal digests in every process. An object with a ``content_hash`` is
    represented by it, a dataclass by its fields (without its ``added_fields`` at their defaults),
    and any other object (such as a function) by its type alone.
    """
    digest = hashlib.sha256()
    _feed(digest, values)
    return digest.hexdigest()


def _feed(digest: Any, value: Any) -> None:
    kind = f"{type(value).__module__}.{type(value).__qualname__}"
    content = getattr(value, "content_hash", None)
    if isinstance(value, np.ndarray | np.generic) and value.dtype != object:
        array = np.asarray(value)
        digest.update(f"array {array.dtype.str} {array.shape};".encode())
        digest.update(np.ascontiguousarray(array).tobytes())
    elif value is None or isinstance(value, bool | int | float | complex | str | bytes | Path):
        # With the type and the length: 1, 1.0, True and "1" differ, and no text can run into the
        # next value.
        text = repr(value) if not isinstance(value, Path) else str(value)
        digest.update(
            f"{kind if not isinstance(value, Path) else 'path'} {len(text)} {text};".encode()
        )
    elif isinstance(content, str) and content:
        digest.update(f"{kind} {content};".encode())
    elif isinstance(value, list | tuple):
        digest.update(f"sequence {len(value)};".encode())
        for item in value:
            _feed(digest, item)
    elif isinstance(value, Mapping):
        digest.update(f"mapping {len(value)};".encode())
        # The order of insertion must not matter; keys of several types can only be sorted by their
        # texts.
        for key in sorted(value, key=repr):
            _feed(digest, key)
            _feed(digest, value[key])
    elif is_dataclass(value) and not isinstance(value, type):
        digest.update(f"{kind};".encode())
        added = getattr(value, "added_fields", ())
        for field in fields(value):
            own = getattr(value, field.name)
            if field.name not in added or own != field.default:
                _feed(digest, own)
    else:
        digest.update(f"{kind};".encode())
