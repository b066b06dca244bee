"""Content of a map folder: parsers of its files (yaml, picture, csv) that check every value, and
the writer.

A parser takes the content of a file, and its path for error messages.
"""

import io
import os
import warnings
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from pcs_racing.base.errors import MapError, check_path, is_number, say
from pcs_racing.base.files import parse_json, write_together
from pcs_racing.base.typing import Floats
from pcs_racing.track.grid import at_cell
from pcs_racing.track.maps import (
    MapFiles,
    find_map,
    label_of,
    parse_ros_yaml,
    parse_yaml,
    picture_of,
    read_bytes,
)

Grid = NDArray[np.bool_]

MAX_PIXELS = 25_000_000  # 5,000 x 5,000, at some 40 bytes of memory each
MAX_POINTS = 100_000  # points of a line: 10 km, one per 0.1 m
PICTURE_FORMATS = ("PNG", "PPM", "BMP")
CENTERLINE_COLUMNS = ("x_m", "y_m", "w_tr_right_m", "w_tr_left_m")
RACELINE_COLUMNS = ("s_m", "x_m", "y_m", "psi_rad", "kappa_radpm", "vx_mps", "ax_mps2")
WAYPOINT_CENTERLINE = ("x_m", "y_m", "d_right", "d_left")
LINE_CELLS = 20  # min extent of thin unknown regions treated as walls
SPECK_CELLS = 2  # max size of dropped dark regions

INFO_KEYS = {
    "description": "a line for people",
    "license": "of the circuit",
    "seed": "of the generator, a whole number",
    "style": "of the generator",
    "direction": "of driving, for the generator",
    "width": "of the track in m, for the generator",
    "length_range": "shortest and longest length in m, for the generator",
    "resolution": "of the grid in m, for the generator",
    "calibration": "for each name of rules speed_range, start_spacing, start_places and left_share",
}
"""Allowed keys of ``NAME_track.yaml``."""


def parse_info(file: Path, data: bytes) -> dict[str, Any]:
    """Parse a file ``NAME_track.yaml`` with the keys `INFO_KEYS`; check the calibration."""
    values = parse_yaml(file, data)
    unknown = [key for key in values if key not in INFO_KEYS]
    if unknown:
        raise MapError(
            f"{file}: unknown {', '.join(map(repr, unknown))}; the keys are {', '.join(INFO_KEYS)}"
        )
    calibration = values.get("calibration", {})
    if not isinstance(calibration, dict) or not all(isinstance(name, str) for name in calibration):
        raise MapError(
            f"{file}: calibration must give values for names of rules, got {calibration!r:.80}"
        )
    for rules, own in calibration.items():
        if not _is_calibration(own):
            raise MapError(
                f"{file}: calibration of {rules} is {own!r:.80}; it must have speed_range [low,"
                " high], start_spacing in m, start_places (for each side [first, last] in m, one"
                " after the other) and left_share, as `pcs-racing track calibrate` writes them"
            )
    return values


def _is_calibration(own: Any) -> bool:
    """Return whether values are a calibration with possible numbers."""
    try:
        low, high = own["speed_range"]
        places = own["start_places"]
        fine = 0.0 < low < high <= 10.0 and len(own) == 4 and 1 <= len(places) <= 2
        fine &= 0.0 <= own["start_spacing"] <= 10.0 and 0.0 <= own["left_share"] <= 1.0
        for side, stretches in places.items():
            ends = np.array(stretches, np.float64)
            along = ends.ravel()
            fine &= isinstance(side, str) and ends.ndim == 2 and ends.shape[1] == 2
            fine &= bool((np.diff(along, prepend=0.0) >= 0.0).all() and along[-1] <= 1e5)
    except (AttributeError, IndexError, KeyError, TypeError, ValueError):
        return False
    return fine


