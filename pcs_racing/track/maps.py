"""Map folders: their files, and the bytes in them; `map_files` parses and writes the files.

A folder ``NAME`` holds

- ``NAME_map.yaml`` and its picture: the grid, in the format of ROS map_server,
- ``NAME_centerline.csv`` (optional): x, y, width to the right, width to the left, separated by
  commas,
- ``NAME_raceline.csv`` (optional): s, x, y, psi, kappa, vx, ax, separated by semicolons,
- ``NAME_track.yaml`` (optional, ours): origin and calibration, see `map_files.INFO_KEYS`,
- ``global_waypoints.json`` (optional, of ForzaETH's race stack): the lines, without csv files.

The map is ``NAME_map.yaml`` or ``NAME.yaml``, or else the only other map in the folder: a
``*_map.yaml``, or a yaml file with an image. Two that fit are refused.
"""

import math
import os
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

from pcs_racing.base import files as _files
from pcs_racing.base.errors import MapError, UnknownNameError, check_number, check_path, choices
from pcs_racing.base.files import MAX_YAML, read_limited, shipped_folder

ROS_KEYS = ("image", "resolution", "origin", "negate", "occupied_thresh", "free_thresh", "mode")
MAX_BYTES = 256_000_000  # size of a picture
MAX_LINE = 8_000_000  # bytes: size of a csv or json file
WAYPOINTS = "global_waypoints.json"

_SHIPPED = shipped_folder(Path(__file__).resolve().parents[1], "maps")


class MapFiles(NamedTuple):
    """Paths of the files of a map folder."""

    name: str  #: Name of the track.
    folder: Path
    yaml: Path  #: The map's yaml file.
    centerline: Path | None  #: Path, None if the file is missing (also below).
    raceline: Path | None
    info: Path | None
    waypoints: Path | None


def list_tracks() -> list[str]:
    """Return the sorted names of the shipped tracks."""
    return sorted(
        path.name for path in _SHIPPED.glob("*") if (path / f"{path.name}_map.yaml").is_file()
    )


def find_shipped(name: str) -> Path:
    """Return the folder of a shipped track; the name's case does not matter."""
    tracks = list_tracks()
    for candidate in tracks:
        if candidate.lower() == name.lower():
            return _SHIPPED / candidate
    raise UnknownNameError(
        f"unknown track {name!r}: neither a map folder nor one of the shipped tracks;"
        f" {choices(name.title(), tracks)}"
    )


def find_map(path: str | os.PathLike[str]) -> MapFiles:
    """Find the files of a map folder, given the folder or its map yaml file."""
    folder = Path(path)
    # For invalid file names, functions of os return False, but methods of Path raise errors.
    if os.path.isfile(folder) and folder.suffix in (".yaml", ".yml"):
        yaml_file = folder
        folder = folder.parent
    elif os.path.isdir(folder):
        yaml_file = _map_yaml(folder)
    else:
        raise MapError(
            f"no map folder at {folder}: it must be a folder that holds a *_map.yaml and its"
            " picture"
        )
    name = yaml_file.stem.removesuffix("_map")
    optional = [
        folder / f"{name}_{kind}" for kind in ("centerline.csv", "raceline.csv", "track.yaml")
    ]
    optional.append(folder / WAYPOINTS)
    # Any existing entry is read or refused: a pipe or a broken link is not a missing file.
    return MapFiles(
        name, folder, yaml_file, *(file if os.path.lexists(file) else None for file in optional)
    )


def read_bytes(files: MapFiles) -> dict[str, bytes]:
    """Read the files of a map (with its picture), by path within the folder."""
    every = (files.yaml, files.centerline, files.raceline, files.info, files.waypoints)
    texts = [file for file in every if file is not None]
    limits = {".csv": MAX_LINE, ".json": MAX_LINE}
    contents = {
        label_of(files, file): read_inside(files.folder, file, limits.get(file.suffix, MAX_YAML))
        for file in texts
    }
    picture = picture_of(files, parse_ros_yaml(files.yaml, contents[files.yaml.name]))
    return contents | {label_of(files, picture): read_inside(files.folder, picture, MAX_BYTES)}


def parse_yaml(file: Path, data: bytes) -> dict[Any, Any]:
    """Parse a yaml file with a mapping."""
    values = _files.parse_yaml(file, data, MapError)
    if not isinstance(values, dict):
        raise MapError(f"{file} must hold keys and values, got {type(values).__name__}")
    return values


