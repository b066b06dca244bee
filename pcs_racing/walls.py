"""Walls as polylines: outlines of the drivable region, simplified, and which of them can be seen from where."""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pcs_racing.grid import cast
from pcs_racing.splines import solve_cyclic

__all__ = ["Outlines", "seen_lists", "simplify", "trace_outlines"]


class Outlines(NamedTuple):
    """The faces between drivable and other cells, in the order of the closed outlines they form.

    Attributes
    ----------
    row, col : ndarray, shape (E,), int32
        The drivable cell of each face.
    side : ndarray, shape (E,), int8
        The face's side of that cell: 0 bottom, 1 right, 2 top, 3 left.
    start : ndarray, shape (L + 1,), int32
        Where each outline begins; the drivable side is on its left.
    """

    row: NDArray[np.int32]
    col: NDArray[np.int32]
    side: NDArray[np.int8]
    start: NDArray[np.int32]


@njit(cache=True, nogil=True)
def _trace(drivable):  # type: ignore[no-untyped-def]
    height, width = drivable.shape
    down = np.array([-1, 0, 1, 0])
    right = np.array([0, 1, 0, -1])
    count = 0
    for i in range(1, height - 1):
        for j in range(1, width - 1):
            if drivable[i, j]:
                for side in range(4):
                    count += not drivable[i + down[side], j + right[side]]
    visited = np.zeros((height, width), dtype=np.uint8)
    row = np.empty(count, dtype=np.int32)
    col = np.empty(count, dtype=np.int32)
    sides = np.empty(count, dtype=np.int8)
    starts = [np.int32(0)]
    k = 0
    for i0 in range(1, height - 1):
        for j0 in range(1, width - 1):
            if not drivable[i0, j0] or drivable[i0 - 1, j0] or visited[i0, j0] & 1:
                continue
            i, j, side = i0, j0, 0
            while not visited[i, j] & (1 << side):
                visited[i, j] |= 1 << side
                row[k] = i
                col[k] = j
                sides[k] = side
                k += 1
                # Turn left where possible: cells that touch at a corner only are not connected.
                ahead = (side + 1) % 4
                i1, j1 = i + down[ahead], j + right[ahead]
                if not drivable[i1, j1]:
                    side = ahead
                elif not drivable[i1 + down[side], j1 + right[side]]:
                    i, j = i1, j1
                else:
                    i, j = i1 + down[side], j1 + right[side]
                    side = (side + 3) % 4
            starts.append(np.int32(k))
    return row, col, sides, np.array(starts)


def trace_outlines(drivable: NDArray[np.bool_]) -> Outlines:
    """Trace the closed outlines of a region along its cell faces, the region on the left.

    Parameters
    ----------
    drivable : ndarray of bool, shape (H, W)
        Four-connected region; its outermost rows and columns must be False.

    Returns
    -------
    Outlines
    """
    return Outlines(*_trace(drivable))


@njit(cache=True, nogil=True)
def _corners(points, tolerance):  # type: ignore[no-untyped-def]
    """Mark the points that Douglas-Peucker keeps of a closed polyline."""
    n = points.shape[0]
    keep = np.zeros(n, dtype=np.bool_)
    far = 0
    best = -1.0
    for k in range(n):
        d = (points[k, 0] - points[0, 0]) ** 2 + (points[k, 1] - points[0, 1]) ** 2
        if d > best:
            best = d
            far = k
    keep[0] = True
    keep[far] = True
    stack = [(0, far), (far, n)]
    while len(stack) > 0:
        first, last = stack.pop()
        x0, y0 = points[first]
        x1, y1 = points[last % n]
        length = np.hypot(x1 - x0, y1 - y0)
        worst = tolerance
        at = -1
        for k in range(first + 1, last):
            dx = points[k, 0] - x0
            dy = points[k, 1] - y0
            if length > 0.0:
                along = (dx * (x1 - x0) + dy * (y1 - y0)) / length
                along = min(max(along, 0.0), length) / length
                dx -= along * (x1 - x0)
                dy -= along * (y1 - y0)
            away = np.hypot(dx, dy)
            if away > worst:
                worst = away
                at = k
        if at >= 0:
            keep[at] = True
            stack.append((first, at))
            stack.append((at, last))
    return keep


