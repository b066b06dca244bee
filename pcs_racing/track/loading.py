"""Track loader by name or map folder: missing lines are built, and results are cached."""

import json
import logging
import os
import threading
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.elementary import arctangent2
from pcs_racing.base.errors import InputError, MapError, UnknownNameError
from pcs_racing.base.files import parse_json
from pcs_racing.track.building.build import LINE_SPACING, check_centerline, check_line
from pcs_racing.track.building.clearance import CLEARANCE, checked_grid, wall_clearance
from pcs_racing.track.building.curves import sample_closed
from pcs_racing.track.cache import TRACK, cache_key, load_cached, store
from pcs_racing.track.frenet import TrackArrays
from pcs_racing.track.grid import distance_to_walls
from pcs_racing.track.maps import MapFiles, MapFolder, find_map, find_shipped, parse_map, read_bytes
from pcs_racing.track.track import Track, build_track, calibration_from_values, calibration_values

Floats = NDArray[np.float64]

TOLERANCE = 0.02
"""Max shortfall of a given race line's CLEARANCE, in m: about the size of a cell's corner."""

_log = logging.getLogger("pcs_racing")


def as_track(track: Track | str | os.PathLike[str]) -> Track:
    """Return a track unchanged, or load it by its name or folder."""
    return track if isinstance(track, Track) else load_track(track)


def load_track(name_or_path: str | os.PathLike[str]) -> Track:
    """Load a track by a shipped track's name (in any case), a map folder, or a map's yaml file.

    `pcs_racing.track.maps` describes the files of a folder. Missing lines are built, which needs
    ``pip install "pcs-racing[mapping]"``. The race line is rebuilt if the given line leaves a car
    less than 0.15 m to the walls; the logger ``pcs_racing`` then reports this. Building lines and
    processing the walls takes about a second. The result is cached on disk (see
    `pcs_racing.track.cache`) and in memory for the life of the process: the same map is the same
    object. A map with changed files is loaded again.
    """
    files = find_map(_resolve(name_or_path))
    with _lock:
        kept = _loaded.get(files.yaml)
        # Checked under the lock: two threads with the same map build it once.
        if kept is None or kept.files != files or kept.stamp != _stamp(kept.paths):
            contents = read_bytes(files)
            paths = tuple(files.folder / name for name in contents)
            kept = _Loaded(files, paths, _stamp(paths), _load(files, contents))
            _loaded[files.yaml] = kept
        return kept.track


def with_walls(
    track: Track, occupied: NDArray[np.bool_], resolution: float, origin: tuple[float, float]
) -> Track:
    """Return a track with the walls of another grid (see `build_track`), cached on disk."""
    grid = np.packbits(occupied).tobytes()
    facts = repr((track.content_hash, occupied.shape, resolution, origin)).encode()
    key = cache_key({"walls": grid, "facts": facts}, TRACK)
    restored = _restore(track.name, track.folder, key)
    if restored is not None:
        return restored[0]
    made = build_track(
        track.name, occupied, resolution, origin, track.centerline, track.line[:, :2]
    )
    store(TRACK, key, _flatten(made, ""))
    return made


class _Loaded(NamedTuple):
    files: MapFiles
    paths: tuple[Path, ...]
    stamp: tuple[tuple[int, int], ...] | None
    track: Track


_lock = threading.Lock()
_loaded: dict[Path, _Loaded] = {}


def _resolve(name_or_path: str | os.PathLike[str]) -> Path:
    if not isinstance(name_or_path, str | os.PathLike):
        raise InputError(
            f"track is {name_or_path!r:.80}; it must be the name of a circuit or the path of a map"
        )
    path = Path(name_or_path)
    # A bare name means a shipped track first, even if a folder of that name exists.
    if isinstance(name_or_path, str) and path.name == name_or_path:
        try:
            return find_shipped(name_or_path)
        except UnknownNameError:
            if not os.path.exists(name_or_path):
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
    restored = _restore(files.name, files.folder, key)
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
                calibration={
                    preset: calibration_from_values(values)
                    for preset, values in calibration.items()
                },
                folder=content.folder,
            )
        except MapError as error:
            raise MapError(f"{files.yaml}: {error}") from error
        store(TRACK, key, _flatten(track, note))
    if note:
        _log.warning("track %s: %s", track.name, note)
    return track


