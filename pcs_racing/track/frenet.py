"""The data of a track for compiled code, and conversions between map and Frenet coordinates.

Frenet coordinates are (s, d): arc length along the closed race line in metres, and signed distance
from it, positive to the left. Between two samples the line is the cubic with their points and
headings at its ends, so position and heading are continuous along the line.
"""

from typing import NamedTuple

import numpy as np

from pcs_racing.base.compilation import inner_kernel, kernel
from pcs_racing.base.typing import Floats

# Columns of ``TrackArrays.line``.
X, Y, COS, SIN, PSI, KAPPA, SPEED, RIGHT, LEFT = range(9)
LINE_COLUMNS = ("x", "y", "cos", "sin", "psi", "kappa", "speed", "right", "left")

LATERAL_OF_PROFILE = 5.0
"""Max lateral acceleration of the race line's speeds, m/s^2."""
TOGETHER = 16
"""Divisor of the lengths of corner lists, for full processor vectors."""


class TrackArrays(NamedTuple):
    """The data of a track for compiled kernels, as plain arrays."""

    length: float  #: Length of the closed race line in m.
    ds: float  #: Spacing of its samples in m (``length / len(line)``).
    #: shape (N, 9), float64: Samples of the race line at ``s = i * ds``: x, y (m), cos and sin of
    #: the heading, heading psi (rad, continuous along the line), curvature kappa (1/m, positive to
    #: the left), speed (m/s, at speed scale 1), and the free width to the right and to the left
    #: wall (m, both positive). The last sample lies one ``ds`` before the first.
    line: np.ndarray
    #: shape (H, W), float32: Exact distance in m from the centre of each cell to the nearest face
    #: of a wall cell; 0 only in walls and off the track. Row 0 is the bottom.
    distance: np.ndarray
    origin_x: float  #: Lower left corner of cell [0, 0] in m: x.
    origin_y: float  #: Lower left corner of cell [0, 0] in m: y.
    cell: float  #: Side of a cell of ``distance`` in m.
    walls: np.ndarray  #: shape (S, 4), float64: Wall segments x0, y0, x1, y1 in m, track on left.
    seen_start: np.ndarray  #: shape (M + 1,), int32: Start of each stretch's list in ``seen``.
    #: int32: Wall segments visible from anywhere on a stretch of ``seen_stretch`` metres (across
    #: the whole width of the track), for each stretch, near segments first.
    seen: np.ndarray
    #: shape of ``seen``, float32: Distance in m, rounded down, of each listed segment from
    #: ``seen_middle`` of its stretch; ascending along a list.
    seen_distance: np.ndarray
    #: shape (M, 2), float64: Point of each stretch, in m, about halfway along it and between walls.
    seen_middle: np.ndarray
    seen_stretch: float  #: Length of a stretch in m (``length / M``).
    #: shape (M + 1,), int32: Start of each stretch's list in ``corners``, and end of the last list.
    corners_start: np.ndarray
    #: shape (2, C), float64: Corners (x, y in m) of the walls in the ``seen`` list of each stretch,
    #: along the walls. There is a wall segment between two successive corners, and none between a
    #: corner and NaN. The corners of obstacles, visible from every stretch, follow the last list.
    corners: np.ndarray
    lookup: np.ndarray  #: shape (h, w), int32: Line sample nearest to each coarse cell's centre.
    lookup_cell: float  #: Side of a cell of ``lookup`` in m (same origin as ``distance``).
    #: shape (K, 5 + 2 N), float64: Moving obstacles (:mod:`pcs_racing.track.moving`).
    moving: np.ndarray


class WallArrays(NamedTuple):
    """The successive fields of :class:`TrackArrays` for contacts and times to collision.

    A separate tuple: passing the whole track to a kernel takes longer than a contact test.
    """

    distance: np.ndarray
    origin_x: float
    origin_y: float
    cell: float
    walls: np.ndarray
    seen_start: np.ndarray
    seen: np.ndarray
    seen_distance: np.ndarray
    seen_middle: np.ndarray
    seen_stretch: float


# Kernels make it by ``WallArrays(*track[WALLS_BEGIN:WALLS_END])``. A function can't do this,
# because a function without reference counts must not return arrays.
WALLS_BEGIN = TrackArrays._fields.index(WallArrays._fields[0])
WALLS_END = WALLS_BEGIN + len(WallArrays._fields)


# Functions of many kernels take the track, but only pass its parts to a worker function: a branch
# in a function with the track's seven arrays costs their reference counts, five times the
# arithmetic.


@inner_kernel
def _wrap(length, s):
    if 0.0 <= s < length:
        return s
    s = s - np.floor(s / length) * length
    # Rounding can leave s on the excluded end, or below zero.
    return s if 0.0 <= s < length else 0.0


@kernel(forceinline=True)
def wrap_s(track, s):
    """Wrap an arc length into [0, length)."""
    return _wrap(track.length, s)


@kernel(forceinline=True)
def shorter_way(length, way):
    """Return a way along a closed line as the shorter way round, in [-length / 2, length / 2)."""
    return way - length * np.floor(way / length + 0.5)


