"""Contacts between cars and of cars with walls, by exact rectangles, and the fault for a contact.

A car is the rectangle of ``2 half_length x 2 half_width`` centred on its pose. Two cars are in contact when they share
a positive area. A car and a wall are in contact when a piece of the wall is inside the car. Touching alone is not a
contact. No lidar scan is needed.
"""

import numpy as np

from pcs_racing.base.compilation import compiled, inner_kernel, kernel
from pcs_racing.base.elementary import sine_cosine
from pcs_racing.track.frenet import interpolate, wrap_s

# Two closing speeds this close to each other (as a share of the larger, or in m/s) put both cars at fault.
EQUAL_SHARES = 0.05
EQUAL_SPEEDS = 1e-3

# The distance field agrees with the wall segments to this many cells: it is interpolated, and the segments run through
# the middles of the cells' faces.
FIELD_ERROR = 1.5

# Contact axes whose penetration lies this near the least (in m) count as equally good, so that the order of the cars
# can't decide which one is taken.
_SAME_AXIS = 1e-3


@kernel
def rectangles_overlap(x0, y0, psi0, x1, y1, psi1, half_length0, half_width0, half_length1, half_width1):  # type: ignore[no-untyped-def]
    """Whether two rectangles share a positive area, by their four separating axes.

    Parameters
    ----------
    x0, y0, psi0 : float
        Centre (m) and heading (rad) of the first rectangle.
    x1, y1, psi1 : float
        Those of the second.
    half_length0, half_width0, half_length1, half_width1 : float
        Half the sides along and across the headings, m.

    Returns
    -------
    bool
    """
    dx = x1 - x0
    dy = y1 - y0
    reach = half_length0 + half_width0 + half_length1 + half_width1  # no less than the two half diagonals together
    if dx * dx + dy * dy >= reach * reach:
        return False
    s0, c0 = sine_cosine(psi0)
    s1, c1 = sine_cosine(psi1)
    c = abs(c0 * c1 + s0 * s1)
    s = abs(c0 * s1 - s0 * c1)
    if abs(dx * c0 + dy * s0) >= half_length0 + half_length1 * c + half_width1 * s:
        return False
    if abs(dy * c0 - dx * s0) >= half_width0 + half_length1 * s + half_width1 * c:
        return False
    if abs(dx * c1 + dy * s1) >= half_length1 + half_length0 * c + half_width0 * s:
        return False
    return abs(dy * c1 - dx * s1) < half_width1 + half_length0 * s + half_width0 * c


@inner_kernel(forceinline=True)
def _segment_in_rectangle(ax, ay, bx, by, half_length, half_width):  # type: ignore[no-untyped-def]
    """Whether a segment, given in the rectangle's own frame, passes through its inside."""
    if max(ax, bx) <= -half_length or min(ax, bx) >= half_length:
        return False
    if max(ay, by) <= -half_width or min(ay, by) >= half_width:
        return False
    # The segment's own normal is the last separating axis.
    ex = bx - ax
    ey = by - ay
    return abs(ax * ey - ay * ex) < half_length * abs(ey) + half_width * abs(ex)


@kernel
def inside_wall(track, x, y):  # type: ignore[no-untyped-def]
    """Whether a point lies in a wall cell, off the track or outside the map."""
    row = np.floor((y - track.origin_y) / track.cell)
    column = np.floor((x - track.origin_x) / track.cell)
    rows, columns = track.distance.shape
    if not (0.0 <= row < rows and 0.0 <= column < columns):
        return True
    return track.distance[int(row), int(column)] <= 0.0


@inner_kernel
def _wall_in_rectangle(walls, seen_start, seen, distance, middle, stretch, x, y, psi, half_length, half_width):  # type: ignore[no-untyped-def]
    """Whether a wall that can be seen from a stretch passes through the inside of a rectangle."""
    s, c = sine_cosine(psi)
    dx = x - middle[stretch, 0]
    dy = y - middle[stretch, 1]
    reach = np.sqrt(dx * dx + dy * dy) + np.sqrt(half_length * half_length + half_width * half_width)
    for k in range(seen_start[stretch], seen_start[stretch + 1]):
        if distance[k] >= reach:
            break
        i = np.uint32(seen[k])
        ax = walls[i, 0] - x
        ay = walls[i, 1] - y
        bx = walls[i, 2] - x
        by = walls[i, 3] - y
        if _segment_in_rectangle(
            ax * c + ay * s, ay * c - ax * s, bx * c + by * s, by * c - bx * s, half_length, half_width
        ):
            return True
    return False


