"""Minimum instantaneous time to collision of a car, exact over all directions and without a scan.

A beam hits a point p (relative to the lidar) that approaches with the relative velocity v. The beam
has the range |p|, the range rate -(v . p) / |p| and so the instantaneous time to collision
|p|^2 / (v . p). The points of equal time t form the circle through the lidar with the diameter
|v| t along v. The minimum over infinitely many beams is the smallest such circle that touches a
wall or the opponent. A point hidden by a nearer object of the same velocity lies farther out on its
beam, so that no point needs a test of visibility.
"""

from typing import NamedTuple

import numpy as np

from pcs_racing.base.compilation import inner_kernel, kernel
from pcs_racing.base.elementary import sine_cosine
from pcs_racing.track.frenet import WALLS_BEGIN, WALLS_END, WallArrays, wrap_s

# Tolerance, in m, for a computed point beyond the end of its segment.
_ROUNDING = 1e-9

# A segment this far, in m, outside the circle of a time can't have a smaller time after rounding.
_OUTSIDE = 1e-8


@kernel(forceinline=True)
def segment_ittc(ax, ay, bx, by, vx, vy, speed, best):
    """Return the smaller of ``best`` and the minimum time to collision (s) with the points of a
    segment.

    The ends a and b (m) and the velocity (m/s) are relative to the lidar. ``speed``, the norm of
    the velocity, is positive.
    """
    # Both ends lie behind, so the whole segment lies behind.
    if max(vx * ax + vy * ay, vx * bx + vy * by) <= 0.0:
        return best
    ex = bx - ax
    ey = by - ay
    length = np.sqrt(ex * ex + ey * ey)
    if length > 0.0:
        ux = ex / length
        uy = ey / length
        # Unit normal (nx, ny) from the lidar to the line, at distance h.
        nx = uy
        ny = -ux
        h = ax * nx + ay * ny
        if h < 0.0:
            h, nx, ny = -h, -nx, -ny
        # The circle of time t has its centre at v t / 2 and touches the line where v.n t / 2 + |v|
        # t / 2 = h.
        closing = speed + vx * nx + vy * ny
        if 2.0 * h >= best * closing:
            return best
        time = 2.0 * h / closing
        foot = (0.5 * time * (vx + speed * nx) - ax) * ux + (
            0.5 * time * (vy + speed * ny) - ay
        ) * uy
        if -_ROUNDING <= foot <= length + _ROUNDING:
            return time
        # The time has a single minimum along the line, so the nearer end is the best point.
        if foot > length:
            ax = bx
            ay = by
    approach = vx * ax + vy * ay
    square = ax * ax + ay * ay
    if square < best * approach:
        return square / approach
    return best


@inner_kernel(forceinline=True)
def _outside_circle(ax, ay, bx, by, cx, cy, square):
    """Return whether the segment from a to b lies outside the circle about c.

    ``square`` is the square of the radius.
    """
    wx = cx - ax
    wy = cy - ay
    ex = bx - ax
    ey = by - ay
    along = wx * ex + wy * ey
    length = ex * ex + ey * ey
    cross = wx * ey - wy * ex
    end = min(wx * wx + wy * wy, (cx - bx) * (cx - bx) + (cy - by) * (cy - by))
    # Without unpredictable branches: both ends are outside, and so is a nearer point between them.
    return (end > square) & ((along <= 0.0) | (along >= length) | (cross * cross > square * length))


@inner_kernel(forceinline=True)
def walls_ittc(near, stretch, x, y, vx, vy, best):
    """Return the smaller of ``best`` and the minimum time to collision with the walls visible from
    a stretch.
    """
    speed = np.sqrt(vx * vx + vy * vy)
    if speed == 0.0:
        return best
    k, last = near.seen_start[stretch], near.seen_start[stretch + 1]
    while k < last:
        # The circle of the best time so far, about (cx, cy) relative to the lidar. A segment beyond
        # ``reach`` from the stretch's middle lies outside, and so do all later segments.
        cx = 0.5 * best * vx
        cy = 0.5 * best * vy
        radius = 0.5 * best * speed + _OUTSIDE
        dx = x + cx - near.seen_middle[stretch, 0]
        dy = y + cy - near.seen_middle[stretch, 1]
        reach = np.sqrt(dx * dx + dy * dy) + radius
        # When the best time falls, the circle shrinks, and more of the list is beyond it.
        known = best
        while k < last and not best < known:
            if near.seen_distance[k] >= reach:
                return best
            i = np.uint32(near.seen[k])
            k += 1
            ax = near.walls[i, 0] - x
            ay = near.walls[i, 1] - y
            bx = near.walls[i, 2] - x
            by = near.walls[i, 3] - y
            # Most segments lie outside: rejected here without a root or a quotient.
            if not _outside_circle(ax, ay, bx, by, cx, cy, radius * radius):
                best = segment_ittc(ax, ay, bx, by, vx, vy, speed, best)
    return best


@inner_kernel
def rectangle_ittc(x, y, psi, half_length, half_width, vx, vy, best):
    """Return the smaller of ``best`` and the minimum time to collision with a rectangle at (x, y)
    from the lidar.
    """
    speed = np.sqrt(vx * vx + vy * vy)
    nearest = np.sqrt(x * x + y * y) - half_length - half_width  # lower bound
    if speed == 0.0 or nearest >= best * speed:
        return best
    s, c = sine_cosine(psi)
    lx = half_length * c
    ly = half_length * s
    wx = -half_width * s
    wy = half_width * c
    best = segment_ittc(x + lx - wx, y + ly - wy, x + lx + wx, y + ly + wy, vx, vy, speed, best)
    best = segment_ittc(x + lx + wx, y + ly + wy, x - lx + wx, y - ly + wy, vx, vy, speed, best)
    best = segment_ittc(x - lx + wx, y - ly + wy, x - lx - wx, y - ly - wy, vx, vy, speed, best)
    return segment_ittc(x - lx - wx, y - ly - wy, x + lx - wx, y + ly - wy, vx, vy, speed, best)


class Motion(NamedTuple):
    """Motion of a lidar."""

    x: float  #: Position, m.
    y: float
    vx: float  #: Velocity in the frame of the map, m/s.
    vy: float


@kernel
def minimum_ittc(track, lidar, s, opponent, ovx, ovy, use_opponent, horizon):
    """Return the minimum instantaneous time to collision of a lidar with the walls and, optionally,
    the opponent.

    Walls hidden by the opponent count too. Rotation of either car is ignored: the direction of a
    beam is taken as constant.

    The lidar is at arc length ``s`` (m). The opponent is a rectangle
    (:class:`pcs_racing.car.collision.Rectangle`) with the velocity (ovx, ovy), m/s. The result is
    at most ``horizon`` (s).
    """
    x, y, vx, vy = lidar
    stretch = int(wrap_s(track, s) / track.seen_stretch) % track.seen_middle.shape[0]
    best = walls_ittc(WallArrays(*track[WALLS_BEGIN:WALLS_END]), stretch, x, y, vx, vy, horizon)
    if use_opponent:
        ox, oy, psi, half_length, half_width = opponent
        best = rectangle_ittc(
            ox - x, oy - y, psi, half_length, half_width, vx - ovx, vy - ovy, best
        )
    return best
