"""Map folders: readers and writers of the occupancy grid, lines and settings of a track.

A folder ``NAME`` holds

- ``NAME_map.yaml`` and its picture: the grid, in the format of ROS map_server,
- ``NAME_centerline.csv`` (optional): x, y, width to the right, width to the left, separated by
  commas,
- ``NAME_raceline.csv`` (optional): s, x, y, psi, kappa, vx, ax, separated by semicolons,
- ``NAME_track.yaml`` (optional, ours): origin and calibration, see `map_files.INFO_KEYS`,
- ``global_waypoints.json`` (optional, of ForzaETH's race stack): the lines, without csv files.

If no file has the name of the folder, the only ``*_map.yaml`` in it, or else the only yaml file
with an image, gives the name.
"""

import io
import os
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml
from numpy.typing import NDArray
from PIL import Image

from pcs_racing.base.artifacts import shipped_folder
from pcs_racing.base.checks import check_path
from pcs_racing.base.errors import MapError, UnknownNameError, choices
from pcs_racing.base.files import MAX_YAML, read_limited, write_together
from pcs_racing.base.typing import Floats
from pcs_racing.track.map_files import (
    CENTERLINE_COLUMNS,
    RACELINE_COLUMNS,
    parse_csv,
    parse_grid,
    parse_info,
    parse_ros_yaml,
    parse_waypoints,
    parse_yaml,
    turned,
    without_specks,
)

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


class MapFolder(NamedTuple):
    """The content of a map folder, in the units of its files."""

    name: str
    folder: Path
    occupied: NDArray[np.bool_]  #: shape (H, W): True in walls; row 0 is the bottom.
    resolution: float  #: Side of a cell in m.
    origin: tuple[float, float]  #: Lower left corner of cell [0, 0] in m.
    centerline: Floats | None  #: shape (M, 4): x, y, width to the right, width to the left, in m.
    #: shape (N, 7): s, x, y, psi, kappa, vx, ax in m, rad and s; the last row repeats the first.
    raceline: Floats | None
    info: dict[str, Any]  #: Content of ``NAME_track.yaml``, see `map_files.INFO_KEYS`.


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


def read_map(path: str | os.PathLike[str]) -> MapFolder:
    """Read a map folder, given the folder or its map yaml file, and check every value.

    `build_track` checks that lines and grid fit together; this function does not.
    """
    files = find_map(path)
    return parse_map(files, read_bytes(files))


def read_bytes(files: MapFiles) -> dict[str, bytes]:
    """Read the files of a map (with its picture), by path within the folder."""
    every = (files.yaml, files.centerline, files.raceline, files.info, files.waypoints)
    texts = [file for file in every if file is not None]
    limits = {".csv": MAX_LINE, ".json": MAX_LINE}
    contents = {
        _label(files, file): read_inside(files.folder, file, limits.get(file.suffix, MAX_YAML))
        for file in texts
    }
    picture = _picture(files, parse_ros_yaml(files.yaml, contents[files.yaml.name]))
    return contents | {_label(files, picture): read_inside(files.folder, picture, MAX_BYTES)}


def parse_map(files: MapFiles, contents: dict[str, bytes]) -> MapFolder:
    """Parse the result of `read_bytes`; see `read_map`."""
    ros = parse_ros_yaml(files.yaml, contents[files.yaml.name])
    picture = _picture(files, ros)
    centerline = raceline = None
    if files.centerline is not None:
        centerline = parse_csv(
            files.centerline, contents[files.centerline.name], CENTERLINE_COLUMNS, ","
        )
    if files.raceline is not None:
        raceline = parse_csv(files.raceline, contents[files.raceline.name], RACELINE_COLUMNS, ";")
    if files.waypoints is not None and raceline is None:
        given, raceline = parse_waypoints(files.waypoints, contents[files.waypoints.name])
        centerline = given if centerline is None else centerline
    occupied, origin = turned(parse_grid(picture, contents[_label(files, picture)], ros), ros)
    return MapFolder(
        name=files.name,
        folder=files.folder,
        occupied=without_specks(picture, occupied, ros["resolution"], origin),
        resolution=ros["resolution"],
        origin=origin,
        centerline=centerline,
        raceline=raceline,
        info=parse_info(files.info, contents[files.info.name]) if files.info is not None else {},
    )


