"""The Track: the immutable data of a circuit, and functions that load and build it."""

import hashlib
import json
import logging
import os
import threading
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.compilation import compiled
from pcs_racing.base.elementary import arctangent2
from pcs_racing.base.errors import InputError, MapError, UnknownNameError
from pcs_racing.track import frenet
from pcs_racing.track.building.build import LINE_SPACING, build_arrays, check_centerline, check_grid, check_line
from pcs_racing.track.building.clearance import wall_clearance
from pcs_racing.track.building.splines import sample_closed
from pcs_racing.track.cache import TRACK, cache_key, load_cached, store
from pcs_racing.track.frenet import KAPPA, LEFT, RIGHT, SPEED, TrackArrays
from pcs_racing.track.grid import distance_to_walls
from pcs_racing.track.maps import MapFiles, MapFolder, find_map, find_shipped, parse_map, read_bytes

__all__ = [
    "Calibration",
    "Track",
    "as_track",
    "build_track",
    "calibration_from_values",
    "calibration_values",
    "load_track",
]

Floats = NDArray[np.float64]

CLEARANCE = 0.305
"""Minimum distance of a race line from the walls, in m: half the width of a car (0.155) and a margin of 0.15."""
TOLERANCE = 0.02
"""Amount by which a given race line may be below that distance, in m: about the size of a cell's corner."""

_log = logging.getLogger("pcs_racing")


@dataclass(frozen=True)
class Calibration:
    """Speed range and start positions of a circuit under a race preset, from `pcs_racing.race.calibration`.

    Attributes
    ----------
    speed_range : tuple of two floats
        Scales of the speed profile that stand for pace 0 and pace 1.
    start_spacing : float
        Distance between the cars across the track at the start, m.
    start_places : dict
        Stretches of start positions for each side that they favour ("left" and "right", or "front"): arc lengths of the
        first and the last position, m, ascending.
    left_share : float
        Share of start lines that are drawn from positions that favour the left car, so that neither side wins more.
    """

    speed_range: tuple[float, float]
    start_spacing: float
    start_places: dict[str, tuple[tuple[float, float], ...]]
    left_share: float = 0.5


def calibration_values(calibration: Calibration) -> dict[str, Any]:
    """Return a calibration as plain lists and numbers, for yaml and json."""
    return {
        "speed_range": list(calibration.speed_range),
        "start_spacing": calibration.start_spacing,
        "start_places": {
            side: [list(stretch) for stretch in stretches] for side, stretches in calibration.start_places.items()
        },
        "left_share": calibration.left_share,
    }


def calibration_from_values(values: dict[str, Any]) -> Calibration:
    """Return the calibration of checked values; the inverse of `calibration_values`."""
    low, high = values["speed_range"]
    places = {
        side: tuple((float(first), float(last)) for first, last in stretches)
        for side, stretches in values["start_places"].items()
    }
    return Calibration((float(low), float(high)), float(values["start_spacing"]), places, float(values["left_share"]))


