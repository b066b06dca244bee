"""Corners of the walls that can be seen from each stretch of a track, in the order in which a lidar draws them."""

import numpy as np
from numpy.typing import NDArray

TOGETHER = 16
"""Lists of corners have a multiple of this length, so that the processor's vectors are full."""

Floats = NDArray[np.float64]


def corner_lists(
    walls: Floats, seen_start: NDArray[np.int32], seen: NDArray[np.int32]
) -> tuple[NDArray[np.int32], Floats]:
    """List for each stretch the corners of the wall segments that can be seen from it, along the walls.

    Parameters
    ----------
    walls : ndarray, shape (S, 4)
        Segments x0, y0, x1, y1; those of one outline follow each other.
    seen_start : ndarray, shape (M + 1,)
    seen : ndarray
        Segments of stretch m: ``seen[seen_start[m]:seen_start[m + 1]]``.

    Returns
    -------
    start : ndarray, shape (M + 1,), int32
    corners : ndarray, shape (2, C)
        x and y of the corners of stretch m: ``corners[:, start[m]:start[m + 1]]``, with NaN between two corners that no
        segment joins, and at the end of each list.
    """
    stretches = range(len(seen_start) - 1)
    lists = [corners_along(walls[np.sort(seen[seen_start[m] : seen_start[m + 1]])]) for m in stretches]
    start = np.cumsum([0, *(len(points) for points in lists)]).astype(np.int32)
    return start, np.ascontiguousarray(np.concatenate(lists).T)


def corners_along(segments: Floats) -> Floats:
    """Return the corners of segments, shape (K, 4), in their order: one between two that meet, else two and NaN.

    The shape is (C, 2); at the end there is NaN, and more of it until C is a multiple of :data:`TOGETHER`.
    """
    meets = (segments[:-1, 2:] == segments[1:, :2]).all(axis=1)
    ends = np.flatnonzero(~np.append(meets, False))
    gaps = np.full((2 * len(ends), 2), np.nan)
    gaps[::2] = segments[ends, 2:]
    points = np.insert(segments[:, :2], np.repeat(ends + 1, 2), gaps, axis=0)
    return np.concatenate([points, np.full((-len(points) % TOGETHER, 2), np.nan)])