def write_map(content: MapFolder) -> Path:
    """Write a map folder (new, empty, or with a map of the same name), and return it.

    All files appear at once, or none.
    """
    name, folder = content.name, Path(check_path("the folder of a map", content.folder, MapError))
    if (
        not name.isprintable()
        or name != name.strip(" .")
        or not name
        or set(name) & set('/\\:*?"<>|')
    ):
        raise MapError(
            f"{name!r} can't name a map: letters, digits, '-', '_' and spaces between them can"
        )
    same = not folder.exists() or (folder / f"{name}_map.yaml").is_file()
    if not same and not (folder.is_dir() and next(folder.iterdir(), None) is None):
        raise MapError(f"{folder} exists and holds no map called {name}: choose another folder")
    try:
        write_together(folder, _files(content))
    except OSError as error:
        raise MapError(f"can't write {folder}: {error.strerror or error}") from error
    return folder


def _files(content: MapFolder) -> dict[str, bytes]:
    """Return the files' content; csv numbers have 9 decimals, other values are exact."""
    name = content.name
    picture = io.BytesIO()
    grey = np.where(content.occupied[::-1], 0, 255).astype(np.uint8)
    Image.fromarray(grey).convert("1").save(picture, format="PNG", optimize=True)
    ros = {
        "image": f"{name}_map.png",
        "resolution": float(content.resolution),
        "origin": [float(content.origin[0]), float(content.origin[1]), 0.0],
        "negate": 0,
        "occupied_thresh": 0.45,
        "free_thresh": 0.196,
    }
    files = {f"{name}_map.png": picture.getvalue(), f"{name}_map.yaml": _dump(ros)}
    for kind, rows, columns, separator in (
        ("centerline", content.centerline, CENTERLINE_COLUMNS, ","),
        ("raceline", content.raceline, RACELINE_COLUMNS, ";"),
    ):
        if rows is not None:
            text = io.StringIO()
            np.savetxt(
                text,
                rows,
                fmt="%.9f",
                delimiter=f"{separator} ",
                header=f"{separator} ".join(columns),
            )
            files[f"{name}_{kind}.csv"] = text.getvalue().encode()
            # Written values must be readable: invalid values are refused here, not by readers.
            parse_csv(Path(f"{name}_{kind}.csv"), files[f"{name}_{kind}.csv"], columns, separator)
    if content.info:
        files[f"{name}_track.yaml"] = _dump(content.info)
        parse_info(Path(f"{name}_track.yaml"), files[f"{name}_track.yaml"])
    parse_ros_yaml(Path(f"{name}_map.yaml"), files[f"{name}_map.yaml"])
    return files


def _dump(values: dict[str, Any]) -> bytes:
    return yaml.safe_dump(values, sort_keys=False, allow_unicode=True).encode()


def _map_yaml(folder: Path) -> Path:
    """Return the path of the map's yaml file in a folder."""
    own = folder / f"{folder.resolve().name}_map.yaml"
    for file in (own, own.with_name(f"{folder.resolve().name}.yaml")):
        if file.is_file() and (file == own or (folder / WAYPOINTS).is_file()):
            return file
    everything = sorted(
        file for pattern in ("*.yaml", "*.yml") for file in folder.glob(pattern) if file.is_file()
    )
    maps = [file for file in everything if file.stem.endswith("_map")]
    if not maps:
        others = [file for file in everything if not file.stem.endswith("_track")]
        maps = [
            file
            for file in others
            if "image" in parse_yaml(file, read_inside(folder, file, MAX_YAML))
        ]
    if len(maps) > 1:
        names = ", ".join(file.name for file in maps)
        raise MapError(
            f"{folder} holds several maps ({names}): name one of these files instead of the folder"
        )
    if not maps:
        raise MapError(
            f"{folder} holds no map: {own.name}, or any one *_map.yaml as ROS writes it, is needed"
        )
    return maps[0]


def _picture(files: MapFiles, ros: dict[str, Any]) -> Path:
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
            " beside it"
        )
    if not exists:
        raise MapError(
            f"{files.yaml}: image {ros['image']!r} is not there; it must name a picture in the"
            " folder"
        )
    return file


def _label(files: MapFiles, file: Path) -> str:
    return os.path.relpath(file, files.folder)


def read_inside(folder: Path, file: Path, limit: int) -> bytes:
    """Return the content of a file of a folder; refuse links out of the folder."""
    check_path("the path of a file", file, MapError)
    with suppress(OSError, RuntimeError):  # a loop of links is unreadable, too
        if not file.resolve().is_relative_to(folder.resolve()):
            raise MapError(f"{file} is a link out of its folder; put the file itself there")
    return read_limited(file, limit, "the file of a map", MapError)
