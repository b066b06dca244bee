"""Compression of arrays to short text, for the JSON of a replay.

An array is rounded to whole multiples of a unit and differenced along given axes; most of the
resulting integers are small. The list of them, as JSON, is deflated and written in base 64.
"""

import base64
import json
import math
import zlib
from collections.abc import Sequence
from typing import Any

import numpy as np

from pcs_racing.base.checks import check_number, check_whole_array
from pcs_racing.base.errors import InputError
from pcs_racing.base.files import parse_json

# Steps per unit: millimetres and milliradians for interpolated data, centimetres for data that is
# only drawn.
FINE = 1000
COARSE = 100

_MAX_STEPS = 2.0**40  # differences of differences remain exact in numbers of JavaScript
_MAX_NUMBERS = 10_000_000
_MAX_DIGITS = 20  # bytes of a number in a list, its comma included


def pack(values: np.ndarray, per_unit: float, differences: Sequence[int] = ()) -> dict[str, Any]:
    """Return an array as compressed text: ``shape``, ``per_unit``, ``differences`` and ``data``,
    ready for JSON.

    ``per_unit`` is the number of steps per unit: 1000 preserves three decimals. Differences are
    taken along the axes ``differences``, in this order; an axis may occur twice. Values must be
    finite, and at most 2^40 steps in size.
    """
    values = np.asarray(values, float)
    if not np.all(np.abs(values * per_unit) < _MAX_STEPS):  # also false for NaN
        raise InputError(
            f"can't store numbers that are not finite or beyond {_MAX_STEPS / per_unit:.3g}"
        )
    whole = np.rint(values * per_unit).astype(np.int64)
    for axis in differences:
        whole = np.diff(whole, axis=axis, prepend=0)
    numbers = json.dumps(whole.ravel().tolist(), separators=(",", ":"))
    return {
        "shape": list(values.shape),
        "per_unit": per_unit,
        "differences": list(differences),
        "data": base64.b64encode(zlib.compress(numbers.encode())).decode(),
    }


def unpack(packed: object, name: str = "array") -> np.ndarray:
    """Return an array packed by `pack`, after a check of all fields."""
    fields = _parts(packed, name, ("shape", "per_unit", "differences", "data"))
    shape, per_unit, differences, data = fields
    shape = check_whole_array(f"{name}.shape", shape, (None,), minimum=0, maximum=_MAX_NUMBERS)
    count = math.prod(shape.tolist())
    if count > _MAX_NUMBERS or len(shape) > 6:
        raise InputError(f"{name}.shape is {shape}; there may be {_MAX_NUMBERS} numbers in all")
    per_unit = check_number(f"{name}.per_unit", per_unit, 1e-9, 1e9)
    axes = check_whole_array(
        f"{name}.differences", differences, (None,), minimum=0, maximum=len(shape) - 1
    )
    if len(axes) > 8:
        raise InputError(f"{name}.differences names {len(axes)} axes; there may be 8")
    try:
        deflated = base64.b64decode(data, validate=True)
        # A few bytes can unpack to gigabytes: no more is unpacked than the shape needs.
        numbers = zlib.decompressobj().decompress(deflated, _MAX_DIGITS * count + 2)
    except (TypeError, ValueError, zlib.error):
        raise InputError(f"{name}.data must be a deflated list in base 64") from None
    listed, limit = parse_json(f"{name}.data", numbers), 2**50
    whole = check_whole_array(f"{name}.data", listed, (count,), minimum=-limit, maximum=limit)
    whole = whole.reshape(shape)
    for axis in axes:
        whole = np.cumsum(whole, axis=axis)
    return np.asarray(whole / per_unit)


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
