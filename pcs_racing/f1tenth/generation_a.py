"""The environment of generation A, ``f110_gym:f110-v0`` (0.2.1): keywords, poses at reset, four values from a step."""

import os
from enum import Enum
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from pcs_racing.base.checks import check_choice
from pcs_racing.base.errors import ConfigError
from pcs_racing.f1tenth.env import Callback, F110Env
from pcs_racing.f1tenth.kernel import OLD_ST, ST
from pcs_racing.f1tenth.maps import load_map
from pcs_racing.f1tenth.rendering import EnvRenderer
from pcs_racing.f1tenth.simulator import warn_of_unknown

_DEFAULTS: dict[str, Any] = {
    "seed": 12345, "map": "vegas", "map_ext": ".png", "params": {}, "num_agents": 2, "timestep": 0.01, "ego_idx": 0,
    "lidar_dist": 0.0,
}  # fmt: skip


class Integrator(Enum):
    """How states are integrated."""

    RK4 = 1
    Euler = 2


class GenerationA(F110Env):
    """The environment; its keywords are those of the gym.

    Parameters
    ----------
    faithful : bool
        Whether the gym's faults are kept (docs/coming_from_f1tenth_gym.md).
    **named
        ``map`` (name, or path without ".yaml"), ``map_ext``, ``num_agents``, ``params``, ``timestep``, ``ego_idx``,
        ``integrator``, ``lidar_dist`` (m), ``seed``.
    """

    metadata = {  # noqa: RUF012
        "render.modes": ["human", "human_fast"],
        "render_modes": ["human", "human_fast", "rgb_array"],
        "render_fps": 100,
    }
    render_callbacks: ClassVar[list[Callback]] = []

    def __init__(self, *, faithful: bool = True, render_mode: str | None = None, **named: Any) -> None:
        warn_of_unknown("f110-v0", named, [*_DEFAULTS, "integrator", "faithful"])
        values = {**_DEFAULTS, **named}
        integrator = getattr(named.get("integrator", Integrator.RK4), "name", None)
        if integrator not in ("RK4", "Euler"):
            raise ConfigError(f"integrator is {named['integrator']!r:.200}; it must be Integrator.RK4 or .Euler")
        model, euler = OLD_ST if faithful else ST, integrator == "Euler"
        self._set_up(values, model=model, euler=euler, control=(False, False), faithful=faithful)
        self.integrator, self.render_mode = named.get("integrator", Integrator.RK4), render_mode
        self.update_map(values["map"], values["map_ext"])
        p = self.params
        self.action_space = self._bounded((p["s_min"], p["v_min"]), (p["s_max"], p["v_max"]))

    def update_map(self, map_path: Any, map_ext: Any) -> None:
        """Drive on another map: its path, and the ending of its picture."""
        if not isinstance(map_path, str | os.PathLike) or not isinstance(map_ext, str):
            raise ConfigError(f"map is {map_path!r:.200}, map_ext {map_ext!r:.80}; they must be a path and an ending")
        self._map = load_map(map_path, map_ext)
        self.sim.set_map(self._map)
        self.map_name, self.map_ext, self.map_path = os.fspath(map_path), map_ext, str(self._map.file)

    def reset(self, poses: ArrayLike) -> tuple[dict[str, Any], float, bool, dict[str, Any]]:  # type: ignore[override]
        """Put the cars at poses, shape (N, 3) in m and rad, and make a step without action."""
        # Without faults the noise goes on; in the gym every episode has the same.
        self._start(poses, None if self.faithful else self.sim.rng)
        return self.step(np.zeros((self.num_agents, 2)))

    def step(self, action: ArrayLike) -> tuple[dict[str, Any], float, bool, dict[str, Any]]:  # type: ignore[override]
        """Make a step with the steering angle (rad) and the speed (m/s) of each car, shape (N, 2)."""
        done, infos = self._advance(action)
        states = self.sim.states
        obs = {
            "ego_idx": self.ego_idx,
            "scans": list(self.sim.agent_scans),
            "poses_x": list(states[:, 0]),
            "poses_y": list(states[:, 1]),
            "poses_theta": list(states[:, 4]),
            "linear_vels_x": list(states[:, 3]),
            "linear_vels_y": [0.0] * self.num_agents,
            "ang_vels_z": list(states[:, 5]),
            "collisions": self.sim.collisions,
            "lap_times": self.lap_times,
            "lap_counts": self.lap_counts,
        }
        F110Env.current_obs = obs
        return obs, self.timestep, done, infos

    def add_render_callback(self, callback_func: Callback) -> None:
        """Call a function with the renderer whenever a frame is drawn."""
        GenerationA.render_callbacks.append(callback_func)

    def render(self, mode: str = "human") -> Any:
        """Show the cars in a window; where there is none, only the callbacks are called."""
        check_choice("mode", mode, self.metadata["render_modes"])
        renderer = GenerationA.renderer = self._shown(lambda: EnvRenderer(self._map, window=mode != "rgb_array"))
        renderer.show_map(self._map)
        renderer.update_obs(self.render_obs, self.sim.states)
        for callback in GenerationA.render_callbacks:
            callback(renderer)
        return renderer.draw(mode)