def parse_ros_yaml(file: Path, data: bytes) -> dict[str, Any]:
    """Parse a ROS map's yaml file, with defaults of ``nav2_map_server``; ignore other keys."""
    values = parse_yaml(file, data)
    missing = [key for key in ("image", "resolution", "origin") if key not in values]
    if missing:
        raise MapError(
            f"{file}: missing {', '.join(map(repr, missing))}; the keys of a ROS map are"
            f" {', '.join(ROS_KEYS)}"
        )
    image, origin, negate = values["image"], values["origin"], values.get("negate", 0)
    if not isinstance(image, str) or not image:
        raise MapError(f"{file}: image must be a file name, got {image!r}")
    if not isinstance(origin, list) or len(origin) != 3:
        raise MapError(f"{file}: origin must be [x, y, yaw], got {origin!r}")
    x, y, yaw = (_number(file, "origin", value, -1e6, 1e6) for value in origin)
    quarters = round(yaw / (0.5 * math.pi))
    if abs(yaw - 0.5 * math.pi * quarters) > 1e-5:
        raise MapError(
            f"{file}: origin has a yaw of {yaw:g} rad; turn the picture, so that it is 0 or a"
            " quarter turn"
        )
    if values.get("mode", "trinary") not in ("trinary", "scale"):
        raise MapError(f"{file}: mode must be trinary or scale, got {values['mode']!r}")
    if negate not in (0, 1):
        raise MapError(f"{file}: negate must be 0 or 1, got {negate!r}")
    resolution = _number(file, "resolution", values["resolution"], 0.0, 1.0)
    if resolution < 1e-3:
        raise MapError(
            f"{file}: resolution must be from 0.001 to 1 metres per cell, got {resolution}"
        )
    occupied = _number(file, "occupied_thresh", values.get("occupied_thresh", 0.65), 0.0, 1.0)
    free = _number(file, "free_thresh", values.get("free_thresh", 0.25), 0.0, 1.0)
    if free > occupied:
        raise MapError(f"{file}: free_thresh {free} must not be above occupied_thresh {occupied}")
    return {
        "image": image,
        "resolution": resolution,
        "origin": (x, y),
        "quarters": quarters,
        "negate": bool(negate),
        "occupied_thresh": occupied,
        "free_thresh": free,
    }


def _map_yaml(folder: Path) -> Path:
    """Return the path of the map's yaml file in a folder."""
    name = folder.resolve().name
    files = [file for pattern in ("*.yaml", "*.yml") for file in folder.glob(pattern)]
    maps = sorted(file for file in files if file.is_file() and _is_map(folder, file))
    maps = [file for file in maps if file.stem in (name, f"{name}_map")] or maps
    if len(maps) > 1:
        names = ", ".join(file.name for file in maps)
        raise MapError(
            f"{folder} holds several maps ({names}): name one of these files instead of the folder"
        )
    if not maps:
        raise MapError(
            f"{folder} holds no map: {name}_map.yaml, or any one *_map.yaml as ROS writes it, is"
            " needed"
        )
    return maps[0]


def _is_map(folder: Path, file: Path) -> bool:
    """Return whether a yaml file is a map, by its name or by an image."""
    if file.stem.endswith(("_map", "_track")):
        return file.stem.endswith("_map")
    with suppress(MapError):
        return "image" in parse_yaml(file, read_inside(folder, file, MAX_YAML))
    return file.stem == folder.resolve().name  # its reader reports the cause


def picture_of(files: MapFiles, ros: dict[str, Any]) -> Path:
    """Return the path of the picture, which must be in the folder after links are resolved."""
    file = files.folder / ros["image"]
    try:
        inside = file.resolve().is_relative_to(files.folder.resolve())
        exists = inside and file.is_file()
    except (OSError, ValueError, RuntimeError):  # too long a name, a zero in it, or a loop of links
        inside, exists = True, False
    if not inside:
        raise MapError(
            f"{files.yaml}: image {ros['image']!r} lies outside the map's folder; put the picture"
            " into that folder"
        )
    if not exists:
        raise MapError(
            f"{files.yaml}: image {ros['image']!r} is not there; it must name a picture in the"
            " folder"
        )
    return file


def label_of(files: MapFiles, file: Path) -> str:
    """Return the path of a file within the map's folder."""
    return os.path.relpath(file, files.folder)


def read_inside(folder: Path, file: Path, limit: int) -> bytes:
    """Return the content of a file of a folder; refuse links out of the folder."""
    check_path("the path of a file", file, MapError)
    with suppress(OSError, RuntimeError):  # a loop of links is unreadable, too
        if not file.resolve().is_relative_to(folder.resolve()):
            raise MapError(f"{file} is a link out of its folder; put the file itself there")
    return read_limited(file, limit, "the file of a map", MapError)


def _number(file: Path, key: str, value: Any, low: float, high: float) -> float:
    if isinstance(value, str):  # YAML 1.1 reads 5e-2 as text
        with suppress(ValueError):
            value = float(value)
    return float(check_number(f"{file}: {key}", value, low, high, error=MapError))
