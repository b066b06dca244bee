# /// script
# dependencies = ["pufferlib-core==3.0.23"]
# ///
"""PufferLib: write a compiled batch of races into its buffers, without workers.

    python examples/clients/pufferlib_drive.py

:class:`Races` is the adapter: a native environment of many agents for ``pufferlib.vector.make`` and
the trainer of PufferLib. ``pufferlib`` 3.0.0 has the same interface.
"""

import time
from typing import Any

import gymnasium as gym
import numpy as np
import pufferlib
import pufferlib.vector
from numpy.typing import NDArray

import pcs_racing

gym.register_envs(pcs_racing)


class Races(pufferlib.PufferEnv):
    """Races of ``pcs_racing/Drive-v1``, one agent each; a new race begins in the step of an end.

    Parameters
    ----------
    num_races : int
        Number of races side by side.
    buf : mapping, optional
        Buffers of PufferLib.
    seed : int
        Seed of the first race, if `reset` gets none; race ``i`` has ``seed + i``.
    **arguments
        Arguments of the environment.
    """

    def __init__(
        self, num_races: int = 512, buf: Any = None, seed: int = 0, **arguments: Any
    ) -> None:
        self.races = gym.make_vec(
            "pcs_racing/Drive-v1", num_envs=num_races, autoreset_mode="SAME_STEP", **arguments
        )
        self.single_observation_space = self.races.single_observation_space
        self.single_action_space = self.races.single_action_space
        self.num_agents = num_races
        self.first_seed = seed
        super().__init__(buf)

    def reset(self, seed: int | None = None) -> tuple[NDArray[np.float32], list[dict[str, Any]]]:
        """Begin new races."""
        self.observations[:] = self.races.reset(seed=self.first_seed if seed is None else seed)[0]
        return self.observations, []

    def step(self, actions: NDArray[np.float32]) -> tuple[Any, ...]:
        """Make a step in every race, and write the results into the buffers."""
        observations, rewards, terminated, truncated, info = self.races.step(actions)
        self.observations[:], self.rewards[:] = observations, rewards
        self.terminals[:], self.truncations[:] = terminated, truncated
        ended = terminated | truncated
        infos = []
        if ended.any():  # PufferLib averages the numbers of the infos
            last = info["final_info"]
            infos = [
                {
                    "progress": float(last["progress"][ended].mean()),
                    "won": float((last["result"][ended] == 1).mean()),
                    "faults": float(last["fault"][ended].mean()),
                }
            ]
        return self.observations, self.rewards, self.terminals, self.truncations, infos

    def close(self) -> None:
        """Free the threads of the races."""
        self.races.close()


def main() -> None:
    envs = pufferlib.vector.make(
        Races,
        env_kwargs={"num_races": 256, "opponent": [(2, "lattice"), (1, "pure-pursuit")]},
        backend=pufferlib.PufferEnv,
    )
    envs.async_reset(seed=0)
    begun, steps, ends = time.process_time(), 0, []
    for _ in range(200):
        observations, *_, infos, _, _ = envs.recv()  # any version
        assert observations is envs.observations, "the races write into the buffers"
        ends += infos
        envs.send(envs.action_space.sample())
        steps += envs.num_agents
    rate = steps / (time.process_time() - begun)
    print(
        f"{steps} steps, {rate:.0f} a second of processor time; observations {observations.shape}"
    )
    print(
        "mean progress of the races that ended:", round(np.mean([e["progress"] for e in ends]), 1)
    )
    envs.close()


if __name__ == "__main__":
    main()