@inner_kernel(forceinline=True)
def hits_wall(  # type: ignore[no-untyped-def]
    distance,
    origin_x,
    origin_y,
    cell,
    walls,
    seen_start,
    seen,
    seen_distance,
    seen_middle,
    stretch,
    x,
    y,
    psi,
    half_length,
    half_width,
):
    """Compute `car_hits_wall` on single arrays, because passing a whole track takes longer than the test."""
    per_cell = 1.0 / cell
    u = (x - origin_x) * per_cell
    v = (y - origin_y) * per_cell
    clearance = interpolate(distance, u - 0.5, v - 0.5)
    error = FIELD_ERROR * cell
    radius = np.sqrt(half_length * half_length + half_width * half_width)
    if clearance > radius + error:
        return False
    # Three circles along the car cover it more closely than the one around it.
    step = half_length * (2.0 / 3.0)
    part = np.sqrt(0.25 * step * step + half_width * half_width) + error
    if clearance > part:
        s, c = sine_cosine(psi)
        du = step * c * per_cell
        dv = step * s * per_cell
        if (
            interpolate(distance, u + du - 0.5, v + dv - 0.5) > part
            and interpolate(distance, u - du - 0.5, v - dv - 0.5) > part
        ):
            return False
    if clearance <= min(half_length, half_width) - error:
        return True
    if clearance < error:
        rows, columns = distance.shape
        if not (0.0 <= v < rows and 0.0 <= u < columns) or distance[int(v), int(u)] <= 0.0:
            return True
    return _wall_in_rectangle(
        walls,
        seen_start,
        seen,
        seen_distance,
        seen_middle,
        int(stretch) % seen_middle.shape[0],
        x,
        y,
        psi,
        half_length,
        half_width,
    )


@kernel
def car_hits_wall(track, x, y, psi, half_length, half_width, s):  # type: ignore[no-untyped-def]
    """Whether a car's rectangle reaches into a wall; everything outside the map is wall.

    The distance field settles the clear cases. Else the rectangle is tested against the wall segments that can be seen
    from the car's stretch of track. These suffice: of all points of walls inside the rectangle, nothing hides the one
    nearest to the centre from it, because the straight way there stays inside the rectangle. A car whose centre is in a
    wall has hit it, too, even if it is too small to touch the wall's face.

    Parameters
    ----------
    track : TrackArrays
    x, y, psi : float
        Pose of the car, m and rad.
    half_length, half_width : float
        Half the sides of its rectangle, m.
    s : float
        Arc length of the car on the race line, m.

    Returns
    -------
    bool
    """
    return hits_wall(
        track.distance,
        track.origin_x,
        track.origin_y,
        track.cell,
        track.walls,
        track.seen_start,
        track.seen,
        track.seen_distance,
        track.seen_middle,
        wrap_s(track, s) / track.seen_stretch,
        x,
        y,
        psi,
        half_length,
        half_width,
    )


@compiled
def _clip(polygon, count, a, b, limit, out):  # type: ignore[no-untyped-def]
    """Keep the part of a convex polygon where a x + b y <= limit (Sutherland and Hodgman 1974); returns its size."""
    kept = 0
    for i in range(count):
        # Number by number: numba takes seconds to compile the copying of rows.
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
def _middle_of_overlap(x0, y0, psi0, x1, y1, psi1, half_length0, half_width0, half_length1, half_width1):  # type: ignore[no-untyped-def]
    """Centroid of the area two rectangles share, relative to (x0, y0); half way between their centres if none."""
    polygon = np.empty((8, 2))
    other = np.empty((8, 2))
    s, c = sine_cosine(psi1)
    for i in range(4):
        u = half_length1 if i in (0, 3) else -half_length1
        v = half_width1 if i < 2 else -half_width1
        polygon[i, 0] = x1 - x0 + u * c - v * s
        polygon[i, 1] = y1 - y0 + u * s + v * c
    s, c = sine_cosine(psi0)
    count = polygon.shape[0] // 2  # of the corners
    count = _clip(polygon, count, c, s, half_length0, other)
    count = _clip(other, count, -c, -s, half_length0, polygon)
    count = _clip(polygon, count, -s, c, half_width0, other)
    count = _clip(other, count, s, -c, half_width0, polygon)
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
        return 0.5 * (x1 - x0), 0.5 * (y1 - y0)
    return polygon[0, 0] + mx / area, polygon[0, 1] + my / area


