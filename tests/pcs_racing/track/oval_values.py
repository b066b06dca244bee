"""What the oval of the tests was built from, as values and as a map folder."""

from pathlib import Path

import numpy as np

from pcs_racing.track.maps import MapFolder, write_map
from pcs_racing.track.track import Track


def oval_values(track: Track) -> dict:
    """What the oval was built from, or nearly so: its grid is cropped, and infield and outfield are walls too."""
    arrays = track.arrays
    return {
        "occupied": arrays.distance == 0.0,
        "resolution": arrays.cell,
        "origin": (arrays.origin_x, arrays.origin_y),
        "centerline": track.centerline.copy(),
        "raceline_xy": track.line[::3, :2].copy(),
    }


def write_oval(oval: Track, home: Path) -> Path:
    """A complete map folder, its name with a space in it."""
    parts = oval_values(oval)
    rows = np.zeros((len(parts["raceline_xy"]) + 1, 7))
    rows[:, 1:3] = np.vstack([parts["raceline_xy"], parts["raceline_xy"][:1]])
    grid = (parts["occupied"], parts["resolution"], parts["origin"])
    own = {"speed_range": [0.9, 1.1], "start_spacing": 0.45, "start_places": {"front": [[1.0, 5.5]]}, "left_share": 0.5}
    info = {"calibration": {"contest": own}}
    return write_map(MapFolder("Big Oval", home / "Big Oval", *grid, parts["centerline"], rows, info))
