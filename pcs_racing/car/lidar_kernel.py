"""One lidar scan in compiled code, without ray marching.

The wall segments visible from the car's stretch of track are projected into polar coordinates and
drawn into a depth buffer of beams; the nearest segment wins. Along a segment the inverse range is
linear in the cosine and sine of the beam's angle, so drawing needs a product and a maximum per
beam. The walls are polylines within about half a cell of the grid. At the edge of a near object,
this half cell may put a beam on the wrong side of the edge. The beams next to such a jump, and
beams without a listed segment, are settled by following them through the cells of the grid.
"""

from typing import NamedTuple

import numpy as np
from annotated_types import Interval
from numpy.typing import NDArray

from pcs_racing.base.compilation import inner_kernel, kernel
from pcs_racing.base.elementary import sine_cosine
from pcs_racing.car.collision import Rectangle, inside_wall
from pcs_racing.track.frenet import wrap_s
from pcs_racing.track.grid import cast
from pcs_racing.track.moving import HALF_LENGTH, HALF_WIDTH, pose_at

# Neighbouring beams lie on two sides of an edge if their ranges differ by this much, in m and as a
# share of the nearer range.
JUMP = 1.0
JUMP_SHARE = 0.2

RUN = 64  # beams searched for jumps at once

# Maximum difference of grid and buffer, in m, that ends the search next to an edge.
AGREEMENT = 0.5

# Extension of segments at both ends, in rad, that closes the gaps between them: more than the error
# of `_angle`.
_OVERLAP = 1e-7

# Corners of a rectangle in both directions, NaN between them, and more NaN to fill the vectors.
_RECTANGLE = 16

# Shape of the working memory of `scan_into`: longer lists of segments are drawn in parts.
WORK_SHAPE = (4, 512)


MAX_BEAMS = 100_000

FIELD_OF_VIEW, MAX_RANGE = Interval(ge=1e-6, le=2.0 * np.pi), Interval(ge=1e-3, le=1e6)
"""Limits of the options of a lidar."""


class Beams(NamedTuple):
    """Beams of a lidar, in the form for compiled kernels."""

    first: float  #: Angle of the first beam relative to the car's heading, counter-clockwise, rad.
    step: float  #: Angle from each beam to the next, rad.
    max_range: float  #: Maximum reported range, m.
    cos: NDArray[np.float64]  #: shape (beams,): Cosines of the beams' angles.
    sin: NDArray[np.float64]  #: shape (beams,): Sines of the beams' angles.


class Pose(NamedTuple):
    """Pose of a lidar."""

    x: float  #: m.
    y: float  #: m.
    psi: float  #: Heading, rad.


class Frame(NamedTuple):
    """Frame of a lidar."""

    x: float  #: m.
    y: float  #: m.
    cos: float  #: Cosine of the heading.
    sin: float  #: Sine of the heading.


@inner_kernel(forceinline=True)
def _angle(x, y):
    """Return the direction of (x, y) in rad to 2e-8 (Abramowitz and Stegun 1964, 4.4.49).

    There is no branch, for vectorisation.
    """
    ax = abs(x)
    ay = abs(y)
    r = min(ax, ay) / max(ax, ay)
    q = r * r
    a = 0.0429096138 + q * (-0.0161657367 + q * 0.0028662257)
    a = -0.1420889944 + q * (0.1065626393 + q * (-0.0752896400 + q * a))
    a = r * (1.0 + q * (-0.3333314528 + q * (0.1999355085 + q * a)))
    a = 0.5 * np.pi - a if ay > ax else a
    a = np.pi - a if x < 0.0 else a
    return -a if y < 0.0 else a


@inner_kernel(forceinline=True)
def _faces_lidar(ax, ay, bx, by):
    """Return whether a segment has the lidar on its left and spans more than 3e-7 rad.

    This angle is well above the error of `_angle`.
    """
    across = ax * by - ay * bx
    # Both terms are computed: half of all segments face away, unpredictably.
    return (across > 0.0) & (across * across > 1e-13 * (ax * ax + ay * ay) * (bx * bx + by * by))


