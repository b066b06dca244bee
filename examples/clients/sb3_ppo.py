# /// script
# dependencies = ["stable-baselines3==2.9.2", "sb3-contrib==2.9.2"]
# ///
"""Stable-Baselines3: train PPO, MaskablePPO, RecurrentPPO and SAC on the environments.

    python examples/clients/sb3_ppo.py

SB3's helpers make the environments by name. ``pcs_racing.envs.make_sb3_vec_env`` makes them as
compiled batches (docs/recipes.md).
"""

import gymnasium as gym
from sb3_contrib import MaskablePPO, RecurrentPPO
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.env_checker import check_env
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.vec_env import VecNormalize

import pcs_racing

gym.register_envs(pcs_racing)


def main() -> None:
    for name in ("pcs_racing/Duel-v1", "pcs_racing/Drive-v1"):
        check_env(gym.make(name).unwrapped)
    duels = VecNormalize(make_vec_env("pcs_racing/Duel-v1", 4, seed=0), norm_obs=False)
    small = {"n_steps": 16, "batch_size": 32, "gamma": 1.0, "seed": 0, "device": "cpu"}
    for kind, policy in (
        (PPO, "MlpPolicy"),
        (MaskablePPO, "MlpPolicy"),
        (RecurrentPPO, "MlpLstmPolicy"),
    ):
        model = kind(policy, duels, **small).learn(128)
        print(f"{kind.__name__} on the duel: {model.num_timesteps} moves")
    mean, spread = evaluate_policy(
        model, make_vec_env("pcs_racing/Duel-v1", 1, seed=1), n_eval_episodes=4
    )
    print(f"mean return of the last model: {mean:+.2f} +- {spread:.2f} m")
    drives = make_vec_env("pcs_racing/Drive-v1", 2, seed=0, env_kwargs={"duration": 2.0})
    model = SAC("MlpPolicy", drives, learning_starts=50, seed=0, device="cpu").learn(200)
    print(f"SAC on the drive: {model.num_timesteps} steps")


if __name__ == "__main__":
    main()
