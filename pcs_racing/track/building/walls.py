"""Walls as polylines: simplified outlines of the drivable region, and visibility lists."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.compilation import compiled
from pcs_racing.base.elementary import sine_cosine
from pcs_racing.track.frenet import corners_along
from pcs_racing.track.grid import cast

RAYS = 120  # rays from each viewpoint of a stretch, before refinement
DEPTH = 6  # max number of halvings of the gaps between rays to non-neighbouring segments


class Outlines(NamedTuple):
    """Faces between drivable and other cells, ordered along closed outlines."""

    row: NDArray[np.int32]  #: shape (E,): Row of the drivable cell of each face.
    col: NDArray[np.int32]  #: shape (E,): Column of the same cell.
    side: NDArray[np.int8]  #: shape (E,): Side of that cell: 0 bottom, 1 right, 2 top, 3 left.
    #: shape (L + 1,): Index of the first face of each outline; the drivable side is on its left.
    start: NDArray[np.int32]


@compiled
def trace_outlines(drivable):
    """Trace the closed outlines of a region along its cell faces, the region on the left.

    The region is connected by sides of cells; its outermost rows and columns must be False.
    """
    height, width = drivable.shape
    down = np.array([-1, 0, 1, 0])
    right = np.array([0, 1, 0, -1])
    count = np.sum(drivable[1:] != drivable[:-1]) + np.sum(drivable[:, 1:] != drivable[:, :-1])
    visited = np.zeros((height, width), dtype=np.uint8)
    row = np.empty(count, dtype=np.int32)
    col = np.empty(count, dtype=np.int32)
    sides = np.empty(count, dtype=np.int8)
    starts = [np.int32(0)]
    k = 0
    for i0 in range(1, height - 1):
        for j0 in range(1, width - 1):
            # Every outline has a bottom face: starts at bottom faces are enough.
            if not drivable[i0, j0] or drivable[i0 - 1, j0] or visited[i0, j0] & 1:
                continue
            i, j, side = i0, j0, 0
            while not visited[i, j] & (1 << side):
                visited[i, j] |= 1 << side
                row[k] = i
                col[k] = j
                sides[k] = side
                k += 1
                # Turn left if possible: cells that touch only at a corner are not connected.
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
    return Outlines(row, col, sides, np.array(starts))


@compiled
def _corners(points, tolerance):
    """Mark the points of a closed polyline retained by the Douglas-Peucker algorithm."""
    n = points.shape[0]
    # A speck of a few cells would collapse to a line.
    keep = np.full(n, n <= 12)
    # A closed line has no ends: the first point and the point farthest from it serve as ends.
    away = points - points[0]
    far = int(np.argmax(away[:, 0] * away[:, 0] + away[:, 1] * away[:, 1]))
    keep[0] = True
    keep[far] = True
    stack = [(0, far), (far, n)]
    while len(stack) > 0:
        first, last = stack.pop()
        x0, y0 = points[first]
        x1, y1 = points[last % n]
        length = np.sqrt((x1 - x0) * (x1 - x0) + (y1 - y0) * (y1 - y0))
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
            off = np.sqrt(dx * dx + dy * dy)
            if off > worst:
                worst = off
                at = k
        if at >= 0:
            keep[at] = True
            stack.append((first, at))
            stack.append((at, last))
    return keep


@compiled
def _protrusion(vertex, corner, ends):
    """Return for each side of a polygon the max distance of its faces' ends to the left."""
    m = corner.shape[0]
    n = ends.shape[0]
    out = np.zeros(m)
    for a in range(m):
        x, y = vertex[a]
        dx = vertex[(a + 1) % m, 0] - x
        dy = vertex[(a + 1) % m, 1] - y
        length = np.sqrt(dx * dx + dy * dy)
        last = corner[a + 1] if a + 1 < m else corner[0] + n
        for k in range(corner[a] + 1, last + 1):
            out[a] = max(out[a], (dx * (ends[k % n, 1] - y) - dy * (ends[k % n, 0] - x)) / length)
    return out


@compiled
def _shift_left(vertex, shift):
    """Shift each side of a closed polygon left by its own distance; corners move on bisectors."""
    n = vertex.shape[0]
    out = np.empty((n, 2))
    for k in range(n):
        ax = vertex[k, 0] - vertex[k - 1, 0]
        ay = vertex[k, 1] - vertex[k - 1, 1]
        bx = vertex[(k + 1) % n, 0] - vertex[k, 0]
        by = vertex[(k + 1) % n, 1] - vertex[k, 1]
        a = np.sqrt(ax * ax + ay * ay)
        b = np.sqrt(bx * bx + by * by)
        nx = -ay / a - by / b
        ny = ax / a + bx / b
        # Squared sum of the two unit normals, with a lower bound against jumps of sharp corners.
        scale = (shift[k - 1] + shift[k]) / max(nx * nx + ny * ny, 1.0)
        out[k, 0] = vertex[k, 0] + scale * nx
        out[k, 1] = vertex[k, 1] + scale * ny
    return out


