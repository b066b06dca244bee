"""Moving obstacles: their lanes along the race line, and their poses as a function of the time."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.compilation import compiled, inner_kernel
from pcs_racing.base.elementary import arctangent2, sine_cosine, sines_cosines
from pcs_racing.track.frenet import KAPPA, LEFT, RIGHT, TrackArrays, offset

BOX = ("x", "y", "heading", "length", "width")
"""Numbers of an obstacle: centre in m, direction of its length in rad, and sides in m.

A width of 0 means a circle: the length is its diameter.
"""

MOTION = ("speed", "sway")
"""Further numbers of a moving obstacle: speed along the race line in m/s, and amplitude of its
motion across the line in m.

It sways once in 4 s, first to the left, or to the right with a negative number.
"""

# Columns of ``TrackArrays.moving``: arc length at time 0 (m), speed along the race line (m/s),
# heading relative to the line (rad), half length and half width (m; 0 for a circle, whose radius is
# the half length). Then, at each sample of the line, the offsets from the line (m) of the two
# lanes; the obstacle sways between them.
PLACE, ALONG, TURN, HALF_LENGTH, HALF_WIDTH = range(5)
LANES = 5

SWAY_PERIOD = 4.0  # s: time of a sway to the left, to the right and back
WALL_CELLS = 2.0  # cells between an obstacle's half diagonal and a wall
EASE = 1.5  # m: half of the stretch over which a lane is smoothed


def make_lanes(track: TrackArrays, d: float, sway: float, reach: float) -> NDArray[Any]:
    """Return two smooth lanes at ``d - sway`` and ``d + sway``, shape (2, N), m.

    Where a wall is nearer across the line than ``reach`` (m) and two cells, a lane keeps this
    distance from it; where both are, it leads through the middle.
    """
    line, reach = track.line, reach + WALL_CELLS * track.cell
    around = min(max(round(EASE / track.ds), 1), len(line) // 2)
    low = _windows(reach - line[:, RIGHT], around).max(axis=1)
    high = _windows(line[:, LEFT] - reach, around).min(axis=1)
    middle = 0.5 * (low + high)
    low, high = np.minimum(low, middle), np.maximum(high, middle)
    lanes = [np.clip(side, low, high) for side in (d - sway, d + sway)]
    return np.array([_windows(lane, around).mean(axis=1) for lane in lanes])


def _windows(values: NDArray[Any], around: int) -> NDArray[Any]:
    """Return each value of a closed line with its neighbours, shape (N, 2 around + 1)."""
    closed = np.concatenate([values[-around:], values, values[:around]])
    return np.lib.stride_tricks.sliding_window_view(closed, 2 * around + 1)


@inner_kernel
def lane_at(moving, ds, length, count, k, time):
    """Return arc length and offset of obstacle ``k`` (m), and the rate of the offset (m/s).

    ``count`` is the number of samples of the race line.
    """
    s = moving[k, PLACE] + moving[k, ALONG] * time
    s -= np.floor(s / length) * length
    i = min(int(s / ds), count - 1)
    j = i + 1 if i + 1 < count else 0
    u = s / ds - i
    right, left = LANES, LANES + count
    near = 0.5 * (moving[k, left + i] + moving[k, right + i])
    far = 0.5 * (moving[k, left + j] + moving[k, right + j])
    half_near = moving[k, left + i] - near
    half_far = moving[k, left + j] - far
    rate = 2.0 * np.pi / SWAY_PERIOD
    sine, cosine = sine_cosine(rate * time)
    half = half_near + u * (half_far - half_near)
    slope = (far - near + sine * (half_far - half_near)) / ds
    d = near + u * (far - near) + sine * half
    return s, d, cosine * half * rate + moving[k, ALONG] * slope


@inner_kernel
def pose_at(moving, line, ds, length, k, time):
    """Return the pose of obstacle ``k`` at a time (s): x and y (m), heading (rad)."""
    s, d, _ = lane_at(moving, ds, length, line.shape[0], k, time)
    x, y, along = offset(line, ds, length, s, d)
    return x, y, along + moving[k, TURN]


@inner_kernel
def velocity_at(moving, line, ds, length, k, time):
    """Return the course (rad) and the speed (m/s) of obstacle ``k`` at a time (s)."""
    s, d, across = lane_at(moving, ds, length, line.shape[0], k, time)
    i = min(int(s / ds), line.shape[0] - 1)
    ahead = moving[k, ALONG] * (1.0 - line[i, KAPPA] * d)
    _, _, along = offset(line, ds, length, s, d)
    return along + arctangent2(across, ahead), np.sqrt(ahead * ahead + across * across)


@compiled
def _poses(track, time, out):
    for k in range(out.shape[0]):
        pose = pose_at(track.moving, track.line, track.ds, track.length, k, time)
        out[k, 0], out[k, 1], out[k, 2] = pose


def moving_poses(track: TrackArrays, time: float) -> NDArray[np.float64]:
    """Return x and y (m) and heading (rad) of the moving obstacles at a time (s), shape (K, 3)."""
    out = np.empty((len(track.moving), 3))
    if len(out):
        _poses(track, time, out)
    return out


def moving_outlines(track: TrackArrays, time: float) -> list[NDArray[np.float64]]:
    """Return the corners of each moving obstacle at a time (s), shape (n, 2), m."""
    outlines = []
    for pose, row in zip(moving_poses(track, time), track.moving, strict=True):
        half_length, half_width = row[HALF_LENGTH], row[HALF_WIDTH]
        if half_width > 0.0:
            corners = np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])
            corners *= (half_length, half_width)
        else:
            sine, cosine = sines_cosines(np.linspace(0.0, 2.0 * np.pi, 16, endpoint=False))
            corners = half_length * np.column_stack([cosine, sine])
        (s,), (c,) = sines_cosines(pose[2:])
        outlines.append(pose[:2] + corners @ np.array([[c, s], [-s, c]]))
    return outlines