@inner_kernel
def _find_angles(beams, frame, px, py, angles):
    """Write the angle of each corner, counted counter-clockwise from the first beam, rad in [0, 2
    pi].

    Vectorisable, like `_choose`: no branch, no lookup.
    """
    x, y, cos, sin = frame
    zero = beams.first
    for k in range(np.uint64(px.shape[0])):
        ax = px[k] - x
        ay = py[k] - y
        angle = _angle(ax * cos + ay * sin, ay * cos - ax * sin) - zero
        angles[k] = angle + 2.0 * np.pi if angle < 0.0 else angle


@inner_kernel(forceinline=True)
def _span(beams, begin, end):
    """Return the span of a segment between two angles, in beams from the first beam.

    The begin is below 0 if the segment crosses the first direction.
    """
    per_step = 1.0 / beams.step
    margin = _OVERLAP * per_step
    begin = begin - 2.0 * np.pi if begin > end else begin
    return begin * per_step - margin, end * per_step + margin


@inner_kernel
def _choose(beams, frame, px, py, angles, last, chosen):
    """Mark, by its first corner, each segment that faces the lidar and is met by a beam.

    Half of all segments face away or fall between two beams, unpredictably. A pair of corners with
    a NaN is no segment.
    """
    x, y, _, _ = frame
    for k in range(np.uint64(chosen.shape[0])):
        after = k + np.uint64(1)
        faces = _faces_lidar(px[k] - x, py[k] - y, px[after] - x, py[after] - y)
        begin, end = _span(beams, angles[k], angles[after])
        met = min(np.floor(end), last) >= max(np.ceil(begin), 0.0)
        chosen[k] = 1.0 if faces & (met | (begin < 0.0)) else 0.0


@inner_kernel
def _fill(cos, sin, p, q, first, last, out):
    """Draw an inverse range into a run of beams; the larger wins."""
    # Unsigned: a possibly negative index (counted from the end, in Python) prevents vectorisation.
    for k in range(np.uint64(first), np.uint64(last + 1)):
        before = out[k]
        inverse = p * cos[k] + q * sin[k]
        out[k] = inverse if inverse > before else before


@inner_kernel
def _draw(beams, frame, px, py, work, out):
    """Draw the segments between successive corners into a buffer of inverse ranges.

    A beam in the direction (c, s) of the car's frame meets a segment at the inverse range ``p c + q
    s``.
    """
    x, y, cos, sin = frame
    count = px.shape[0] - 1
    last = out.shape[0] - 1.0
    turn = 2.0 * np.pi / beams.step
    angles, chosen = work[0], work[1]
    _find_angles(beams, frame, px, py, angles[: count + 1])
    _choose(beams, frame, px, py, angles, last, chosen[:count])
    # Move the chosen segments to the front without a branch: write every index, but advance the
    # position only for chosen segments.
    kept = 0
    for k in range(np.uint64(count)):
        is_chosen = chosen[k] > 0.0
        chosen[np.uint64(kept)] = k
        kept += is_chosen
    for i in range(np.uint64(kept)):
        first = np.uint64(chosen[i])
        after = first + np.uint64(1)
        ax = px[first] - x
        ay = py[first] - y
        bx = px[after] - x
        by = py[after] - y
        ux = ax * cos + ay * sin
        uy = ay * cos - ax * sin
        vx = bx * cos + by * sin
        vy = by * cos - bx * sin
        scale = 1.0 / (ux * vy - uy * vx)
        p = (vy - uy) * scale
        q = (ux - vx) * scale
        begin, end = _span(beams, angles[first], angles[after])
        # A segment across the first direction is drawn at both ends of the scan.
        if begin < 0.0:
            around = min(max(np.ceil(begin + turn), 0.0), last + 1.0)
            _fill(beams.cos, beams.sin, p, q, int(around), int(last), out)
        begin = min(max(np.ceil(begin), 0.0), last + 1.0)
        _fill(beams.cos, beams.sin, p, q, int(begin), int(min(np.floor(end), last)), out)


