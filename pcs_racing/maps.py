"""Map folders: ROS occupancy grid, f1tenth_racetracks lines, and what belongs to a circuit beside them."""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml
from numpy.typing import NDArray
from PIL import Image

from pcs_racing.errors import MapError

__all__ = ["MapFolder", "read_map"]


class MapFolder(NamedTuple):
    """What a map folder holds, read and checked."""

    name: str
    folder: Path
    occupied: NDArray[np.bool_]
    resolution: float
    origin: tuple[float, float]
    centerline: NDArray[np.float64] | None
    raceline: NDArray[np.float64] | None
    info: dict[str, Any]


def read_map(folder: Path) -> MapFolder:
    """Read a map folder."""
    name = folder.name
    path = folder / f"{name}_map.yaml"
    if not path.is_file():
        raise MapError(f"no map in {folder}: {path.name} does not exist")
    info = yaml.safe_load(path.read_text())
    grey = np.asarray(Image.open(folder / info["image"]).convert("L"))[::-1]
    p = (grey if info["negate"] else 255 - grey.astype(np.float64)) / 255.0
    occupied = p > info["occupied_thresh"]
    lines: list[NDArray[np.float64] | None] = []
    for kind, delimiter in (("centerline", ","), ("raceline", ";")):
        at = folder / f"{name}_{kind}.csv"
        lines.append(np.loadtxt(at, delimiter=delimiter, ndmin=2) if at.is_file() else None)
    x, y, _ = info["origin"]
    return MapFolder(name, folder, occupied, float(info["resolution"]), (float(x), float(y)), lines[0], lines[1], {})