@kernel(forceinline=True)
def angle_between(a, b):
    """Return the difference a - b of two angles, wrapped into [-pi, pi)."""
    d = a - b
    return d - 2.0 * np.pi * np.floor((d + np.pi) / (2.0 * np.pi))


@inner_kernel(forceinline=True)
def _cubic(line, ds, i):
    """Return the coefficients of the line between sample ``i`` and the next one, for u in [0, 1].

    The cubic Hermite polynomial ``p + u (q + u (a + u b))`` has the samples' points and headings at
    its ends.
    """
    j = i + 1 if i + 1 < line.shape[0] else 0
    qx = ds * line[i, COS]
    qy = ds * line[i, SIN]
    ex = ds * line[j, COS]
    ey = ds * line[j, SIN]
    dx = line[j, X] - line[i, X]
    dy = line[j, Y] - line[i, Y]
    return (
        qx,
        qy,
        3.0 * dx - 2.0 * qx - ex,
        3.0 * dy - 2.0 * qy - ey,
        qx + ex - 2.0 * dx,
        qy + ey - 2.0 * dy,
    )


@inner_kernel
def foot(line, ds, length, x, y, hint):
    """Compute `project` on single arrays."""
    n = line.shape[0]
    i = int(_wrap(length, hint) / ds + 0.5)
    if i >= n:
        i -= n
    dx = x - line[i, X]
    dy = y - line[i, Y]
    best = dx * dx + dy * dy
    step = 1 if dx * line[i, COS] + dy * line[i, SIN] > 0.0 else -1
    # One lap at most, for a point so far away that all samples are about equally near.
    for _ in range(n):
        j = i + step
        if j >= n:
            j = 0
        elif j < 0:
            j = n - 1
        ex = x - line[j, X]
        ey = y - line[j, Y]
        there = ex * ex + ey * ey
        if there >= best:
            break
        best = there
        i = j
        dx = ex
        dy = ey
    # The foot lies on the cubic before or behind the nearest sample, on the side of the point.
    ahead = dx * line[i, COS] + dy * line[i, SIN]
    if ahead < 0.0:
        i = i - 1 if i > 0 else n - 1
        behind = ahead
        dx = x - line[i, X]
        dy = y - line[i, Y]
        ahead = dx * line[i, COS] + dy * line[i, SIN]
    else:
        j = i + 1 if i + 1 < n else 0
        behind = (x - line[j, X]) * line[j, COS] + (y - line[j, Y]) * line[j, SIN]
    # Between samples the distance to their normals falls almost linearly: ``ahead`` to ``behind``.
    gap = ahead - behind
    u = min(max(ahead / gap, 0.0), 1.0) if gap > 1e-12 else 0.0
    qx, qy, ax, ay, bx, by = _cubic(line, ds, i)
    # Two steps of Newton's method from this good guess leave an error below 1e-9 m.
    for _ in range(2):
        tx = qx + u * (2.0 * ax + 3.0 * u * bx)
        ty = qy + u * (2.0 * ay + 3.0 * u * by)
        ex = dx - u * (qx + u * (ax + u * bx))
        ey = dy - u * (qy + u * (ay + u * by))
        slope = tx * tx + ty * ty - ex * (2.0 * ax + 6.0 * u * bx) - ey * (2.0 * ay + 6.0 * u * by)
        # Beyond the centre of curvature there is no nearest point to converge to.
        if slope <= 0.0:
            break
        u = min(max(u + (ex * tx + ey * ty) / slope, 0.0), 1.0)
    tx = qx + u * (2.0 * ax + 3.0 * u * bx)
    ty = qy + u * (2.0 * ay + 3.0 * u * by)
    ex = dx - u * (qx + u * (ax + u * bx))
    ey = dy - u * (qy + u * (ay + u * by))
    s = (i + u) * ds
    return s if s < length else 0.0, (tx * ey - ty * ex) / np.sqrt(tx * tx + ty * ty)


@kernel
def project(track, x, y, hint):
    """Return the Frenet coordinates (s, d) in m of a point (m), by a walk along the line.

    The walk starts at the arc length ``hint`` (any real number; it is wrapped) and ends at the
    sample nearer than the next: O(1) while driving. Newton's method then finds the foot of the
    perpendicular on one of the two adjacent cubics. So s, in [0, length), and d are continuous in x
    and y, and `to_cartesian` inverts the projection, if the line's centre of curvature is
    farther away than the line (``1 - kappa * d > 0``). Beyond it there may be no perpendicular
    foot; the end of a cubic is then used.
    """
    return foot(track.line, track.ds, track.length, x, y, hint)


@inner_kernel
def offset(line, ds, length, s, d):
    """Compute `to_cartesian` on single arrays."""
    at = _wrap(length, s) / ds
    i = int(at)
    if i >= line.shape[0]:
        i = line.shape[0] - 1
    u = at - i
    qx, qy, ax, ay, bx, by = _cubic(line, ds, i)
    tx = qx + u * (2.0 * ax + 3.0 * u * bx)
    ty = qy + u * (2.0 * ay + 3.0 * u * by)
    scale = d / np.sqrt(tx * tx + ty * ty)
    x = line[i, X] + u * (qx + u * (ax + u * bx)) - scale * ty
    y = line[i, Y] + u * (qy + u * (ay + u * by)) + scale * tx
    # The heading turns little between samples: a few terms of the arctangent's series suffice.
    t = (qx * ty - qy * tx) / (qx * tx + qy * ty)
    t2 = t * t
    return x, y, line[i, PSI] + t * (1.0 - t2 * (1.0 / 3.0 - t2 * (0.2 - t2 / 7.0)))


