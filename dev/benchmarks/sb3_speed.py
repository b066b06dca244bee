"""Steps a second of PPO of Stable-Baselines3 with its default settings, with torch's own threads
and with one.

    python dev/benchmarks/sb3_speed.py [--steps 4096]

All in one run, in turns, and the best round of each counts. The networks are so small that more
threads only wait for each other, most of all on a machine that does other work as well.
"""

import argparse
import time

import gymnasium as gym
import torch
from stable_baselines3 import PPO

import pcs_racing  # noqa: F401  (registers)
from pcs_racing.envs.sb3 import make_sb3_vec_env

ROUNDS = 3
ENVIRONMENTS = {
    "gym.make": lambda: gym.make("pcs_racing/Drive-v1", opponent="lattice", beams=108),
    "make_sb3_vec_env, 16": lambda: make_sb3_vec_env("drive", 16, opponent="lattice", beams=108),
    "make_sb3_vec_env, 64": lambda: make_sb3_vec_env("drive", 64, opponent="lattice", beams=108),
}


def steps_per_second(name: str, threads: int, steps: int) -> float:
    """Train for some steps, and return how many a second."""
    torch.set_num_threads(threads)
    env = ENVIRONMENTS[name]()
    rollout = 512 // getattr(env, "num_envs", 1)
    model = PPO("MlpPolicy", env, n_steps=rollout, seed=0, device="cpu")
    begun = time.perf_counter()
    model.learn(steps)
    return model.num_timesteps / (time.perf_counter() - begun)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--steps", type=int, default=4096, help="steps of each training")
    steps = parser.parse_args().steps
    usual = torch.get_num_threads()
    cells = [(name, threads) for name in ENVIRONMENTS for threads in dict.fromkeys((usual, 1))]
    for name in ENVIRONMENTS:
        steps_per_second(name, usual, 1)  # compile
    best = dict.fromkeys(cells, 0.0)
    for _ in range(ROUNDS):
        for cell in cells:
            best[cell] = max(best[cell], steps_per_second(*cell, steps))
    print(f"steps a second of PPO, Drive with 108 beams; torch's own threads: {usual}")
    for (name, threads), rate in best.items():
        print(f"{name:22} {threads} threads {rate:8.0f}")


if __name__ == "__main__":
    main()
