"""F1TENTH gym environments: generation A (``f110_gym:f110-v0``) and B (``f1tenth_gym:f1tenth-v0``).

A (0.2.1) takes keywords, gets its poses at reset, and returns four values from a step. B (v1.0.0)
takes a dictionary, and returns Gymnasium's five values.
"""

import os
import warnings
from collections.abc import Callable, Mapping
from copy import deepcopy
from enum import Enum
from typing import Any, Self

import gymnasium
import numpy as np
from numpy.typing import ArrayLike

from pcs_racing.base.errors import (
    ConfigError,
    InputError,
    check_choice,
    check_number,
    check_seed,
    check_whole,
)
from pcs_racing.f1tenth import kernel as k
from pcs_racing.f1tenth.lines import Track, starting_poses
from pcs_racing.f1tenth.maps import load_map
from pcs_racing.f1tenth.observations import observation
from pcs_racing.f1tenth.rendering import EnvRenderer, TrackRenderer
from pcs_racing.f1tenth.simulator import (
    BEAMS,
    DEFAULT_PARAMS,
    FIELD_OF_VIEW,
    MAX_CARS,
    Simulator,
    merged_params,
    warn_of_unknown,
)

Callback = Callable[[Any], None]
Integrator = Enum("Integrator", "RK4 Euler")

_BOTH: dict[str, Any] = {
    "seed": 12345,
    "params": DEFAULT_PARAMS,
    "num_agents": 2,
    "timestep": 0.01,
    "ego_idx": 0,
    "num_beams": BEAMS,
    "fov": FIELD_OF_VIEW,
}
DEFAULTS_A: dict[str, Any] = {
    **_BOTH,
    "map": "vegas",
    "map_ext": ".png",
    "lidar_dist": 0.0,
    "integrator": Integrator["RK4"],
}
"""Keywords of generation A."""
DEFAULTS_B: dict[str, Any] = {
    **_BOTH,
    "map": "Spielberg",
    "integrator": "rk4",
    "model": "st",
    "control_input": ["speed", "steering_angle"],
    "observation_config": {"type": None},
    "reset_config": {"type": None},
}
_PAIRS = ("accl", "steering_speed"), ("speed", "steering_angle")  # one implies its partner
_BOUNDS = {"steering_angle": ("s_min", "s_max"), "steering_speed": ("sv_min", "sv_max")}
_FACTS = {
    "poses_x": k.AT_X,
    "poses_y": k.AT_Y,
    "poses_theta": k.AT_PSI,
    "collisions": k.CRASHED,
    "lap_times": k.LAP_TIME,
    "lap_counts": k.LAPS,
    "toggle_list": k.TOGGLES,
    "start_xs": k.START_X,
    "start_ys": k.START_Y,
    "start_thetas": k.START_PSI,
}
_MODES = ["human", "human_fast", "rgb_array"]


def deep_update(mapping: dict[Any, Any], *updates: Mapping[Any, Any]) -> dict[Any, Any]:
    """Return a dictionary with others merged into it, including nested dictionaries."""
    out = dict(mapping)
    for key, value in (pair for update in updates for pair in update.items()):
        both = isinstance(out.get(key), dict) and isinstance(value, Mapping)
        out[key] = deep_update(out[key], value) if both else value
    return out


def control_types(given: Any) -> tuple[str, str]:
    """Return the longitudinal and the steering input; a single input gets its partner."""
    for pair in _PAIRS:
        if isinstance(given, str) and given in pair:
            warnings.warn(
                f"control_input is {given!r}: taken for {list(pair)}", UserWarning, stacklevel=4
            )
            return pair
    listed = (
        isinstance(given, list | tuple)
        and len(given) == 2
        and all(isinstance(one, str) for one in given)
    )
    if (
        not listed
        or given[0] not in ("accl", "speed")
        or given[1] not in ("steering_angle", "steering_speed")
    ):
        raise ConfigError(
            f"control_input is {given!r:.200}; it must be a list of 'speed' or 'accl', and"
            " 'steering_angle' or 'steering_speed'"
        )
    return given[0], given[1]