@dataclass(frozen=True, eq=False, repr=False)
class Track:
    """A circuit: race line, walls, distance field.

    Immutable and shared: any number of races, environments and threads use one Track at the same time.

    Attributes
    ----------
    name : str
    arrays : TrackArrays
        The data that compiled kernels read. Its arrays are technically writeable, so that all tracks have the same
        compiled type, but no code writes to them.
    centerline : ndarray, shape (M, 4)
        x, y, width to the right, width to the left, in m; as given, read-only.
    calibration : dict
        The calibration of each race preset that the map's files contain; may be empty.
    folder : Path or None
        The map folder of the circuit.
    content_hash : str
        SHA-256 of the drivable region and the lines, in hexadecimal. Equal tracks have equal hashes, also if their
        files differ.
    """

    name: str
    arrays: TrackArrays
    centerline: Floats
    calibration: dict[str, Calibration] = field(default_factory=dict)
    folder: Path | None = None
    content_hash: str = ""

    def __repr__(self) -> str:
        return f"Track({self.name!r}, {self.length:.1f} m, content_hash={self.content_hash[:12]!r})"

    @property
    def length(self) -> float:
        """Length of the closed race line in m."""
        return self.arrays.length

    @property
    def line(self) -> Floats:
        """Samples of the race line, shape (N, 9), see `TrackArrays`; read-only."""
        return _read_only(self.arrays.line)

    def to_frenet(self, points: ArrayLike) -> Floats:
        """Return Frenet coordinates (s, d) in m of points (x, y), shape (..., 2) both; see `frenet.locate`."""
        return self._each(_to_frenet, points, 2)

    def to_cartesian(self, sd: ArrayLike) -> Floats:
        """Return points and headings (x, y, psi), shape (..., 3), of Frenet coordinates (s, d), shape (..., 2)."""
        return self._each(_to_cartesian, sd, 3)

    def wall_distance(self, points: ArrayLike) -> Floats:
        """Return the distance in m from points (x, y), shape (..., 2), to the nearest wall; 0 off the track."""
        return self._each(_wall_distance, points, 1)[..., 0]

    def _each(self, function: Any, values: ArrayLike, columns: int) -> Floats:
        pairs = np.ascontiguousarray(values, dtype=np.float64)
        if pairs.shape[-1:] != (2,):
            raise ValueError(f"pairs of coordinates of shape (..., 2) are needed, got shape {pairs.shape}")
        out = np.empty((*pairs.shape[:-1], columns))
        function(self.arrays, pairs.reshape(-1, 2), out.reshape(-1, columns))
        return out

    def summary(self) -> str:
        """Return a description of the circuit in a few lines."""
        line = self.arrays.line
        width = line[:, RIGHT] + line[:, LEFT]
        turn = "left" if line[-1, frenet.PSI] > line[0, frenet.PSI] else "right"
        ranges = ", ".join(
            f"{preset} {own.speed_range[0]:g}-{own.speed_range[1]:g}"
            for preset, own in sorted(self.calibration.items())
        )
        return "\n".join(
            [
                f"{self.name}: {self.length:.1f} m, {turn}-hand",
                f"  width {width.min():.2f}-{width.max():.2f} m (mean {width.mean():.2f}), "
                f"{len(self.arrays.walls)} wall segments, cells of {self.arrays.cell:g} m",
                f"  race line: tightest radius {1.0 / np.abs(line[:, KAPPA]).max():.2f} m, at least "
                f"{self.wall_distance(line[:, :2]).min():.2f} m from the walls",
                f"  lap at speed scale 1: {(self.arrays.ds / line[:, SPEED]).sum():.1f} s, {line[:, SPEED].min():.1f}-"
                f"{line[:, SPEED].max():.1f} m/s",
                f"  speed range: {ranges or 'calibrated when a race preset first asks for it'}",
            ]
        )


def build_track(
    name: str,
    occupied: ArrayLike,
    resolution: float,
    origin: ArrayLike,
    centerline: ArrayLike,
    raceline_xy: ArrayLike,
    *,
    calibration: dict[str, Calibration] | None = None,
    folder: Path | None = None,
) -> Track:
    """Build a track from a grid and its lines.

    Parameters
    ----------
    name : str
    occupied : array_like of bool, shape (H, W)
        Occupancy grid, True where a wall is; row 0 is the bottom.
    resolution : float
        Side of a cell in m, in (0, 1].
    origin : array_like, shape (2,)
        Lower left corner of cell [0, 0] in m.
    centerline : array_like, shape (M, 4)
        x, y, width to the right, width to the left, in m.
    raceline_xy : array_like, shape (K, 2)
        Points of the closed race line in m, in driving order; it is the reference of all Frenet coordinates.
    calibration : dict of Calibration, optional
        Speed range and start positions for each race preset, as far as they are known.
    folder : Path, optional
        The map folder of the circuit.

    Returns
    -------
    Track

    Raises
    ------
    MapError
        If a value is not allowed, or if the lines and the grid do not fit together.
    """
    label = f"track {name}"
    grid, resolution, corner = check_grid(occupied, resolution, origin, label)
    center = check_centerline(centerline, f"{label}: the centre line")
    arrays, drivable = build_arrays(grid, resolution, corner, check_line(raceline_xy, f"{label}: the race line"), label)
    _check_centre(arrays, center, f"{label}: the centre line")
    for preset, own in (calibration or {}).items():
        last = max(stretches[-1][1] for stretches in own.start_places.values())
        if last >= arrays.length:
            raise MapError(
                f"{label}: the calibration of {preset} has a start place at {last:g} m, but the race line is "
                f"{arrays.length:.2f} m long; calibrate it again"
            )
    digest = hashlib.sha256(np.packbits(drivable).tobytes())
    for array in (np.array([*drivable.shape, resolution, *corner]), arrays.line, center):
        digest.update(array.tobytes())
    return Track(name, arrays, _read_only(center), dict(calibration or {}), folder, digest.hexdigest())


