"""The Track: everything about a circuit that never changes while cars race on it."""

import hashlib
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from pcs_racing import frenet
from pcs_racing.errors import MapError
from pcs_racing.frenet import LINE_COLUMNS, TrackArrays
from pcs_racing.grid import cast, distance_to_walls, flood, label_cells
from pcs_racing.splines import LineSamples, sample_closed
from pcs_racing.walls import seen_lists, simplify, trace_outlines

__all__ = ["Track", "build_track", "load_track"]

Floats = NDArray[np.float64]

LINE_SPACING = 0.1
SEEN_STRETCH = 0.8
LOOKUP_CELL = 0.5
MARGIN_CELLS = 3
SIMPLIFY_CELLS = 0.5


@dataclass(frozen=True, eq=False)
class Track:
    """A circuit: race line, walls, distance field."""

    name: str
    arrays: TrackArrays
    centerline: Floats
    speed_range: dict[str, tuple[float, float]] = field(default_factory=dict)
    folder: Path | None = None
    content_hash: str = ""

    @property
    def length(self) -> float:
        """Length of the race line in m."""
        return self.arrays.length

    @property
    def line(self) -> Floats:
        """Samples of the race line, see `TrackArrays.line`; read-only."""
        view = self.arrays.line.view()
        view.flags.writeable = False
        return view

    def to_frenet(self, points: ArrayLike) -> Floats:
        """Frenet coordinates (s, d) of points (..., 2)."""
        xy = np.asarray(points, dtype=np.float64)
        return _to_frenet(self.arrays, np.ascontiguousarray(xy.reshape(-1, 2))).reshape(xy.shape)

    def to_cartesian(self, sd: ArrayLike) -> Floats:
        """Points and line headings (x, y, psi) of Frenet coordinates (..., 2)."""
        at = np.asarray(sd, dtype=np.float64)
        return _to_cartesian(self.arrays, np.ascontiguousarray(at.reshape(-1, 2))).reshape(*at.shape[:-1], 3)

    def wall_distance(self, points: ArrayLike) -> Floats:
        """Distance in m from points (..., 2) to the nearest wall."""
        xy = np.asarray(points, dtype=np.float64)
        return _wall_distance(self.arrays, np.ascontiguousarray(xy.reshape(-1, 2))).reshape(xy.shape[:-1])


@njit(cache=True, nogil=True)
def _to_frenet(track, xy):  # type: ignore[no-untyped-def]
    out = np.empty((xy.shape[0], 2))
    for k in range(xy.shape[0]):
        out[k, 0], out[k, 1] = frenet.locate(track, xy[k, 0], xy[k, 1])
    return out


@njit(cache=True, nogil=True)
def _to_cartesian(track, sd):  # type: ignore[no-untyped-def]
    out = np.empty((sd.shape[0], 3))
    for k in range(sd.shape[0]):
        out[k, 0], out[k, 1], out[k, 2] = frenet.to_cartesian(track, sd[k, 0], sd[k, 1])
    return out


@njit(cache=True, nogil=True)
def _wall_distance(track, xy):  # type: ignore[no-untyped-def]
    out = np.empty(xy.shape[0])
    for k in range(xy.shape[0]):
        out[k] = frenet.wall_distance(track, xy[k, 0], xy[k, 1])
    return out


@njit(cache=True, nogil=True)
def _free_widths(drivable, x, y, tangent):  # type: ignore[no-untyped-def]
    """Free width in cells to the right and to the left of each line sample, along the line's normal."""
    out = np.empty((x.shape[0], 2))
    for k in range(x.shape[0]):
        c, s = tangent[k]
        out[k, 0] = cast(drivable, x[k], y[k], s, -c, 1e9)[0]
        out[k, 1] = cast(drivable, x[k], y[k], -s, c, 1e9)[0]
    return out


def build_track(
    name: str,
    occupied: NDArray[np.bool_],
    resolution: float,
    origin: tuple[float, float],
    centerline: ArrayLike,
    raceline_xy: ArrayLike,
    *,
    speed_range: dict[str, tuple[float, float]] | None = None,
    folder: Path | None = None,
) -> Track:
    """Build a track from values.

    Parameters
    ----------
    name : str
    occupied : ndarray of bool, shape (H, W)
        Occupancy grid, row 0 at the bottom.
    resolution : float
        Side of a cell in m.
    origin : tuple of float
        Lower left corner of cell [0, 0] in m.
    centerline : array_like, shape (M, 4)
        x, y, width to the right, width to the left, in m.
    raceline_xy : array_like, shape (K, 2)
        Points of the closed race line in m, in driving order.
    speed_range : dict, optional
        Calibrated range of the speed scale for each race preset.
    folder : Path, optional
        Where the map came from.

    Returns
    -------
    Track
    """
    from pcs_racing.mapping.speed import speed_profile

    grid = np.ascontiguousarray(occupied, dtype=np.bool_)
    samples = sample_closed(raceline_xy, LINE_SPACING)
    drivable, row0, col0 = _drivable_region(name, grid, resolution, origin, samples)
    origin_x = origin[0] + col0 * resolution
    origin_y = origin[1] + row0 * resolution
    x = (samples.xy[:, 0] - origin_x) / resolution
    y = (samples.xy[:, 1] - origin_y) / resolution
    width = _free_widths(drivable, x, y, samples.tangent) * resolution
    ds = samples.length / len(x)
    line = np.empty((len(x), len(LINE_COLUMNS)))
    line[:, 0:2] = samples.xy
    line[:, 2:4] = samples.tangent
    line[:, 4] = samples.psi
    line[:, 5] = samples.kappa
    line[:, 6] = speed_profile(samples.kappa, ds)
    line[:, 7:9] = width

    outlines = trace_outlines(drivable)
    segments, owner, start = simplify(outlines, SIMPLIFY_CELLS)
    stretches = max(int(round(samples.length / SEEN_STRETCH)), 1)
    sections = _viewpoints(line, stretches, (origin_x, origin_y), resolution)
    seen_start, seen = seen_lists(drivable, outlines, segments, owner, start, sections, 720, 60.0 / resolution)
    lookup = _lookup(drivable, x, y, LOOKUP_CELL / resolution)
    center = np.array(centerline, dtype=np.float64)
    center.flags.writeable = False
    digest = hashlib.sha256(np.packbits(drivable).tobytes())
    for part in (np.array([*drivable.shape, resolution, origin_x, origin_y]), line, center):
        digest.update(np.ascontiguousarray(part).tobytes())
    arrays = TrackArrays(
        length=samples.length,
        ds=ds,
        line=line,
        distance=distance_to_walls(drivable, resolution),
        origin_x=origin_x,
        origin_y=origin_y,
        cell=float(resolution),
        walls=segments * resolution + np.array([origin_x, origin_y, origin_x, origin_y]),
        seen_start=seen_start,
        seen=seen,
        seen_stretch=samples.length / stretches,
        lookup=lookup,
        lookup_cell=LOOKUP_CELL,
    )
    return Track(name, arrays, center, dict(speed_range or {}), folder, digest.hexdigest())