class F110Env(gymnasium.Env[Any, Any]):
    """Common part of both generations; called directly, it makes B with a ``config``, else A."""

    num_agents: int
    renderer: Any = None
    render_callbacks: list[Callback]
    current_obs: Any = None  # class attribute, read by programs of generation A
    observation_space: Any = None  # None for generation A, as in gym

    def __new__(cls, *args: Any, **named: Any) -> Self:
        """Choose the generation by the arguments."""
        chosen: Any = GenerationB if args or "config" in named else GenerationA
        made: Self = object.__new__(chosen if cls is F110Env else cls)
        return made

    def _set_up(
        self,
        values: dict[str, Any],
        model: int,
        control: tuple[str, str],
        euler: bool,
    ) -> None:
        """Check the arguments of both generations, and make the cars."""
        self.num_agents = check_whole("num_agents", values["num_agents"], 1, MAX_CARS, ConfigError)
        self.ego_idx = check_whole(
            "ego_idx", values["ego_idx"], 0, self.num_agents - 1, ConfigError
        )
        self.timestep = float(
            check_number("timestep", values["timestep"], 1e-4, 0.2, error=ConfigError)
        )
        self.lidar_dist = float(
            check_number(
                "lidar_dist", values.get("lidar_dist", 0.0), -10.0, 10.0, error=ConfigError
            )
        )
        self.seed = check_seed(values["seed"])
        self.params = merged_params(DEFAULT_PARAMS, values["params"])
        integrator = k.EULER if euler else k.RK4
        inputs = control[0] == "accl", control[1][-1] == "d"
        setup = k.Setup(
            model, integrator, *inputs, self.timestep, self.lidar_dist, self.ego_idx, False
        )
        beams = check_whole("num_beams", values["num_beams"], 2, 100_000, ConfigError)
        fov = float(check_number("fov", values["fov"], 1e-3, 2.0 * np.pi, error=ConfigError))
        self.sim = Simulator(self.params, self.num_agents, self.seed, setup, beams, fov)
        along, steering = control
        most, low, high = self.params["a_max"], *_BOUNDS[steering]
        rows = [[self.params[low], -most], [self.params[high], most]]
        if along == "speed":
            rows = [
                [self.params[low], self.params["v_min"]],
                [self.params[high], self.params["v_max"]],
            ]
        ends = np.repeat(np.array(rows, np.float32)[:, None], self.num_agents, axis=1)
        self.action_space = gymnasium.spaces.Box(ends[0], ends[1], dtype=np.float32)

    def _advance(self, action: ArrayLike) -> tuple[bool, dict[str, Any]]:
        """Make a step; return whether the episode has ended, and the infos."""
        if not self.sim.started:
            raise InputError(
                "step() before reset(): the cars have no place yet; call reset() first"
            )
        done = self.sim.advance(action)
        return done, {"checkpoint_done": self.sim.cars[:, k.TOGGLES] >= 4.0}

    def __getattr__(self, name: str) -> Any:
        """Return a quantity of all cars under its name in the gym, shape (N,), or the time."""
        if "sim" not in self.__dict__ or name not in (*_FACTS, "current_time"):
            raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r} here")
        return self.sim.cars[:, _FACTS[name]] if name in _FACTS else self.sim.time

    @property
    def render_obs(self) -> dict[str, Any] | None:
        """Observation for the renderer; None before the first reset."""
        names = (
            "ego_idx",
            "poses_x",
            "poses_y",
            "poses_theta",
            "lap_times",
            "lap_counts",
            "collisions",
        )
        more = {"steering_angles": self.sim.agent_steerings, "sim_time": self.sim.time}
        return {name: getattr(self, name) for name in names} | more if self.sim.started else None

    def update_params(self, params: Any, index: int = -1) -> None:
        """Change the parameters of all cars, or of the car with an index from 0."""
        self.sim.update_params(params, index)

    def add_render_callback(self, callback_func: Callback) -> None:
        """Add a function to call with the renderer at each frame."""
        self.render_callbacks.append(callback_func)

    def _shown(self, made: Callable[[], Any]) -> Any:
        """Return the renderer, made on first use."""
        if not self.sim.started:
            raise ConfigError("there is nothing to show: call reset() before render()")
        return self.renderer or made()

    def close(self) -> None:
        """Close the window."""
        if self.renderer is not None:
            self.renderer.close()
            type(self).renderer = self.renderer = None


class GenerationA(F110Env):
    """Environment of generation A.

    The keywords of the gym are ``map`` (name, or path without ".yaml"), ``map_ext``,
    ``num_agents``, ``params``, ``timestep``, ``ego_idx``, ``integrator``, ``lidar_dist`` (m) and
    ``seed``.
    """

    metadata = {"render.modes": _MODES, "render_modes": _MODES, "render_fps": 100}  # noqa: RUF012
    render_callbacks: list[Callback] = []  # noqa: RUF012 shared by all environments

    def __init__(self, *, render_mode: str | None = None, **named: Any) -> None:
        warn_of_unknown("f110-v0", named, DEFAULTS_A)
        values, self.render_mode = {**DEFAULTS_A, **named}, render_mode
        self.integrator = values["integrator"]
        integrator = getattr(self.integrator, "name", None)
        if integrator not in ("RK4", "Euler"):
            raise ConfigError(
                f"integrator is {self.integrator!r:.200}; it must be Integrator.RK4 or .Euler"
            )
        self._set_up(values, k.OLD_ST, _PAIRS[1], integrator == "Euler")
        self.update_map(values["map"], values["map_ext"])

    def update_map(self, map_path: Any, map_ext: Any) -> None:
        """Switch to another map, given its path and the extension of its picture."""
        if not isinstance(map_path, str | os.PathLike) or not isinstance(map_ext, str):
            raise ConfigError(
                f"map is {map_path!r:.200}, map_ext {map_ext!r:.80}; they must be a path and an"
                " ending"
            )
        self._map = load_map(map_path, map_ext)
        self.sim.set_map(self._map)
        self.map_name, self.map_ext, self.map_path = (
            os.fspath(map_path),
            map_ext,
            str(self._map.file),
        )

    def reset(self, poses: ArrayLike) -> tuple[dict[str, Any], float, bool, dict[str, Any]]:  # type: ignore[override]
        """Place the cars at poses, shape (N, 3) in m and rad, and make a step with zero actions."""
        self.sim.reset(poses)
        return self.step(np.zeros((self.num_agents, 2)))

    def step(self, action: ArrayLike) -> tuple[dict[str, Any], float, bool, dict[str, Any]]:  # type: ignore[override]
        """Make a step with each car's steering angle (rad) and speed (m/s), shape (N, 2)."""
        done, infos = self._advance(action)
        laps = {"lap_times": self.lap_times, "lap_counts": self.lap_counts}
        obs = F110Env.current_obs = self.sim.observed() | laps
        return obs, self.timestep, done, infos

    def render(self, mode: str = "human") -> Any:
        """Show the cars in a window; without a window, only call the callbacks."""
        check_choice("mode", mode, _MODES)
        renderer = GenerationA.renderer = self._shown(
            lambda: EnvRenderer(self._map, window=mode != "rgb_array")
        )
        renderer.show_map(self._map)
        renderer.update_obs(self.render_obs, self.sim.states)
        for callback in GenerationA.render_callbacks:
            callback(renderer)
        return renderer.draw(mode)