def parse_grid(file: Path, data: bytes, ros: dict[str, Any]) -> Grid:
    """Return a picture's occupancy grid, row 0 at the bottom; ``ros``: from `parse_ros_yaml`.

    A cell is wall if its darkness (255 - grey) / 255 (grey / 255 if negated) is above
    ``occupied_thresh``, and free if it is below ``free_thresh``. Unknown cells between the
    thresholds are wall in regions at least three cells across, and in narrower lines away from
    other walls. Narrow regions at a wall are its soft edges; they count as free, otherwise every
    wall would grow by a cell.
    """
    level = np.arange(256)
    dark = (level if ros["negate"] else 255 - level) / 255.0
    wall = dark > ros["occupied_thresh"]
    grey = _grey(file, data)
    occupied = wall[grey]
    unknown = (~wall & (dark >= ros["free_thresh"]))[grey]
    if unknown.any():
        from scipy import ndimage

        occupied |= ndimage.binary_opening(unknown, np.ones((3, 3)))
        thin, _ = ndimage.label(
            unknown & ~ndimage.binary_dilation(occupied, np.ones((5, 5))), np.ones((3, 3))
        )
        extent = [
            0,
            *(max(part.stop - part.start for part in box) for box in ndimage.find_objects(thin)),
        ]
        occupied |= (np.array(extent) >= LINE_CELLS)[thin]
    return occupied


def turned(grid: Grid, ros: dict[str, Any]) -> tuple[Grid, tuple[float, float]]:
    """Return a grid turned by the yaw of its origin, and the new origin (lower left corner)."""
    sine, cosine = ((0, 1), (1, 0), (0, -1), (-1, 0))[ros["quarters"] % 4]
    height, width = grid.shape
    x, y = ros["origin"]
    left = min(0, width * cosine) + min(0, -height * sine)
    bottom = min(0, width * sine) + min(0, height * cosine)
    # Row 0 is the bottom: numpy's quarter turns have the opposite sense.
    turned = np.ascontiguousarray(np.rot90(grid, -ros["quarters"] % 4))
    return turned, (x + left * ros["resolution"], y + bottom * ros["resolution"])


def without_specks(file: Path, grid: Grid, resolution: float, origin: tuple[float, float]) -> Grid:
    """Return a grid without specks (up to two dark cells, as from mapping), and report them."""
    from scipy import ndimage

    labels, count = ndimage.label(grid, np.ones((3, 3)))
    cells = np.bincount(labels.ravel(), minlength=count + 1)
    small = cells <= SPECK_CELLS
    small[0] = False  # the free cells
    if not small.any():
        return grid
    specks = small[labels]
    i, j = np.argwhere(specks)[0]
    say(
        f"{file}: {np.count_nonzero(small)} specks of up to {SPECK_CELLS} cells are left out, such"
        f" as the one at {at_cell(i, j, len(grid), resolution, np.array(origin))}"
    )
    return grid & ~specks


def parse_waypoints(file: Path, data: bytes) -> tuple[Floats | None, Floats]:
    """Return centre line and race line of a ``global_waypoints.json`` of ForzaETH's race stack.

    The rows are as in the csv files; a missing centre line is None.
    """
    content = parse_json(file, data)

    def table(key: str, columns: tuple[str, ...]) -> Floats:
        try:
            rows = [
                [point[column] for column in columns]
                for point in content[key]["wpnts"][: MAX_POINTS + 1]
            ]
        except (KeyError, TypeError):
            rows = []
        if not 10 <= len(rows) <= MAX_POINTS or not all(
            is_number(value) for row in rows for value in row
        ):
            raise MapError(
                f"{file}: {key} must hold 10 to {MAX_POINTS} wpnts of finite {', '.join(columns)}"
            )
        return np.array(rows, dtype=np.float64)

    race = table("global_traj_wpnts_iqp", RACELINE_COLUMNS)
    return (
        table("centerline_waypoints", WAYPOINT_CENTERLINE)
        if "centerline_waypoints" in content
        else None
    ), race


