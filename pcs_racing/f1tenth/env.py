"""What both generations of the F1TENTH gym's environment share: cars, laps, the end of an episode, callbacks."""

from collections.abc import Callable
from importlib import import_module
from typing import Any, Self

import gymnasium
import numpy as np
from numpy.typing import ArrayLike

from pcs_racing.base.checks import check_flag, check_number, check_seed, check_whole
from pcs_racing.base.errors import ConfigError, InputError
from pcs_racing.f1tenth import kernel as k
from pcs_racing.f1tenth.simulator import DEFAULT_PARAMS, MOST_CARS, Simulator, merged_params

Callback = Callable[[Any], None]

_FACTS = {
    "poses_x": k.AT_X, "poses_y": k.AT_Y, "poses_theta": k.AT_PSI, "collisions": k.CRASHED, "lap_times": k.LAP_TIME,
    "lap_counts": k.LAPS, "toggle_list": k.TOGGLES, "start_xs": k.START_X, "start_ys": k.START_Y,
    "start_thetas": k.START_PSI,
}  # fmt: skip


class F110Env(gymnasium.Env[Any, Any]):
    """The F1TENTH gym's environment; made directly, of generation B with a ``config``, else of generation A."""

    num_agents: int
    renderer: Any = None
    current_obs: Any = None  # of the class, where programs of generation A reach for it

    def __new__(cls, *args: Any, **named: Any) -> Self:
        """Choose the generation by the arguments."""
        if cls is F110Env:
            letter = "b" if args or "config" in named else "a"
            module = import_module(f"pcs_racing.f1tenth.generation_{letter}")
            return object.__new__(getattr(module, f"Generation{letter.upper()}"))
        return object.__new__(cls)

    def _set_up(
        self, values: dict[str, Any], *, model: int, euler: bool, control: tuple[bool, bool], faithful: Any
    ) -> None:
        """Check the arguments that both generations have, and make the cars."""
        self.num_agents = check_whole("num_agents", values["num_agents"], 1, MOST_CARS, ConfigError)
        self.ego_idx = check_whole("ego_idx", values["ego_idx"], 0, self.num_agents - 1, ConfigError)
        self.timestep = float(check_number("timestep", values["timestep"], 1e-4, 0.2, error=ConfigError))
        self.lidar_dist = float(check_number("lidar_dist", values["lidar_dist"], -10.0, 10.0, error=ConfigError))
        self.params = merged_params(DEFAULT_PARAMS, values["params"])
        self.faithful = check_flag("faithful", faithful, ConfigError)
        self.seed = check_seed(values["seed"])
        integrator = k.EULER if euler and self.faithful else k.RK4
        setup = k.Setup(
            model, integrator, *control, self.timestep, self.lidar_dist, self.ego_idx, self.faithful, on_circuit=False
        )
        self.sim = Simulator(self.params, self.num_agents, self.seed, setup)
        self._started = False

    def _start(self, poses: ArrayLike, rng: np.random.Generator | None = None) -> None:
        """Put the cars at poses, and begin to count."""
        self.sim.reset(poses, rng)
        self._started = True

    def _advance(self, action: ArrayLike) -> tuple[bool, dict[str, Any]]:
        """Make a step; whether the episode has ended, and the infos."""
        if not self._started:
            raise InputError("step() before reset(): the cars have no place yet; call reset() first")
        done = self.sim.step(action)
        infos: dict[str, Any] = {"checkpoint_done": self.sim.cars[:, k.TOGGLES] >= 4.0}
        if not self.faithful:
            infos["at_fault"] = self.sim.cars[:, k.AT_FAULT] > 0.0
        return done, infos

    def __getattr__(self, name: str) -> Any:
        """Facts of all cars under the gym's names, shape (N,)."""
        if name == "current_time":
            return self.sim.time
        if name in _FACTS and "sim" in self.__dict__:
            return self.sim.cars[:, _FACTS[name]]
        raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")

    @property
    def render_obs(self) -> dict[str, Any] | None:
        """What a renderer is told; None before the first reset."""
        if not self._started:
            return None
        names = ("ego_idx", "poses_x", "poses_y", "poses_theta", "lap_times", "lap_counts", "collisions")
        facts = {name: getattr(self, name) for name in names}
        return facts | {"steering_angles": self.sim.agent_steerings, "sim_time": self.sim.time}

    def update_params(self, params: Any, index: int = -1) -> None:
        """Change the parameters of all cars, or of the one with an index from 0."""
        self.sim.update_params(params, index)

    def _bounded(self, low: tuple[float, float], high: tuple[float, float]) -> gymnasium.spaces.Box:
        """Return the space of the actions of all cars by the bounds for one."""
        ends = [np.tile(np.array(one, np.float32), (self.num_agents, 1)) for one in (low, high)]
        return gymnasium.spaces.Box(ends[0], ends[1], dtype=np.float32)

    def _shown(self, made: Any) -> Any:
        """The renderer, made when it is first needed."""
        if not self._started:
            raise ConfigError("there is nothing to show: call reset() before render()")
        return self.renderer or made()

    def close(self) -> None:
        """Close the window."""
        if self.renderer is not None:
            self.renderer.close()
            type(self).renderer = self.renderer = None