class GenerationB(F110Env):
    """Environment of generation B.

    ``config`` has keys of the gym's configuration; missing keys have their default
    (:meth:`default_config`). ``render_mode`` is "human", "human_fast" or "rgb_array".
    """

    metadata = {"render_modes": _MODES, "render_fps": 100}  # noqa: RUF012

    def __init__(self, config: Any = None, render_mode: str | None = None, **named: Any) -> None:
        warn_of_unknown("f1tenth-v0", named, ["config", "render_mode"])
        if config is not None and not isinstance(config, Mapping):
            raise ConfigError(
                f"config is of type {type(config).__name__}; give a dictionary such as"
                " {'num_agents': 2} (EnvConfig belongs to the development line of the gym, which"
                " is not served)"
            )
        warn_of_unknown("config", config or {}, DEFAULTS_B)
        merged_params(DEFAULT_PARAMS, (config or {}).get("params", {}))
        self.config = values = deep_update(self.default_config(), config or {})
        if values["model"] not in ("st", "ks"):
            raise ConfigError(
                f"model is {values['model']!r:.200}; there are 'st' (dynamic) and 'ks' (kinematic),"
                " no multi-body model"
            )
        self.integrator = check_choice(
            "integrator", values["integrator"], ("rk4", "euler"), ConfigError
        )
        self.model, model = values["model"], k.KS if values["model"] == "ks" else k.ST
        control = control_types(values["control_input"])
        self._set_up(values, model, control, self.integrator == "euler")
        self.map = values["map"]
        self.update_map(self.map)
        self.agent_ids = [f"agent_{i}" for i in range(self.num_agents)]
        self.observation_config = values["observation_config"]
        self.observation_space, self._observe = observation(self, self.observation_config)
        if render_mode is not None:
            check_choice("render_mode", render_mode, _MODES, ConfigError)
        self.render_mode = render_mode
        self.metadata = {**self.metadata, "render_fps": int(1.0 / self.timestep)}
        self.render_callbacks = []

    @classmethod
    def default_config(cls) -> dict[str, Any]:
        """Return the default configuration."""
        return deepcopy(DEFAULTS_B)

    def update_map(self, map_name: Any) -> None:
        """Switch to another map: its name, its path, or a :class:`Track`."""
        self.track = map_name if isinstance(map_name, Track) else Track.from_track_name(map_name)
        self.sim.set_map(self.track.loaded)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Place the cars, and make a step with zero actions.

        Poses are ``options["poses"]``, shape (N, 3), or drawn by ``reset_config``.
        """
        super().reset(seed=seed)
        if options is not None and not isinstance(options, Mapping):
            raise InputError(
                f"options is {options!r:.200}; it must be a dictionary such as {{'poses': ...}}, or"
                " None"
            )
        poses = (options or {}).get("poses")
        if poses is None:
            poses = starting_poses(
                self.track, self.num_agents, self.config["reset_config"], self.np_random
            )
        self.sim.reset(poses)
        obs, _, _, _, infos = self.step(np.zeros((self.num_agents, 2)))
        return obs, infos

    def step(self, action: ArrayLike) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        """Make a step with the steering and the longitudinal input of each car, shape (N, 2), in
        this order.
        """
        laps = self.sim.cars  # observed laps are one step old
        done, infos = self._advance(action)
        return self._observe(laps), self.timestep, done, False, infos

    def render(self, mode: str = "human") -> Any:
        """Return a frame in mode "rgb_array"; else show it in a window, if one is available."""
        if self.render_mode is None:
            return None
        fps = self.metadata["render_fps"] * (10.0 if self.render_mode == "human_fast" else 1.0)
        window = self.render_mode != "rgb_array"
        self.renderer = self._shown(
            lambda: TrackRenderer(self.track.loaded, window=window, fps=fps)
        )
        return self.renderer.draw(self.sim.states, self.sim.time, self.render_callbacks)
