# /// script
# dependencies = ["agilerl==2.7.1"]
# ///
"""AgileRL: train IPPO on both cars, with AgileRL's vector environment.

    python examples/clients/agilerl_ippo.py

AgileRL 2.7.1 can't compare masks of several agents (``extract_action_masks``), so a wrapper removes
them. A masked move is valid: it has the same effect as another move.
"""

from typing import Any

from agilerl.algorithms import IPPO
from agilerl.training.train_multi_agent_on_policy import train_multi_agent_on_policy
from agilerl.vector.pz_async_vec_env import AsyncPettingZooVecEnv
from pettingzoo.utils import BaseParallelWrapper

import pcs_racing


class WithoutMasks(BaseParallelWrapper):
    """The environment without action masks."""

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        """Begin a game."""
        observations, infos = self.env.reset(seed=seed, options=options)
        return observations, {car: {} for car in infos}

    def step(self, actions: dict[str, Any]) -> Any:
        """Let both cars move."""
        *results, infos = self.env.step(actions)
        return *results, {car: {} for car in infos}


def make() -> WithoutMasks:
    """Make the environment; every process of the vector environment does."""
    return WithoutMasks(pcs_racing.parallel_env(track="Tarnfjord"))


def main() -> None:
    cars = make()
    env = AsyncPettingZooVecEnv([make, make])
    agent = IPPO(
        observation_spaces=[cars.observation_space(car) for car in cars.possible_agents],
        action_spaces=[cars.action_space(car) for car in cars.possible_agents],
        agent_ids=cars.possible_agents,
        learn_step=16,
        batch_size=8,
        gamma=1.0,
        device="cpu",
    )
    train_multi_agent_on_policy(
        env,
        "head_to_head",
        "IPPO",
        [agent],
        max_steps=64,
        evo_steps=32,
        eval_steps=4,
        verbose=False,
    )
    env.close()
    print(f"{agent.steps[-1]} moves of both cars")


if __name__ == "__main__":
    main()
