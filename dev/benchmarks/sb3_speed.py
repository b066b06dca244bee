"""Steps of PPO of Stable-Baselines3 a second of processor time, learning included: default settings
against large batches.

    python dev/benchmarks/sb3_speed.py [--steps 262144] [--learn 60]

``Drive`` with 41 numbers against ``lattice``, two layers of 64 for actor and critic, torch and
races with one thread. All settings run in turns, and the best round of each counts; the default
settings train for an eighth of the steps. ``--learn`` trains with each of the settings for this
processor time (s), and prints the strength of the policy.
"""

import argparse
import time
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from stable_baselines3 import PPO

import pcs_racing  # noqa: F401  (registers)
from pcs_racing.envs import DriveVectorEnv
from pcs_racing.envs.infos import Result
from pcs_racing.envs.sb3 import make_sb3_vec_env

ROUNDS = 3
TASK = {"opponent": "lattice"}
LESSON = {"opponent": "gap-follower:top_speed=4", "normalize": True, "rivalry": 0.5}
LARGE = "512 environments, batches of 8192, 4 epochs"
_LARGE = {"n_steps": 32, "batch_size": 8192, "n_epochs": 4, "learning_rate": 1e-3}
SETTINGS: dict[str, tuple[int, dict[str, Any]]] = {
    "default settings, gym.make": (0, {}),
    "default settings, 16 environments": (16, {"n_steps": 128}),
    "512 environments, batches of 2048, 4 epochs": (512, _LARGE | {"batch_size": 2048}),
    LARGE: (512, _LARGE),
    f"{LARGE}, ReLU": (512, _LARGE | {"policy_kwargs": {"activation_fn": torch.nn.ReLU}}),
}
"""Number of environments (0 for ``gym.make``), and settings of PPO."""
FORWARD_FLOP = 2 * 2 * (41 * 64 + 64 * 64 + 64 * 2)
"""Operations of a step forward through both networks; backward takes twice as many."""


def make_model(name: str, task: dict[str, Any], threads: int | None = 1) -> PPO:
    """Make an untrained model with one of the settings."""
    envs, settings = SETTINGS[name]
    env = (
        make_sb3_vec_env("drive", envs, threads=threads, **task)
        if envs
        else gym.make("pcs_racing/Drive-v1", **task)
    )
    return PPO("MlpPolicy", env, seed=0, device="cpu", **settings)


def learn(name: str, seconds: float) -> str:
    """Train for this processor time, and return the policy's result in 200 races."""
    model, begun = make_model(name, LESSON), time.process_time()
    while time.process_time() - begun < seconds:
        model.learn(model.n_steps * model.n_envs, reset_num_timesteps=False)
    races = DriveVectorEnv(200, **LESSON)
    observations, _ = races.reset(seed=1_000_000)
    over, ends = np.zeros(200, bool), np.zeros((3, 200))
    while not over.all():
        observations, _, ended, late, info = races.step(
            model.predict(observations, deterministic=True)[0]
        )
        new = (ended | late) & ~over
        ends[:, new] = np.stack([info["progress"], info["result"] == Result.WIN, info["fault"]])[
            :, new
        ]
        over |= new
    progress, won, faults = ends.mean(axis=1)
    return f"{model.num_timesteps:10,} steps  {progress:6.1f} m  won {won:.2f}  faults {faults:.2f}"


def steps_per_second(
    name: str, steps: int, task: dict[str, Any] = TASK, threads: int | None = 1
) -> float:
    """Train for about this number of steps, and return the steps a second of processor time."""
    model, begun = make_model(name, task, threads), time.process_time()
    model.learn(steps)
    return model.num_timesteps / (time.process_time() - begun)


def arithmetic_limit(epochs: int) -> float:
    """Return the steps a second that the products of the networks alone would allow.

    The rate of products is measured: batches of 8192, layers of 64.
    """
    rows, weights = torch.randn(8192, 64), torch.randn(64, 64)
    begun, products = time.process_time(), 200
    for _ in range(products):
        torch.mm(rows, weights)
    rate = products * 2 * 8192 * 64 * 64 / (time.process_time() - begun)
    return rate / ((1 + 3 * epochs) * FORWARD_FLOP)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--steps", type=int, default=262_144, help="steps of each training")
    parser.add_argument("--learn", type=float, default=0.0, help="processor time of a lesson, s")
    given = parser.parse_args()
    torch.set_num_threads(1)
    for name in SETTINGS:
        steps_per_second(name, 1)  # compile
    if given.learn > 0.0:
        for name in SETTINGS:
            print(f"{name:50} {learn(name, given.learn)}", flush=True)
        return
    best = dict.fromkeys(SETTINGS, 0.0)
    for _ in range(ROUNDS):
        for name in SETTINGS:
            steps = given.steps if SETTINGS[name][0] > 16 else given.steps // 8
            best[name] = max(best[name], steps_per_second(name, steps))
    print("steps a second of PPO, Drive with 41 numbers")
    for name, rate in best.items():
        print(f"{name:50} {rate:8.0f}  x {rate / best['default settings, gym.make']:.1f}")
    limit = arithmetic_limit(SETTINGS[LARGE][1]["n_epochs"])
    print(f"{'limit by the products of the networks':50} {limit:8.0f}")


if __name__ == "__main__":
    main()
