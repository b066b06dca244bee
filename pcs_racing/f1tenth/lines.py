"""Tracks and lines in the interface of generation B, and its start poses along these lines."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.errors import ConfigError, InputError, MapError, check_array, check_number
from pcs_racing.f1tenth.maps import GymMap, framed, load_map
from pcs_racing.track.frenet import KAPPA, PSI, SPEED
from pcs_racing.track.map_files import CENTERLINE_COLUMNS, RACELINE_COLUMNS, parse_csv
from pcs_racing.track.maps import MAX_LINE, find_map, read_inside

Floats = NDArray[Any]

SPACING = 0.1  # distance between the points of a line without a file, m
CELL = 0.05  # side of a cell of a map without walls, m


def nearest_point_on_trajectory(
    point: ArrayLike, trajectory: ArrayLike
) -> tuple[Floats, float, float, int]:
    """Return the nearest point of a polyline, shape (N, 2), its distance (m), share and segment."""
    corners = np.asarray(trajectory)
    ways = np.diff(corners, axis=0)
    from_corners = np.asarray(point) - corners[:-1]
    shares = np.clip((from_corners * ways).sum(axis=1) / (ways * ways).sum(axis=1), 0.0, 1.0)
    feet = corners[:-1] + shares[:, None] * ways
    distances = np.linalg.norm(np.asarray(point) - feet, axis=1)
    i = int(np.argmin(distances))
    return feet[i], distances[i], shares[i], i


class CubicSpline2D:
    """Closed cubic spline through points."""

    def __init__(self, x: ArrayLike, y: ArrayLike) -> None:
        from scipy.interpolate import CubicSpline

        points = np.stack([np.asarray(x, np.float64), np.asarray(y, np.float64)], axis=1)
        self.points = (
            points if np.array_equal(points[0], points[-1]) else np.vstack([points, points[:1]])
        )
        #: Length along the chords at each point, m.
        self.s = np.concatenate(
            [[0.0], np.cumsum(np.linalg.norm(np.diff(self.points, axis=0), axis=1))]
        )
        if not (np.diff(self.s) > 0.0).all():
            raise InputError("a line repeats a point; its points must differ from one to the next")
        self.spline = CubicSpline(self.s, self.points, bc_type="periodic")

    def calc_position(self, s: float) -> Floats:
        """Return the point at a length, shape (2,), m."""
        return np.asarray(self.spline(s))

    def calc_yaw(self, s: float) -> float:
        """Return the heading at a length, in [0, 2 pi)."""
        dx, dy = self.spline(s, 1)
        return math.atan2(dy, dx) % (2.0 * math.pi)

    def calc_curvature(self, s: float) -> float:
        """Return the curvature at a length, 1/m."""
        (dx, dy), (ddx, ddy) = self.spline(s, 1), self.spline(s, 2)
        return float((ddy * dx - ddx * dy) / (dx * dx + dy * dy) ** 1.5)

    def calc_arclength(self, x: float, y: float, s_guess: float = 0.0) -> tuple[float, float]:
        """Return the length at the nearest point of the polyline, and the point's distance, m."""
        _, distance, share, i = nearest_point_on_trajectory((x, y), self.points)
        return float(self.s[i] + share * (self.s[i + 1] - self.s[i])), float(distance)


