"""Checking a grid, and the exact distance of points from its walls; row 0 of every grid is its bottom row."""

import numpy as np
from numba import njit

from pcs_racing.errors import MapError

__all__ = ["checked_grid", "wall_clearance"]


def checked_grid(
    occupied: np.ndarray, resolution: float, origin: np.ndarray | tuple[float, float]
) -> tuple[np.ndarray, float, np.ndarray]:
    """Occupancy grid, cell size and origin as arrays of the right kind, or one clear error.

    Parameters
    ----------
    occupied : array_like, shape (H, W), bool
        True where a wall is; row 0 is the bottom of the picture.
    resolution : float
        Side of a cell in m.
    origin : array_like, shape (2,) or longer
        Lower left corner of cell [0, 0] in m; further elements (the yaw of ROS maps) are ignored.

    Raises
    ------
    MapError
        If the grid isn't a two-dimensional boolean array, or the resolution or the origin is impossible.
    """
    grid = np.ascontiguousarray(occupied)
    if grid.ndim != 2 or grid.dtype != np.bool_ or min(grid.shape) < 3:
        raise MapError(f"the grid is a {grid.dtype} array of shape {grid.shape}: a boolean (H, W) array is needed")
    if not (np.isfinite(resolution) and resolution > 0.0):
        raise MapError(f"resolution is {resolution!r}: it must be a positive number of metres per cell")
    corner = np.asarray(origin, dtype=np.float64)[:2]
    if corner.shape != (2,) or not np.isfinite(corner).all():
        raise MapError(f"origin is {origin!r}: it must begin with two finite coordinates in metres")
    return grid, float(resolution), corner


@njit(cache=True, nogil=True)
def wall_clearance(points, occupied, resolution, origin, reach):  # type: ignore[no-untyped-def]
    """Exact distance from points to the nearest wall cell, taken as the full square that it covers.

    Parameters
    ----------
    points : ndarray, shape (N, 2), float64
        In m.
    occupied : ndarray, shape (H, W), bool
    resolution : float
        Side of a cell in m.
    origin : ndarray, shape (2,), float64
        Lower left corner of cell [0, 0] in m.
    reach : float
        Distances beyond this one are not told apart, m.

    Returns
    -------
    ndarray, shape (N,), float64
        In m, at most ``reach``; 0 in a wall. Everything outside the grid is wall.
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
