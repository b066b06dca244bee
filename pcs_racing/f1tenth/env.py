"""What both generations of the F1TENTH gym's environment share: cars, laps, the end of an episode, callbacks."""

from collections.abc import Callable
from importlib import import_module
from typing import Any, Self

import gymnasium
import numpy as np
from numpy.typing import ArrayLike

from pcs_racing.base.checks import check_flag, check_number, check_seed, check_whole
from pcs_racing.base.errors import ConfigError, InputError
from pcs_racing.f1tenth.kernel import count_laps, count_progress
from pcs_racing.f1tenth.simulator import DEFAULT_PARAMS, MOST_CARS, Simulator, merged_params

Callback = Callable[[Any], None]


class F110Env(gymnasium.Env[Any, Any]):
    """The F1TENTH gym's environment; made directly, of generation B with a ``config``, else of generation A."""

    num_agents: int
    renderer: Any = None
    render_obs: dict[str, Any] | None = None

    def __new__(cls, *args: Any, **named: Any) -> Self:
        """Choose the generation by the arguments."""
        if cls is F110Env:
            letter = "b" if args or "config" in named else "a"
            module = import_module(f"pcs_racing.f1tenth.generation_{letter}")
            return object.__new__(getattr(module, f"Generation{letter.upper()}"))
        return object.__new__(cls)

    def _set_up(
        self, values: dict[str, Any], *, model: int, integrator: int, control: tuple[bool, bool], faithful: Any
    ) -> None:
        """Check the arguments that both generations have, and make the cars."""
        self.num_agents = check_whole("num_agents", values["num_agents"], 1, MOST_CARS, ConfigError)
        self.ego_idx = check_whole("ego_idx", values["ego_idx"], 0, self.num_agents - 1, ConfigError)
        self.timestep = float(check_number("timestep", values["timestep"], 1e-4, 0.2, error=ConfigError))
        self.lidar_dist = float(check_number("lidar_dist", values["lidar_dist"], -10.0, 10.0, error=ConfigError))
        self.params = merged_params(DEFAULT_PARAMS, values["params"])
        self.faithful = check_flag("faithful", faithful, ConfigError)
        self.seed = check_seed(values["seed"])
        self.sim = Simulator(
            self.params,
            self.num_agents,
            self.seed,
            ego_idx=self.ego_idx,
            model=model,
            integrator=integrator,
            control=control,
            time_step=self.timestep,
            lidar_dist=self.lidar_dist,
            faithful=self.faithful,
        )
        self.lap_times, self.lap_counts = np.zeros(self.num_agents), np.zeros(self.num_agents)
        self.current_time = 0.0
        self._started = False

    def _start(self, poses: ArrayLike, rng: np.random.Generator | None = None) -> None:
        """Put the cars at poses and the laps to nothing."""
        self.sim.reset(poses, rng)
        at = self.sim.states[:, [0, 1, 4]]
        self._starts = at
        self.start_xs, self.start_ys, self.start_thetas = at.T
        sine, cosine = np.sin(-at[self.ego_idx, 2]), np.cos(-at[self.ego_idx, 2])
        self.start_rot = np.array([[cosine, -sine], [sine, cosine]])
        self.current_time = 0.0
        self.near_starts, self.toggle_list = np.ones(self.num_agents, np.bool_), np.zeros(self.num_agents)
        self._by_progress = not self.faithful and self.sim.on_circuit
        if self._by_progress:
            self.lap_counts[:] = 0.0
            self._progress, self._places = np.zeros(self.num_agents), self.sim.track.to_frenet(at[:, :2])[:, 0].copy()
        self._started = True

    def _advance(self, action: ArrayLike) -> None:
        if not self._started:
            raise InputError("step() before reset(): the cars have no place yet; call reset() first")
        self.sim.step(action)

    def _judge(self) -> tuple[bool, dict[str, Any]]:
        """Count the time and the laps; whether the episode has ended, and the infos."""
        self.current_time += self.timestep
        poses, laps = self.sim.agent_poses, (self.toggle_list, self.lap_times, self.lap_counts, self.current_time)
        if self._by_progress:
            count_progress(self.sim.track.arrays, poses, self._places, self._progress, *laps)
        else:
            count_laps(self._starts, self.ego_idx, poses, self.near_starts, *laps)
        self.poses_x, self.poses_y, self.poses_theta = poses.T
        self.collisions, finished = self.sim.collisions, self.toggle_list >= 4.0
        infos: dict[str, Any] = {"checkpoint_done": finished}
        crashed = self.sim.collisions.tolist()
        done = crashed[self.ego_idx] > 0.0
        if not self.faithful:
            # Any crash ends the race, and the infos say whose fault it was.
            done, infos["at_fault"] = max(crashed) > 0.0, self.sim.at_fault
        return done or all(finished.tolist()), infos

    def update_params(self, params: Any, index: int = -1) -> None:
        """Change the parameters of all cars, or of the one with an index from 0."""
        self.sim.update_params(params, index)

    def _bounded(self, low: tuple[float, float], high: tuple[float, float]) -> gymnasium.spaces.Box:
        """Return the space of the actions of all cars by the bounds for one."""
        ends = [np.tile(np.array(one, np.float32), (self.num_agents, 1)) for one in (low, high)]
        return gymnasium.spaces.Box(ends[0], ends[1], dtype=np.float32)