@inner_kernel
def _draw_list(corners, beams, frame, first, end, work, out):
    """Draw a list of corners, in parts that fit into the working memory."""
    for begin in range(first, end - 1, work.shape[1] - 1):
        stop = min(begin + work.shape[1], end)
        _draw(beams, frame, corners[0, begin:stop], corners[1, begin:stop], work, out)


@inner_kernel
def _draw_walls(track, beams, frame, s, work, out):
    """Draw the walls and obstacles visible from arc length s into a buffer of inverse ranges."""
    corners, start = track.corners, track.corners_start
    lists = track.seen_middle.shape[0]
    stretch = int(wrap_s(track, s) / track.seen_stretch) % lists
    _draw_list(corners, beams, frame, start[stretch], start[stretch + 1], work, out)
    _draw_list(corners, beams, frame, start[lists], corners.shape[1], work, out)


@inner_kernel
def draw_rectangle(beams, body, cos, sin, work, out):
    """Draw a rectangle, centred from the lidar, into a buffer of inverse ranges.

    ``cos`` and ``sin`` belong to the lidar's heading.
    """
    s, c = sine_cosine(body.psi)
    px, py = work[2, :_RECTANGLE], work[3, :_RECTANGLE]
    px[:] = np.nan
    for k in range(5):
        u = body.half_length if k % 4 in (0, 3) else -body.half_length
        v = body.half_width if k % 4 in (0, 1) else -body.half_width
        # In both directions: near sides run clockwise around a lidar outside, all sides run
        # counter-clockwise around a lidar inside.
        for at in (k, 10 - k):
            px[at] = body.x + u * c - v * s
            py[at] = body.y + u * s + v * c
    _draw(beams, Frame(0.0, 0.0, cos, sin), px, py, work, out)


@inner_kernel
def _draw_circle(beams, x, y, radius, cos, sin, work, out):
    """Draw a circle around (x, y) from the lidar, as a polygon, into a buffer."""
    px, py = work[2, :_RECTANGLE], work[3, :_RECTANGLE]
    for k in range(_RECTANGLE):  # clockwise
        s, c = sine_cosine(-2.0 * np.pi * k / (_RECTANGLE - 1))
        px[k] = x + radius * c
        py[k] = y + radius * s
    _draw(beams, Frame(0.0, 0.0, cos, sin), px, py, work, out)


@inner_kernel
def _follow(track, beams, frame, k, reach):
    """Follow beam k through the cells of the grid; return its range in m, at most ``reach``."""
    x, y, cos, sin = frame
    c = cos * beams.cos[k] - sin * beams.sin[k]
    s = sin * beams.cos[k] + cos * beams.sin[k]
    u = (x - track.origin_x) / track.cell
    v = (y - track.origin_y) / track.cell
    cells = cast(track.distance, u, v, c, s, reach / track.cell)[0]
    return min(cells * track.cell, reach) if cells < reach / track.cell else reach


@inner_kernel(forceinline=True)
def _stands_out(out, k):
    """Return whether the jump behind beam k is more than a slope.

    Along a wall at a grazing angle, ranges grow steadily.
    """
    before = abs(out[k] - out[max(k - 1, 0)])
    after = abs(out[min(k + 2, out.shape[0] - 1)] - out[k + 1])
    return abs(out[k + 1] - out[k]) > 2.0 * max(before, after)


@inner_kernel(forceinline=True)
def _jumps(out, k):
    """Return whether there is a jump behind beam k."""
    before = np.uint64(k)  # as in `_fill`
    after = before + np.uint64(1)
    far = min(out[before], out[after])
    near = max(out[before], out[after])
    return near - far > max(JUMP * near, JUMP_SHARE) * far


@inner_kernel
def _smooth(out, first, last):
    """Return whether a run of beams has no jump; vectorisable."""
    jumps = 0
    for k in range(np.uint64(first), np.uint64(last)):
        jumps += _jumps(out, k)
    return jumps == 0


