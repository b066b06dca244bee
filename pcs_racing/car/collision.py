"""Contacts between cars and of cars with walls, by exact rectangles, and the fault for a contact.

A car is the rectangle of ``2 half_length x 2 half_width`` (m) centred on its pose: x, y (m) and psi
(rad). Two cars are in contact when they share a positive area. A car and a wall are in contact when
a piece of the wall is inside the car. Touching alone is not a contact. No lidar scan is needed.
"""

from typing import NamedTuple

import numpy as np

from pcs_racing.base.compilation import compiled, inner_kernel, kernel
from pcs_racing.base.elementary import sine_cosine
from pcs_racing.track.frenet import WALLS_BEGIN, WALLS_END, WallArrays, interpolate, wrap_s

# Two closing speeds this close to each other (as a share of the larger, or in m/s) put both cars at
# fault.
EQUAL_SHARES = 0.05
EQUAL_SPEEDS = 1e-3

# The distance field agrees with the wall segments to this many cells: it is interpolated, and the
# segments run through the middles of the cells' faces.
FIELD_ERROR = 1.5

# Contact axes with a penetration this close to the minimum (in m) count as equal, so that the order
# of the cars does not decide the axis.
_SAME_AXIS = 1e-3


class Rectangle(NamedTuple):
    """Outline of a car."""

    x: float  #: x of the centre, m.
    y: float  #: y of the centre, m.
    psi: float  #: Direction of the length, rad.
    half_length: float  #: Half of the length, m.
    half_width: float  #: Half of the width, m.


@kernel
def rectangles_overlap(a, b):
    """Return whether two rectangles share a positive area, by their four separating axes."""
    # Most cars are far apart: decided without a sine.
    dx = b.x - a.x
    dy = b.y - a.y
    # No less than the sum of the two half diagonals.
    reach = a.half_length + a.half_width + b.half_length + b.half_width
    if dx * dx + dy * dy >= reach * reach:
        return False
    s0, c0 = sine_cosine(a.psi)
    s1, c1 = sine_cosine(b.psi)
    c = abs(c0 * c1 + s0 * s1)
    s = abs(c0 * s1 - s0 * c1)
    if abs(dx * c0 + dy * s0) >= a.half_length + b.half_length * c + b.half_width * s:
        return False
    if abs(dy * c0 - dx * s0) >= a.half_width + b.half_length * s + b.half_width * c:
        return False
    if abs(dx * c1 + dy * s1) >= b.half_length + a.half_length * c + a.half_width * s:
        return False
    return abs(dy * c1 - dx * s1) < b.half_width + a.half_length * s + a.half_width * c


@inner_kernel
def _segment_in_rectangle(ax, ay, bx, by, half_length, half_width):
    """Return whether a segment, in a rectangle's own frame, passes through its inside."""
    if max(ax, bx) <= -half_length or min(ax, bx) >= half_length:
        return False
    if max(ay, by) <= -half_width or min(ay, by) >= half_width:
        return False
    # The segment's own normal is the last separating axis.
    ex = bx - ax
    ey = by - ay
    return abs(ax * ey - ay * ex) < half_length * abs(ey) + half_width * abs(ex)


@kernel
def inside_wall(track, x, y):
    """Return whether a point lies in a wall cell, off the track or outside the map."""
    row = np.floor((y - track.origin_y) / track.cell)
    column = np.floor((x - track.origin_x) / track.cell)
    rows, columns = track.distance.shape
    if not (0.0 <= row < rows and 0.0 <= column < columns):
        return True
    return track.distance[int(row), int(column)] <= 0.0


@inner_kernel
def _wall_in_rectangle(near, stretch, body):
    """Return whether a wall visible from a stretch passes through the inside of a rectangle."""
    s, c = sine_cosine(body.psi)
    dx = body.x - near.seen_middle[stretch, 0]
    dy = body.y - near.seen_middle[stretch, 1]
    half_length, half_width = body.half_length, body.half_width
    reach = np.sqrt(dx * dx + dy * dy) + np.sqrt(
        half_length * half_length + half_width * half_width
    )
    for k in range(near.seen_start[stretch], near.seen_start[stretch + 1]):
        # The list is sorted: no later segment can reach into the rectangle.
        if near.seen_distance[k] >= reach:
            break
        i = np.uint32(near.seen[k])
        ax = near.walls[i, 0] - body.x
        ay = near.walls[i, 1] - body.y
        bx = near.walls[i, 2] - body.x
        by = near.walls[i, 3] - body.y
        if _segment_in_rectangle(
            ax * c + ay * s,
            ay * c - ax * s,
            bx * c + by * s,
            by * c - bx * s,
            half_length,
            half_width,
        ):
            return True
    return False


