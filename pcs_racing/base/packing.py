"""Compression of arrays to short text, for the JSON of a replay.

An array is rounded to whole multiples of a unit and differenced along given axes; most of the
resulting integers are small. Each integer is written as one or more characters of the base-64
alphabet. A character holds five bits, lowest first, and a sixth bit that marks whether more
characters follow. Negative and positive integers are interleaved (0, -1, 1, -2, ...), as in
Google's polyline format. A JSON list of the same integers is about twice as long and slower to
parse.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from pcs_racing.base.checks import check_number, check_wholes
from pcs_racing.base.errors import InputError

# Steps per unit: millimetres and milliradians for interpolated data, centimetres for data that is
# only drawn.
FINE = 1000
COARSE = 100

_CODES = np.frombuffer(
    b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789-_", np.uint8
)
_VALUES = np.full(256, 255, np.uint8)
_VALUES[_CODES] = np.arange(64, dtype=np.uint8)

# Ten characters hold 50 bits: the maximum after eight differences of 2^40, and exact in numbers of
# JavaScript too.
_MOST_CHARACTERS = 10
_MOST_DIFFERENCES = 8
_LARGEST = 2.0**40
_MOST_NUMBERS = 10_000_000


def pack(values: np.ndarray, per_unit: float, differences: Sequence[int] = ()) -> dict[str, Any]:
    """Return an array as compressed text: ``shape``, ``per_unit``, ``differences`` and ``data``,
    ready for JSON.

    ``per_unit`` is the number of steps per unit: 1000 preserves three decimals. Differences are
    taken along the axes ``differences``, in this order; an axis may occur twice. Values must be
    finite, and at most 2^40 steps in size.
    """
    values = np.asarray(values, float)
    if not np.all(np.abs(values * per_unit) < _LARGEST):  # also false for NaN
        raise InputError(
            f"can't store numbers that are not finite or beyond {_LARGEST / per_unit:.3g}"
        )
    whole = np.rint(values * per_unit).astype(np.int64)
    for axis in differences:
        whole = np.diff(whole, axis=axis, prepend=0)
    # Small signed numbers become small unsigned numbers.
    folded = np.where(whole < 0, -2 * whole - 1, 2 * whole).ravel()
    lengths = np.ones(folded.shape, np.int64)
    for place in range(1, _MOST_CHARACTERS):
        lengths += folded >= 32**place
    starts = np.cumsum(lengths) - lengths
    text = np.empty(int(lengths.sum()), np.uint8)
    for place in range(_MOST_CHARACTERS):
        selected = lengths > place
        more = lengths[selected] > place + 1
        text[starts[selected] + place] = _CODES[((folded[selected] >> 5 * place) & 31) + 32 * more]
    data = text.tobytes().decode()
    return {
        "shape": list(values.shape),
        "per_unit": per_unit,
        "differences": list(differences),
        "data": data,
    }


def unpack(packed: object, name: str = "array") -> np.ndarray:
    """Return an array packed by `pack`, after a check of all fields: numbers below 1e15 in size."""
    fields = _parts(packed, name, ("shape", "per_unit", "differences", "data"))
    shape, per_unit, differences, data = fields
    shape = check_wholes(f"{name}.shape", shape, 0, _MOST_NUMBERS, (0, 6))
    if math.prod(shape) > _MOST_NUMBERS:
        raise InputError(f"{name}.shape is {shape}; there may be {_MOST_NUMBERS} numbers in all")
    per_unit = check_number(f"{name}.per_unit", per_unit, 1e-9, 1e9)
    differences = check_wholes(
        f"{name}.differences", differences, 0, len(shape) - 1, (0, _MOST_DIFFERENCES)
    )
    digits = (
        _VALUES[np.frombuffer(data.encode(errors="replace"), np.uint8)]
        if isinstance(data, str)
        else None
    )
    if digits is None or np.any(digits == 255):
        raise InputError(f"{name}.data must be text in the base-64 alphabet")
    last = digits < 32
    count, ends = math.prod(shape), int(np.count_nonzero(last))
    if ends != count or (len(last) > 0 and not last[-1]):
        raise InputError(f"{name}.data must hold {count} numbers for shape {shape}, got {ends}")
    if count == 0:
        return np.zeros(shape)

    starts = np.concatenate([[0], np.flatnonzero(last)[:-1] + 1])
    lengths = np.diff(starts, append=len(digits))
    if lengths.max() > _MOST_CHARACTERS:
        raise InputError(f"{name}.data holds a number of more than {_MOST_CHARACTERS} characters")
    place = np.arange(len(digits)) - np.repeat(starts, lengths)
    folded = np.add.reduceat((digits & 31).astype(np.int64) << (5 * place), starts)
    # Odd numbers encode negative numbers.
    whole = np.where(folded & 1, -(folded >> 1) - 1, folded >> 1).reshape(shape)
    for axis in differences:
        whole = np.cumsum(whole, axis=axis)
    values: np.ndarray = whole / per_unit
    if np.any(np.abs(values) >= 1e15):
        raise InputError(f"{name}.data holds numbers beyond 1e15")
    return values


def join_segments(segments: np.ndarray) -> list[np.ndarray]:
    """Join segments (S, 4) into polylines (n, 2), rounded to 1 cm; a closed polyline ends with its
    first point.
    """
    ends = [tuple(row) for row in (np.rint(segments * COARSE) / COARSE + 0.0).tolist()]
    # Backwards, so that the first of several segments that begin at a point is taken from the end
    # of the list.
    following: dict[tuple[float, ...], list[int]] = {}
    for i in range(len(ends) - 1, -1, -1):
        following.setdefault(ends[i][:2], []).append(i)
    free = [True] * len(ends)
    polylines = []
    for first in range(len(ends)):
        if not free[first]:
            continue
        points = [ends[first][:2]]
        ahead = [first]
        while ahead:
            i = ahead[-1]
            free[i] = False
            points.append(ends[i][2:])
            ahead = following.get(ends[i][2:], [])
            while ahead and not free[ahead[-1]]:
                ahead.pop()
        polylines.append(np.array(points))
    return polylines


def pack_segments(segments: np.ndarray) -> dict[str, Any]:
    """Return segments of shape (S, 4) as packed polylines; the order of the segments may change."""
    polylines = join_segments(segments)
    counts = np.array([len(points) for points in polylines])
    return {
        "points": pack(np.vstack([np.empty((0, 2)), *polylines]), COARSE, [0]),
        "counts": pack(counts, 1),
    }


def unpack_segments(packed: object, name: str) -> np.ndarray:
    """Return the segments that `pack_segments` packed, shape (S, 4)."""
    points, counts = _parts(packed, name, ("points", "counts"))
    points, counts = (
        unpack(points, f"{name}.points"),
        unpack(counts, f"{name}.counts").astype(np.int64),
    )
    if points.ndim != 2 or points.shape[1] != 2 or counts.ndim != 1:
        raise InputError(f"{name} must have points of shape (M, 2) and a list of counts")
    if np.any(counts < 2) or np.any(counts > len(points)) or counts.sum() != len(points):
        raise InputError(
            f"{name}.counts must be at least 2 each and sum to the {len(points)} points"
        )
    joined = np.ones(len(points), bool)
    joined[np.cumsum(counts) - 1] = False
    starts = np.flatnonzero(joined)
    return np.hstack([points[starts], points[starts + 1]])


def pack_paths(paths: np.ndarray, per_unit: float) -> dict[str, Any]:
    """Return packed paths, shape (..., P, columns); each path may end in rows of NaN.

    The rows of NaN are replaced by copies of the last point, and the number of points of each path
    is stored. Second differences along a path are small because its points are evenly spaced.
    Neighbouring paths (along the axis before the points; for a car's plans, consecutive plans) have
    similar second differences.
    """
    counts = np.count_nonzero(~np.isnan(paths).any(axis=-1), axis=-1)
    last = np.minimum(np.arange(paths.shape[-2]), np.maximum(counts - 1, 0)[..., None])
    held = np.nan_to_num(np.take_along_axis(paths, last[..., None], axis=-2))
    along = paths.ndim - 2
    across = 0 if paths.ndim == 4 else along - 1
    return {"points": pack(held, per_unit, [along, along, across]), "counts": pack(counts, 1, [0])}


def unpack_paths(packed: object, name: str) -> np.ndarray:
    """Return the paths that `pack_paths` packed."""
    points, counts = _parts(packed, name, ("points", "counts"))
    points, counts = unpack(points, f"{name}.points"), unpack(counts, f"{name}.counts")
    if points.ndim < 3 or counts.shape != points.shape[:-2]:
        raise InputError(f"{name}.counts must have one number for each path of {name}.points")
    points[np.arange(points.shape[-2]) >= counts[..., None]] = np.nan
    return points


def pack_costs(costs: np.ndarray) -> dict[str, Any]:
    """Return packed costs as steps of 1/1000 above the minimum; 0 means infinity."""
    finite = np.isfinite(costs)
    offset = float(costs[finite].min()) if finite.any() else 0.0
    steps = np.where(finite, 1.0 + np.rint((np.where(finite, costs, offset) - offset) * FINE), 0.0)
    return {"offset": offset, "steps": pack(steps, 1)}


def unpack_costs(packed: object, name: str) -> np.ndarray:
    """Return the costs that `pack_costs` packed."""
    offset, steps = _parts(packed, name, ("offset", "steps"))
    offset = check_number(f"{name}.offset", offset, -1e15, 1e15)
    steps = unpack(steps, f"{name}.steps")
    return np.where(steps > 0.0, offset + (steps - 1.0) / FINE, np.inf)


def _parts(packed: object, name: str, keys: tuple[str, ...]) -> list[Any]:
    if not isinstance(packed, dict) or packed.keys() != set(keys):
        raise InputError(f"{name} must be an object with {', '.join(keys)}")
    return [packed[key] for key in keys]
