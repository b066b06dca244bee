"""A track as compiled code sees it, and the Frenet conversions on its race line.

Frenet coordinates are (s, d): arc length along the closed race line in metres, and signed distance from it, positive to
the left. Between two samples the line is taken as the circle that its sampled heading and curvature describe.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

__all__ = [
    "COS",
    "KAPPA",
    "LEFT",
    "LINE_COLUMNS",
    "PSI",
    "RIGHT",
    "SIN",
    "SPEED",
    "TrackArrays",
    "X",
    "Y",
    "angle_between",
    "locate",
    "project",
    "to_cartesian",
    "wall_distance",
    "wrap_s",
]

# Columns of ``TrackArrays.line``.
X, Y, COS, SIN, PSI, KAPPA, SPEED, RIGHT, LEFT = range(9)
LINE_COLUMNS = ("x", "y", "cos", "sin", "psi", "kappa", "speed", "right", "left")


class TrackArrays(NamedTuple):
    """Everything a compiled kernel needs of a track; plain arrays, never written to.

    Attributes
    ----------
    length : float
        Length of the closed race line in m.
    ds : float
        Spacing of its samples in m (``length / len(line)``).
    line : ndarray, shape (N, 9), float64
        Samples of the race line at ``s = i * ds``: x, y (m), cos and sin of the heading, the heading psi (rad, continuous
        along the line), curvature kappa (1/m, positive to the left), speed (m/s, at speed scale 1), and the free width to
        the right and to the left wall (m, both positive). The last sample lies one ``ds`` before the first.
    distance : ndarray, shape (H, W), float32
        Distance in m from the centre of each cell to the nearest wall, 0 in walls and off the track. Row 0 is the bottom.
    origin_x, origin_y : float
        Lower left corner of cell [0, 0] in m.
    cell : float
        Side of a cell of ``distance`` and ``nearest`` in m.
    walls : ndarray, shape (S, 4), float64
        Wall segments x0, y0, x1, y1 in m, the drivable side on their left.
    seen_start : ndarray, shape (M + 1,), int32
        Where the list of each stretch of the line begins in ``seen``.
    seen : ndarray, int32
        For each stretch of ``seen_stretch`` metres, the wall segments that can be seen from anywhere on it (across the
        whole width of the track), near ones first.
    seen_stretch : float
        Length of such a stretch in m (``length / M``).
    lookup : ndarray, shape (h, w), int32
        Index of the line sample nearest to the centre of each coarse cell.
    lookup_cell : float
        Side of a cell of ``lookup`` in m; it shares the origin of ``distance``.
    """

    length: float
    ds: float
    line: np.ndarray
    distance: np.ndarray
    origin_x: float
    origin_y: float
    cell: float
    walls: np.ndarray
    seen_start: np.ndarray
    seen: np.ndarray
    seen_stretch: float
    lookup: np.ndarray
    lookup_cell: float


@njit(cache=True, nogil=True, inline="always")
def wrap_s(track, s):  # type: ignore[no-untyped-def]
    """Bring an arc length into [0, length)."""
    s = s - np.floor(s / track.length) * track.length
    if s >= track.length:
        s -= track.length
    return s


@njit(cache=True, nogil=True, inline="always")
def angle_between(a, b):  # type: ignore[no-untyped-def]
    """Difference a - b of two angles, brought into [-pi, pi)."""
    d = a - b
    return d - 2.0 * np.pi * np.floor((d + np.pi) / (2.0 * np.pi))


@njit(cache=True, nogil=True)
def _project_at(track, x, y, i):  # type: ignore[no-untyped-def]
    """Project a point onto the circle that touches the line at sample ``i``."""
    row = track.line[i]
    dx = x - row[X]
    dy = y - row[Y]
    along = dx * row[COS] + dy * row[SIN]
    across = -dx * row[SIN] + dy * row[COS]
    kappa = row[KAPPA]
    if abs(kappa) < 1e-6:
        return i * track.ds + along, across
    # The centre of the circle is 1/kappa to the left; arc length and distance follow from the polar form.
    reach = 1.0 - kappa * across
    radius = np.hypot(kappa * along, reach)
    if reach <= 1e-9:
        return i * track.ds + along, across
    ds = np.arctan2(kappa * along, reach) / kappa
    return i * track.ds + ds, (1.0 - radius) / kappa


@njit(cache=True, nogil=True)
def project(track, x, y, hint):  # type: ignore[no-untyped-def]
    """Frenet coordinates of a point, found by walking along the line from a nearby arc length.

    O(1) while driving: the walk ends at the first sample from which both neighbours are farther away.

    Parameters
    ----------
    track : TrackArrays
    x, y : float
        The point in m.
    hint : float
        An arc length near the point, in m (any real number; it is wrapped).

    Returns
    -------
    s : float
        Arc length in [0, length), m.
    d : float
        Signed distance from the line in m, positive to the left.
    """
    n = track.line.shape[0]
    i = int(wrap_s(track, hint) / track.ds + 0.5) % n
    best = (x - track.line[i, X]) ** 2 + (y - track.line[i, Y]) ** 2
    for direction in (1, -1):
        moved = False
        for _ in range(n):
            j = (i + direction) % n
            there = (x - track.line[j, X]) ** 2 + (y - track.line[j, Y]) ** 2
            if there >= best:
                break
            best = there
            i = j
            moved = True
        if moved:
            break
    s, d = _project_at(track, x, y, i)
    return wrap_s(track, s), d


@njit(cache=True, nogil=True)
def locate(track, x, y):  # type: ignore[no-untyped-def]
    """Frenet coordinates of a point anywhere near the track, without a hint.

    A point outside the map is projected from the nearest cell of the look-up grid.
    """
    rows, cols = track.lookup.shape
    col = min(max(int(np.floor((x - track.origin_x) / track.lookup_cell)), 0), cols - 1)
    row = min(max(int(np.floor((y - track.origin_y) / track.lookup_cell)), 0), rows - 1)
    return project(track, x, y, track.lookup[row, col] * track.ds)


@njit(cache=True, nogil=True)
def to_cartesian(track, s, d):  # type: ignore[no-untyped-def]
    """Point and heading of the line's offset by ``d`` at arc length ``s``.

    Returns
    -------
    x, y : float
        The point in m.
    psi : float
        Heading of the line there, rad.
    """
    s = wrap_s(track, s)
    n = track.line.shape[0]
    i = int(s / track.ds + 0.5) % n
    row = track.line[i]
    ds = s - i * track.ds
    if ds > 0.5 * track.length:
        ds -= track.length
    kappa = row[KAPPA]
    turn = kappa * ds
    # sin(t)/t and (1 - cos t)/t by series, so that straights need no case of their own.
    chord = ds * (1.0 - turn * turn / 6.0)
    rise = 0.5 * ds * turn * (1.0 - turn * turn / 12.0)
    c = np.cos(turn)
    t = np.sin(turn)
    along = chord - d * t
    across = rise + d * c
    x = row[X] + along * row[COS] - across * row[SIN]
    y = row[Y] + along * row[SIN] + across * row[COS]
    return x, y, row[PSI] + turn


@njit(cache=True, nogil=True)
def wall_distance(track, x, y):  # type: ignore[no-untyped-def]
    """Distance in m from a point to the nearest wall, interpolated between cells; 0 outside the map."""
    rows, cols = track.distance.shape
    u = (x - track.origin_x) / track.cell - 0.5
    v = (y - track.origin_y) / track.cell - 0.5
    if not (u >= 0.0 and v >= 0.0 and u < cols - 1.0 and v < rows - 1.0):
        return 0.0
    i = int(v)
    j = int(u)
    fu = u - j
    fv = v - i
    low = track.distance[i, j] * (1.0 - fu) + track.distance[i, j + 1] * fu
    high = track.distance[i + 1, j] * (1.0 - fu) + track.distance[i + 1, j + 1] * fu
    return low * (1.0 - fv) + high * fv
