"""Simulator of the F1TENTH gym's cars, and its imports for planners: models, controllers, lidar."""

import warnings
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.compilation import compiled, first_call
from pcs_racing.base.errors import (
    ConfigError,
    InputError,
    all_finite,
    check_array,
    check_number,
    check_whole,
    did_you_mean,
)
from pcs_racing.base.numba_parts import compiled_for
from pcs_racing.base.typing import Floats
from pcs_racing.car.lidar import Lidar
from pcs_racing.car.lidar_kernel import WORK_SHAPE
from pcs_racing.f1tenth import kernel as k
from pcs_racing.f1tenth.kernel import (
    KS,
    OLD_ST,
    ST,
    handling,
    pid_accl,
    pid_steer,
    scan_map,
    write_rates,
)
from pcs_racing.f1tenth.maps import GymMap, load_map
from pcs_racing.track.loading import load_track
from pcs_racing.track.maps import list_tracks

DEFAULT_PARAMS = {
    "mu": 1.0489,
    "C_Sf": 4.718,
    "C_Sr": 5.4562,
    "lf": 0.15875,
    "lr": 0.17145,
    "h": 0.074,
    "m": 3.74,
    "I": 0.04712,
    "s_min": -0.4189,
    "s_max": 0.4189,
    "sv_min": -3.2,
    "sv_max": 3.2,
    "v_switch": 7.319,
    "a_max": 9.51,
    "v_min": -5.0,
    "v_max": 20.0,
    "width": 0.31,
    "length": 0.58,
}
_POSITIVE = (1e-6, 1e5)
_ENDS = {
    "s_min": (-1.5, 0.0),
    "s_max": (0.0, 1.5),
    "sv_min": (-1e3, 0.0),
    "sv_max": (0.0, 1e3),
    "v_min": (-1e3, -1e-3),
}
NOISE = 0.01  # m
BEAMS, FIELD_OF_VIEW, RANGE = 1080, 4.7, 30.0
MAX_CARS = 64


@compiled
def _rates(model, x, u, params):
    p, state, out = np.empty(len(params)), np.zeros(7), np.empty(7)
    for i, value in enumerate(params):
        p[i] = value
    state[: len(x)] = x
    write_rates(state, u[0], u[1], p, handling(p), model, out)
    return out[: len(x)]


@compiled
def vehicle_dynamics_ks(x, u_init, *params):
    """Return the time derivative of a kinematic state, shape (5,).

    Inputs are a steering rate and an acceleration.
    """
    return _rates(KS, x, u_init, params)


@compiled
def vehicle_dynamics_st(x, u_init, *params):
    """Return the time derivative of a single-track state, shape (7,), as in v1.0.0.

    Parameters are in the gym's order, mu to v_max.
    """
    return _rates(ST, x, u_init, params)


@compiled
def old_dynamics_st(x, u_init, *params):
    """Return the time derivative as in 0.2.1, different from v1.0.0 below 0.5 m/s."""
    return _rates(OLD_ST, x, u_init, params)


@compiled
def pid(speed, steer, current_speed, current_steer, max_sv, max_a, max_v, min_v):
    """Return acceleration (m/s^2) and steering rate (rad/s) towards a speed and an angle."""
    return pid_accl(speed, current_speed, max_a, max_v, min_v), pid_steer(
        steer, current_steer, max_sv
    )


_MAP_FACTS: dict[str, Callable[[GymMap], Any]] = {
    "map_resolution": lambda loaded: loaded.resolution,
    "map_height": lambda loaded: loaded.free.shape[0],
    "map_width": lambda loaded: loaded.free.shape[1],
    "map_img": lambda loaded: np.where(loaded.free, 255.0, 0.0),
    "dt": lambda loaded: loaded.grid.distance[1:-1, 1:-1],
    "origin": lambda loaded: [*loaded.origin, 0.0],
    "orig_x": lambda loaded: loaded.origin[0],
    "orig_y": lambda loaded: loaded.origin[1],
    "orig_s": lambda loaded: 0.0,
    "orig_c": lambda loaded: 1.0,
}


