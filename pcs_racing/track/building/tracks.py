"""Builders of a track: from a grid and lines, or from the files of a map folder."""

import hashlib
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from pcs_racing.base.elementary import arctangent2, headings, lengths
from pcs_racing.base.errors import MapError
from pcs_racing.base.typing import Floats
from pcs_racing.track.building.build import (
    LINE_SPACING,
    Grid,
    build_arrays,
    check_centerline,
    check_direction,
    check_line,
    free_widths,
)
from pcs_racing.track.building.centerline import centerline_from_grid
from pcs_racing.track.building.clearance import CLEARANCE, checked_grid, wall_clearance
from pcs_racing.track.building.curves import sample_closed
from pcs_racing.track.building.islands import fill_islands
from pcs_racing.track.building.raceline import minimum_curvature_raceline
from pcs_racing.track.frenet import TrackArrays
from pcs_racing.track.grid import distance_to_walls
from pcs_racing.track.map_files import MapFolder, parse_map
from pcs_racing.track.maps import MapFiles
from pcs_racing.track.track import Calibration, Track, calibration_from_values

TOLERANCE = 0.02
"""Max shortfall of a given race line's CLEARANCE, in m: about the size of a cell's corner."""
WIDTH_TOLERANCE = 0.4
"""Max excess of a centre line's stated widths over the picture, m; real tracks reach 0.19."""


def build_track(
    name: str,
    occupied: ArrayLike,
    resolution: float,
    origin: ArrayLike,
    centerline: ArrayLike,
    raceline_xy: ArrayLike,
    *,
    calibration: dict[str, Calibration] | None = None,
    folder: Path | None = None,
) -> Track:
    """Build a track from a grid and its lines.

    Parameters
    ----------
    occupied : array_like of bool, shape (H, W)
        Occupancy grid, True in walls; row 0 is the bottom.
    resolution : float
        Side of a cell in m, in (0, 1].
    origin : array_like, shape (2,)
        Lower left corner of cell [0, 0] in m.
    centerline : array_like, shape (M, 4)
        x, y, width to the right, width to the left, in m.
    raceline_xy : array_like, shape (K, 2)
        Points of the closed race line in m, in driving order: the reference of all Frenet
        coordinates.
    calibration : dict of Calibration, optional
        Speed range and start positions by rules, as far as known.
    folder : Path, optional
        Map folder of the track.
    """
    label = f"track {name}"
    grid, resolution, corner = checked_grid(occupied, resolution, origin, label)
    center = check_centerline(centerline, f"{label}: the centre line")
    race = check_line(raceline_xy, f"{label}: the race line")
    check_direction(race, center, label)
    arrays, drivable = build_arrays(grid, resolution, corner, race, center, label)
    filled, holes, large = fill_islands(drivable, resolution)
    _check_centre(arrays, center, filled, f"{label}: the centre line")
    _check_round(arrays, [holes == hole for hole in large], label)
    for rules, own in (calibration or {}).items():
        last = max(stretches[-1][1] for stretches in own.start_places.values())
        if last >= arrays.length:
            raise MapError(
                f"{label}: the calibration of {rules} has a start place at {last:g} m, but the"
                f" race line is {arrays.length:.2f} m long; calibrate it again"
            )
    # Hash of the data that decide races, not of the files: the picture format does not matter.
    digest = hashlib.sha256(np.packbits(drivable).tobytes())
    for array in (np.array([*drivable.shape, resolution, *corner]), arrays.line, center):
        digest.update(array.tobytes())
    center = center.view()
    center.flags.writeable = False
    return Track(name, arrays, center, dict(calibration or {}), folder, digest.hexdigest())


