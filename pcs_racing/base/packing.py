"""Compact forms of arrays for pages: whole numbers as compressed text, walls as polylines.

An array is rounded to whole multiples of a unit and differenced along given axes; most of the
resulting integers are small. The list of them, as JSON, is deflated by zlib and written in base 64.
The function ``unpack`` of ``pcs_racing/race/replay.html`` reads it.
"""

import base64
import json
import zlib
from collections.abc import Sequence
from typing import Any

import numpy as np

from pcs_racing.base.errors import InputError

# Steps per unit: millimetres and milliradians for interpolated data, centimetres for data that is
# only drawn.
FINE = 1000
COARSE = 100

_MAX_STEPS = 2.0**40  # differences of differences remain exact in numbers of JavaScript


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


def pack_paths(paths: np.ndarray) -> dict[str, Any]:
    """Return packed paths, shape (..., P, columns); each path may end in rows of NaN.

    The last point of a path is repeated in place of its rows of NaN. Second differences along a
    path are small because its points are evenly spaced. Neighbouring paths (along the axis before
    the points; for a car's plans, consecutive plans) have similar second differences.
    """
    counts = np.count_nonzero(~np.isnan(paths).any(axis=-1), axis=-1)
    last = np.minimum(np.arange(paths.shape[-2]), np.maximum(counts - 1, 0)[..., None])
    held = np.nan_to_num(np.take_along_axis(paths, last[..., None], axis=-2))
    along = paths.ndim - 2
    across = 0 if paths.ndim == 4 else along - 1
    return pack(held, COARSE, [along, along, across])


def join_segments(segments: np.ndarray) -> list[np.ndarray]:
    """Join segments (S, 4) that begin where the last one ends into polylines (n, 2), rounded to
    1 cm; a closed polyline ends with its first point.
    """
    ends = np.rint(segments * COARSE) / COARSE + 0.0
    breaks = np.flatnonzero((ends[1:, :2] != ends[:-1, 2:]).any(axis=1)) + 1
    parts = np.split(ends, breaks) if len(ends) else []
    return [np.vstack([part[:, :2], part[-1:, 2:]]) for part in parts]