@kernel
def to_cartesian(track, s, d):
    """Return the point (x, y) in m at Frenet coordinates (s, d), and the line's heading (rad)."""
    return offset(track.line, track.ds, track.length, s, d)


@inner_kernel
def _in_sight(distance, u0, v0, u1, v1):
    """Return whether no wall is between two points, in cells from the corner of the grid."""
    rows, cols = distance.shape
    # Checked before the conversion to integers, which may overflow.
    if not (0.0 <= u0 < cols and 0.0 <= v0 < rows):
        return False
    steps = int(2.0 * np.sqrt((u1 - u0) * (u1 - u0) + (v1 - v0) * (v1 - v0))) + 1
    for k in range(steps + 1):
        i = int(np.floor(v0 + (v1 - v0) * k / steps))
        j = int(np.floor(u0 + (u1 - u0) * k / steps))
        if i < 0 or j < 0 or i >= rows or j >= cols or distance[i, j] == 0.0:
            return False
    return True


@inner_kernel
def locate(track, x, y):
    """Return the Frenet coordinates of a point anywhere near the track, without a hint.

    The walk starts from the four cells of the look-up grid around the point. If they lead to
    different parts of the line, as near a thin wall between two parts, the nearest visible part is
    taken. A point outside the map is projected from the nearest cell.
    """
    line, ds, length, lookup, cell = track.line, track.ds, track.length, track.lookup, track.cell
    u, v = (x - track.origin_x) / cell, (y - track.origin_y) / cell
    coarse = track.lookup_cell / cell  # cells per look-up cell
    rows, cols = lookup.shape
    row = int(min(max(np.floor(v / coarse - 0.5), -1.0), rows + 0.0))
    col = int(min(max(np.floor(u / coarse - 0.5), -1.0), cols + 0.0))
    best_s = -1.0
    best_d = 0.0
    best_seen = False
    for k in range(4):
        i = min(max(row + k // 2, 0), rows - 1)
        j = min(max(col + k % 2, 0), cols - 1)
        s, d = foot(line, ds, length, x, y, lookup[i, j] * ds)
        # The same foot as before: its line of sight has been checked.
        if best_s >= 0.0 and abs(s - best_s) < ds:
            continue
        fx, fy, _ = offset(line, ds, length, s, 0.0)
        seen = _in_sight(track.distance, u, v, u + (fx - x) / cell, v + (fy - y) / cell)
        if best_s < 0.0 or (seen and not best_seen) or (seen == best_seen and abs(d) < abs(best_d)):
            best_s, best_d, best_seen = s, d, seen
    return best_s, best_d


@inner_kernel
def interpolate(distance, u, v):
    """Compute `wall_distance` for a point in cells from the centre of cell [0, 0]."""
    rows, cols = distance.shape
    # In this form NaN counts as outside, too.
    if not (u >= 0.0 and v >= 0.0 and u < cols - 1.0 and v < rows - 1.0):
        return 0.0
    i = int(v)
    j = int(u)
    fu = u - j
    fv = v - i
    low = distance[i, j] * (1.0 - fu) + distance[i, j + 1] * fu
    high = distance[i + 1, j] * (1.0 - fu) + distance[i + 1, j + 1] * fu
    return low * (1.0 - fv) + high * fv


@kernel
def wall_distance(track, x, y):
    """Return the interpolated distance in m from a point to the nearest wall; 0 outside the map.

    Walls count as 0 up to their cells' centres, so a point on a straight wall's face has a quarter
    of a cell; from half a cell on, the distance from a straight wall is exact. The max error is
    0.71 of a cell: distances of cell centres are exact, and the four centres are within 0.71 cells.
    """
    u = (x - track.origin_x) / track.cell - 0.5
    v = (y - track.origin_y) / track.cell - 0.5
    return interpolate(track.distance, u, v)


def corners_along(segments: Floats) -> Floats:
    """Return the corners of segments, shape (K, 4), in order, with NaN between separate segments.

    The shape is (C, 2); meeting segments share a corner. NaN at the end pads C to a multiple of
    :data:`TOGETHER`.
    """
    if not len(segments):
        return np.empty((0, 2))
    meets = (segments[:-1, 2:] == segments[1:, :2]).all(axis=1)
    ends = np.flatnonzero(~np.append(meets, False))
    gaps = np.full((2 * len(ends), 2), np.nan)
    gaps[::2] = segments[ends, 2:]
    points = np.insert(segments[:, :2], np.repeat(ends + 1, 2), gaps, axis=0)
    return np.concatenate([points, np.full((-len(points) % TOGETHER, 2), np.nan)])
