"""Random circuits with grid and race line; map folders of circuits or pictures of walls."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pcs_racing.base.compilation import compiled
from pcs_racing.base.elementary import sine_cosine
from pcs_racing.base.errors import (
    InputError,
    MapError,
    UnknownNameError,
    check_choice,
    check_number,
    check_seed,
    require,
)
from pcs_racing.track.building.build import check_centerline, check_direction
from pcs_racing.track.building.centerline import centerline_from_grid, directed, straightest
from pcs_racing.track.building.curves import (
    curve_length,
    first_crossing,
    resample,
    sample_closed,
    signed_area,
    smooth,
)
from pcs_racing.track.building.raceline import minimum_curvature_raceline, raceline_rows
from pcs_racing.track.building.tracks import build_track
from pcs_racing.track.map_files import MapFolder, read_map, write_map
from pcs_racing.track.mapping.shapes import STYLES, rounded
from pcs_racing.track.track import Track

WALL = 0.1  # thickness of the drawn walls, m
RADIUS_RATIO = 1.2  # min radius of the centre line in half widths: below 1 the inner wall folds
STRAIGHT = 8.0  # min length of a circuit's longest straight, m
HAIRPIN_STRAIGHT = 15.0  # min length of two straights, for circuits of style hairpin, m
ZONES = 3  # min number of braking zones
EASING = 2.5  # waves of this length are halved in the rounded outline, for gradual curvature, m


@dataclass(frozen=True, eq=False)
class Circuit:
    """A generated circuit: the content of a map folder."""

    #: shape (M, 4): x, y, width to the right and to the left (m), evenly spaced, about 0.3 m apart.
    centerline: np.ndarray
    raceline: np.ndarray  #: shape (N, 2): Race line points, m, evenly spaced, about 0.2 m apart.
    occupied: np.ndarray  #: shape (H, W), bool: True in walls; row 0 is the bottom.
    resolution: float  #: Side of a cell in m.
    origin: np.ndarray  #: shape (2,): Lower left corner of cell [0, 0], m.

    @property
    def length(self) -> float:
        """Length of the centre line in m."""
        return sample_closed(self.centerline[:, :2], 0.3).length


def generate_circuit(
    seed: int,
    style: str = "hull",
    *,
    width: float = 2.2,
    length_range: tuple[float, float] = (60.0, 180.0),
    direction: str = "counterclockwise",
    resolution: float = 0.05,
    attempts: int = 400,
) -> Circuit:
    """Generate the first acceptable circuit of a seed.

    A draft is accepted if its centre line is simple and nowhere tighter than 1.2 half widths, if
    two stretches of track never share a wall, if it has a straight of at least 8 m (style hairpin:
    two of at least 15 m), and if its race line has at least three braking zones. It begins at the
    origin, on its straightest stretch.

    Parameters
    ----------
    seed : int
        Seed, at least 0. Attempt k draws from ``SeedSequence(seed, spawn_key=(style, k))``.
    style : {"hull", "voronoi", "hairpin"}
        Flowing; angular with the most braking zones; long straights into hairpins.
    width : float
        Width of the track in m, from 1.2 to 10.
    length_range : tuple of float
        Min and max length of the centre line in m.
    direction : {"counterclockwise", "clockwise"}
        Driving direction.
    resolution : float
        Side of a cell of the grid in m, from 0.02 to 0.2.
    attempts : int
        Max number of drafts.
    """
    require("clarabel")
    check_choice("style", style, STYLES, UnknownNameError)
    check_choice("direction", direction, ("counterclockwise", "clockwise"))
    check_number("width", width, 1.2, 10.0)
    check_number("resolution", resolution, 0.02, 0.2)
    shortest, longest = (float(value) for value in length_range)
    if not 10.0 * width <= shortest < longest <= 1000.0:
        raise InputError(
            f"length_range is {length_range!r}: two lengths are needed, ascending, from 10 widths"
            " to 1000 m"
        )
    check_seed(seed)
    refusals: Counter[str] = Counter()
    for attempt in range(attempts):
        key = (list(STYLES).index(style), attempt)
        rng = np.random.default_rng(np.random.SeedSequence(int(seed), spawn_key=key))
        line, refusal = _draft(rng, style, width, shortest, longest)
        if line is not None:
            # The start line is at the origin, as in f1tenth_racetracks.
            line = directed(np.roll(line, -straightest(line), axis=0), direction)
            line = line - line[0]
            grid, origin = walls_to_grid(line, width, resolution)
            try:
                raceline = minimum_curvature_raceline(line, grid, resolution, origin)
            except MapError:
                refusal = "without a race line"
            else:
                if braking_zones(raceline_rows(raceline)[:-1, 5]) >= ZONES:
                    center = np.hstack([line, np.full((len(line), 2), 0.5 * width)])
                    return Circuit(center, raceline, grid, resolution, origin)
                refusal = "with too few braking zones"
        refusals[refusal] += 1
    why = ", ".join(f"{count} {reason}" for reason, count in refusals.most_common())
    raise MapError(
        f"no circuit of style {style!r} came from seed {seed} in {attempts} drafts: {why}"
    )


def straights(line: np.ndarray) -> np.ndarray:
    """Return the lengths (m) of the straights of a closed line, longest first.

    A stretch with less curvature than a circle of 25 m radius is straight.
    """
    samples = sample_closed(line, 0.2)
    straight = np.abs(samples.kappa) < 1.0 / 25.0
    if straight.all():
        return np.array([samples.length])
    # Begin in a bend, so that no straight is cut in two.
    straight = np.roll(straight, -int(np.argmin(straight)))
    edges = np.flatnonzero(np.diff(straight.astype(int), append=0))
    return np.sort(np.diff(edges)[::2])[::-1] * (samples.length / len(straight))


def braking_zones(v: np.ndarray) -> int:
    """Return the number of stretches of a closed line with a drop of ``v`` of at least 1 m/s."""
    v = np.roll(v, -int(np.argmax(v)))
    falling = np.diff(v, append=v[0]) < 0.0
    edges = np.flatnonzero(np.diff(falling.astype(int), prepend=0, append=0))
    return sum(
        v[begin] - v[end % len(v)] >= 1.0
        for begin, end in zip(edges[::2], edges[1::2], strict=True)
    )


def walls_to_grid(
    line: np.ndarray, width: float, resolution: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return a grid with two thin walls, ``width`` m apart, along a centre line (as in real maps).

    Returns ``occupied`` and its lower left corner in m, a multiple of the resolution.
    """
    dense = resample(line, resolution)
    border = 0.5 * width + WALL + 0.5
    low = np.floor((dense.min(axis=0) - border) / resolution)
    cols, rows = (np.ceil((dense.max(axis=0) + border) / resolution) - low).astype(int)
    # At least two cells: else a car could pass between the corners of two cells.
    wall = max(WALL, 2.0 * resolution)
    distance = _distance_to_points(
        dense / resolution - low, int(rows), int(cols), (0.5 * width + wall) / resolution
    )
    return (distance >= 0.5 * width / resolution) & np.isfinite(distance), low * resolution


