"""Maps as the F1TENTH gym reads them, found by name or by path."""

import os
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml
from numpy.typing import NDArray

from pcs_racing.base.errors import MapError, UnknownNameError
from pcs_racing.base.files import MAX_YAML, read_limited
from pcs_racing.f1tenth.kernel import MapGrid
from pcs_racing.track.loading import load_track, with_walls
from pcs_racing.track.map_files import parse_grid, turned
from pcs_racing.track.maps import (
    MAX_BYTES,
    find_map,
    find_shipped,
    list_tracks,
    parse_ros_yaml,
    parse_yaml,
)
from pcs_racing.track.track import Track

FREE_ABOVE = 128  # grey level
OWN_MAPS = "PCS_RACING_GYM_MAPS"
"""Environment variable with the map folder of a program's own copy of the gym."""


class GymMap(NamedTuple):
    """Map, with its track if the map is a track."""

    name: str
    file: Path | None  #: Path of the yaml file.
    picture: Path | None
    resolution: float  #: Side of a cell, m.
    origin: tuple[float, float]  #: x and y of the lower left corner, m.
    free: NDArray[np.bool_]  #: shape (H, W): Free cells, row 0 at the bottom.
    grid: MapGrid
    circuit: Track | None


def find_yaml(name: str | os.PathLike[str]) -> Path:
    """Return a map's yaml file by path (extension optional), by folder, or by the name of a track.

    Names are the folders in ``$PCS_RACING_MAPS`` and the shipped tracks; case does not matter.
    """
    text = os.fspath(name)
    places = [
        Path(folder, f"{text}{end}")
        for folder in (Path(), Path(os.environ.get(OWN_MAPS, "")))
        for end in (".yaml", "_map.yaml")
    ]
    for path in (Path(text), *places):
        if path.suffix in (".yaml", ".yml") and os.path.isfile(path):
            return path
    if os.path.isdir(text):
        return find_map(text).yaml
    folder = os.environ.get("PCS_RACING_MAPS", "")
    wanted = text.replace(" ", "").lower()
    for entry in sorted(Path(folder).iterdir()) if os.path.isdir(folder) else ():
        if entry.is_dir() and entry.name.replace(" ", "").lower() == wanted:
            return find_map(entry).yaml
    try:
        return find_map(find_shipped(text)).yaml
    except UnknownNameError:
        raise MapError(
            f"map {text!r:.200}: there is no file {text:.200}.yaml, and no circuit of that name"
            f" here ({', '.join(list_tracks())}) or in $PCS_RACING_MAPS; the gym's own maps (vegas,"
            " berlin, skirk, levine, Spielberg) are not shipped: give the path of the map's yaml"
            " file without its ending"
        ) from None


def load_map(name: str | os.PathLike[str], ending: str | None = None) -> GymMap:
    """Load a map; ``ending`` is the extension of a picture next to the yaml file.

    By default the yaml file names the picture.
    """
    file = find_yaml(name)
    beside = Path(f"{file.with_suffix('')}.{(ending or '').removeprefix('.')}")
    return _load(
        file, beside if ending and os.path.isfile(beside) else None, file.stat().st_mtime_ns
    )


def framed(free: NDArray[np.bool_], resolution: float, origin: tuple[float, float]) -> MapGrid:
    """Return a grid in the form for compiled code."""
    from scipy import ndimage

    walls = not free.all()
    # Without a wall every distance is infinite: any number above all ranges is enough.
    distance = (
        resolution * ndimage.distance_transform_edt(free) if walls else np.full(free.shape, 1e3)
    )
    return MapGrid(
        np.pad(free, 1),
        np.pad(distance, 1),
        float(origin[0]),
        float(origin[1]),
        resolution,
        bool(free[-1, -1]),
    )


@lru_cache(maxsize=8)
def _load(file: Path, picture: Path | None, stamp: int) -> GymMap:
    values: dict[Any, Any] = parse_yaml(
        file, read_limited(file, MAX_YAML, "the file of a map", MapError)
    )
    # Some files name a picture other than the adjacent picture, or none.
    ros = parse_ros_yaml(file, yaml.safe_dump({"image": "-"} | values).encode())
    picture = picture or file.parent / ros["image"]
    if not os.path.isfile(picture):
        raise MapError(
            f"{file}: the picture {picture.name!r:.200} is not in its folder; map_ext must be the"
            " extension of the picture"
        )
    level = (255 - FREE_ABOVE - 0.5) / 255.0
    rule = ros | {"negate": False, "occupied_thresh": level, "free_thresh": level}
    picture_bytes = read_limited(picture, MAX_BYTES, "the picture of a map", MapError)
    occupied, origin = turned(parse_grid(picture, picture_bytes, rule), ros)
    free = ~occupied
    grid, circuit = framed(free, ros["resolution"], origin), None
    # The track of a map has the gym's walls: its lidar is many times as fast.
    with suppress(MapError, ModuleNotFoundError):
        circuit = with_walls(load_track(file), occupied, ros["resolution"], origin)
    name = file.stem.removesuffix("_map")
    return GymMap(name, file, picture, ros["resolution"], origin, free, grid, circuit)
