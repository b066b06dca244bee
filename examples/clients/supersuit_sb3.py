# /// script
# dependencies = ["SuperSuit==3.11.0", "stable-baselines3==2.9.2"]
# ///
"""SuperSuit: stack frames of both cars, and train PPO of Stable-Baselines3.

    python examples/clients/supersuit_sb3.py

``pcs_racing.envs.make_sb3_vec_env`` does the same from compiled batches, many times as fast:
``"self-play"`` and ``"drive-self-play"``. SuperSuit's vector environment has no method ``seed``:
leave out ``seed=``.
"""

import supersuit
from stable_baselines3 import PPO

import pcs_racing
from pcs_racing.envs import drive


def main() -> None:
    for both in (pcs_racing.parallel_env(), drive.parallel_env(duration=1.0)):
        cars = supersuit.frame_stack_v1(both, 2)
        pairs = supersuit.pettingzoo_env_to_vec_env_v1(cars)
        env = supersuit.concat_vec_envs_v1(pairs, 4, base_class="stable_baselines3")
        model = PPO("MlpPolicy", env, n_steps=16, batch_size=32, gamma=1.0, device="cpu").learn(128)
        print(f"{both.metadata['name']}: {model.num_timesteps} steps of {env.num_envs} cars")


if __name__ == "__main__":
    main()