@njit(cache=True, nogil=True)
def _fit(points, corner):  # type: ignore[no-untyped-def]
    """Move the corners of a closed polyline to where it fits its points best, in least squares."""
    n = points.shape[0]
    m = corner.shape[0]
    vertex = points[corner].copy()
    lower = np.zeros(m)
    diagonal = np.full(m, 1e-3)
    upper = np.zeros(m)
    right = 1e-3 * vertex
    for a in range(m):
        b = (a + 1) % m
        last = corner[b] if b > 0 else corner[0] + n
        x0, y0 = vertex[a]
        dx = vertex[b, 0] - x0
        dy = vertex[b, 1] - y0
        length2 = dx * dx + dy * dy
        for k in range(corner[a], last):
            x, y = points[k % n]
            t = ((x - x0) * dx + (y - y0) * dy) / length2 if length2 > 0.0 else 0.0
            t = min(max(t, 0.0), 1.0)
            diagonal[a] += (1.0 - t) * (1.0 - t)
            diagonal[b] += t * t
            upper[a] += t * (1.0 - t)
            lower[b] += t * (1.0 - t)
            right[a, 0] += (1.0 - t) * x
            right[a, 1] += (1.0 - t) * y
            right[b, 0] += t * x
            right[b, 1] += t * y
    return solve_cyclic(lower, diagonal, upper, right)


@njit(cache=True, nogil=True)
def simplify(outlines, tolerance):  # type: ignore[no-untyped-def]
    """Straight segments along outlines, fitted through the middles of the cell faces.

    Parameters
    ----------
    outlines : Outlines
    tolerance : float
        Largest deviation in cells of a face's middle from its segment, before the fit.

    Returns
    -------
    segments : ndarray, shape (S, 4)
        x0, y0, x1, y1 in cells from the grid's lower left corner, outline after outline; the region is on their left.
    owner : ndarray, shape (E,), int32
        The segment that stands for each face.
    start : ndarray, shape (L + 1,), int32
        Where each outline's segments begin.
    """
    count = outlines.row.shape[0]
    middle = np.empty((count, 2))
    for k in range(count):
        side = outlines.side[k]
        middle[k, 0] = outlines.col[k] + (0.5 if side % 2 == 0 else (1.0 if side == 1 else 0.0))
        middle[k, 1] = outlines.row[k] + (0.5 if side % 2 == 1 else (1.0 if side == 2 else 0.0))
    segments = np.empty((count, 4))
    owner = np.empty(count, dtype=np.int32)
    start = np.zeros(outlines.start.shape[0], dtype=np.int32)
    s = 0
    for loop in range(outlines.start.shape[0] - 1):
        first = outlines.start[loop]
        points = middle[first : outlines.start[loop + 1]]
        corner = np.nonzero(_corners(points, tolerance))[0]
        vertex = _fit(points, corner) if corner.shape[0] >= 3 else points[corner]
        m = corner.shape[0]
        for a in range(m):
            segments[s + a, 0:2] = vertex[a]
            segments[s + a, 2:4] = vertex[(a + 1) % m]
            last = corner[a + 1] if a + 1 < m else points.shape[0]
            owner[first + corner[a] : first + last] = s + a
        owner[first : first + corner[0]] = s + m - 1
        s += m
        start[loop + 1] = s
    return segments[:s].copy(), owner, start


@njit(cache=True, nogil=True)
def _cell_faces(outlines, shape):  # type: ignore[no-untyped-def]
    """Number the cells that have a wall face; for each, which outline face is on each of its sides."""
    number = np.full(shape, -1, dtype=np.int32)
    count = 0
    for k in range(outlines.row.shape[0]):
        if number[outlines.row[k], outlines.col[k]] < 0:
            number[outlines.row[k], outlines.col[k]] = count
            count += 1
    faces = np.full((count, 4), -1, dtype=np.int32)
    for k in range(outlines.row.shape[0]):
        faces[number[outlines.row[k], outlines.col[k]], outlines.side[k]] = k
    return number, faces


