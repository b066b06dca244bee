"""Parsers for the files of a map folder (yaml, picture, csv), with checks of every value.

The functions do not read from disk. Each takes the content of a file, and its path for error
messages.
"""

import contextlib
import io
import math
import warnings
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from pcs_racing.base import files
from pcs_racing.base.checks import check_number, is_number
from pcs_racing.base.errors import MapError, say
from pcs_racing.base.typing import Floats
from pcs_racing.track.building.causes import at_cell

Grid = NDArray[np.bool_]

MAX_PIXELS = 25_000_000  # 5,000 x 5,000, at some 40 bytes of memory each
MAX_POINTS = 100_000  # points of a line: 10 km, one per 0.1 m
PICTURE_FORMATS = ("PNG", "PPM", "BMP")
CENTERLINE_COLUMNS = ("x_m", "y_m", "w_tr_right_m", "w_tr_left_m")
RACELINE_COLUMNS = ("s_m", "x_m", "y_m", "psi_rad", "kappa_radpm", "vx_mps", "ax_mps2")
WAYPOINT_CENTERLINE = ("x_m", "y_m", "d_right", "d_left")
LINE_CELLS = 20  # min extent of thin unknown regions treated as walls
SPECK_CELLS = 2  # max size of dropped dark regions
ROS_KEYS = ("image", "resolution", "origin", "negate", "occupied_thresh", "free_thresh", "mode")

INFO_KEYS = {
    "description": "a line for people",
    "license": "of the circuit",
    "seed": "of the generator, a whole number",
    "style": "of the generator",
    "direction": "of driving, for the generator",
    "width": "of the track in m, for the generator",
    "length_range": "shortest and longest length in m, for the generator",
    "resolution": "of the grid in m, for the generator",
    "calibration": "for each race preset speed_range, start_spacing, start_places and left_share",
}
"""Allowed keys of ``NAME_track.yaml``."""


def parse_yaml(file: Path, data: bytes) -> dict[Any, Any]:
    """Parse a yaml file with a mapping."""
    values = files.parse_yaml(file, data, MapError)
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
            f"{file}: calibration must give values for each race preset, got {calibration!r:.80}"
        )
    for preset, own in calibration.items():
        if not _is_calibration(own):
            raise MapError(
                f"{file}: calibration of {preset} is {own!r:.80}; it must have speed_range [low,"
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
    content = files.parse_json(file, data)

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
        with warnings.catch_warnings(action="ignore"):  # of a file without rows
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


def _number(file: Path, key: str, value: Any, low: float, high: float) -> float:
    if isinstance(value, str):  # YAML 1.1 reads 5e-2 as text
        with contextlib.suppress(ValueError):
            value = float(value)
    return float(check_number(f"{file}: {key}", value, low, high, error=MapError))


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