def _check_centre(arrays: TrackArrays, center: Floats, filled: Grid, label: str) -> None:
    """Check that a centre line lies on the track, and that its stated widths are about right.

    ``filled`` is the drivable region without islands.
    """
    cols, rows = (
        np.floor((center[:, :2] - [arrays.origin_x, arrays.origin_y]) / arrays.cell)
        .astype(np.int64)
        .T
    )
    height, width = arrays.distance.shape
    on = (rows >= 0) & (cols >= 0) & (rows < height) & (cols < width)
    room = np.zeros(len(center))
    room[on] = arrays.distance[rows[on], cols[on]]
    stated = center[:, 2:].min(axis=1)
    if (room < stated - WIDTH_TOLERANCE).any():  # obstacles do not narrow a centre line's track
        room[on] = distance_to_walls(filled, arrays.cell)[rows[on], cols[on]]
    if (room == 0.0).any():
        x, y = center[np.argmin(room), :2]
        raise MapError(
            f"{label} leaves the track at ({x:.2f}, {y:.2f}): it must stay between the walls"
        )
    worst = int(np.argmax(stated - room))
    if stated[worst] > room[worst] + WIDTH_TOLERANCE:
        x, y, right, left = center[worst]
        raise MapError(
            f"{label} states {right:.2f} m to the right and {left:.2f} m to the left wall at"
            f" ({x:.2f}, {y:.2f}), but in the picture a wall is {room[worst]:.2f} m away: line,"
            " widths and picture must fit together"
        )
    ahead = np.roll(center[:, :2], -1, axis=0) - np.roll(center[:, :2], 1, axis=0)
    x, y = ((center[:, :2] - [arrays.origin_x, arrays.origin_y]) / arrays.cell).T
    ahead /= np.maximum(lengths(ahead), 1e-9)[:, None]
    across = arrays.cell * free_widths(filled, x.copy(), y.copy(), ahead)
    over = (center[:, 2:] - across - WIDTH_TOLERANCE).max(axis=0)
    if (over > 0.0).any():
        exchanged = (center[:, 3:1:-1] < across + WIDTH_TOLERANCE).all()
        raise MapError(
            f"{label} states up to {over.max() + WIDTH_TOLERANCE:.2f} m more room to the"
            f" {('right', 'left')[int(np.argmax(over))]} than the picture has"
            f"{': right and left are exchanged' if exchanged else ''}"
        )


def _check_round(arrays: TrackArrays, infields: list[Grid], label: str) -> None:
    """Check that the race line leads round an infield, if there is one."""
    line = (arrays.line[:, :2] - [arrays.origin_x, arrays.origin_y]) / arrays.cell
    turns = []
    for infield in infields:
        angle = headings(line - np.argwhere(infield)[0, ::-1] - 0.5)
        turns.append(abs(float(np.unwrap([*angle, angle[0]])[-1] - angle[0])))
    if turns and max(turns) < np.pi:
        raise MapError(
            f"{label}: the race line is {arrays.length:.1f} m long and leads round no wall: it must"
            " lead all the way round the track"
        )


def build_from_map(files: MapFiles, contents: dict[str, bytes]) -> tuple[Track, str]:
    """Build a track from its files; return it, and a note on lines made from the picture."""
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
                rules: calibration_from_values(values) for rules, values in calibration.items()
            },
            folder=content.folder,
        )
    except MapError as error:
        raise MapError(f"{files.yaml}: {error}") from error
    return track, note


def _lines(files: MapFiles, content: MapFolder) -> tuple[Floats, Floats, str]:
    """Return a map's centre and race line, built if missing or unsuitable, and a note on it."""
    grid = checked_grid(content.occupied, content.resolution, content.origin, str(files.yaml))
    if not content.occupied.any():
        raise MapError(
            f"{files.yaml}: the picture has no wall, no cell darker than occupied_thresh"
        )
    center = given = None
    reasons = []
    if content.raceline is None:
        reasons.append("it has no race line")
    else:
        source = files.raceline or files.waypoints
        given = check_line(content.raceline[:, 1:3], f"{source}: the race line")
        points = sample_closed(given, LINE_SPACING).xy
        air = float(wall_clearance(points, *grid, 1.0).min())
        if air == 0.0:
            raise MapError(
                f"{source}: the race line leads through a wall or off the map: it must stay on the"
                " track"
            )
        if air < CLEARANCE - TOLERANCE:
            reasons.append(
                f"its race line comes within {air:.2f} m of a wall ({CLEARANCE} m are needed)"
            )
    race = None if reasons else given
    if content.centerline is None:
        reasons.append("it has no centre line")
    else:
        source = files.centerline or files.waypoints
        try:
            center = check_centerline(content.centerline, f"{source}: the centre line")
        except MapError as error:
            if files.centerline is not None:  # may cross itself in the race stack
                raise
            reasons.append(f"it has a bad centre line ({error})")
    note = " and ".join(reasons)
    try:
        if center is None:
            heading = None if given is None else float(arctangent2(*(given[1] - given[0])[::-1]))
            seed = None if given is None else given[0]
            center = centerline_from_grid(*grid, seed_point=seed, direction=heading)
        if race is None:
            race = minimum_curvature_raceline(center, *grid)
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            f"track {files.name} must be completed: {note}; {error}", name=error.name
        ) from error
    except MapError as error:
        raise MapError(f"{files.yaml}: {error}") from error
    return center, race, f"{note}; a new one was made from the picture" if note else ""