@compiled
def simplify(outlines, tolerance, inset):
    """Simplify outlines to segments through middles of cell faces (Douglas and Peucker, 1973).

    On a slanted wall the middles lie halfway between protruding cells and the cells behind them. A
    slanted ray meets more of the protruding cells, so each segment is then shifted by a share of
    the protrusion (``inset``). Before the shift no middle is farther than ``tolerance`` cells from
    its segment.

    Returns
    -------
    segments : ndarray, shape (S, 4)
        x0, y0, x1, y1 in cells from the grid's lower left corner, outline after outline; the region
        is on the left.
    owner : ndarray, shape (E,), int32
        Segment of each face.
    start : ndarray, shape (L + 1,), int32
        Index of the first segment of each outline.
    """
    count = outlines.row.shape[0]
    middle = np.empty((count, 2))
    ends = np.empty((count, 2))
    for k in range(count):
        side = outlines.side[k]
        ends[k, 0] = outlines.col[k] + (side == 1 or side == 2)
        ends[k, 1] = outlines.row[k] + (side == 2 or side == 3)
        middle[k, 0] = ends[k, 0] + (0.5 if side == 0 else (-0.5 if side == 2 else 0.0))
        middle[k, 1] = ends[k, 1] + (0.5 if side == 1 else (-0.5 if side == 3 else 0.0))
    segments = np.empty((count, 4))
    owner = np.empty(count, dtype=np.int32)
    start = np.zeros(outlines.start.shape[0], dtype=np.int32)
    s = 0
    for loop in range(outlines.start.shape[0] - 1):
        first, after = outlines.start[loop], outlines.start[loop + 1]
        points = middle[first:after]
        corner = np.nonzero(_corners(points, tolerance))[0]
        m = corner.shape[0]
        vertex = points[corner]
        vertex = _shift_left(vertex, inset * _protrusion(vertex, corner, ends[first:after]))
        for a in range(m):
            segments[s + a, 0:2] = vertex[a]
            segments[s + a, 2:4] = vertex[(a + 1) % m]
            last = corner[a + 1] if a + 1 < m else points.shape[0]
            owner[first + corner[a] : first + last] = s + a
        owner[first : first + corner[0]] = s + m - 1
        s += m
        start[loop + 1] = s
    return segments[:s].copy(), owner, start


@compiled
def _segments_by_face(outlines, owner, shape):
    """Return the segment on each side of each cell, shape (H, W, 4); -1 where there is no wall."""
    faces = np.full((shape[0], shape[1], 4), -1, dtype=np.int32)
    for k in range(owner.shape[0]):
        faces[outlines.row[k], outlines.col[k], outlines.side[k]] = owner[k]
    return faces


@compiled
def _segment_at(drivable, faces, x, y, angle):
    """Return the segment hit by a ray; -1 for a viewpoint in a wall."""
    sine, cosine = sine_cosine(angle)
    _, i, j, side = cast(drivable, x, y, cosine, sine, np.inf)
    return faces[i, j, side] if side >= 0 else np.int32(-1)


@compiled
def _mark(drivable, faces, x, y, marks):
    """Mark the segments visible from a point by a fan of rays, denser between distant hits."""
    high = np.empty(DEPTH + 1)
    met = np.empty(DEPTH + 1, dtype=np.int64)
    step = 2.0 * np.pi / RAYS
    low = 0.5 * step
    last = _segment_at(drivable, faces, x, y, low)
    if last < 0:
        return
    # ``high`` is a stack of pending rays: between two rays to distant parts, one more is cast.
    for r in range(RAYS):
        high[0] = (r + 1.5) * step
        met[0] = _segment_at(drivable, faces, x, y, high[0])
        top = 0
        while top >= 0:
            if top < DEPTH and abs(met[top] - last) > 1:
                high[top + 1] = 0.5 * (low + high[top])
                met[top + 1] = _segment_at(drivable, faces, x, y, high[top + 1])
                top += 1
            else:
                low = high[top]
                last = met[top]
                marks[last] = True
                top -= 1


