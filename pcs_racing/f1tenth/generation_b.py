"""The environment of generation B, ``f1tenth_gym:f1tenth-v0`` (v1.0.0): a dictionary, Gymnasium's five values."""

import warnings
from collections.abc import Mapping
from copy import deepcopy
from enum import Enum
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from pcs_racing.base.checks import check_choice
from pcs_racing.base.errors import ConfigError, InputError
from pcs_racing.f1tenth.env import Callback, F110Env
from pcs_racing.f1tenth.kernel import KS, ST
from pcs_racing.f1tenth.lines import Track
from pcs_racing.f1tenth.observations import observation
from pcs_racing.f1tenth.rendering import RenderSpec, TrackRenderer
from pcs_racing.f1tenth.resetting import starting_poses
from pcs_racing.f1tenth.simulator import DEFAULT_PARAMS, merged_params, warn_of_unknown

_DEFAULTS: dict[str, Any] = {
    "seed": 12345, "map": "Spielberg", "params": DEFAULT_PARAMS, "num_agents": 2, "timestep": 0.01, "ego_idx": 0,
    "integrator": "rk4", "model": "st", "control_input": ["speed", "steering_angle"],
    "observation_config": {"type": None}, "reset_config": {"type": None},
}  # fmt: skip
_PAIRS = ("accl", "steering_speed"), ("speed", "steering_angle")  # of which one is given without the other

ENUMS = ("DynamicModel", "IntegratorType", "LongitudinalActionEnum", "SteerActionEnum")
DynamicModel = Enum("DynamicModel", "KS ST")
IntegratorType = Enum("IntegratorType", "RK4 Euler")
LongitudinalActionEnum = Enum("LongitudinalActionEnum", "Accl Speed")
SteerActionEnum = Enum("SteerActionEnum", "Steering_Angle Steering_Speed")


def deep_update(mapping: dict[Any, Any], *updates: Mapping[Any, Any]) -> dict[Any, Any]:
    """Return a dictionary with others merged into it, dictionaries within it likewise."""
    out = dict(mapping)
    for update in updates:
        for key, value in update.items():
            both = isinstance(out.get(key), dict) and isinstance(value, Mapping)
            out[key] = deep_update(out[key], value) if both else value
    return out


def control_types(given: Any) -> tuple[str, str]:
    """Return the longitudinal and the steering input; a single one gets its partner."""
    for pair in _PAIRS:
        if isinstance(given, str) and given in pair:
            warnings.warn(f"control_input is {given!r}: taken for {list(pair)}", UserWarning, stacklevel=4)
            return pair
    listed = isinstance(given, list | tuple) and len(given) == 2
    if not listed or given[0] not in ("accl", "speed") or given[1] not in ("steering_angle", "steering_speed"):
        raise ConfigError(
            f"control_input is {given!r:.200}; it must be a list of 'speed' or 'accl', and 'steering_angle' or "
            "'steering_speed'"
        )
    return given[0], given[1]


