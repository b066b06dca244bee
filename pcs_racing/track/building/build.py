"""Builder of a track's arrays for compiled kernels from a checked grid and race line."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.compilation import compiled
from pcs_racing.base.elementary import lengths
from pcs_racing.base.errors import MapError
from pcs_racing.base.typing import Floats
from pcs_racing.track.building.causes import find_gap
from pcs_racing.track.building.curves import (
    MAX_LENGTH,
    LineSamples,
    clean_closed,
    first_crossing,
    sample_closed,
    signed_area,
)
from pcs_racing.track.building.walls import corner_lists, seen_lists, simplify, trace_outlines
from pcs_racing.track.frenet import (
    COS,
    KAPPA,
    LEFT,
    LINE_COLUMNS,
    PSI,
    RIGHT,
    SIN,
    SPEED,
    TrackArrays,
    X,
    Y,
)
from pcs_racing.track.grid import cast, distance_to_walls, lookup_grid
from pcs_racing.track.moving import LANES

Grid = NDArray[np.bool_]

LINE_SPACING = 0.1  # sample spacing of the race line, m
MAX_CURVATURE = 4.0  # 1/m; the max of a car is 1.3, so a sharper line has a kink
MARGIN = 3  # cells around the drivable region
SIMPLIFY = 0.027  # max deviation of a wall from the middles of its cell faces, m, ...
SIMPLIFY_CELLS = 0.5  # ... but at least this many cells: else a slanted wall retains every step
INSET = 0.25  # see walls.simplify
SEEN_STRETCH = 0.8  # m
SEEN_ACROSS = 6  # viewpoints across the track
LOOKUP_CELL = 0.25  # m
LEAK = 1.4  # max ratio of a track's region to length x mean width


def check_line(points: ArrayLike, label: str) -> Floats:
    """Check the points of a closed line, shape (K, 2), and remove repeated points."""
    xy = np.array(points, dtype=np.float64)
    if xy.ndim != 2 or xy.shape[1] != 2:
        raise MapError(f"{label} must be an array of shape (K, 2), got {xy.shape}")
    bad = ~(np.abs(xy) <= 1e6).all(axis=1)
    if bad.any():
        raise MapError(
            f"{label} holds the impossible point {_at(xy[bad][0])}: coordinates must be finite, in"
            " metres"
        )
    xy = clean_closed(xy)
    if len(xy) < 10:
        raise MapError(f"{label} has {len(xy)} different points: at least 10 are needed")
    step = lengths(np.roll(xy, -1, axis=0) - xy)
    if step[-1] > max(3.0 * step[:-1].max(), 1.0):
        raise MapError(
            f"{label} is open: from its last point {_at(xy[-1])} to its first {_at(xy[0])} it is"
            f" {step[-1]:.2f} m, more than three of its longest steps; it must lead all the way"
            " round"
        )
    if step.sum() > MAX_LENGTH:
        raise MapError(
            f"{label} is {step.sum():.0f} m long: at most {MAX_LENGTH:.0f} m are possible (is it in"
            " metres?)"
        )
    samples = sample_closed(xy, 2.0 * LINE_SPACING).xy
    crossing = first_crossing(samples)[0]
    if crossing >= 0:
        raise MapError(
            f"{label} crosses itself near {_at(samples[crossing])}: it must be a simple closed line"
        )
    return xy


def check_centerline(centerline: ArrayLike, label: str) -> Floats:
    """Check a centre line with its widths; see `check_line`."""
    rows = np.array(centerline, dtype=np.float64)
    if rows.ndim != 2 or rows.shape[1] != 4:
        raise MapError(
            f"{label} must have 4 columns (x, y, width to the right, to the left), got shape"
            f" {rows.shape}"
        )
    check_line(rows[:, :2], label)
    bad = ~((rows[:, 2:] > 0.0) & (rows[:, 2:] < MAX_LENGTH)).all(axis=1)
    if bad.any():
        row = int(np.argmax(bad))
        raise MapError(
            f"{label}: the track is {rows[row, 2]} m wide to the right and {rows[row, 3]} m to the"
            f" left of point {_at(rows[row])}: both must be positive"
        )
    return rows


def check_direction(raceline: Floats, centerline: Floats, label: str) -> None:
    """Check that a race line is driven in the direction of the centre line."""
    race, center = signed_area(raceline), signed_area(centerline[:, :2])
    if race * center < 0.0:
        ways = ("counterclockwise", "clockwise")
        raise MapError(
            f"{label}: the race line is driven {ways[race < 0.0]}, but the centre line"
            f" {ways[center < 0.0]}: reverse the rows of one of them (a reversed centre line"
            " exchanges its widths)"
        )


def drivable_region(
    occupied: Grid,
    resolution: float,
    origin: Floats,
    samples: LineSamples,
    center: Floats,
    label: str,
) -> tuple[Grid, int, int]:
    """Return the region connected with a line, cropped to its bounding box and a margin.

    Its outermost rows and columns are False. The first row and column of the crop in the grid are
    returned too (negative if the margin is outside the grid).
    """
    from scipy import ndimage

    rows, cols = _cells(samples.xy, occupied, resolution, origin, f"{label}: the race line")
    regions, count = ndimage.label(~occupied)
    on_line = np.zeros(count + 1, dtype=np.bool_)
    on_line[regions[rows, cols]] = True
    reached = on_line[regions]
    in_row, in_col = np.flatnonzero(reached.any(axis=1)), np.flatnonzero(reached.any(axis=0))
    (bottom, top), (left, right) = in_row[[0, -1]].tolist(), in_col[[0, -1]].tolist()
    height, width = occupied.shape
    open_to_border = bottom == 0 or left == 0 or top == height - 1 or right == width - 1
    drivable = np.pad(reached[bottom : top + 1, left : right + 1], MARGIN)
    bottom, left = bottom - MARGIN, left - MARGIN
    # An area far above length times width: the walls leak into a yard or the infield.
    # A wide track's race line is much shorter than the track: the larger of both estimates counts.
    usual = 0.0
    for line in (samples, sample_closed(center[:, :2], LINE_SPACING)):
        if not (
            (line.xy < origin) | (line.xy >= origin + resolution * np.array(occupied.shape[::-1]))
        ).any():
            across = free_widths(drivable, *_in_cells(line, resolution, origin, bottom, left)).sum(
                axis=1
            )
            usual = max(usual, float(across.mean()) * line.length / resolution)
    area = int(np.count_nonzero(reached))
    if open_to_border or area > LEAK * usual:
        gap = find_gap(occupied, reached, resolution, origin, 1.0 if open_to_border else 0.9)
        extent = (
            "the border of the picture"
            if open_to_border
            else f"{area / usual:.1f} times the area of the track"
        )
        raise MapError(
            f"{label} reaches {extent}: {gap or 'the walls have a gap, or the seed is outside'}"
        )
    return drivable, bottom, left


def build_arrays(
    occupied: Grid, resolution: float, origin: Floats, raceline: Floats, center: Floats, label: str
) -> tuple[TrackArrays, Grid]:
    """Build a track's arrays for compiled kernels, and its drivable region.

    The drivable region has the shape of ``arrays.distance``.

    `checked_grid`, `check_line` and `check_centerline` must have checked grid and lines.
    """
    from pcs_racing.track.building.raceline import speed_profile

    samples = sample_closed(raceline, LINE_SPACING)
    sharpest = int(np.argmax(np.abs(samples.kappa)))
    if abs(samples.kappa[sharpest]) > MAX_CURVATURE:
        raise MapError(
            f"{label}: the race line has a kink at {_at(samples.xy[sharpest])}, its radius there is"
            f" {1.0 / abs(samples.kappa[sharpest]):.2f} m; it must be at least"
            f" {1.0 / MAX_CURVATURE} m everywhere"
        )
    drivable, row, col = drivable_region(occupied, resolution, origin, samples, center, label)
    corner = np.array([origin[0] + col * resolution, origin[1] + row * resolution])
    x, y, tangent = _in_cells(samples, resolution, origin, row, col)
    ds = samples.length / len(x)
    line = np.empty((len(x), len(LINE_COLUMNS)))
    line[:, [X, Y]] = samples.xy
    line[:, [COS, SIN]] = samples.tangent
    line[:, PSI] = samples.psi
    line[:, KAPPA] = samples.kappa
    line[:, SPEED] = speed_profile(samples.kappa, ds)
    line[:, [RIGHT, LEFT]] = free_widths(drivable, x, y, tangent) * resolution

    outlines = trace_outlines(drivable)
    segments, owner, start = simplify(outlines, max(SIMPLIFY_CELLS, SIMPLIFY / resolution), INSET)
    stretches = max(round(samples.length / SEEN_STRETCH), 1)
    sections = (_viewpoints(line, stretches) - corner) / resolution
    seen_start, seen, seen_distance = seen_lists(
        drivable, outlines, segments, owner, start, sections
    )
    walls = segments * resolution + np.tile(corner, 2)
    corners_start, corners = corner_lists(walls, seen_start, seen)
    block = max(round(LOOKUP_CELL / resolution), 1)
    arrays = TrackArrays(
        length=samples.length,
        ds=ds,
        line=line,
        distance=distance_to_walls(drivable, resolution),
        origin_x=float(corner[0]),
        origin_y=float(corner[1]),
        cell=resolution,
        walls=walls,
        seen_start=seen_start,
        seen=seen,
        # Rounded down: a search up to a distance must never end too early.
        seen_distance=np.nextafter(
            (seen_distance * resolution).astype(np.float32), np.float32(-1.0)
        ),
        seen_middle=sections[1::2].mean(axis=1) * resolution + corner,
        seen_stretch=samples.length / stretches,
        corners_start=corners_start,
        corners=corners,
        lookup=lookup_grid(drivable, x, y, block),
        lookup_cell=block * resolution,
        moving=np.empty((0, LANES)),
    )
    return arrays, drivable


def _at(point: NDArray[Any]) -> str:
    return f"({point[0]:.2f}, {point[1]:.2f})"


def _cells(
    xy: Floats, occupied: Grid, resolution: float, origin: Floats, label: str
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the rows and columns of the free cells with the points."""
    cols, rows = np.floor((xy - origin) / resolution).astype(np.int64).T.copy()
    height, width = occupied.shape
    outside = (rows < 0) | (cols < 0) | (rows >= height) | (cols >= width)
    if outside.any():
        raise MapError(
            f"{label} leaves the map at {_at(xy[outside][0])}: do resolution, origin and the line"
            " fit together?"
        )
    hit = occupied[rows, cols]
    if hit.any():
        raise MapError(
            f"{label} runs through a wall at {_at(xy[hit][0])}: it must stay between the walls"
        )
    return rows, cols