class Raceline:
    """Line to follow.

    Attributes are ``xs``, ``ys``, ``yaws``, ``ks``, ``vxs``, ``axs``, ``ss`` (float32), ``n`` and
    ``length`` (m).
    """

    def __init__(
        self,
        xs: Floats,
        ys: Floats,
        velxs: Floats,
        ss: Any = None,
        psis: Any = None,
        kappas: Any = None,
        accxs: Any = None,
        spline: CubicSpline2D | None = None,
    ) -> None:
        if not xs.shape == ys.shape == velxs.shape:
            raise InputError(
                f"xs, ys and velxs have shapes {xs.shape}, {ys.shape}, {velxs.shape}; they must be"
                " equal"
            )
        self.xs, self.ys, self.vxs, self.ss, self.yaws, self.ks, self.axs = (
            xs,
            ys,
            velxs,
            ss,
            psis,
            kappas,
            accxs,
        )
        self.n, self.length = len(xs), float(np.hypot(np.diff(xs), np.diff(ys)).sum())
        self.spline = spline or CubicSpline2D(xs, ys)

    @classmethod
    def from_columns(cls, columns: ArrayLike, spline: CubicSpline2D | None = None) -> "Raceline":
        """Make a line from s, x, y, heading, curvature, speed and acceleration, shape (N, 7)."""
        s, x, y, psi, kappa, speed, acceleration = np.asarray(columns).astype(np.float32).T
        return cls(x, y, speed, s, psi, kappa, acceleration, spline)

    @classmethod
    def through(cls, x: ArrayLike, y: ArrayLike, speeds: ArrayLike) -> "Raceline":
        """Make a line with a point every 0.1 m along the spline through given points.

        Each point has the speed of the nearest given point.
        """
        spline = CubicSpline2D(x, y)
        s = np.arange(0.0, spline.s[-1], SPACING)
        at = spline.spline(s)
        nearest = [
            int(np.argmin(np.hypot(np.asarray(x) - px, np.asarray(y) - py))) for px, py in at
        ]
        rows = [s, *at.T, [spline.calc_yaw(k) for k in s], [spline.calc_curvature(k) for k in s]]
        return cls.from_columns(
            np.stack([*rows, np.asarray(speeds)[nearest], 0.0 * s], axis=1), spline
        )

    def render_waypoints(self, e: Any) -> None:
        """Draw the line, as a render callback."""
        e.render_closed_lines(np.stack([self.xs, self.ys], axis=1), color=(0, 128, 0), size=1)


class TrackSpec(NamedTuple):
    """Content of the yaml file of a map."""

    name: str | None
    image: str | None
    resolution: float
    origin: tuple[float, float, float]
    negate: int = 0
    occupied_thresh: float = 0.65
    free_thresh: float = 0.196


@dataclass(frozen=True, eq=False)
class Track:
    """Map with its lines; a missing line is ``None``."""

    spec: TrackSpec
    occupancy_map: Floats  #: Free cells as 255, others as 0; float32, row 0 at the bottom.
    centerline: Raceline | None
    raceline: Raceline | None
    loaded: GymMap

    @classmethod
    def from_track_name(cls, track: Any) -> Self:
        """Load a track by name (see :func:`pcs_racing.f1tenth.maps.find_yaml`) or path."""
        if not isinstance(track, str | Path):
            raise MapError(
                f"map is {track!r:.200}; it must be the name or the path of a map, or a Track"
            )
        loaded = load_map(track)
        assert loaded.file is not None
        assert loaded.picture is not None
        spec = TrackSpec(loaded.name, loaded.picture.name, loaded.resolution, (*loaded.origin, 0.0))
        files = find_map(loaded.file)
        center = race = None
        if files.centerline is not None:
            x, y = _rows(files.centerline, CENTERLINE_COLUMNS, ",")[:, :2].T
            center = Raceline.through(x, y, np.ones_like(x))
        if files.raceline is not None:
            race = Raceline.from_columns(_rows(files.raceline, RACELINE_COLUMNS, ";"))
        elif loaded.circuit is not None and center is None:
            line = loaded.circuit.line
            s = np.arange(len(line)) * loaded.circuit.arrays.ds
            race = Raceline.from_columns(
                np.stack([s, *line[:, [0, 1, PSI, KAPPA, SPEED]].T, 0.0 * s], axis=1)
            )
        return cls(spec, _levels(loaded.free), center or race, race or center, loaded)

    from_track_path = from_track_name

    @classmethod
    def from_refline(cls, x: ArrayLike, y: ArrayLike, velx: ArrayLike) -> Self:
        """Make a track without walls from points to follow, shape (N,) each, m and m/s."""
        xs, ys, speeds = (
            check_array(name, values, (None,))
            for name, values in zip(("x", "y", "velx"), (x, y, velx), strict=True)
        )
        if not 4 <= len(xs) <= 100_000 or not len(xs) == len(ys) == len(speeds):
            raise InputError(
                f"x, y, velx hold {len(xs)}, {len(ys)}, {len(speeds)} numbers; give 4 or more of"
                " each"
            )
        line = Raceline.through(xs, ys, speeds)
        low, high = np.array([[of(line.xs), of(line.ys)] for of in (np.min, np.max)], np.float64)
        size = high - low
        if float(size.max()) > 500.0:
            raise InputError(f"the line is {size.max():g} m across; it must be at most 500")
        x0, y0 = (low - 0.1 * size).tolist()
        free = np.ones(np.maximum(1.2 * size[::-1] / CELL, 1.0).astype(int), np.bool_)
        loaded = GymMap(
            "empty", None, None, CELL, (x0, y0), free, framed(free, CELL, (x0, y0)), None
        )
        return cls(
            TrackSpec(None, None, CELL, (x0, y0, 0.0)),
            _levels(free),
            line,
            line,
            loaded,
        )

    def frenet_to_cartesian(self, s: float, ey: float, ephi: float) -> tuple[float, float, float]:
        """Return x, y (m) and heading (rad) from a length along the centre line.

        ``ey`` is the offset from the line (m), and ``ephi`` the turn from it (rad).
        """
        line = self._line()
        (x, y), psi = line.calc_position(s), line.calc_yaw(s)
        return float(x - ey * math.sin(psi)), float(y + ey * math.cos(psi)), psi + ephi

    def cartesian_to_frenet(
        self, x: float, y: float, phi: float, s_guess: float = 0.0
    ) -> tuple[float, float, float]:
        """Return the length along the centre line (m), offset to its left (m) and turn (rad)."""
        line = self._line()
        s, _ = line.calc_arclength(x, y)
        (px, py), psi = line.calc_position(s), line.calc_yaw(s)
        across = (y - py) * math.cos(psi) - (x - px) * math.sin(psi)
        return s, math.copysign(math.hypot(x - px, y - py), across), phi - psi

    def _line(self) -> CubicSpline2D:
        if self.centerline is None:
            raise InputError(
                "this map has no centre line and no race line: it has no Frenet coordinates"
            )
        return self.centerline.spline