class GenerationB(F110Env):
    """The environment.

    Parameters
    ----------
    config : dict, optional
        Keys of the gym's configuration; what is not named keeps its default. See :meth:`default_config`.
    render_mode : str, optional
        "human", "human_fast" or "rgb_array".
    faithful : bool
        Whether the gym's faults are kept (docs/coming_from_f1tenth_gym.md).
    """

    metadata = {"render_modes": ["human", "human_fast", "rgb_array"], "render_fps": 100}  # noqa: RUF012

    def __init__(
        self, config: Any = None, render_mode: str | None = None, *, faithful: bool = True, **named: Any
    ) -> None:
        warn_of_unknown("f1tenth-v0", named, ["config", "render_mode", "faithful"])
        self.config = self.default_config()
        self._merge(config)
        values = self.config
        if values["model"] not in ("st", "ks"):
            raise ConfigError(
                f"model is {values['model']!r:.200}; there are 'st' (dynamic) and 'ks' (kinematic), no multi-body model"
            )
        check_choice("integrator", values["integrator"], ("rk4", "euler"), ConfigError)
        self._control = control_types(values["control_input"])
        self._set_up(
            values | {"lidar_dist": 0.0},
            model=KS if values["model"] == "ks" else ST,
            euler=values["integrator"] == "euler",
            control=(self._control[0] == "accl", self._control[1] == "steering_speed"),
            faithful=faithful,
        )
        self.model, self.integrator = values["model"], values["integrator"]
        self.map = values["map"]
        self.update_map(self.map)
        self.agent_ids = [f"agent_{i}" for i in range(self.num_agents)]
        self.observation_config = values["observation_config"]
        self.observation_space, self._observe = observation(self, self.observation_config)
        self._find_action_space()
        if render_mode is not None:
            check_choice("render_mode", render_mode, self.metadata["render_modes"], ConfigError)
        self.render_mode, self.render_spec = render_mode, RenderSpec()
        self.metadata = {**self.metadata, "render_fps": int(1.0 / self.timestep)}
        self._callbacks: list[Callback] = []

    @classmethod
    def default_config(cls) -> dict[str, Any]:
        """Return the configuration that a given one changes."""
        return deepcopy(_DEFAULTS)

    def _merge(self, config: Any) -> None:
        if config is None:
            return
        if not isinstance(config, Mapping):
            raise ConfigError(
                f"config is of type {type(config).__name__}; give a dictionary such as {{'num_agents': 2}} (EnvConfig "
                "belongs to the development line of the gym, which is not served)"
            )
        warn_of_unknown("config", config, _DEFAULTS)
        if "params" in config:
            merged_params(DEFAULT_PARAMS, config["params"])
        self.config = deep_update(self.config, config)

    def configure(self, config: Any) -> None:
        """Change the configuration of an environment; parameters of the cars take effect at once."""
        self._merge(config)
        self.sim.update_params(self.config["params"])
        self.params = self.sim.params
        self._find_action_space()

    def _find_action_space(self) -> None:
        p = self.params
        steering = ("sv_min", "sv_max") if self._control[1] == "steering_speed" else ("s_min", "s_max")
        along = (-p["a_max"], p["a_max"]) if self._control[0] == "accl" else (p["v_min"], p["v_max"])
        self.action_space = self._bounded((p[steering[0]], along[0]), (p[steering[1]], along[1]))

    def update_map(self, map_name: Any) -> None:
        """Drive on another map: its name, its path, or a :class:`Track`."""
        self.track = map_name if isinstance(map_name, Track) else Track.from_track_name(map_name)
        self.sim.set_map(self.track.loaded)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Put the cars at ``options["poses"]``, shape (N, 3), or as ``reset_config`` says, and step without action."""
        super().reset(seed=seed)
        if options is not None and not isinstance(options, Mapping):
            raise InputError(f"options is {options!r:.200}; it must be a dictionary such as {{'poses': ...}}, or None")
        poses = (options or {}).get("poses")
        if poses is None:
            poses = starting_poses(self.track, self.num_agents, self.config["reset_config"], self.np_random)
        own = None if self.faithful else np.random.default_rng(self.np_random.integers(2**62))
        self._start(poses, own)
        obs, _, _, _, infos = self.step(np.zeros((self.num_agents, 2)))
        return obs, infos

    def step(self, action: ArrayLike) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        """Make a step with the steering and the longitudinal input of each car, shape (N, 2), in this order."""
        # What is observed of the laps is a step old.
        laps = self.sim.cars if self.faithful else None
        done, infos = self._advance(action)
        return self._observe(laps), self.timestep, done, False, infos

    def add_render_callback(self, callback_func: Callback) -> None:
        """Call a function with the renderer whenever a frame is drawn."""
        self._callbacks.append(callback_func)

    def render(self, mode: str = "human") -> Any:
        """Return a frame in mode "rgb_array"; else show it in a window, if there can be one."""
        if self.render_mode is None:
            return None
        self.renderer = self._shown(
            lambda: TrackRenderer(
                self.track.loaded,
                self.render_spec,
                window=self.render_mode != "rgb_array",
                fps=self.metadata["render_fps"] * (10.0 if self.render_mode == "human_fast" else 1.0),
            )
        )
        return self.renderer.draw(self.sim.states, self.sim.time, self._callbacks)
