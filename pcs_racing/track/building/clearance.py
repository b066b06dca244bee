"""Room between the walls of a grid: exact distances and bounds of a line's moves.

Row 0 of a grid is its bottom.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.compilation import compiled
from pcs_racing.base.errors import MapError, check_array, check_number
from pcs_racing.track.frenet import interpolate

CLEARANCE = 0.305
"""Min distance of a race line from the walls, m: half a car's width (0.155) and 0.15 m of air."""


def checked_grid(
    occupied: ArrayLike, resolution: float, origin: ArrayLike, label: str = "the map"
) -> tuple[NDArray[np.bool_], float, NDArray[np.float64]]:
    """Return occupancy grid, cell size and origin, with checked types, shapes and values."""
    grid = np.ascontiguousarray(occupied)
    if grid.ndim != 2 or grid.dtype != np.bool_ or min(grid.shape) < 8:
        raise MapError(
            f"{label}: the grid is {grid.dtype} of shape {grid.shape}; it must be a boolean array"
            " of at least 8 x 8"
        )
    check_number(f"{label}: resolution", resolution, maximum=1.0, above=0.0, error=MapError)
    corner = check_array(
        f"{label}: origin", origin, (2,), minimum=-1e6, maximum=1e6, error=MapError
    )
    return grid, float(resolution), corner


@compiled
def wall_clearance(points, occupied, resolution, origin, reach):
    """Return the exact distance in m from points (N, 2) to the square of the nearest wall cell.

    It is 0 in a wall, and at most ``reach`` (m); everything outside the grid is wall.
    """
    rows, cols = occupied.shape
    out = np.empty(points.shape[0])
    rings = int(np.ceil(reach / resolution)) + 1
    for n in range(points.shape[0]):
        x = (points[n, 0] - origin[0]) / resolution
        y = (points[n, 1] - origin[1]) / resolution
        col = int(np.floor(x))
        row = int(np.floor(y))
        best = (reach / resolution) ** 2
        for ring in range(rings + 1):
            # Cells of this ring are at least ring - 1 cells away.
            if ring >= 1 and (ring - 1) ** 2 >= best:
                break
            for i in range(row - ring, row + ring + 1):
                on_edge = i == row - ring or i == row + ring
                stride = 1 if on_edge or ring == 0 else 2 * ring
                for j in range(col - ring, col + ring + 1, stride):
                    if 0 <= i < rows and 0 <= j < cols and not occupied[i, j]:
                        continue
                    dx = max(j - x, 0.0, x - j - 1.0)
                    dy = max(i - y, 0.0, y - i - 1.0)
                    best = min(best, dx * dx + dy * dy)
        out[n] = np.sqrt(best) * resolution
    return out


@compiled
def room_at(line, room, resolution, corner):
    """Return the bilinear value of a distance field at points (N, 2); 0 outside it."""
    out = np.empty(line.shape[0])
    for k in range(line.shape[0]):
        u = (line[k, 0] - corner[0]) / resolution - 0.5
        v = (line[k, 1] - corner[1]) / resolution - 0.5
        out[k] = interpolate(room, u, v)
    return out


@compiled
def corridor(line, normal, room, resolution, corner, need, reach):
    """Return bounds of moves along normals at a min distance ``need`` (m) from the walls.

    A point without room must move to the nearest place with room, on this side of the next wall.

    Parameters
    ----------
    line, normal : ndarray, shape (N, 2)
        Points in m, and unit vectors to the left.
    room : ndarray, shape (H, W)
        Distance to the nearest wall at the centre of each cell, m.
    reach : float
        Max distance of the search, m.

    Returns
    -------
    low, high : ndarray, shape (N,)
        Bounds of the move to the left in m (negative: to the right); 1 and -1 without room.
    """
    n = line.shape[0]
    low = np.empty(n)
    high = np.empty(n)
    step = 0.01
    for k in range(n):
        u = (line[k, 0] - corner[0]) / resolution - 0.5
        v = (line[k, 1] - corner[1]) / resolution - 0.5
        du = normal[k, 0] / resolution
        dv = normal[k, 1] / resolution
        base = 0.0
        enough = interpolate(room, u, v) >= need
        free = [True, True]  # to the left, to the right
        m = 0
        # Alternate steps to both sides find the nearer place with room; a side ends at a wall.
        while not enough and m * step < reach and (free[0] or free[1]):
            m += 1
            for side in range(2):
                if free[side] and not enough:
                    move = m * step if side == 0 else -m * step
                    r = interpolate(room, u + move * du, v + move * dv)
                    free[side], enough = r > 0.0, r >= need
                    base = move if enough else 0.0
        if not enough:
            low[k] = 1.0
            high[k] = -1.0
            continue
        for sign in (1.0, -1.0):
            a = 0.0
            r = interpolate(room, u + base * du, v + base * dv)
            while a < reach:
                # No wall is nearer than r, so room can't run out within r - need.
                ahead = max(step, 0.9 * (r - need))
                x = base + sign * (a + ahead)
                r = interpolate(room, u + x * du, v + x * dv)
                if r < need:
                    break
                a += ahead
            if sign > 0.0:
                high[k] = base + a
            else:
                low[k] = base - a
    return low, high