@compiled
def _nearest_squared(segment, x, y):
    dx = segment[2] - segment[0]
    dy = segment[3] - segment[1]
    length2 = dx * dx + dy * dy
    t = ((x - segment[0]) * dx + (y - segment[1]) * dy) / length2 if length2 > 0.0 else 0.0
    t = min(max(t, 0.0), 1.0)
    return (segment[0] + t * dx - x) ** 2 + (segment[1] + t * dy - y) ** 2


@compiled
def seen_lists(drivable, outlines, segments, owner, start, sections):
    """List for each stretch of a closed line the wall segments that are visible from it.

    A fan of exact rays from several points of each cross-section marks the segments hit. The list
    of a stretch contains the segments visible from the cross-sections at its ends and in its
    middle, and both neighbours of each such segment. The neighbours cover segments visible only
    between two viewpoints.

    Parameters
    ----------
    segments, owner, start
        Results of `simplify`.
    sections : ndarray, shape (2 * M, V, 2)
        Viewpoints in cells: cross-section ``2 * m`` is at the start of stretch m, ``2 * m + 1`` in
        its middle.

    Returns
    -------
    seen_start : ndarray, shape (M + 1,), int32
    seen : ndarray, int32
        Segments of stretch m: ``seen[seen_start[m]:seen_start[m + 1]]``, nearest to middle first.
    distance : ndarray, shape of ``seen``
        Distance of each segment from the mean viewpoint in the middle of its stretch, in cells.
    """
    faces = _segments_by_face(outlines, owner, drivable.shape)
    count = segments.shape[0]
    stretches = sections.shape[0] // 2
    seen_start = np.zeros(stretches + 1, dtype=np.int32)
    seen = np.empty(64 * stretches, dtype=np.int32)
    distance = np.empty(seen.shape[0])
    size = 0
    marks = np.zeros((3, count), dtype=np.bool_)
    visible = np.empty(count, dtype=np.bool_)
    for v in range(sections.shape[1]):
        _mark(drivable, faces, sections[0, v, 0], sections[0, v, 1], marks[2])
    for m in range(stretches):
        # The section at the end of the last stretch is the start of this stretch.
        marks[0] = marks[2]
        marks[1:] = False
        for section in range(1, 3):
            view = sections[(2 * m + section) % (2 * stretches)]
            for v in range(view.shape[0]):
                _mark(drivable, faces, view[v, 0], view[v, 1], marks[section])
        visible[:] = False
        for loop in range(start.shape[0] - 1):
            first, last = start[loop], start[loop + 1]
            for k in range(first, last):
                if marks[0, k] or marks[1, k] or marks[2, k]:
                    visible[k] = True
                    visible[k - 1 if k > first else last - 1] = True
                    visible[k + 1 if k + 1 < last else first] = True
        indices = np.nonzero(visible)[0]
        middle = sections[2 * m + 1]
        away = np.empty(indices.shape[0])
        for k in range(indices.shape[0]):
            away[k] = _nearest_squared(
                segments[indices[k]], middle[:, 0].mean(), middle[:, 1].mean()
            )
        if size + indices.shape[0] > seen.shape[0]:
            more = size + indices.shape[0]
            seen = np.concatenate((seen, np.empty(more, dtype=np.int32)))
            distance = np.concatenate((distance, np.empty(more)))
        order = np.argsort(away, kind="mergesort")
        seen[size : size + indices.shape[0]] = indices[order]
        distance[size : size + indices.shape[0]] = np.sqrt(away[order])
        size += indices.shape[0]
        seen_start[m + 1] = size
    return seen_start, seen[:size].copy(), distance[:size].copy()


def corner_lists(
    walls: NDArray[np.float64], seen_start: NDArray[np.int32], seen: NDArray[np.int32]
) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    """List for each stretch the corners of the visible wall segments, along the walls.

    ``walls`` are segments x0, y0, x1, y1, shape (S, 4), in the order of the outlines. The segments
    visible from stretch m are ``seen[seen_start[m]:seen_start[m + 1]]``.

    Returns ``start``, shape (M + 1,), and ``corners``, shape (2, C): x and y of the corners of
    stretch m are ``corners[:, start[m]:start[m + 1]]``, with NaN between two corners without a
    joining segment, and at the end of each list.
    """
    stretches = range(len(seen_start) - 1)
    lists = [
        corners_along(walls[np.sort(seen[seen_start[m] : seen_start[m + 1]])]) for m in stretches
    ]
    start = np.cumsum([0, *(len(points) for points in lists)]).astype(np.int32)
    return start, np.ascontiguousarray(np.concatenate(lists).T)
