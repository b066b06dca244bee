"""2D lidar that measures ranges to walls and to the opponent."""

from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any

import numpy as np
from annotated_types import Interval
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.compilation import compiled
from pcs_racing.base.elementary import sines_cosines
from pcs_racing.base.errors import ConfigError, InputError, check_number
from pcs_racing.base.settings import Checked, Settings
from pcs_racing.car.collision import Rectangle
from pcs_racing.car.lidar_errors import EDGE
from pcs_racing.car.lidar_kernel import (
    FIELD_OF_VIEW,
    MAX_BEAMS,
    MAX_RANGE,
    WORK_SHAPE,
    Beams,
    Pose,
    scan_into,
)
from pcs_racing.car.vehicle import F1TENTH, VehicleParams, load_vehicle
from pcs_racing.track.frenet import locate
from pcs_racing.track.track import Track


@compiled
def _scan_all(track, beams, poses, has_opponent, opponents, half_length, half_width, out):
    work = np.empty(WORK_SHAPE)
    for k in range(poses.shape[0]):
        x, y, psi = poses[k]
        ox, oy, opsi = opponents[k]
        s, _ = locate(track, x, y)
        opponent = Rectangle(ox, oy, opsi, half_length, half_width)
        scan_into(track, beams, Pose(x, y, psi), s, has_opponent, opponent, work, out[k])


def _poses(value: ArrayLike, name: str) -> NDArray[np.float64]:
    try:
        poses = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"{name} must be numbers of shape (..., 3): x, y, psi") from error
    if poses.ndim == 0 or poses.shape[-1] != 3:
        raise InputError(f"{name} must have the shape (..., 3): x, y, psi; got {poses.shape}")
    if not np.isfinite(poses).all():
        raise InputError(
            f"{name} must be finite; got {poses[~np.isfinite(poses).all(axis=-1)][0].tolist()}"
        )
    return poses


def _track(name: str, value: Any) -> Track:
    if not isinstance(value, Track):
        raise ConfigError(
            f"{name} is a {type(value).__name__}; it must be a Track, as load_track returns it"
        )
    return value


@dataclass(frozen=True, eq=False)
class Lidar(Settings):
    """Scanning lidar of a car, on one track."""

    track: Annotated[Track, Checked(_track), "The circuit."]
    beams: Annotated[
        int, Interval(ge=1, le=MAX_BEAMS), "Number of beams; a single beam points straight ahead."
    ] = 1080
    fov: Annotated[float, FIELD_OF_VIEW, "Angle from the first beam to the last, rad."] = 4.7
    max_range: Annotated[float, MAX_RANGE, "Maximum range, m."] = 30.0
    vehicle: Annotated[
        VehicleParams,
        Checked(lambda _, value: load_vehicle(value)),
        "Car that carries the lidar: `scan` mounts it, and changes the ranges, as its parameters"
        ' ``lidar_x`` to ``lidar_step`` say, for instance ``{"lidar_noise": 0.02}``.',
    ] = F1TENTH

    @cached_property
    def angles(self) -> NDArray[np.float64]:
        """Beam angles from the heading, shape (beams,), rad, counter-clockwise; read-only."""
        angles = (
            np.linspace(-0.5 * self.fov, 0.5 * self.fov, self.beams)
            if self.beams > 1
            else np.zeros(1)
        )
        angles.flags.writeable = False
        return angles

    @cached_property
    def kernel(self) -> Beams:
        """Beams in the form for `scan_into`."""
        step = self.fov / (self.beams - 1) if self.beams > 1 else 2.0 * np.pi
        sin, cos = sines_cosines(self.angles)
        cos.flags.writeable = sin.flags.writeable = False
        return Beams(float(self.angles[0]), float(step), float(self.max_range), cos, sin)

    def scan(
        self,
        poses: ArrayLike,
        opponents: ArrayLike | None = None,
        *,
        opponent_size: tuple[float, float] = (0.58, 0.31),
        rng: np.random.Generator | None = None,
    ) -> NDArray[np.float64]:
        """Measure the ranges from any number of poses.

        Parameters
        ----------
        poses : array_like, shape (..., 3)
            x, y (m) and psi (rad) of the car.
        opponents : array_like, shape (..., 3), optional
            Pose of one other car for each scan; broadcast to the shape of ``poses``.
        opponent_size : tuple of float
            Length and width of the other car, m.
        rng : numpy.random.Generator, optional
            Source of noise and lost beams; required if the car's lidar has them, else unused.

        Returns
        -------
        ndarray, shape (..., beams)
            Ranges in [0, max_range], m; all 0 for a pose inside a wall or off the map.
        """
        at = _poses(poses, "poses")
        others = at
        if opponents is not None:
            others = _poses(opponents, "opponents")
            try:
                others = np.broadcast_to(others, at.shape)
            except ValueError as error:
                message = (
                    f"opponents of shape {others.shape} can't be broadcast to poses of shape"
                    f" {at.shape}"
                )
                raise InputError(message) from error
        length, width = opponent_size
        check_number("the opponent's length", length, 1e-3, 1e3)
        check_number("the opponent's width", width, 1e-3, 1e3)
        car = self.vehicle
        if max(car.lidar_noise, car.lidar_lost) > 0.0 and not isinstance(rng, np.random.Generator):
            raise InputError(
                f"a lidar with noise or lost beams needs rng, a numpy.random.Generator, got {rng!r}"
            )
        out = np.empty((at.size // 3, self.beams))
        # Writeable, although no code writes to it: numba compiles read-only arrays as a separate
        # type.
        _scan_all(
            self.track.arrays,
            self.kernel,
            np.require(self._mounted(at.reshape(-1, 3)), requirements=["C", "W"]),
            opponents is not None,
            np.require(others.reshape(-1, 3), requirements=["C", "W"]),
            0.5 * length,
            0.5 * width,
            out,
        )
        return self._reported(out, rng).reshape(*at.shape[:-1], self.beams)

    def _mounted(self, poses: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the poses of the lidar, from the poses (n, 3) of its car."""
        car = self.vehicle
        if (car.lidar_x, car.lidar_y, car.lidar_yaw) == (0.0, 0.0, 0.0):
            return poses
        sin, cos = sines_cosines(poses[:, 2])
        moved = [
            cos * car.lidar_x - sin * car.lidar_y,
            sin * car.lidar_x + cos * car.lidar_y,
            np.full(len(poses), car.lidar_yaw),
        ]
        return poses + np.stack(moved, axis=1)

    def _reported(
        self, ranges: NDArray[np.float64], rng: np.random.Generator | None
    ) -> NDArray[np.float64]:
        """Return the ranges that the lidar reports in place of exact ranges.

        These are the errors of :mod:`pcs_racing.car.lidar_errors`, drawn from a generator.
        """
        car, most = self.vehicle, self.max_range
        if car.lidar_bias != 0.0:
            ranges = np.where(ranges < most, ranges + car.lidar_bias, ranges)
        if rng is not None and car.lidar_noise > 0.0:
            ranges = ranges + rng.normal(0.0, car.lidar_noise, ranges.shape)
        if (step := car.lidar_step) > 0.0:
            ranges = np.where(ranges < most, step * np.floor(ranges / step + 0.5), ranges)
        gone = np.abs(self.angles) > 0.5 * car.lidar_fov + EDGE
        if rng is not None and car.lidar_lost > 0.0:
            gone = gone | (rng.random(ranges.shape) < car.lidar_lost)
        return np.where(gone, most, np.clip(ranges, 0.0, most))