@njit(cache=True, nogil=True)
def _mark(drivable, number, faces, owner, x, y, rays, reach, stamp, marks):  # type: ignore[no-untyped-def]
    for r in range(rays):
        angle = 2.0 * np.pi * (r + 0.5) / rays
        _, i, j, side = cast(drivable, x, y, np.cos(angle), np.sin(angle), reach)
        if side >= 0:
            marks[owner[faces[number[i, j], side]]] = stamp


@njit(cache=True, nogil=True)
def seen_lists(drivable, outlines, segments, owner, start, sections, rays, reach):  # type: ignore[no-untyped-def]
    """List for each stretch of a line the wall segments that can be seen from it.

    From several points of each cross-section a fan of exact rays marks the segments it meets. A stretch sees what the
    cross-sections at its ends and between them see, and both neighbours of every such segment, which covers what the
    gaps between rays and viewpoints leave out.

    Parameters
    ----------
    drivable : ndarray of bool, shape (H, W)
    outlines : Outlines
    segments, owner, start
        What `simplify` returned.
    sections : ndarray, shape (2 * M, V, 2)
        Viewpoints in cells: cross-section ``2 * m`` stands where stretch m begins, ``2 * m + 1`` in its middle.
    rays : int
        Rays from each viewpoint.
    reach : float
        Their length in cells.

    Returns
    -------
    seen_start : ndarray, shape (M + 1,), int32
    seen : ndarray, int32
        Segments of stretch m: ``seen[seen_start[m]:seen_start[m + 1]]``, those near its middle first.
    """
    number, faces = _cell_faces(outlines, drivable.shape)
    count = segments.shape[0]
    marks = np.full((3, count), -1, dtype=np.int32)
    around = np.empty((count, 3), dtype=np.int32)
    for loop in range(start.shape[0] - 1):
        for k in range(start[loop], start[loop + 1]):
            around[k, 0] = k - 1 if k > start[loop] else start[loop + 1] - 1
            around[k, 1] = k
            around[k, 2] = k + 1 if k + 1 < start[loop + 1] else start[loop]
    stretches = sections.shape[0] // 2
    seen_start = np.zeros(stretches + 1, dtype=np.int32)
    seen = np.empty(64 * stretches, dtype=np.int32)
    size = 0
    chosen = np.full(count, -1, dtype=np.int32)
    found = np.empty(count, dtype=np.int32)
    away = np.empty(count)
    for v in range(sections.shape[1]):
        _mark(drivable, number, faces, owner, sections[0, v, 0], sections[0, v, 1], rays, reach, 0, marks[0])
    for m in range(stretches):
        for part in range(1, 3):
            at = (2 * m + part) % (2 * stretches)
            for v in range(sections.shape[1]):
                _mark(
                    drivable, number, faces, owner, sections[at, v, 0], sections[at, v, 1], rays, reach, m, marks[part]
                )
        n = 0
        for k in range(count):
            if marks[0, k] == m or marks[1, k] == m or marks[2, k] == m:
                for near in around[k]:
                    if chosen[near] != m:
                        chosen[near] = m
                        found[n] = near
                        n += 1
        viewpoints = sections[2 * m + 1]
        cx = viewpoints[:, 0].mean()
        cy = viewpoints[:, 1].mean()
        for a in range(n):
            x0, y0, x1, y1 = segments[found[a]]
            dx, dy = x1 - x0, y1 - y0
            length2 = dx * dx + dy * dy
            t = ((cx - x0) * dx + (cy - y0) * dy) / length2 if length2 > 0.0 else 0.0
            t = min(max(t, 0.0), 1.0)
            away[a] = (x0 + t * dx - cx) ** 2 + (y0 + t * dy - cy) ** 2
        order = np.argsort(away[:n], kind="mergesort")
        if size + n > seen.shape[0]:
            larger = np.empty(2 * (size + n), dtype=np.int32)
            larger[:size] = seen[:size]
            seen = larger
        for a in range(n):
            seen[size + a] = found[order[a]]
        size += n
        seen_start[m + 1] = size
        # The section at the end of this stretch begins the next one.
        for k in range(count):
            marks[0, k] = m + 1 if marks[2, k] == m else -1
    return seen_start, seen[:size].copy()