class ScanSimulator2D:
    """Lidar on a map; the ray march's ``eps`` and ``theta_dis`` are ignored: ranges are exact."""

    def __init__(
        self,
        num_beams: int,
        fov: float,
        eps: float = 1e-4,
        theta_dis: int = 2000,
        max_range: float = 30.0,
    ) -> None:
        self._some_track = load_track(list_tracks()[0])
        self._lidar = Lidar(self._some_track, num_beams, fov, max_range)
        self._map: GymMap | None = None
        self.num_beams, self.fov, self.max_range = num_beams, fov, max_range
        self.angle_increment = self.get_increment()

    def __getattr__(self, name: str) -> Any:
        """Return a property of the map under its name in the gym; None without a map."""
        if name not in _MAP_FACTS:
            raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")
        return None if self._map is None else _MAP_FACTS[name](self._map)

    def set_map(self, map_path: Any, map_ext: str | None = None) -> bool:
        """Set the map for all later scans."""
        self._map = map_path if isinstance(map_path, GymMap) else load_map(map_path, map_ext)
        return True

    def scan(
        self, pose: ArrayLike, rng: np.random.Generator | None = None, std_dev: float = 0.01
    ) -> NDArray[np.float64]:
        """Return the ranges (m) from x, y, heading, shape (num_beams,); ``rng`` adds noise."""
        if self._map is None:
            raise InputError("the lidar has no map; call set_map before scan")
        on, out = self._map.circuit, np.empty(self.num_beams)
        x, y, psi = check_array("pose", pose, (3,), minimum=-1e6, maximum=1e6).tolist()
        track = (on or self._some_track).arrays
        scan_map(
            self._map.grid,
            track,
            on is not None,
            self._lidar.kernel,
            x,
            y,
            psi,
            np.empty(WORK_SHAPE),
            out,
        )
        return out if rng is None else out + rng.normal(0.0, std_dev, len(out))

    def get_increment(self) -> float:
        """Return the angle between two beams, rad."""
        return self._lidar.kernel.step


def merged_params(base: Mapping[str, float], params: Any) -> dict[str, float]:
    """Return a car's parameters with checked changes."""
    if not isinstance(params, Mapping):
        raise ConfigError(
            f"params is {params!r:.200}; it must be a dictionary of a car's parameters, such as"
            " mu: 1.0"
        )
    warn_of_unknown("params", params, DEFAULT_PARAMS)
    known = {name: value for name, value in params.items() if name in DEFAULT_PARAMS}
    for name, value in known.items():
        known[name] = float(
            check_number(f"params: {name}", value, *_ENDS.get(name, _POSITIVE), error=ConfigError)
        )
    return {**base, **known}


def warn_of_unknown(where: str, given: Mapping[Any, Any], known: Iterable[str]) -> None:
    """Warn of each unknown name: programs of the gym continue, because the gym ignored it."""
    for name in (name for name in given if name not in known):
        text = (
            f"{where}: {name!r:.100} is ignored, as in the gym{did_you_mean(name, known)}; there"
            f" are {', '.join(known)}"
        )
        warnings.warn(text, UserWarning, stacklevel=4)


class RaceCar:
    """Interface for programs to one car of a simulator."""

    def __init__(self, simulator: "Simulator", index: int) -> None:
        self._simulator, self._index, self.params = simulator, index, dict(simulator.params)
        self.num_beams, self.fov, self.scan_angles = (
            simulator.lidar.beams,
            simulator.lidar.fov,
            simulator.lidar.angles,
        )
        self.is_ego = index == simulator.setup.ego

    opp_poses = property(lambda self: np.delete(self._simulator.agent_poses, self._index, axis=0))
    scan_simulator = property(lambda self: self._simulator.scan_simulator)

    def __getattr__(self, name: str) -> Any:
        """Refuse parts of a step: this simulator steps all cars at once."""
        hint = ": env.sim.step(actions) drives all cars" if name.startswith("update_") else ""
        raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r} here{hint}")

    def update_params(self, params: Any) -> None:
        """Change parameters of this car."""
        self._simulator.update_params(params, self._index)

    @property
    def state(self) -> Floats:
        """State: x, y, steering angle, speed, heading; without model KS also yaw rate and slip.

        The shape is (7,), or (5,) for KS.
        """
        return self._simulator.cars[self._index, : 5 if self._simulator.setup.model == k.KS else 7]

    @state.setter
    def state(self, value: ArrayLike) -> None:
        self.state[:] = check_array("state", value, self.state.shape, minimum=-1e6, maximum=1e6)

    @property
    def in_collision(self) -> bool:
        """True if the car has hit a wall in the last step."""
        return bool(self._simulator.cars[self._index, k.WALL])


