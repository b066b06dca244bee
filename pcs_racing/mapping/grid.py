"""Distances and regions on an occupancy grid; row 0 of every grid is its bottom row."""

import numpy as np
from numba import njit

from pcs_racing.errors import MapError

__all__ = ["cell_of", "checked_grid", "distance_field", "free_region", "wall_clearance"]


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


def cell_of(point: np.ndarray, resolution: float, origin: np.ndarray) -> tuple[int, int]:
    """Row and column of the cell that holds a point (which may lie outside the grid)."""
    col, row = np.floor((np.asarray(point, dtype=np.float64) - origin) / resolution).astype(int)
    return int(row), int(col)


def distance_field(occupied: np.ndarray, resolution: float) -> np.ndarray:
    """Distance in m from the centre of each cell to the centre of the nearest wall cell.

    Exact Euclidean transform in linear time, after Felzenszwalb and Huttenlocher (2012), "Distance transforms of
    sampled functions". Without any wall cell every distance is infinite.

    Parameters
    ----------
    occupied : ndarray, shape (H, W), bool
    resolution : float
        Side of a cell in m.

    Returns
    -------
    ndarray, shape (H, W), float32
    """
    return np.sqrt(_squared_distance(np.ascontiguousarray(occupied))) * np.float32(resolution)


@njit(cache=True, nogil=True)
def _squared_distance(occupied):  # type: ignore[no-untyped-def]
    rows, cols = occupied.shape
    out = np.empty((rows, cols), np.float32)
    # Along the rows: cells to the nearest wall to the left or to the right.
    for i in range(rows):
        run = np.float32(np.inf)
        for j in range(cols):
            run = np.float32(0.0) if occupied[i, j] else run + np.float32(1.0)
            out[i, j] = run
        run = np.float32(np.inf)
        for j in range(cols - 1, -1, -1):
            run = np.float32(0.0) if occupied[i, j] else run + np.float32(1.0)
            out[i, j] = min(out[i, j], run) ** 2
    # Along the columns: lower envelope of the parabolas that stand on those values.
    apex = np.empty(rows, np.int64)
    edge = np.empty(rows + 1, np.float64)
    height = np.empty(rows, np.float64)
    for j in range(cols):
        k = -1
        for i in range(rows):
            f = float(out[i, j])
            if f == np.inf:
                continue
            cut = -np.inf
            while k >= 0:
                q = apex[k]
                cut = (f - height[k] + i * i - q * q) / (2.0 * (i - q))
                if cut > edge[k]:
                    break
                k -= 1
            k += 1
            apex[k] = i
            height[k] = f
            edge[k] = cut if k > 0 else -np.inf
        if k < 0:
            continue
        edge[k + 1] = np.inf
        k = 0
        for i in range(rows):
            while edge[k + 1] < i:
                k += 1
            out[i, j] = np.float32((i - apex[k]) ** 2 + height[k])
    return out


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


@njit(cache=True, nogil=True)
def free_region(occupied, row, col):  # type: ignore[no-untyped-def]
    """Free cells that can be reached from a free cell by steps to the four neighbours.

    Parameters
    ----------
    occupied : ndarray, shape (H, W), bool
    row, col : int
        The cell to start from, inside the grid.

    Returns
    -------
    ndarray, shape (H, W), bool
        All False if the first cell is a wall.
    """
    rows, cols = occupied.shape
    region = np.zeros((rows, cols), np.bool_)
    if occupied[row, col]:
        return region
    stack = np.empty(rows * cols, np.int64)
    stack[0] = row * cols + col
    region[row, col] = True
    top = 1
    while top > 0:
        top -= 1
        i = stack[top] // cols
        j = stack[top] % cols
        for k in range(4):
            a = i + (k == 0) - (k == 1)
            b = j + (k == 2) - (k == 3)
            if 0 <= a < rows and 0 <= b < cols and not occupied[a, b] and not region[a, b]:
                region[a, b] = True
                stack[top] = a * cols + b
                top += 1
    return region
