"""The centre line of the ring-shaped free region of an occupancy grid."""

import math
from collections.abc import Sequence

import numpy as np

from pcs_racing.base.elementary import arctangent2, headings, lengths, sine_cosine
from pcs_racing.base.errors import MapError, is_number, require
from pcs_racing.track.building.causes import no_loop
from pcs_racing.track.building.clearance import checked_grid
from pcs_racing.track.building.curves import MAX_LENGTH, curve_length, resample, signed_area, smooth
from pcs_racing.track.building.islands import ISLAND, fill_islands
from pcs_racing.track.grid import distance_to_walls

SPACING = 0.3  # point spacing of the result, m
SMOOTHING = 1.0  # waves of this length are halved, m: far above a cell, below the tightest hairpin
RIM = 3  # cells of wall around the track: the rim is never the nearer wall
ROUNDING = 1e-23  # max rounding error of the squared turns along that stretch, rad^2
MAX_DETOURS = 10  # rounds of detours: behind one obstacle the line may meet another
START_STRAIGHT = 8.0  # length of the straightest stretch, with the start line, m


def centerline_from_grid(
    occupied: np.ndarray,
    resolution: float,
    origin: np.ndarray | tuple[float, float],
    *,
    seed_point: Sequence[float] | np.ndarray | None = None,
    direction: str | float | None = None,
) -> np.ndarray:
    """Compute the closed line midway between the inner and the outer wall of a track.

    The track is a free region around exactly one hole. The centre line is the set of points with
    equal distances from the hole and the outer wall: the zero contour of the difference of two
    exact distance fields. Unlike the skeleton of a region, it is always a single closed curve
    without branches, and more precise than a cell.

    Parameters
    ----------
    seed_point : array_like, shape (2,), optional
        A point on the track, in m; the line begins next to it. Without a point, the track is the
        free region that surrounds exactly one hole and does not touch the border of the map, and
        the line begins on its longest straight.
    direction : {"counterclockwise", "clockwise"} or float, optional
        Driving direction, or the heading in rad at the beginning of the line. Default:
        counterclockwise.

    Returns
    -------
    ndarray, shape (M, 4)
        x, y and the widths to the right and to the left wall, all in m, evenly spaced about 0.3 m
        apart. A width is the distance to the nearest point of the wall on that side.
    """
    require("skimage")
    from scipy import ndimage

    grid, resolution, corner = checked_grid(occupied, resolution, origin)
    if not (
        direction is None or direction in ("counterclockwise", "clockwise") or is_number(direction)
    ):
        raise MapError(
            f"direction is {direction!r}: it must be 'counterclockwise', 'clockwise' or a heading"
            " in rad"
        )
    seed = None if seed_point is None else _checked_seed(seed_point, grid, resolution, corner)
    region, hole, row, col = _ring(grid, resolution, corner, seed)
    corner = corner + resolution * np.array([col, row])
    # A line around a box is at least twice as long as its diagonal: checked before the fields.
    shortest = 2.0 * resolution * math.hypot(*(size - 2 * RIM for size in region.shape))
    if shortest > MAX_LENGTH:
        raise MapError(
            f"the track is at least {shortest:.0f} m long: at most {MAX_LENGTH:.0f} m are supported"
            f" (is the resolution, {resolution:g} m, right?)"
        )
    # Distance from every cell to the inner and to the outer wall.
    to_hole = distance_to_walls(np.pad(~hole[1:-1, 1:-1], 1), resolution)
    to_outside = distance_to_walls(region | hole, resolution)
    line = _zero_contour(to_outside - to_hole) * resolution + corner
    line = resample(smooth(resample(line, 0.1), SMOOTHING), SPACING)
    first = straightest(line) if seed is None else int(np.argmin(lengths(line - seed)))
    line = directed(np.roll(line, -first, axis=0), direction)
    cells = ((line - corner) / resolution - 0.5).T[::-1]
    inner, outer = (
        ndimage.map_coordinates(field, cells, order=1) for field in (to_hole, to_outside)
    )
    left, right = (inner, outer) if signed_area(line) > 0.0 else (outer, inner)
    return np.column_stack([line, right, left])


def _checked_seed(
    seed_point: Sequence[float] | np.ndarray,
    grid: np.ndarray,
    resolution: float,
    corner: np.ndarray,
) -> np.ndarray:
    seed = np.asarray(seed_point, dtype=np.float64)
    if seed.shape != (2,) or not np.isfinite(seed).all():
        raise MapError(
            f"seed point {seed_point!r} is not a point: two finite coordinates in metres are needed"
        )
    col, row = np.floor((seed - corner) / resolution).astype(int)
    name = f"seed point ({seed[0]:g}, {seed[1]:g})"
    height, width = grid.shape
    if not (0 <= row < height and 0 <= col < width):
        low, high = corner, corner + resolution * np.array([width, height])
        raise MapError(
            f"{name} is off the map, which reaches from ({low[0]:.2f}, {low[1]:.2f}) to"
            f" ({high[0]:.2f}, {high[1]:.2f})"
        )
    if grid[row, col]:
        raise MapError(f"{name} lies in a wall: give a point on the track")
    return seed


