"""Track loader by name or map folder: missing lines are built, and results are cached."""

import json
import logging
import os
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.errors import InputError, UnknownNameError
from pcs_racing.track.cache import TRACK, cache_key, load_cached, store
from pcs_racing.track.frenet import TrackArrays
from pcs_racing.track.grid import distance_to_walls
from pcs_racing.track.maps import MapFiles, find_map, find_shipped, read_bytes
from pcs_racing.track.track import Track, calibration_from_values, calibration_values

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
    contents = read_bytes(files)
    key = cache_key(contents, TRACK)
    with _lock:  # two threads with the same map build it once
        if (files, key) not in _loaded:
            _loaded[files, key] = _load(files, contents, key)
        return _loaded[files, key]


def with_walls(
    track: Track, occupied: NDArray[np.bool_], resolution: float, origin: tuple[float, float]
) -> Track:
    """Return a track with the walls of another grid (see `build_track`), cached on disk."""
    grid = np.packbits(occupied).tobytes()
    facts = repr((track.content_hash, occupied.shape, resolution, origin)).encode()
    key = cache_key({"walls": grid, "facts": facts}, TRACK)
    line = track.line[:, :2]

    def build() -> tuple[Track, str]:
        from pcs_racing.track.building.tracks import build_track

        made = build_track(track.name, occupied, resolution, origin, track.centerline, line)
        return made, ""

    return _cached(track.name, track.folder, key, build)[0]


_lock = threading.Lock()
_loaded: dict[tuple[MapFiles, str], Track] = {}


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


def _load(files: MapFiles, contents: dict[str, bytes], key: str) -> Track:
    """Return the track of a map's files, and report lines made from the picture."""

    def build() -> tuple[Track, str]:
        from pcs_racing.track.building.tracks import build_from_map

        return build_from_map(files, contents)

    track, note = _cached(files.name, files.folder, key, build)
    if note:
        _log.warning("track %s: %s", track.name, note)
    return track


def _cached(
    name: str, folder: Path | None, key: str, build: Callable[[], tuple[Track, str]]
) -> tuple[Track, str]:
    """Return a track and its note from the cache on disk, or build and cache them."""
    found = _restore(name, folder, key)
    if found is None:
        found = build()
        store(TRACK, key, _flatten(*found))
    return found


def _flatten(track: Track, note: str) -> dict[str, Any]:
    """Return all data of a track as arrays, with the drivable region as distance field."""
    # The distance field is large and quickly computed: one bit per cell is stored instead.
    values = {
        name: np.asarray(value)
        for name, value in track.arrays._asdict().items()
        if name != "distance"
    }
    own = {
        rules: calibration_values(calibration) for rules, calibration in track.calibration.items()
    }
    return values | {
        "drivable": np.packbits(track.arrays.distance > 0.0, axis=1),
        "columns": np.asarray(track.arrays.distance.shape[1]),
        "centerline": track.centerline,
        "text": np.array(json.dumps([note, track.content_hash, own])),
    }


def _restore(name: str, folder: Path | None, key: str) -> tuple[Track, str] | None:
    """Return the track of cached arrays from `_flatten`, and its note; None if missing."""
    stored = load_cached(TRACK, key)
    if stored is None:
        return None
    # A 0-d array has another type than a number: kernels would be compiled again for it.
    values: dict[str, Any] = {
        key: value if value.ndim else value.item() for key, value in stored.items()
    }
    note, content_hash, own = json.loads(values.pop("text"))
    center = values.pop("centerline")
    center.flags.writeable = False  # as in every Track
    drivable = np.unpackbits(values.pop("drivable"), axis=1, count=values.pop("columns"))
    distance = distance_to_walls(drivable.view(np.bool_), values["cell"])
    arrays = TrackArrays(distance=distance, **values)
    calibration = {rules: calibration_from_values(values) for rules, values in own.items()}
    return Track(name, arrays, center, calibration, folder, content_hash), note