def _drivable_region(
    name: str, occupied: NDArray[np.bool_], resolution: float, origin: tuple[float, float], samples: LineSamples
) -> tuple[NDArray[np.bool_], int, int]:
    """Flood the grid from the line; return the region cropped to its box plus a margin, and where the crop begins."""
    cells = np.floor((samples.xy - np.asarray(origin)) / resolution).astype(np.int64)
    height, width = occupied.shape
    inside = (cells >= 0).all(axis=1) & (cells[:, 0] < width) & (cells[:, 1] < height)
    if not inside.all():
        raise MapError(f"track {name}: the race line leaves the map at {samples.xy[~inside][0]}")
    hit = occupied[cells[:, 1], cells[:, 0]]
    if hit.any():
        raise MapError(f"track {name}: the race line runs through a wall at {samples.xy[hit][0]}")
    reached, (bottom, top, left, right) = flood(occupied, cells[:, 1].copy(), cells[:, 0].copy())
    if bottom == 0 or left == 0 or top == height - 1 or right == width - 1:
        raise MapError(f"track {name}: the walls have a gap, the track can be left to the picture's border")
    m = MARGIN_CELLS
    drivable = np.zeros((top - bottom + 1 + 2 * m, right - left + 1 + 2 * m), dtype=np.bool_)
    drivable[m:-m, m:-m] = reached[bottom : top + 1, left : right + 1]
    return drivable, bottom - m, left - m


def _viewpoints(line: Floats, stretches: int, corner: tuple[float, float], resolution: float) -> Floats:
    """Points across the track at the beginning and the middle of each stretch, in cells."""
    index = np.round(np.arange(2 * stretches) * (len(line) / (2 * stretches))).astype(int) % len(line)
    at = line[index]
    across = np.array([-0.97, -0.5, 0.0, 0.5, 0.97])
    d = np.where(across < 0, across * at[:, 7:8], across * at[:, 8:9])
    points = np.stack([at[:, 0:1] - d * at[:, 3:4], at[:, 1:2] + d * at[:, 2:3]], axis=2)
    return np.ascontiguousarray((points - np.asarray(corner)) / resolution)


def _lookup(drivable: NDArray[np.bool_], x: Floats, y: Floats, coarse: float) -> NDArray[np.int32]:
    label = label_cells(drivable, x, y)
    return _coarse_labels(label, x, y, coarse)


@njit(cache=True, nogil=True)
def _coarse_labels(label, x, y, coarse):  # type: ignore[no-untyped-def]
    """Label of the labelled cell nearest to the centre of each coarse cell, else the nearest sample of all."""
    height, width = label.shape
    rows = int(np.ceil(height / coarse))
    cols = int(np.ceil(width / coarse))
    out = np.empty((rows, cols), dtype=np.int32)
    for a in range(rows):
        for b in range(cols):
            cy = (a + 0.5) * coarse
            cx = (b + 0.5) * coarse
            best = np.inf
            found = -1
            for i in range(int(a * coarse), min(int((a + 1) * coarse) + 1, height)):
                for j in range(int(b * coarse), min(int((b + 1) * coarse) + 1, width)):
                    if label[i, j] >= 0:
                        away = (i + 0.5 - cy) ** 2 + (j + 0.5 - cx) ** 2
                        if away < best:
                            best = away
                            found = label[i, j]
            if found < 0:
                for k in range(x.shape[0]):
                    away = (x[k] - cx) ** 2 + (y[k] - cy) ** 2
                    if away < best:
                        best = away
                        found = k
            out[a, b] = found
    return out


def load_track(name_or_path: str | Path) -> Track:
    """Load a track from a map folder."""
    from pcs_racing.maps import read_map

    folder = Path(name_or_path)
    data = read_map(folder)
    assert data.centerline is not None and data.raceline is not None
    return build_track(
        data.name, data.occupied, data.resolution, data.origin, data.centerline, data.raceline[:, 1:3], folder=folder
    )