def as_track(track: Track | str | os.PathLike[str]) -> Track:
    """Return a circuit as it is, or load it by its name or folder."""
    return track if isinstance(track, Track) else load_track(track)


def load_track(name_or_path: str | os.PathLike[str]) -> Track:
    """Load a track by the name of a shipped circuit or from a map folder.

    Missing lines are built, which needs ``pip install "pcs-racing[mapping]"``. The race line is built again if the
    given one leaves a car less than 0.15 m to the walls; the logger ``pcs_racing`` then reports this. Building lines
    and processing the walls takes about a second. The result is cached on disk (see `pcs_racing.track.cache`), and in
    memory as long as the process runs. A map whose files have changed is loaded again.

    Parameters
    ----------
    name_or_path : str or path-like
        Name of a shipped circuit (case does not matter), a map folder, or a map's yaml file. See
        `pcs_racing.track.maps` for the files of a folder.

    Returns
    -------
    Track
        The same object for the same map.

    Raises
    ------
    UnknownNameError
        If there is neither a folder nor a shipped circuit of that name.
    MapError
        If the folder, or a file in it, is not a valid map.
    """
    files = find_map(_resolve(name_or_path))
    with _lock:
        kept = _loaded.get(files.yaml)
        if kept is None or kept.files != files or kept.stamp != _stamp(kept.paths):
            contents = read_bytes(files)
            paths = tuple(files.folder / name for name in contents)
            kept = _Loaded(files, paths, _stamp(paths), _load(files, contents))
            _loaded[files.yaml] = kept
        return kept.track


class _Loaded(NamedTuple):
    files: MapFiles
    paths: tuple[Path, ...]
    stamp: tuple[tuple[int, int], ...] | None
    track: Track


_lock = threading.Lock()
_loaded: dict[Path, _Loaded] = {}


def _resolve(name_or_path: str | os.PathLike[str]) -> Path:
    if not isinstance(name_or_path, str | os.PathLike):
        raise InputError(f"track is {name_or_path!r:.80}; it must be the name of a circuit or the path of a map")
    path = Path(name_or_path)
    if isinstance(name_or_path, str) and path.name == name_or_path:
        try:
            return find_shipped(name_or_path)
        except UnknownNameError:
            if not os.path.exists(path):
                raise
    return path.resolve() if os.path.exists(path) else path


def _stamp(paths: tuple[Path, ...]) -> tuple[tuple[int, int], ...] | None:
    """Return values that change when one of the files changes; None if a file is missing."""
    try:
        return tuple((status.st_mtime_ns, status.st_size) for status in map(os.stat, paths))
    except OSError:
        return None


def _load(files: MapFiles, contents: dict[str, bytes]) -> Track:
    """Return a track from the cache on disk, or build and cache it."""
    key = cache_key(contents, TRACK)
    arrays = load_cached(TRACK, key)
    restored = None if arrays is None else _restore(files, arrays)
    if restored is not None:
        track, note = restored
    else:
        content = parse_map(files, contents)
        center, race, note = _lines(files, content)
        calibration = content.info.get("calibration", {})
        try:
            track = build_track(
                content.name,
                content.occupied,
                content.resolution,
                content.origin,
                center,
                race,
                calibration={preset: calibration_from_values(values) for preset, values in calibration.items()},
                folder=content.folder,
            )
        except MapError as error:
            raise MapError(f"{files.yaml}: {error}") from error
        store(TRACK, key, _flatten(track, note))
    if note:
        _log.warning("track %s: %s", track.name, note)
    return track