@compiled
def _distance_to_points(points, rows, cols, reach):
    """Return the distance (cells) of cell centres to the nearest point; inf beyond ``reach``."""
    best = np.full((rows, cols), np.inf)
    for k in range(points.shape[0]):
        x, y = points[k]
        for i in range(max(int(y - reach), 0), min(int(y + reach) + 2, rows)):
            for j in range(max(int(x - reach), 0), min(int(x + reach) + 2, cols)):
                d = (j + 0.5 - x) ** 2 + (i + 0.5 - y) ** 2
                if d <= reach * reach and d < best[i, j]:
                    best[i, j] = d
    return np.sqrt(best)


def _draft(
    rng: np.random.Generator, style: str, width: float, shortest: float, longest: float
) -> tuple[np.ndarray | None, str]:
    """Return the centre line of one draft, or None and the reason for its rejection."""
    corners = STYLES[style](rng)
    # The cheap checks come first, because most drafts fail.
    if len(corners) < 3 or first_crossing(corners)[0] >= 0 or signed_area(corners) <= 0.0:
        return None, "with an outline that is not simple"
    length = rng.uniform(shortest, longest)
    turn = rng.uniform(0.0, 2.0 * np.pi)
    sine, cosine = sine_cosine(turn)
    least = 0.5 * RADIUS_RATIO * width
    radii = least + rng.exponential(2.5, size=len(corners))
    # Rounding shortens the line: scale twice.
    for _ in range(2):
        corners = corners * (length / curve_length(corners))
        line = resample(rounded(corners, radii, 0.1), 0.1)
        length *= length / curve_length(line)
    x, y = smooth(line, EASING).T
    line = np.column_stack([x * cosine - y * sine, x * sine + y * cosine])
    samples = sample_closed(line, 0.3)
    if not shortest <= samples.length <= longest:
        return None, "of the wrong length"
    # Checked from a reader's view, with the points only.
    if np.abs(sample_closed(samples.xy, 0.02).kappa).max() > 1.0 / least:
        return None, "too tight"
    if not _apart(samples.xy, samples.length / len(samples.xy), width + 2.0 * WALL + 0.2):
        return None, "too close to itself"
    long = np.append(straights(samples.xy), (0.0, 0.0))
    if long[0] < STRAIGHT or (style == "hairpin" and long[1] < HAIRPIN_STRAIGHT):
        return None, "without long straights"
    return samples.xy, ""