def _in_cells(
    samples: LineSamples, resolution: float, origin: Floats, row: int, col: int
) -> tuple[Floats, Floats, Floats]:
    """Return the line samples, in cells from the corner of a crop, and their tangents."""
    x = (samples.xy[:, 0] - origin[0]) / resolution - col
    y = (samples.xy[:, 1] - origin[1]) / resolution - row
    return x, y, samples.tangent


def _viewpoints(line: Floats, stretches: int) -> Floats:
    """Return points across each stretch's start and middle, (2 * stretches, SEEN_ACROSS, 2)."""
    index = np.round(np.arange(2 * stretches) * (len(line) / (2 * stretches))).astype(int) % len(
        line
    )
    at = line[index][:, None, :]
    across = np.linspace(-0.98, 0.98, SEEN_ACROSS)
    d = across * np.where(across < 0.0, at[..., RIGHT], at[..., LEFT])
    return np.stack([at[..., X] - d * at[..., SIN], at[..., Y] + d * at[..., COS]], axis=2)


@compiled
def free_widths(drivable, x, y, tangent):
    """Return the free widths (cells) to the right and left of line samples, along the normals."""
    out = np.empty((x.shape[0], 2))
    for k in range(x.shape[0]):
        c, s = tangent[k]
        out[k, 0] = cast(drivable, x[k], y[k], s, -c, np.inf)[0]
        out[k, 1] = cast(drivable, x[k], y[k], -s, c, np.inf)[0]
    return out
