"""The Track class with the immutable data of a track."""

import json
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from pcs_racing.base.compilation import compiled
from pcs_racing.base.typing import Floats
from pcs_racing.track import frenet
from pcs_racing.track.frenet import KAPPA, LEFT, RIGHT, SPEED, TrackArrays


@dataclass(frozen=True)
class Calibration:
    """Speed range and start positions of a track under rules, by `pcs_racing.race.calibration`."""

    speed_range: tuple[float, float]  #: Scales of the speed profile at pace 0 and pace 1.
    start_spacing: float  #: Distance between the cars across the track at the start, m.
    #: Stretches of start positions by favoured side ("left" and "right", or "front"): arc lengths
    #: of the first and the last position, m, ascending.
    start_places: dict[str, tuple[tuple[float, float], ...]]
    #: Share of start lines from positions in favour of the left car, for equal wins of both sides.
    left_share: float = 0.5


def calibration_values(calibration: Calibration) -> dict[str, Any]:
    """Return a calibration as plain lists and numbers, for yaml and json."""
    values: dict[str, Any] = json.loads(json.dumps(asdict(calibration)))
    return values


def calibration_from_values(values: dict[str, Any]) -> Calibration:
    """Return the calibration of checked values; the inverse of `calibration_values`."""
    low, high = values["speed_range"]
    places = {
        side: tuple((float(first), float(last)) for first, last in stretches)
        for side, stretches in values["start_places"].items()
    }
    return Calibration(
        (float(low), float(high)),
        float(values["start_spacing"]),
        places,
        float(values["left_share"]),
    )


@dataclass(frozen=True, eq=False, repr=False)
class Track:
    """A track: race line, walls, distance field.

    Immutable and shared: any number of races, environments and threads use one Track concurrently.
    """

    name: str
    #: Data for compiled kernels. Its arrays are technically writeable, so that all tracks have the
    #: same compiled type, but no code writes to them.
    arrays: TrackArrays
    centerline: Floats  #: shape (M, 4): x, y, right width, left width, in m; as given, read-only.
    #: Calibration by rules, from the map's files; may be empty.
    calibration: dict[str, Calibration] = field(default_factory=dict)
    folder: Path | None = None  #: Map folder of the track.
    #: SHA-256 of the drivable region and the lines, in hexadecimal. Equal tracks have equal hashes,
    #: even if their files differ.
    content_hash: str = ""

    def __repr__(self) -> str:
        return f"Track({self.name!r}, {self.length:.1f} m, content_hash={self.content_hash[:12]!r})"

    @property
    def length(self) -> float:
        """Length of the closed race line in m."""
        return self.arrays.length

    @property
    def line(self) -> Floats:
        """Samples of the race line, shape (N, 9), see `TrackArrays`; read-only."""
        return _read_only(self.arrays.line)

    def to_frenet(self, points: ArrayLike) -> Floats:
        """Return Frenet coordinates (s, d) of points (x, y), shape (..., 2), m; `frenet.locate`."""
        return self._each(_to_frenet, points, 2)

    def to_cartesian(self, sd: ArrayLike) -> Floats:
        """Return points with headings (x, y, psi), shape (..., 3), of (s, d), shape (..., 2)."""
        return self._each(_to_cartesian, sd, 3)

    def wall_distance(self, points: ArrayLike) -> Floats:
        """Return the distance (m) of points, shape (..., 2), to the nearest wall; 0 off track."""
        return self._each(_wall_distance, points, 1)[..., 0]

    def _each(self, function: Any, values: ArrayLike, columns: int) -> Floats:
        pairs = np.ascontiguousarray(values, dtype=np.float64)
        if pairs.shape[-1:] != (2,):
            raise ValueError(
                f"pairs of coordinates of shape (..., 2) are needed, got shape {pairs.shape}"
            )
        out = np.empty((*pairs.shape[:-1], columns))
        function(self.arrays, pairs.reshape(-1, 2), out.reshape(-1, columns))
        return out

    def summary(self) -> str:
        """Return a description of the track in a few lines."""
        line = self.arrays.line
        width = line[:, RIGHT] + line[:, LEFT]
        turn = "left" if line[-1, frenet.PSI] > line[0, frenet.PSI] else "right"
        ranges = ", ".join(
            f"{rules} {own.speed_range[0]:g}-{own.speed_range[1]:g}"
            for rules, own in sorted(self.calibration.items())
        )
        return "\n".join(
            [
                f"{self.name}: {self.length:.1f} m, {turn}-hand",
                (
                    f"  width {width.min():.2f}-{width.max():.2f} m (mean {width.mean():.2f}), "
                    f"{len(self.arrays.walls)} wall segments, cells of {self.arrays.cell:g} m"
                ),
                (
                    f"  race line: tightest radius {1.0 / np.abs(line[:, KAPPA]).max():.2f} m, at"
                    f" least {self.wall_distance(line[:, :2]).min():.2f} m from the walls"
                ),
                (
                    f"  lap at speed scale 1: {(self.arrays.ds / line[:, SPEED]).sum():.1f} s,"
                    f" {line[:, SPEED].min():.1f}-{line[:, SPEED].max():.1f} m/s"
                ),
                f"  speed range: {ranges or 'calibrated when rules first ask for it'}",
            ]
        )


def _read_only(values: Floats) -> Floats:
    view = values.view()
    view.flags.writeable = False
    return view


@compiled
def _to_frenet(track, points, out):
    for k in range(points.shape[0]):
        out[k, 0], out[k, 1] = frenet.locate(track, points[k, 0], points[k, 1])


@compiled
def _to_cartesian(track, sd, out):
    line, ds, length = track.line, track.ds, track.length
    for k in range(sd.shape[0]):
        place = frenet.offset(line, ds, length, sd[k, 0], sd[k, 1])
        out[k, 0], out[k, 1], out[k, 2] = place


@compiled
def _wall_distance(track, points, out):
    for k in range(points.shape[0]):
        out[k, 0] = frenet.wall_distance(track, points[k, 0], points[k, 1])