def _lines(files: MapFiles, content: MapFolder) -> tuple[Floats, Floats, str]:
    """Return a map's centre and race line, built if missing or unsuitable, and a note on it."""
    from pcs_racing.track.building.centerline import centerline_from_grid
    from pcs_racing.track.building.raceline import minimum_curvature_raceline

    occupied, resolution, origin = checked_grid(
        content.occupied, content.resolution, content.origin, str(files.yaml)
    )
    if not occupied.any():
        raise MapError(
            f"{files.yaml}: the picture has no wall, no cell darker than occupied_thresh"
        )
    center = race = None
    reasons = []
    if content.raceline is None:
        reasons.append("it has no race line")
    else:
        race = check_line(content.raceline[:, 1:3], str(files.raceline))
        points = sample_closed(race, LINE_SPACING).xy
        air = float(wall_clearance(points, occupied, resolution, origin, 1.0).min())
        if air == 0.0:
            raise MapError(
                f"{files.raceline} leads through a wall or off the map: it must stay on the track"
            )
        if air < CLEARANCE - TOLERANCE:
            reasons.append(
                f"its race line comes within {air:.2f} m of a wall ({CLEARANCE} m are needed)"
            )
    if content.centerline is not None:
        try:
            center = check_centerline(content.centerline, str(files.centerline or files.waypoints))
        except MapError:
            if files.centerline is not None:  # may cross itself in the race stack
                raise
    if center is None:
        reasons.append("it has no centre line")
    note = " and ".join(reasons)
    try:
        if center is None:
            heading = None if race is None else float(arctangent2(*(race[1] - race[0])[::-1]))
            seed = None if race is None else race[0]
            center = centerline_from_grid(
                occupied, resolution, origin, seed_point=seed, direction=heading
            )
        if race is None or air < CLEARANCE - TOLERANCE:
            race = minimum_curvature_raceline(center, occupied, resolution, origin)
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            f"track {files.name} must be completed: {note}; {error}", name=error.name
        ) from error
    except MapError as error:
        raise MapError(f"{files.yaml}: {error}") from error
    return center, race, f"{note}; it was made from the picture" if note else ""


def _flatten(track: Track, note: str) -> dict[str, Any]:
    """Return all data of a track as arrays, with the drivable region as distance field."""
    # The distance field is large and quickly computed: one bit per cell is stored instead.
    values = {
        name: np.asarray(value)
        for name, value in track.arrays._asdict().items()
        if name != "distance"
    }
    own = {
        preset: calibration_values(calibration) for preset, calibration in track.calibration.items()
    }
    return values | {
        "drivable": np.packbits(track.arrays.distance > 0.0, axis=1),
        "columns": np.asarray(track.arrays.distance.shape[1]),
        "centerline": track.centerline,
        "text": np.array(json.dumps([note, track.content_hash, own])),
    }


def _restore(name: str, folder: Path | None, key: str) -> tuple[Track, str] | None:
    """Return the track of cached arrays from `_flatten`; None if missing or inconsistent."""
    stored = load_cached(TRACK, key)
    try:
        if stored is None or not _fit(stored):
            return None
        drivable = np.unpackbits(stored["drivable"], axis=1, count=int(stored["columns"])).view(
            np.bool_
        )
        note, content_hash, own = parse_json("the cache", str(stored["text"]))
        center = stored["centerline"]
        center.flags.writeable = False  # as in every Track
        values: dict[str, Any] = {
            name: stored[name] for name in TrackArrays._fields if name != "distance"
        }
    except (KeyError, ValueError, IndexError, TypeError):
        return None
    # A 0-d array has another type than a number: kernels would be compiled again for it.
    for field, value in values.items():
        if value.ndim == 0:
            values[field] = float(value)
    arrays = TrackArrays(distance=distance_to_walls(drivable, values["cell"]), **values)
    calibration = {preset: calibration_from_values(values) for preset, values in own.items()}
    return Track(name, arrays, center, calibration, folder, content_hash), note


def _fit(stored: dict[str, NDArray[Any]]) -> bool:
    """Return whether lengths and indices of arrays agree: compiled code does not check them."""
    samples, walls, stretches = (len(stored[name]) for name in ("line", "walls", "seen_middle"))
    listed, corners = int(stored["seen_start"][-1]), int(stored["corners_start"][-1])
    shapes = {
        **{
            "line": (samples, 9),
            "walls": (walls, 4),
            "seen_middle": (stretches, 2),
            "corners": (2, corners),
        },
        **dict.fromkeys(("seen_start", "corners_start"), (stretches + 1,)),
        **dict.fromkeys(("seen", "seen_distance"), (listed,)),
    }
    rising = all(
        np.diff(stored[name], prepend=0).min() >= 0 for name in ("seen_start", "corners_start")
    )
    known = all(
        0 <= stored[name].min() <= stored[name].max() < n
        for name, n in (("seen", walls), ("lookup", samples))
    )
    return rising and known and all(stored[name].shape == shape for name, shape in shapes.items())