def parse_csv(file: Path, data: bytes, columns: tuple[str, ...], separator: str) -> Floats:
    """Parse 10 to 100,000 rows of finite numbers, shape (K, columns), and skip '#' comments."""
    try:
        text = io.StringIO(data.decode("utf-8-sig"))
        with warnings.catch_warnings(action="ignore"):  # a file may have no rows
            rows = np.loadtxt(text, delimiter=separator, ndmin=2)
    except UnicodeDecodeError as error:
        raise MapError(f"{file} is no text: a csv file is needed") from error
    except ValueError as error:
        raise MapError(f"{file}: {error}; {_form(columns, separator)}") from error
    if not 10 <= len(rows) <= MAX_POINTS:
        count = f"more than {MAX_POINTS}" if len(rows) > MAX_POINTS else len(rows)
        raise MapError(f"{file} has {count} points: 10 to {MAX_POINTS} are possible")
    bad = ~np.isfinite(rows).all(axis=1)
    if rows.shape[1] != len(columns) or bad.any():
        row = int(np.argmax(bad))
        raise MapError(
            f"{file}: row {row + 1} is {rows[row].tolist()}; {_form(columns, separator)}"
        )
    return rows


def _form(columns: tuple[str, ...], separator: str) -> str:
    names = ", ".join(columns)
    return f"a row is {len(columns)} finite numbers separated by {separator!r}: {names}"


def _grey(file: Path, data: bytes) -> NDArray[np.uint8]:
    """Return the grey levels of a picture, row 0 at the bottom."""
    kinds = ", ".join(PICTURE_FORMATS)
    try:
        with warnings.catch_warnings():
            # Pillow warns of large pictures and refuses huge pictures; MAX_PIXELS is stricter.
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)
            picture = Image.open(io.BytesIO(data), formats=PICTURE_FORMATS)
        width, height = picture.size
        if width * height > MAX_PIXELS:
            raise MapError(
                f"{file} has {width} x {height} pixels: at most {MAX_PIXELS} in all are read"
            )
        picture.load()
    except MapError:
        raise
    except (OSError, ValueError, SyntaxError, EOFError, Image.DecompressionBombError) as error:
        # Pillow's own message names the stream object, not the file.
        words = "another format" if isinstance(error, UnidentifiedImageError) else error
        raise MapError(
            f"{file} can't be read as a picture ({words}): it must be a whole {kinds} file"
        ) from error
    if picture.mode in ("1", "L"):
        return np.asarray(picture.convert("L"))[::-1]
    if picture.mode not in ("P", "LA", "RGB", "RGBA"):
        raise MapError(
            f"{file} has pixels of mode {picture.mode}: save it as an 8-bit grey picture"
        )
    channels = np.asarray(picture.convert("RGBA"))[::-1]
    red = np.ascontiguousarray(channels[..., 0])
    if (channels[..., 3] != 255).any():
        raise MapError(f"{file} has transparent pixels: save it as an 8-bit grey picture")
    if (channels[..., 1] != red).any() or (channels[..., 2] != red).any():
        raise MapError(f"{file} has coloured pixels: save it as an 8-bit grey picture")
    return red


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
    info: dict[str, Any]  #: Content of ``NAME_track.yaml``, see `INFO_KEYS`.


def read_map(path: str | os.PathLike[str]) -> MapFolder:
    """Read a map folder, given the folder or its map yaml file, and check every value.

    `build_track` checks that lines and grid fit together; this function does not.
    """
    files = find_map(path)
    return parse_map(files, read_bytes(files))


def parse_map(files: MapFiles, contents: dict[str, bytes]) -> MapFolder:
    """Parse the result of `read_bytes`; see `read_map`."""
    ros = parse_ros_yaml(files.yaml, contents[files.yaml.name])
    picture = picture_of(files, ros)
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
    occupied, origin = turned(parse_grid(picture, contents[label_of(files, picture)], ros), ros)
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