@inner_kernel
def _axis(dx, dy, psi, reach):  # type: ignore[no-untyped-def]
    """The axis of direction psi, turned to point along (dx, dy), and how deep shapes of this reach overlap on it."""
    ay, ax = sine_cosine(psi)
    apart = dx * ax + dy * ay
    if apart < 0.0:
        return -ax, -ay, reach + apart
    return ax, ay, reach - apart


@compiled
def contact_fault(state0, state1, half_length0, half_width0, half_length1, half_width1):  # type: ignore[no-untyped-def]
    """Decide which car is at fault for a contact of two cars.

    The contact direction is the axis of least penetration of the two rectangles, from the first car to the second. Each
    car's share is the speed with which its own body moves into the other one: the velocity of its material point in the
    middle of the overlap, along that direction, nothing if it moves away. The car with the larger share is at fault;
    both are when the shares lie within ``EQUAL_SHARES`` or ``EQUAL_SPEEDS`` of each other. So the follower is at fault
    for a rear-end contact, however hard the leader braked, and of two parallel cars the one that moved over.

    Parameters
    ----------
    state0, state1 : ndarray, shape (7,)
        States x, y, delta, v, psi, psi_dot, beta of the two cars (m, rad, m/s, rad/s).
    half_length0, half_width0, half_length1, half_width1 : float
        Half the sides of their rectangles, m.

    Returns
    -------
    fault0, fault1 : bool
        At least one is true.
    """
    x0, y0, v0, psi0, rate0, beta0 = state0[0], state0[1], state0[3], state0[4], state0[5], state0[6]
    x1, y1, v1, psi1, rate1, beta1 = state1[0], state1[1], state1[3], state1[4], state1[5], state1[6]
    dx = x1 - x0
    dy = y1 - y0
    s, c = sine_cosine(psi1 - psi0)
    s, c = abs(s), abs(c)
    axes = np.empty((4, 3))  # unit vector from the first car towards the second, penetration along it
    reaches = (
        half_length0 + half_length1 * c + half_width1 * s,
        half_width0 + half_length1 * s + half_width1 * c,
        half_length1 + half_length0 * c + half_width0 * s,
        half_width1 + half_length0 * s + half_width0 * c,
    )
    least = np.inf
    for i in range(4):
        psi = (psi0 if i < 2 else psi1) + 0.5 * np.pi * (i % 2)
        axes[i, 0], axes[i, 1], axes[i, 2] = _axis(dx, dy, psi, reaches[i])
        least = min(least, axes[i, 2])
    nx = 0.0
    ny = 0.0
    for i in range(4):
        if axes[i, 2] <= least + _SAME_AXIS:
            nx += axes[i, 0]
            ny += axes[i, 1]
    norm = np.sqrt(nx * nx + ny * ny)
    nx /= norm
    ny /= norm
    mx, my = _middle_of_overlap(x0, y0, psi0, x1, y1, psi1, half_length0, half_width0, half_length1, half_width1)
    s0, c0 = sine_cosine(psi0 + beta0)
    s1, c1 = sine_cosine(psi1 + beta1)
    share0 = (v0 * c0 - rate0 * my) * nx + (v0 * s0 + rate0 * mx) * ny
    share1 = (v1 * c1 - rate1 * (my - dy)) * nx + (v1 * s1 + rate1 * (mx - dx)) * ny
    share0 = max(share0, 0.0)
    share1 = max(-share1, 0.0)
    margin = max(EQUAL_SHARES * max(share0, share1), EQUAL_SPEEDS)
    return not share1 - share0 > margin, not share0 - share1 > margin