class _SameNoise:
    """Noise of one seed in blocks of 64 steps, restarted by each episode and shared by all cars."""

    BLOCK, KEPT = 64, 32  # steps drawn at once, and stored blocks: 18 MB

    def __init__(self, seed: int, beams: int) -> None:
        self._beams = beams
        self._rng, self._kept, self._after = np.random.default_rng(seed), list[Floats](), None

    def block(self, number: int) -> Floats:
        """Return the noise of the ranges, shape (64, beams), m; request blocks in order."""
        if number < len(self._kept):
            return self._kept[number]
        if number == self.KEPT:  # in this episode or in an earlier episode
            self._after = self._after or self._rng.bit_generator.state  # type: ignore[assignment]
            self._rng.bit_generator.state = self._after  # type: ignore[assignment]
        drawn = NOISE * self._rng.standard_normal((self.BLOCK, self._beams))
        self._kept += [drawn] if number < self.KEPT else []
        return drawn


class Simulator:
    """Simulator of all cars on one map.

    Simulators share no data (in the gym a second simulator changed the map of the first).
    """

    #: shape (N, COLUMNS): State of each car; a new array in each step, as programs store the old.
    cars: Floats
    agent_scans: Floats  #: shape (N, beams): Ranges, m.

    def __init__(
        self,
        params: dict[str, float],
        cars: int,
        seed: int,
        setup: k.Setup,
        beams: int = BEAMS,
        fov: float = FIELD_OF_VIEW,
    ) -> None:
        self.params, self.num_agents, self.seed, self.setup = params, cars, seed, setup
        self._some_track = load_track(list_tracks()[0])  # unused, but required by compiled code
        self.lidar = Lidar(self._some_track, beams, fov, RANGE)
        turn = np.linspace(0.0, 2.0 * np.pi, k.DIRECTIONS)
        self._tables = np.stack([np.sin(turn), np.cos(turn)])
        self._work, self._inverse = np.empty(WORK_SHAPE), np.empty(beams)
        self.cars, self.agent_scans = np.zeros((cars, k.COLUMNS)), np.zeros((cars, beams))
        self.agents = [RaceCar(self, i) for i in range(cars)]
        self._noise, self.steps = _SameNoise(seed, beams), 0
        self.time, self.started = 0.0, False  # s

    states = property(lambda self: self.cars[:, :7])
    agent_poses = property(lambda self: self.cars[:, k.AT_X : k.AT_PSI + 1])
    agent_steerings = property(lambda self: self.cars[:, 2])
    collisions = property(lambda self: self.cars[:, k.CRASHED])
    collision_idx = property(lambda self: self.cars[:, k.CONTACT])

    def set_map(self, map_path: Any, map_ext: str | None = None) -> None:
        """Switch to another map."""
        loaded = map_path if isinstance(map_path, GymMap) else load_map(map_path, map_ext)
        self.scan_simulator = ScanSimulator2D(self.lidar.beams, self.lidar.fov, max_range=RANGE)
        self.scan_simulator.set_map(loaded)
        self.map, self.track = loaded, loaded.circuit or self._some_track
        self.setup = self.setup._replace(on_circuit=loaded.circuit is not None)
        self._build()

    def update_params(self, params: Any, agent_idx: int = -1) -> None:
        """Change parameters of all cars, or of one car."""
        index = check_whole("index", agent_idx, None, self.num_agents - 1)
        if index < 0:
            self.params = merged_params(self.params, params)
        for car in self.agents if index < 0 else [self.agents[index]]:
            car.params = merged_params(car.params, params)
        self._build()

    def _build(self) -> None:
        rows = np.array([[car.params[name] for name in DEFAULT_PARAMS] for car in self.agents])
        half_width, half_length = 0.5 * rows[0, k.WIDTH], 0.5 * (rows[0, k.LF] + rows[0, k.LR])
        angles = self.lidar.angles
        with np.errstate(divide="ignore"):
            # The gym uses the axles as the ends of the car.
            sides = np.minimum(
                half_width / np.abs(np.sin(angles)), half_length / np.abs(np.cos(angles))
            )
        arrays, beams = self.track.arrays, self.lidar.kernel
        self._world = k.World(self.map.grid, arrays, self.setup, beams, self._tables, sides, rows)

    def reset(self, poses: ArrayLike) -> None:
        """Place the cars at poses, shape (N, 3), at rest."""
        at = check_array("poses", poses, (self.num_agents, 3), minimum=-1e6, maximum=1e6)
        if (np.abs(at[:, 2]) > 900.0).any():
            raise InputError(
                f"poses: heading {np.abs(at[:, 2]).max():g} rad; it must be from -900 to 900"
            )
        before, self.cars = self.cars, np.zeros((self.num_agents, k.COLUMNS))
        self.cars[:, [0, 1, 4]] = self.cars[:, k.AT_X : k.AT_PSI + 1] = self.cars[
            :, k.START_X : k.START_PSI + 1
        ] = at
        # The gym reports the old laps once more.
        self.cars[:, k.LAP_TIME : k.LAPS + 1] = before[:, k.LAP_TIME : k.LAPS + 1]
        self.steps, self.time, self.started = 0, 0.0, True

    def step(self, control_inputs: ArrayLike) -> dict[str, Any]:
        """Advance all cars by one step; return the result of generation A: no laps and no end."""
        self.advance(control_inputs)
        return self.observed()

    def observed(self) -> dict[str, Any]:
        """Return the observation of generation A, without laps."""
        seen = {
            "ego_idx": self.setup.ego,
            "scans": list(self.agent_scans),
            "linear_vels_y": [0.0] * self.num_agents,
        }
        seen |= {name: list(self.cars[:, column]) for name, column in k.ORIGINAL.items()}
        return seen | {"collisions": self.collisions}

    def advance(self, control_inputs: ArrayLike) -> bool:
        """Advance all cars by one step with actions of shape (N, 2): steering, then speed or
        acceleration.

        Return whether the episode ends.
        """
        try:
            actions = np.array(control_inputs, np.float64, order="C")
        except (TypeError, ValueError, OverflowError):
            actions = np.empty(0)
        if actions.shape != (self.num_agents, 2) or not all_finite(actions):
            given = " ".join(repr(control_inputs).split())
            raise InputError(
                f"action is {given:.200}; it must be finite numbers of shape ({self.num_agents},"
                " 2), steering and speed"
            )
        number, at = divmod(self.steps, _SameNoise.BLOCK)
        if at == 0:
            self._drawn = self._noise.block(number)
        self.steps, self.time = self.steps + 1, self.time + self.setup.dt
        self.cars, self.agent_scans = self.cars.copy(), np.empty(self.agent_scans.shape)
        arguments = (
            self._world,
            self.cars,
            actions,
            self._drawn[at],
            self.time,
            self.agent_scans,
            self._inverse,
            self._work,
        )
        if _advance is None:
            _compile(arguments)
        ended = bool(_advance(*arguments))
        if not all_finite(self.cars[:, : k.AT_X]):
            raise InputError(
                f"a car's state is not finite after {self.steps} steps: the gym's steps can't hold"
                " such params; raise I, or lower mu, C_Sf, C_Sr, m or the time step"
            )
        return ended


_advance: Any = None


def _compile(arguments: tuple[Any, ...]) -> None:
    global _advance
    with first_call(k.advance, "the F1TENTH gym's step", 140.0):
        _advance = compiled_for(k.advance, arguments)
