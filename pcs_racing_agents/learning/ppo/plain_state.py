"""What environments remember, as plain arrays and back: what a checkpoint holds instead of a pickle."""

import json
from collections.abc import Iterator
from typing import Any

import numpy as np

from pcs_racing.base.errors import InputError
from pcs_racing_agents.jobs.chunks import Arrays

__all__ = ["pack", "unpack"]

PLAIN = "plain"


def pack(value: Any) -> Arrays:
    """Take a value apart.

    Parameters
    ----------
    value : nested named tuples, tuples, lists and dicts
        Of arrays, and of numbers (of any size), texts and None.

    Returns
    -------
    dict of ndarray
        Every array under the path to it, and one of bytes, ``plain``, with everything else as JSON.
    """
    arrays: Arrays = {}
    plain: dict[str, Any] = {}
    for path, leaf in _leaves(value, ""):
        if isinstance(leaf, np.ndarray):
            arrays[path] = leaf
        else:
            plain[path] = leaf.item() if isinstance(leaf, np.generic) else leaf
    return {**arrays, PLAIN: np.frombuffer(json.dumps(plain, sort_keys=True).encode(), np.uint8)}


def unpack(arrays: Arrays, like: Any) -> Any:
    """Put a value together that :func:`pack` took apart.

    Parameters
    ----------
    arrays : dict of ndarray
    like
        A value of the same structure; its arrays say what shapes and types those of the result must have.

    Raises
    ------
    InputError
        If the arrays belong to a value of another structure.
    """
    try:
        plain = json.loads(arrays[PLAIN].tobytes())
    except (KeyError, ValueError):
        raise InputError("the state is not one that was taken apart here") from None
    found = {**plain, **{path: array for path, array in arrays.items() if path != PLAIN}}
    if set(found) != {path for path, _ in _leaves(like, "")}:
        odd = sorted(set(found) ^ {path for path, _ in _leaves(like, "")})[0]
        raise InputError(f"the state is one of other environments: {odd} is in one of the two only")
    return _filled(like, "", found)


def _children(value: Any) -> dict[str, Any] | None:
    if isinstance(value, dict):
        return {str(key): item for key, item in value.items()}
    if isinstance(value, tuple) and hasattr(value, "_asdict"):
        return dict(value._asdict())
    if isinstance(value, tuple | list):
        return {str(i): item for i, item in enumerate(value)}
    return None


def _leaves(value: Any, path: str) -> Iterator[tuple[str, Any]]:
    children = _children(value)
    if children is None:
        yield path, value
        return
    for key, item in children.items():
        yield from _leaves(item, f"{path}.{key}" if path else key)


def _filled(like: Any, path: str, found: dict[str, Any]) -> Any:
    children = _children(like)
    if children is None:
        leaf = found[path]
        fits = isinstance(leaf, np.ndarray) == isinstance(like, np.ndarray)
        if fits and isinstance(like, np.ndarray):
            fits = leaf.shape == like.shape and leaf.dtype == like.dtype
        if not fits:
            raise InputError(f"the state is one of other environments: {path} has another shape or type")
        return leaf
    filled = [_filled(item, f"{path}.{key}" if path else key, found) for key, item in children.items()]
    if isinstance(like, dict):
        return dict(zip(like, filled, strict=True))
    if isinstance(like, tuple) and hasattr(like, "_asdict"):
        return type(like)(*filled)
    return type(like)(filled)