@inner_kernel
def hits_wall(near, s, body):
    """Compute `car_hits_wall` for :class:`WallArrays`, a :class:`Rectangle` and an arc length in
    [0, length).
    """
    half_length, half_width = body.half_length, body.half_width
    per_cell = 1.0 / near.cell
    u = (body.x - near.origin_x) * per_cell
    v = (body.y - near.origin_y) * per_cell
    clearance = interpolate(near.distance, u - 0.5, v - 0.5)
    error = FIELD_ERROR * near.cell
    radius = np.sqrt(half_length * half_length + half_width * half_width)
    if clearance > radius + error:
        return False
    # Three circles along the car cover it more closely than one circle around it.
    step = half_length * (2.0 / 3.0)
    part = np.sqrt(0.25 * step * step + half_width * half_width) + error
    if clearance > part:
        sine, cosine = sine_cosine(body.psi)
        du = step * cosine * per_cell
        dv = step * sine * per_cell
        if (
            interpolate(near.distance, u + du - 0.5, v + dv - 0.5) > part
            and interpolate(near.distance, u - du - 0.5, v - dv - 0.5) > part
        ):
            return False
    if clearance <= min(half_length, half_width) - error:
        return True
    # A body with its centre in a wall may be too small to touch the wall's face.
    if clearance < error:
        rows, columns = near.distance.shape
        if not (0.0 <= v < rows and 0.0 <= u < columns) or near.distance[int(v), int(u)] <= 0.0:
            return True
    return _wall_in_rectangle(near, int(s / near.seen_stretch) % near.seen_middle.shape[0], body)


@inner_kernel
def circle_overlaps(body, x, y, radius):
    """Return whether a rectangle and a circle around (x, y) overlap."""
    dx, dy = x - body.x, y - body.y
    s, c = sine_cosine(body.psi)
    u = max(abs(dx * c + dy * s) - body.half_length, 0.0)
    v = max(abs(dy * c - dx * s) - body.half_width, 0.0)
    return u * u + v * v < radius * radius


@kernel
def car_hits_wall(track, x, y, psi, half_length, half_width, s):
    """Return whether the rectangle of a car at arc length ``s`` (m) reaches into a wall.

    Everything outside the map is wall. The distance field settles the clear cases. Otherwise the
    rectangle is tested against the wall segments visible from the car's stretch of track. These
    suffice: the wall point inside the rectangle nearest to the centre is visible from the centre,
    because the straight line between them stays inside the rectangle. A car with its centre in a
    wall has hit it, too, even if the car is too small to touch the wall's face.
    """
    near = WallArrays(*track[WALLS_BEGIN:WALLS_END])
    return hits_wall(near, wrap_s(track, s), Rectangle(x, y, psi, half_length, half_width))


@compiled
def _clip(polygon, count, a, b, limit, out):
    """Clip a convex polygon to a x + b y <= limit; return its size (Sutherland, Hodgman 1974)."""
    kept = 0
    for i in range(count):
        # Number by number: numba takes seconds to compile a copy of rows.
        px, py = polygon[i, 0], polygon[i, 1]
        following = i + 1 if i + 1 < count else 0
        qx, qy = polygon[following, 0], polygon[following, 1]
        here = a * px + b * py - limit
        there = a * qx + b * qy - limit
        if here <= 0.0:
            out[kept, 0] = px
            out[kept, 1] = py
            kept += 1
        if (here < 0.0 < there) or (there < 0.0 < here):
            share = here / (here - there)
            out[kept, 0] = px + share * (qx - px)
            out[kept, 1] = py + share * (qy - py)
            kept += 1
    return kept