@compiled
def _apart(line, step, distance):
    """Return whether non-neighbouring points of a closed line are a min distance apart.

    Neighbours are points within a half circle of that diameter: the limit of a legal hairpin.
    """
    n = line.shape[0]
    near = int(0.5 * np.pi * distance / step) + 1
    for i in range(n):
        for j in range(i + near, min(n, i + n - near + 1)):
            if (line[i, 0] - line[j, 0]) ** 2 + (
                line[i, 1] - line[j, 1]
            ) ** 2 < distance * distance:
                return False
    return True


def generate_map(
    folder: str | Path,
    seed: int,
    style: str = "hull",
    *,
    name: str | None = None,
    description: str = "",
    direction: str = "counterclockwise",
    width: float = 2.2,
    length_range: tuple[float, float] = (60.0, 180.0),
    resolution: float = 0.05,
) -> Track:
    """Generate a circuit and write its map folder: grid, lines, and settings of the generation.

    The default name is the folder's name; see ``generate_circuit`` for the other parameters.
    """
    settings: dict[str, Any] = {
        "seed": seed,
        "style": style,
        "direction": direction,
        "width": width,
        "length_range": list(length_range),
        "resolution": resolution,
    }
    info = {"description": description or f"Generated circuit of style {style}", "license": "MIT"}
    circuit = generate_circuit(**settings)
    x, y = circuit.origin.tolist()
    grid = (circuit.occupied, circuit.resolution, (x, y))
    return _save(Path(folder), name, grid, circuit.centerline, circuit.raceline, info | settings)


def import_map(
    source: str | Path,
    destination: str | Path,
    *,
    seed_point: Sequence[float] | None = None,
    direction: str | float | None = None,
    name: str | None = None,
) -> Track:
    """Complete a map folder: centre line from the grid, race line from the centre line.

    The source needs only ``NAME_map.yaml`` and its picture; the destination, another folder, gives
    the default of ``name``. ``seed_point`` and ``direction`` are as for ``centerline_from_grid``,
    with defaults from the source's centre line, if any.
    """
    target = Path(destination)
    if target.resolve() == Path(source).resolve():
        raise MapError(f"destination {target} is the source itself: choose another folder")
    content = read_map(Path(source))
    if content.centerline is not None:
        # The given centre line decides the start and the driving direction.
        line = check_centerline(content.centerline, f"{source}: the centre line")[:, :2]
        if content.raceline is not None and direction is None:
            check_direction(content.raceline[:, 1:3], line, str(source))
        seed_point = line[0].tolist() if seed_point is None else seed_point
        direction = (
            ("counterclockwise", "clockwise")[signed_area(line) < 0.0]
            if direction is None
            else direction
        )
    grid = (content.occupied, content.resolution, content.origin)
    center = centerline_from_grid(*grid, seed_point=seed_point, direction=direction)
    race = minimum_curvature_raceline(center, *grid)
    return _save(target, name, grid, center, race, content.info)


def _save(
    folder: Path,
    name: str | None,
    grid: tuple[np.ndarray, float, tuple[float, float]],
    center: np.ndarray,
    race: np.ndarray,
    info: dict[str, Any],
) -> Track:
    name = folder.name if name is None else name
    rows = raceline_rows(race)
    # Nothing is written unless the result is a valid track.
    track = build_track(name, *grid, center, rows[:-1, 1:3], folder=folder)
    write_map(MapFolder(name, folder, *grid, center, rows, info))
    return track
