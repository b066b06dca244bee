"""Parts of the gym that planners import: its vehicle models and controllers for compiled code, and its lidar."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.checks import check_array
from pcs_racing.base.compilation import compiled
from pcs_racing.base.errors import InputError
from pcs_racing.car.lidar import Lidar
from pcs_racing.car.lidar_kernel import WORK_SHAPE
from pcs_racing.f1tenth.kernel import KS, OLD_ST, ST, handling, pid_accl, pid_steer, scan_map, write_rates
from pcs_racing.f1tenth.maps import GymMap, load_map
from pcs_racing.track.loading import load_track
from pcs_racing.track.maps import list_tracks


@compiled
def _rates(model, x, u, params):  # type: ignore[no-untyped-def]
    p, state, out = np.empty(len(params)), np.zeros(7), np.empty(7)
    for k, value in enumerate(params):
        p[k] = value
    state[: len(x)] = x
    write_rates(state, u[0], u[1], p, handling(p), model, out)
    return out[: len(x)]


@compiled
def vehicle_dynamics_ks(x, u_init, *params):  # type: ignore[no-untyped-def]
    """Time derivative of a kinematic state, shape (5,), under a steering rate and an acceleration."""
    return _rates(KS, x, u_init, params)


@compiled
def vehicle_dynamics_st(x, u_init, *params):  # type: ignore[no-untyped-def]
    """Time derivative of a single-track state, shape (7,), by v1.0.0; parameters in the gym's order, mu to v_max."""
    return _rates(ST, x, u_init, params)


@compiled
def old_dynamics_st(x, u_init, *params):  # type: ignore[no-untyped-def]
    """The same by 0.2.1, which differs below 0.5 m/s."""
    return _rates(OLD_ST, x, u_init, params)


@compiled
def pid(speed, steer, current_speed, current_steer, max_sv, max_a, max_v, min_v):  # type: ignore[no-untyped-def]
    """Acceleration (m/s^2) and steering rate (rad/s) towards a speed and a steering angle."""
    return pid_accl(speed, current_speed, max_a, max_v, min_v), pid_steer(steer, current_steer, max_sv)


class ScanSimulator2D:
    """A lidar on a map; ``eps`` and ``theta_dis`` of the gym's march are ignored, for ranges are exact."""

    def __init__(
        self, num_beams: int, fov: float, eps: float = 1e-4, theta_dis: int = 2000, max_range: float = 30.0
    ) -> None:
        self._some_track = load_track(list_tracks()[0])
        self._lidar = Lidar(self._some_track, num_beams, fov, max_range)
        self._map: GymMap | None = None
        self.num_beams, self.fov, self.max_range = num_beams, fov, max_range

    def set_map(self, map_path: Any, map_ext: str | None = None) -> bool:
        """Measure on this map from now on."""
        self._map = map_path if isinstance(map_path, GymMap) else load_map(map_path, map_ext)
        return True

    def scan(
        self, pose: ArrayLike, rng: np.random.Generator | None = None, std_dev: float = 0.01
    ) -> NDArray[np.float64]:
        """Return the ranges (m) from x, y, heading, shape (num_beams,), with noise if there is a generator."""
        if self._map is None:
            raise InputError("the lidar has no map; call set_map before scan")
        on, out = self._map.circuit, np.empty(self.num_beams)
        x, y, psi = check_array("pose", pose, (3,), least=-1e6, most=1e6).tolist()
        track = (on or self._some_track).arrays
        scan_map(self._map.grid, track, on is not None, self._lidar.kernel, x, y, psi, np.empty(WORK_SHAPE), out)
        return out if rng is None else out + rng.normal(0.0, std_dev, len(out))

    def get_increment(self) -> float:
        """Return the angle between two beams, rad."""
        return self._lidar.kernel.step