@compiled
def _middle_of_overlap(a, b):
    """Return the centroid of the shared area of two rectangles, relative to the first's centre.

    Without a shared area, return the point half way to the second's centre.
    """
    polygon = np.empty((8, 2))
    other = np.empty((8, 2))
    s, c = sine_cosine(b.psi)
    for i in range(4):
        u = b.half_length if i in (0, 3) else -b.half_length
        v = b.half_width if i < 2 else -b.half_width
        polygon[i, 0] = b.x - a.x + u * c - v * s
        polygon[i, 1] = b.y - a.y + u * s + v * c
    s, c = sine_cosine(a.psi)
    count = polygon.shape[0] // 2  # number of corners
    count = _clip(polygon, count, c, s, a.half_length, other)
    count = _clip(other, count, -c, -s, a.half_length, polygon)
    count = _clip(polygon, count, -s, c, a.half_width, other)
    count = _clip(other, count, s, -c, a.half_width, polygon)
    area = 0.0
    mx = 0.0
    my = 0.0
    for i in range(1, count - 1):
        ax, ay = polygon[i, 0] - polygon[0, 0], polygon[i, 1] - polygon[0, 1]
        bx, by = polygon[i + 1, 0] - polygon[0, 0], polygon[i + 1, 1] - polygon[0, 1]
        part = ax * by - ay * bx
        area += part
        mx += part * (ax + bx) / 3.0
        my += part * (ay + by) / 3.0
    if area <= 0.0:
        return 0.5 * (b.x - a.x), 0.5 * (b.y - a.y)
    return polygon[0, 0] + mx / area, polygon[0, 1] + my / area


@inner_kernel
def _axis(dx, dy, psi, reach):
    """Return the axis of direction psi, oriented along (dx, dy), and the penetration along it.

    ``reach`` is the sum of the two shapes' half extents on the axis.
    """
    ay, ax = sine_cosine(psi)
    apart = dx * ax + dy * ay
    if apart < 0.0:
        return -ax, -ay, reach + apart
    return ax, ay, reach - apart


@compiled
def contact_fault(state0, state1, a, b):
    """Decide which car is at fault for a contact, from two vehicle states and rectangles.

    At least one car is at fault. The contact direction is the axis of minimum penetration of the
    two rectangles, from the first car to the second. Each car's share is the speed of its own body
    into the other body: the velocity of its material point in the middle of the overlap, along the
    contact direction, or 0 if it moves away. The car with the larger share is at fault; both cars
    are at fault if the shares lie within ``EQUAL_SHARES`` or ``EQUAL_SPEEDS`` of each other. So the
    follower is at fault for a rear-end contact, however hard the leader braked. Of two parallel
    cars, the car that moved over is at fault.
    """
    v0, rate0, v1, rate1 = state0[3], state0[5], state1[3], state1[5]
    dx = b.x - a.x
    dy = b.y - a.y
    s, c = sine_cosine(b.psi - a.psi)
    s, c = abs(s), abs(c)
    # unit vector from the first car towards the second, penetration along it
    axes = np.empty((4, 3))
    reaches = (
        a.half_length + b.half_length * c + b.half_width * s,
        a.half_width + b.half_length * s + b.half_width * c,
        b.half_length + a.half_length * c + a.half_width * s,
        b.half_width + a.half_length * s + a.half_width * c,
    )
    least = np.inf
    for i in range(4):
        psi = (a.psi if i < 2 else b.psi) + 0.5 * np.pi * (i % 2)
        axes[i, 0], axes[i, 1], axes[i, 2] = _axis(dx, dy, psi, reaches[i])
        least = min(least, axes[i, 2])
    # Corner to corner, two axes may have the same penetration: the contact lies between them.
    nx = 0.0
    ny = 0.0
    for i in range(4):
        if axes[i, 2] <= least + _SAME_AXIS:
            nx += axes[i, 0]
            ny += axes[i, 1]
    norm = np.sqrt(nx * nx + ny * ny)
    nx /= norm
    ny /= norm
    mx, my = _middle_of_overlap(a, b)
    s0, c0 = sine_cosine(a.psi + state0[6])
    s1, c1 = sine_cosine(b.psi + state1[6])
    share0 = (v0 * c0 - rate0 * my) * nx + (v0 * s0 + rate0 * mx) * ny
    share1 = (v1 * c1 - rate1 * (my - dy)) * nx + (v1 * s1 + rate1 * (mx - dx)) * ny
    share0 = max(share0, 0.0)
    share1 = max(-share1, 0.0)
    margin = max(EQUAL_SHARES * max(share0, share1), EQUAL_SPEEDS)
    return not share1 - share0 > margin, not share0 - share1 > margin