def _ring(
    grid: np.ndarray, resolution: float, corner: np.ndarray, seed: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray, int, int]:
    """Return the track (free region around a hole), the hole, and row and column of their cut."""
    from scipy import ndimage

    labels, _ = ndimage.label(~grid)
    boxes = ndimage.find_objects(labels)
    if seed is not None:
        col, row = np.floor((seed - corner) / resolution).astype(int)
        candidates = [int(labels[row, col])]
    else:
        edge = np.unique(np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]]))
        candidates = [k + 1 for k in range(len(boxes)) if k + 1 not in edge]
    rings = []
    for k in candidates:
        rows, cols = boxes[k - 1]
        if min(rows.stop - rows.start, cols.stop - cols.start) * resolution < 1.0:
            continue
        region, holes, large = fill_islands(np.pad(labels[rows, cols] == k, RIM), resolution)
        if len(large) == 1:
            size = float(np.count_nonzero(holes == large[0]))
            rings.append(
                (size, region, holes == large[0], int(rows.start) - RIM, int(cols.start) - RIM)
            )
    rings.sort(key=lambda ring: -ring[0])
    if not rings:
        raise MapError(no_loop(grid, resolution, corner, seed))
    if len(rings) > 1 and rings[1][0] > 0.1 * rings[0][0]:
        points = []
        for _, region, _, row, col in rings:
            i, j = np.argwhere(region)[0]
            x, y = corner + resolution * (np.array([j + col, i + row]) + 0.5)
            points.append(f"({x:.2f}, {y:.2f})")
        raise MapError(
            f"{len(rings)} regions could be the track: choose one with `pcs-racing track import"
            f" --seed-point`, at {' or '.join(points)}"
        )
    _, region, hole, row, col = rings[0]
    return region, hole, row, col


def around_islands(
    line: np.ndarray, grid: np.ndarray, resolution: float, corner: np.ndarray
) -> np.ndarray:
    """Return a closed line, or a centre line that passes each obstacle on it on the wider side.

    Each obstacle is joined to the nearest other wall: then the ring has no island there.
    """
    from scipy import ndimage

    height, width = grid.shape
    for _ in range(MAX_DETOURS):
        col, row = np.floor((resample(line, resolution) - corner) / resolution).astype(int).T
        if ((row < 0) | (col < 0) | (row >= height) | (col >= width)).any() or not grid[
            row, col
        ].any():
            return line
        walls, _ = ndimage.label(grid, structure=np.ones((3, 3)))
        extent = [
            max(part.stop - part.start for part in box) for box in ndimage.find_objects(walls)
        ]
        grid = grid.copy()
        for k in np.setdiff1d(walls[row, col], 0):
            if extent[k - 1] > ISLAND * max(extent):
                return line  # a wall, not an obstacle
            others = np.pad((walls > 0) & (walls != k), 1, constant_values=True)
            away, nearest = ndimage.distance_transform_edt(~others, return_indices=True)
            i, j = min(np.argwhere(np.pad(walls == k, 1)), key=lambda cell: away[tuple(cell)])
            # Cells along the shortest bridge, two per cell of its length to avoid gaps.
            share = np.linspace(0.0, 1.0, 2 * int(away[i, j]) + 2)[:, None]
            bridge = np.round([i, j] + share * (nearest[:, i, j] - [i, j])).astype(int) - 1
            bridge = np.clip(bridge, 0, [height - 1, width - 1])
            grid[bridge[:, 0], bridge[:, 1]] = True
        free = ~grid[row, col]
        if not free.any():
            return line
        seed = corner + resolution * (np.array([col[free][0], row[free][0]]) + 0.5)
        direction = "counterclockwise" if signed_area(line) > 0.0 else "clockwise"
        line = centerline_from_grid(grid, resolution, corner, seed_point=seed, direction=direction)[
            :, :2
        ]
    return line


def _zero_contour(values: np.ndarray) -> np.ndarray:
    """Return the sign changes (x, y) of cell-centre values, in cells from the lower left corner."""
    from skimage.measure import find_contours

    closed = [
        contour for contour in find_contours(values, 0.0) if np.array_equal(contour[0], contour[-1])
    ]
    # The contour is one closed curve; if rounding splits off a fragment, the longest curve counts.
    return max(closed, key=len)[:-1, ::-1] + 0.5


def straightest(line: np.ndarray) -> int:
    """Return the index of the point in the middle of the straightest stretch."""
    ahead = np.roll(line, -1, axis=0) - line
    angle = headings(ahead)
    turn = np.mod(np.diff(angle, prepend=angle[-1]) + np.pi, 2.0 * np.pi) - np.pi
    half = max(int(0.5 * START_STRAIGHT * len(line) / curve_length(line)), 1)
    window = np.arange(-half, half + 1)
    blame = (turn**2)[(np.arange(len(line))[:, None] + window) % len(line)].sum(axis=1)
    # On a long straight all points are equal up to rounding errors: take their middle.
    best = np.flatnonzero(blame <= blame.min() + ROUNDING)
    return int(best[len(best) // 2])


def directed(line: np.ndarray, direction: str | float | None) -> np.ndarray:
    """Return the line, reversed about its first point if it runs against the direction."""
    if direction is None or isinstance(direction, str):
        against = (signed_area(line) < 0.0) != (direction == "clockwise")
    else:
        ahead = line[1] - line[-1]
        psi = float(arctangent2(ahead[1], ahead[0]))
        _, along = sine_cosine(psi - float(direction))
        if abs(along) < 0.2:
            raise MapError(
                f"heading {direction:g} rad lies across the track, which runs at {psi:.2f} or"
                f" {psi + math.pi:.2f} rad at its start ({line[0, 0]:.2f}, {line[0, 1]:.2f})"
            )
        against = along < 0.0
    return np.roll(line[::-1], 1, axis=0) if against else line