def _lines(files: MapFiles, content: MapFolder) -> tuple[Floats, Floats, str]:
    """Return centre line and race line of a map, built if missing or unsuitable, and a note with the reason."""
    from pcs_racing.track.building.centerline import centerline_from_grid
    from pcs_racing.track.building.raceline import minimum_curvature_raceline

    occupied, resolution, origin = check_grid(content.occupied, content.resolution, content.origin, str(files.yaml))
    center = race = None
    reasons = []
    if content.raceline is None:
        reasons.append("it has no race line")
    else:
        race = check_line(content.raceline[:, 1:3], str(files.raceline))
        points = sample_closed(race, LINE_SPACING).xy
        air = float(wall_clearance(points, occupied, resolution, np.asarray(origin), 1.0).min())
        if air == 0.0:
            raise MapError(f"{files.raceline} leads through a wall or off the map: it must stay on the track")
        if air < CLEARANCE - TOLERANCE:
            reasons.append(f"its race line comes within {air:.2f} m of a wall ({CLEARANCE} m are needed)")
    if content.centerline is None:
        reasons.append("it has no centre line")
    else:
        center = check_centerline(content.centerline, str(files.centerline))
    note = " and ".join(reasons)
    try:
        if center is None:
            heading = None if race is None else float(arctangent2(*(race[1] - race[0])[::-1]))
            seed = None if race is None else race[0]
            center = centerline_from_grid(occupied, resolution, origin, seed_point=seed, direction=heading)
        if race is None or air < CLEARANCE - TOLERANCE:
            race = minimum_curvature_raceline(center, occupied, resolution, origin, clearance=CLEARANCE)
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(f"track {files.name} must be completed: {note}; {error}", name=error.name) from error
    except MapError as error:
        raise MapError(f"{files.yaml}: {error}") from error
    return center, race, f"{note}; it was made from the picture" if note else ""


def _flatten(track: Track, note: str) -> dict[str, Any]:
    """Return all data of a track as arrays; the drivable region stands for the distance field."""
    values = {name: np.asarray(value) for name, value in track.arrays._asdict().items() if name != "distance"}
    own = {preset: calibration_values(calibration) for preset, calibration in track.calibration.items()}
    return values | {
        "drivable": np.packbits(track.arrays.distance > 0.0, axis=1),
        "columns": np.asarray(track.arrays.distance.shape[1]),
        "centerline": track.centerline,
        "text": np.array(json.dumps([note, track.content_hash, own])),
    }


def _restore(files: MapFiles, stored: dict[str, NDArray[Any]]) -> tuple[Track, str] | None:
    """Return the track of arrays from `_flatten`; None if an array is missing."""
    try:
        drivable = np.unpackbits(stored["drivable"], axis=1, count=int(stored["columns"])).view(np.bool_)
        note, content_hash, own = json.loads(str(stored["text"]))
        center = _read_only(stored["centerline"])
        values: dict[str, Any] = {name: stored[name] for name in TrackArrays._fields if name != "distance"}
    except (KeyError, ValueError):
        return None
    for name, value in values.items():
        if value.ndim == 0:
            values[name] = float(value)
    arrays = TrackArrays(distance=distance_to_walls(drivable, values["cell"]), **values)
    calibration = {preset: calibration_from_values(values) for preset, values in own.items()}
    return Track(files.name, arrays, center, calibration, files.folder, content_hash), note


def _check_centre(arrays: TrackArrays, center: Floats, label: str) -> None:
    """Raise an error unless the points of a centre line lie on the track."""
    cols, rows = np.floor((center[:, :2] - [arrays.origin_x, arrays.origin_y]) / arrays.cell).astype(np.int64).T
    height, width = arrays.distance.shape
    on = (rows >= 0) & (cols >= 0) & (rows < height) & (cols < width)
    on[on] = arrays.distance[rows[on], cols[on]] > 0.0
    if not on.all():
        x, y = center[np.argmin(on), :2]
        raise MapError(f"{label} leaves the track at ({x:.2f}, {y:.2f}): it must stay between the walls")


def _read_only(values: Floats) -> Floats:
    view = values.view()
    view.flags.writeable = False
    return view


@compiled
def _to_frenet(track, points, out):  # type: ignore[no-untyped-def]
    for k in range(points.shape[0]):
        out[k, 0], out[k, 1] = frenet.locate(track, points[k, 0], points[k, 1])


@compiled
def _to_cartesian(track, sd, out):  # type: ignore[no-untyped-def]
    for k in range(sd.shape[0]):
        out[k, 0], out[k, 1], out[k, 2] = frenet.to_cartesian(track, sd[k, 0], sd[k, 1])


@compiled
def _wall_distance(track, points, out):  # type: ignore[no-untyped-def]
    for k in range(points.shape[0]):
        out[k, 0] = frenet.wall_distance(track, points[k, 0], points[k, 1])