def _rows(file: Path, columns: tuple[str, ...], separator: str) -> Floats:
    return parse_csv(file, read_inside(file.parent, file, MAX_LINE), columns, separator)


def _levels(free: NDArray[np.bool_]) -> Floats:
    return np.where(free, np.float32(255.0), np.float32(0.0))


_LENGTHS = {"min_dist": 1.5, "max_dist": 2.5, "start_width": 1.0}  # m


def starting_poses(
    track: Track, cars: int, config: Any, rng: np.random.Generator
) -> NDArray[np.float64]:
    """Draw start poses, shape (N, 3), according to a ``reset_config``."""
    if not isinstance(config, Mapping) or config.keys() - {"type", *_LENGTHS}:
        raise ConfigError(
            f"reset_config is {config!r:.200}; its keys are type, {', '.join(_LENGTHS)}"
        )
    kind = config.get("type") or "rl_grid_static"
    words = kind.split("_") if isinstance(kind, str) else []
    choices = (("cl", "rl"), ("grid", "random"), ("static", "random"))
    if len(words) != 3 or any(
        word not in known for word, known in zip(words, choices, strict=True)
    ):
        raise ConfigError(
            f"reset_config: type is {kind!r:.80}; it must be 'cl' or 'rl', 'grid' or 'random',"
            " 'static' or 'random', joined by '_'"
        )
    low, high, width = (
        check_number(
            f"reset_config: {name}", config.get(name, default), 0.01, 100.0, error=ConfigError
        )
        for name, default in _LENGTHS.items()
    )
    if high < low:
        raise ConfigError(
            f"reset_config: max_dist is {high:g} m; it must not be below min_dist, {low:g} m"
        )
    line = track.centerline if words[0] == "cl" else track.raceline
    if line is None:
        raise InputError(
            "this map has no centre line and no race line: give poses, reset(options={'poses':"
            " ...})"
        )
    # From a point of the line onwards, each car is a random distance ahead of the previous car, on
    # alternating sides.
    at = int(
        rng.integers(
            line.n if words[1] == "random" else max(int(width / (line.length / line.n)), 1)
        )
    )
    points = np.stack([line.xs, line.ys], axis=1).astype(np.float64)
    ways = np.linalg.norm(np.roll(points, -1, axis=0) - points, axis=1)
    side = float(rng.choice([-1.0, 1.0])) / cars if words[0] == "cl" and cars > 1 else 0.0
    poses = np.empty((cars, 3))
    for i in range(cars):
        ahead = points[(at + 1) % line.n] - points[at]
        theta = np.arctan2(ahead[1], ahead[0])
        poses[i] = (*points[at] + side * np.array([-np.sin(theta), np.cos(theta)]), theta)
        side = -side
        gone = np.cumsum(np.roll(ways, -at))
        near, far = np.searchsorted(gone, low), np.searchsorted(gone, high, "right")
        at = (at + 1 + int(rng.integers(near, max(far, near + 1)))) % line.n
    if words[2] == "random":
        rng.shuffle(poses)
    return poses
