# /// script
# dependencies = ["torchrl==0.14.1"]
# ///
"""TorchRL: make environments by name, in batches and with two cars, and collect frames.

    python examples/clients/torchrl_envs.py

The environments need no wrapper of their own. A collector steps them with random actions, as in a
training.
"""

from functools import partial

import gymnasium as gym
from torchrl.collectors import Collector
from torchrl.envs import GymEnv, GymWrapper, ParallelEnv, PettingZooWrapper, check_env_specs

import pcs_racing
from pcs_racing.envs import drive

gym.register_envs(pcs_racing)


def main() -> None:
    for name in ("pcs_racing/Duel-v1", "pcs_racing/Drive-v1"):
        env = GymEnv(name)
        check_env_specs(env)
        print(name, "reward of 4 steps:", env.rollout(4)["next", "reward"].shape)

    several = GymEnv("pcs_racing/Drive-v1", num_envs=2)
    print("num_envs=2:", several.rollout(4)["next", "reward"].shape)

    batch = GymWrapper(gym.make_vec("pcs_racing/Drive-v1", num_envs=4, autoreset_mode="DISABLED"))
    print("make_vec:", batch.rollout(4)["next", "reward"].shape)

    processes = ParallelEnv(2, partial(GymEnv, "pcs_racing/Duel-v1"), mp_start_method="spawn")
    print("two processes:", processes.rollout(2, break_when_any_done=False)["next", "reward"].shape)
    processes.close()

    for both in (pcs_racing.parallel_env(), drive.parallel_env(duration=1.0)):
        cars = PettingZooWrapper(both, return_state=True)
        check_env_specs(cars)
        print(f"both cars of {both.metadata['name']}:", cars.rollout(4)["car", "observation"].shape)

    collector = Collector(
        lambda: GymEnv("pcs_racing/Duel-v1"), None, frames_per_batch=16, total_frames=32
    )
    print("collected:", sum(frames.numel() for frames in collector), "frames")
    collector.shutdown()


if __name__ == "__main__":
    main()
