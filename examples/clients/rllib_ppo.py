# /// script
# dependencies = ["ray[rllib]==2.60.0"]
# ///
"""RLlib: PPO on the duel, and self-play of one network in both cars of the head-to-head environment.

    python examples/clients/rllib_ppo.py
    python examples/clients/rllib_ppo.py --iterations 50

Workers are processes of Ray: each imports ``pcs_racing`` where it makes its environment.
"""

import argparse
from typing import Any

import ray
from ray.rllib.algorithms.ppo import PPOConfig
from ray.rllib.env.wrappers.pettingzoo_env import ParallelPettingZooEnv
from ray.tune.registry import register_env


def duel(config: dict[str, Any]) -> Any:
    """Make the duel; the text before the colon tells Gymnasium what to import."""
    import gymnasium as gym

    return gym.make("pcs_racing:pcs_racing/Duel-v1", **config)


def head_to_head(config: dict[str, Any]) -> ParallelPettingZooEnv:
    """Make the game of both cars."""
    import pcs_racing

    return ParallelPettingZooEnv(pcs_racing.parallel_env(**config))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--iterations", type=int, default=1, help="updates of each training")
    given = parser.parse_args()
    ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False)
    register_env("duel", duel)
    register_env("head_to_head", head_to_head)
    small = {"gamma": 1.0, "train_batch_size_per_learner": 64, "minibatch_size": 32, "num_epochs": 2}
    alone = PPOConfig().environment("duel", env_config={"track": "Tarnfjord"})
    pair = (
        PPOConfig()
        .environment("head_to_head", env_config={"track": "Tarnfjord"})
        .multi_agent(policies={"shared"}, policy_mapping_fn=lambda agent, *args, **kwargs: "shared")
    )
    for name, config in (("duel", alone), ("self-play", pair)):
        algorithm = config.env_runners(num_env_runners=1).training(**small).build_algo()
        for _ in range(given.iterations):
            results = algorithm.train()["env_runners"]
        print(f"{name}: {results['num_episodes']} episodes, mean return {results['episode_return_mean']:+.2f} m")
        algorithm.stop()
    ray.shutdown()


if __name__ == "__main__":
    main()
