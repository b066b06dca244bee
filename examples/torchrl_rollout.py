"""TorchRL: play the duel and both cars of the head-to-head environment, and learn from what was played.

    python examples/torchrl_rollout.py
    python examples/torchrl_rollout.py --updates 20 --games 200

One step of REINFORCE per rollout, for one car against random moves and for both cars with one network (self-play). It
shows the wiring, not good racing. Run with torchrl 0.14.1, tensordict 0.14.3, torch 2.13.0, gymnasium 1.4.0 and
pettingzoo 1.27.0. Without TorchRL it says so and ends.
"""

import argparse
import sys
from typing import Any

import gymnasium as gym
import numpy as np
from pettingzoo.utils import BaseParallelWrapper

import pcs_racing

try:
    import torch
    from torch import nn
    from torch.distributions import Categorical
except ModuleNotFoundError as error:
    raise SystemExit(f'this example needs {error.name}: pip install ".[learning]"') from None
try:
    from tensordict.nn import TensorDictModule
    from torchrl.envs import GymWrapper, PettingZooWrapper
except ImportError as error:
    print(f"skipped: TorchRL can't be imported ({error}); pip install torchrl")
    sys.exit(0)


class MaskOnly(BaseParallelWrapper):
    """Keep the mask of the infos, and drop the rest, of which TorchRL would keep tensors."""

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        """Begin a new game."""
        seen, infos = self.env.reset(seed=seed, options=options)
        return seen, self.masks(infos)

    def step(self, actions: dict[str, Any]) -> Any:
        """Let both cars move."""
        *results, infos = self.env.step({agent: int(action) for agent, action in actions.items()})
        return *results, self.masks(infos)

    @staticmethod
    def masks(infos: dict[str, dict[str, Any]]) -> dict[str, dict[str, np.ndarray]]:
        """Pick the masks."""
        return {agent: {"action_mask": info["action_mask"]} for agent, info in infos.items()}


class Player(nn.Module):
    """Draws a move; moves that the mask forbids are never drawn."""

    def __init__(self, observations: int, moves: int) -> None:
        super().__init__()
        self.network = nn.Sequential(nn.Linear(observations, 64), nn.Tanh(), nn.Linear(64, moves))

    def moves(self, seen: torch.Tensor, mask: torch.Tensor | None = None) -> Categorical:
        """How likely each move is."""
        logits = self.network(seen)
        return Categorical(logits=logits if mask is None else logits.masked_fill(~mask, -1e9))

    def forward(self, seen: torch.Tensor, mask: torch.Tensor | None = None) -> torch.Tensor:
        """Draw moves."""
        return self.moves(seen, mask).sample()


def learn(optimiser: torch.optim.Optimizer, moves: Categorical, played: Any, after: Any) -> float:
    """Make one step of REINFORCE from a rollout (games one after the other); return the mean utility of a game."""
    going, outcome = torch.zeros_like(after["reward"][0]), torch.zeros_like(after["reward"])
    for t in reversed(range(len(outcome))):  # a game pays at its end: every move of it gets that
        going = after["reward"][t] + going * ~after["done"][t]
        outcome[t] = going
    outcome = outcome.squeeze(-1)
    utility = after["reward"][after["done"]].mean()
    loss = -(moves.log_prob(played["action"]) * (outcome - outcome.mean())).mean()
    optimiser.zero_grad()
    loss.backward()
    optimiser.step()
    return float(utility)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--updates", type=int, default=3, help="rollouts, and steps of the optimiser, of each part")
    parser.add_argument("--games", type=int, default=20, help="games in a rollout, about")
    parser.add_argument("--track", default="Tarnfjord", help="name of a shipped circuit or a map folder")
    parser.add_argument("--seed", type=int, default=0, help="root of everything random")
    given = parser.parse_args()
    torch.manual_seed(given.seed)
    torch.set_num_threads(1)
    steps = 4 * given.games  # a game has four moves, fewer after a crash

    duel = GymWrapper(gym.make("pcs_racing/Duel-v1", track=given.track), categorical_action_encoding=True)
    duel.set_seed(given.seed)
    player = Player(duel.observation_spec["observation"].shape[-1], duel.action_spec.space.n)
    policy = TensorDictModule(player, in_keys=["observation"], out_keys=["action"])
    optimiser = torch.optim.Adam(player.parameters(), lr=1e-2)
    for update in range(given.updates):
        games = duel.rollout(steps, policy, break_when_any_done=False)
        utility = learn(optimiser, player.moves(games["observation"]), games, games["next"])
        print(f"duel, update {update}: {utility:+.2f} m against random moves", flush=True)

    cars = MaskOnly(pcs_racing.parallel_env(track=given.track, mask_duplicates=True))
    pair = PettingZooWrapper(cars, return_state=True, seed=given.seed)
    # TorchRL puts car_0 and car_1 into one group, "car": their tensors have an axis for the car.
    policy = TensorDictModule(
        player, in_keys=[("car", "observation"), ("car", "action_mask")], out_keys=[("car", "action")]
    )
    for update in range(given.updates):
        games = pair.rollout(steps, policy, break_when_any_done=False)
        car = games["car"]
        learn(optimiser, player.moves(car["observation"], car["action_mask"]), car, games["next", "car"])
        total = float(games["next", "car", "reward"].sum(-2).abs().max())
        print(f"self-play, update {update}: the cars' rewards add up to {total:.1f}", flush=True)


if __name__ == "__main__":
    main()