@inner_kernel
def _settle_jump(track, beams, frame, k, out):
    """Follow the beams on both sides of the jump behind beam k; return the last settled beam.

    A beam that passes the nearer object agrees: its range beyond that object was not in doubt.
    """
    last = out.shape[0] - 1
    passed = min(1.0 / max(out[k], out[k + 1]) + JUMP, beams.max_range)
    j = k
    for step in (-1, 1):
        j = k if step < 0 else k + 1
        while 0 <= j <= last:
            drawn = 1.0 / out[j]
            true = _follow(track, beams, frame, j, passed)
            if true >= passed:
                if drawn >= passed:
                    break
                true = _follow(track, beams, frame, j, beams.max_range)
            out[j] = 1.0 / true
            if abs(true - drawn) <= AGREEMENT:
                break
            j += step
    return max(k, j - 1)


@inner_kernel
def _settle_edges(track, beams, frame, out):
    """Follow the beams on both sides of every jump, outwards from it, until the grid agrees with
    the buffer.
    """
    last = out.shape[0] - 1
    k = 0
    while k < last:
        stop = min(k + RUN, last)
        if _smooth(out, k, stop):
            k = stop
        while k < stop:
            if _jumps(out, k) and _stands_out(out, k):
                k = _settle_jump(track, beams, frame, k, out)
            k += 1


@kernel
def scan_walls(track, beams, pose, s, work, out):
    """Begin a scan: write the inverse ranges of the walls, 1/m; return False for a lidar in a wall.

    `scan_car` adds cars; inverting the buffer then gives the ranges. In a wall all ranges are 0
    already.
    """
    if inside_wall(track, pose.x, pose.y):
        out[:] = 0.0
        return False
    # The buffer holds inverse ranges until the end; 0 marks a beam without a segment.
    out[:] = 0.0
    sin, cos = sine_cosine(pose.psi)
    frame = Frame(pose.x, pose.y, cos, sin)
    _draw_walls(track, beams, frame, s, work, out)
    empty = 0
    for k in range(out.shape[0]):
        empty += out[k] <= 0.0
    if empty > 0:
        for k in range(out.shape[0]):
            if out[k] <= 0.0:
                out[k] = 1.0 / _follow(track, beams, frame, k, beams.max_range)
    # Before the edges: a jump to a range beyond the maximum does not count.
    least = 1.0 / beams.max_range
    for k in range(out.shape[0]):
        out[k] = out[k] if out[k] > least else least
    _settle_edges(track, beams, frame, out)
    return True


@kernel
def scan_car(beams, pose, body, work, out):
    """Add a car's rectangle to the inverse ranges of a scan."""
    # Cars come last: their edges are exact and need not be settled on the grid.
    dx, dy = body.x - pose.x, body.y - pose.y
    reach = beams.max_range + body.half_length + body.half_width
    if dx * dx + dy * dy < reach * reach:
        sin, cos = sine_cosine(pose.psi)
        seen = Rectangle(dx, dy, body.psi, body.half_length, body.half_width)
        draw_rectangle(beams, seen, cos, sin, work, out)


@kernel
def scan_moving(track, beams, pose, time, work, out):
    """Add the moving obstacles at a time (s) to the inverse ranges of a scan."""
    moving = track.moving
    for k in range(moving.shape[0]):
        ox, oy, opsi = pose_at(moving, track.line, track.ds, track.length, k, time)
        half_length, half_width = moving[k, HALF_LENGTH], moving[k, HALF_WIDTH]
        if half_width > 0.0:
            scan_car(beams, pose, Rectangle(ox, oy, opsi, half_length, half_width), work, out)
        else:
            sin, cos = sine_cosine(pose.psi)
            _draw_circle(beams, ox - pose.x, oy - pose.y, half_length, cos, sin, work, out)


@kernel
def scan_into(track, beams, pose, s, has_opponent, opponent, work, out):
    """Write one scan without allocation into ``out``, shape (beams,): ranges in [0, max_range], m.

    A lidar inside a wall or off the map reads 0 everywhere. The working memory, one for each
    thread, may have any shape (4, n) with n >= 16, such as ``np.empty(WORK_SHAPE)``. The lidar is
    at arc length ``s`` (m); the opponent is a rectangle.
    """
    if scan_walls(track, beams, pose, s, work, out):
        if has_opponent:
            scan_car(beams, pose, opponent, work, out)
        for k in range(out.shape[0]):
            out[k] = 1.0 / out[k]
