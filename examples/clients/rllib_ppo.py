# /// script
# dependencies = ["ray[rllib]==2.60.0"]
# ///
"""RLlib: train PPO on the duel, and one network for both cars by self-play.

    python examples/clients/rllib_ppo.py
    python examples/clients/rllib_ppo.py --iterations 50

Workers are processes of Ray: each imports ``pcs_racing`` in the function that makes its
environment.
"""

import argparse
from typing import Any

import ray
from ray.rllib.algorithms.ppo import PPOConfig
from ray.rllib.env.wrappers.pettingzoo_env import ParallelPettingZooEnv
from ray.tune.registry import register_env


def duel(config: dict[str, Any]) -> Any:
    """Make the duel; Gymnasium imports the package before the colon."""
    import gymnasium as gym

    return gym.make("pcs_racing:pcs_racing/Duel-v1", **config)


def head_to_head(config: dict[str, Any]) -> ParallelPettingZooEnv:
    """Make the game of moves for both cars."""
    import pcs_racing

    return ParallelPettingZooEnv(pcs_racing.parallel_env(**config))


def drive_head_to_head(config: dict[str, Any]) -> ParallelPettingZooEnv:
    """Make the race with steering and speed of both cars."""
    from pcs_racing.envs import drive

    return ParallelPettingZooEnv(drive.parallel_env(**config))


def self_play(name: str, **arguments: Any) -> PPOConfig:
    """Return the config of PPO with one network for both cars."""
    return (
        PPOConfig()
        .environment(name, env_config={"track": "Tarnfjord", **arguments})
        .multi_agent(policies={"shared"}, policy_mapping_fn=lambda agent, *args, **kwargs: "shared")
    )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--iterations", type=int, default=1, help="updates of each training")
    given = parser.parse_args()
    ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False)
    register_env("duel", duel)
    register_env("head_to_head", head_to_head)
    register_env("drive_head_to_head", drive_head_to_head)
    small = {
        "gamma": 1.0,
        "train_batch_size_per_learner": 64,
        "minibatch_size": 32,
        "num_epochs": 2,
    }
    alone = PPOConfig().environment("duel", env_config={"track": "Tarnfjord"})
    configs = {
        "duel": alone,
        "self-play": self_play("head_to_head"),
        "self-play, steering and speed": self_play("drive_head_to_head", duration=1.0),
    }
    for name, config in configs.items():
        algorithm = config.env_runners(num_env_runners=1).training(**small).build_algo()
        for _ in range(given.iterations):
            results = algorithm.train()["env_runners"]
        print(
            f"{name}: {results['num_episodes']} episodes, mean return"
            f" {results['episode_return_mean']:+.2f} m"
        )
        algorithm.stop()
    ray.shutdown()


if __name__ == "__main__":
    main()
