"""A picture of a circuit: road, walls, race line coloured by speed, start line."""

import io
import os
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from PIL import Image

from pcs_racing.base.errors import require
from pcs_racing.base.files import write_atomically
from pcs_racing.track.building.raceline import lap_time
from pcs_racing.track.frenet import LEFT, PSI, RIGHT, SPEED, X, Y

if TYPE_CHECKING:
    from pcs_racing.track.track import Track


def show_track(track: "Track", path: str | os.PathLike[str]) -> None:
    """Draw a track to a file in the format of its name (png, svg, pdf)."""
    require("matplotlib", extra="plots")
    from matplotlib.collections import LineCollection
    from matplotlib.colors import ListedColormap
    from matplotlib.figure import Figure

    arrays = track.arrays
    line = arrays.line
    xy = line[:, (X, Y)]
    low = np.minimum(arrays.walls[:, :2].min(axis=0), arrays.walls[:, 2:].min(axis=0)) - 1.0
    high = np.maximum(arrays.walls[:, :2].max(axis=0), arrays.walls[:, 2:].max(axis=0)) + 1.0
    size = high - low
    # As high as the circuit asks for, within reason: 8 inches wide, of which the bar of speeds takes a part.
    figure = Figure(figsize=(8.0, min(max(6.88 * size[1] / size[0] + 0.9, 3.0), 16.0)), layout="constrained")
    axes = figure.add_subplot()

    rows, cols = arrays.distance.shape
    extent = (
        arrays.origin_x,
        arrays.origin_x + cols * arrays.cell,
        arrays.origin_y,
        arrays.origin_y + rows * arrays.cell,
    )
    road = np.ma.masked_equal(arrays.distance > 0.0, False)
    axes.imshow(road, cmap=ListedColormap(["#e4e6ea"]), origin="lower", extent=extent, interpolation="nearest")
    axes.add_collection(LineCollection(list(arrays.walls.reshape(-1, 2, 2)), colors="#30343b", linewidths=1.2))

    segments = np.stack([xy, np.roll(xy, -1, axis=0)], axis=1)
    speeds = LineCollection(list(segments), cmap="turbo", linewidths=1.8, capstyle="round")
    speeds.set_array(line[:, SPEED])
    axes.add_collection(speeds)
    figure.colorbar(speeds, ax=axes, label="speed (m/s)", shrink=0.6, aspect=30)

    along = np.array([np.cos(line[0, PSI]), np.sin(line[0, PSI])])
    left = np.array([-along[1], along[0]])
    ends = np.array([xy[0] - line[0, RIGHT] * left, xy[0] + line[0, LEFT] * left])
    axes.plot(*ends.T, color="black", linewidth=3.0, solid_capstyle="butt")
    axes.plot(*ends.T, color="white", linewidth=3.0, linestyle=(0, (0.7, 0.7)), solid_capstyle="butt")
    head = xy[0] + 3.0 * along
    axes.annotate("", head, xy[0], arrowprops={"arrowstyle": "-|>", "color": "black", "linewidth": 1.2})

    lap = lap_time(line[:, SPEED], arrays.ds)
    axes.set_title(f"{track.name}: {arrays.length:.0f} m, {lap:.1f} s a lap on the race line")
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), xlabel="x (m)", ylabel="y (m)", aspect="equal")
    axes.spines[["top", "right"]].set_visible(False)

    suffix = Path(path).suffix.lstrip(".") or "png"
    drawn = io.BytesIO()
    figure.savefig(drawn, format=suffix, dpi=90)
    if suffix == "png":
        # A palette makes the file three times smaller, and nothing in it names the program that drew it.
        image = Image.open(drawn).convert("RGB").quantize(128, dither=Image.Dither.NONE)
        drawn = io.BytesIO()
        image.save(drawn, format="png", optimize=True)
    write_atomically(Path(path), lambda file: file.write(drawn.getvalue()))
