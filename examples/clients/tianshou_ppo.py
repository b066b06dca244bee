# /// script
# dependencies = ["tianshou==2.0.1"]
# ///
"""Tianshou: collect games of the duel by a PPO policy, in its vector environment.

    python examples/clients/tianshou_ppo.py

Eight games fill the buffer of an untrained policy.
"""

import gymnasium as gym
import numpy as np
import torch
from tianshou.algorithm import PPO
from tianshou.algorithm.modelfree.reinforce import DiscreteActorPolicy
from tianshou.algorithm.optim import AdamOptimizerFactory
from tianshou.data import Collector, CollectStats, VectorReplayBuffer
from tianshou.env import DummyVectorEnv
from tianshou.utils.net.common import Net
from tianshou.utils.net.discrete import DiscreteActor, DiscreteCritic

import pcs_racing

gym.register_envs(pcs_racing)


def main() -> None:
    torch.manual_seed(0)
    envs = DummyVectorEnv([lambda: gym.make("pcs_racing/Duel-v1") for _ in range(4)])
    envs.seed(0)
    space = envs.action_space[0]
    net = Net(state_shape=envs.observation_space[0].shape, hidden_sizes=[64])
    policy = DiscreteActorPolicy(
        actor=DiscreteActor(preprocess_net=net, action_shape=space.n), action_space=space
    )
    algorithm = PPO(
        policy=policy,
        critic=DiscreteCritic(preprocess_net=net),
        optim=AdamOptimizerFactory(lr=3e-4),
        gamma=1.0,
    )
    collector = Collector[CollectStats](algorithm, envs, VectorReplayBuffer(256, len(envs)))
    collector.reset()
    collected = collector.collect(n_episode=8)
    print(
        f"{collected.n_collected_episodes} episodes, mean return"
        f" {np.mean(collected.returns):+.2f} m"
    )


if __name__ == "__main__":
    main()
