# /// script
# dependencies = ["skrl==2.1.1", "torch"]
# ///
"""skrl: wrap vector environments, and races of one, two and four cars.

    python examples/clients/skrl_wrap.py

Actions are drawn from the spaces of the wrapper, and the returned tensors could fill a memory.
"""

import gymnasium as gym
from skrl.envs.wrappers.torch import wrap_env

import pcs_racing
from pcs_racing.envs import drive

gym.register_envs(pcs_racing)

OPPONENTS = ["lattice:pace=0.3", "pure-pursuit", "lattice:pace=0.2"]


def main() -> None:
    for cars in (1, 2, 4):
        made = gym.make_vec(
            "pcs_racing/Drive-v1", num_envs=4, opponents=OPPONENTS[: cars - 1], beams=9
        )
        vector = wrap_env(made, wrapper="gymnasium", verbose=False)
        observations, _ = vector.reset()
        for _ in range(20):
            actions = observations.new_tensor(made.action_space.sample())
            observations, rewards, terminated, *_ = vector.step(actions)
        print(
            f"{cars} cars, vector:",
            tuple(observations.shape),
            tuple(rewards.shape),
            tuple(terminated.shape),
        )
        vector.close()
        race = wrap_env(drive.parallel_env(cars=cars, beams=9), wrapper="pettingzoo", verbose=False)
        observed, _ = race.reset()
        while race.agents:
            actions = {name: observed[name].new_tensor([[0.0, -0.6]]) for name in race.agents}
            observed, paid, *_ = race.step(actions)
        print(
            f"{cars} cars, parallel:",
            {name: tuple(one.shape) for name, one in observed.items()},
            tuple(paid),
        )
        race.close()


if __name__ == "__main__":
    main()
