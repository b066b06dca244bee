"""Train MaskablePPO of sb3-contrib, and race it by a protocol.

    python examples/maskable_ppo.py
    pcs-racing tournament --protocol bench-v4 --agents examples.maskable_ppo:make_agent

Two moves that lead to the same policy are one choice: the training masks the second one, and a race
computes the mask from the observation. The training uses the tracks and opponents that the
protocol allows. Run the second command in the folder that contains ``examples``. Tested with
sb3-contrib 2.9.2.
"""

import argparse
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pcs_racing.game import RaceGame, duplicate_moves
from pcs_racing_agents.agents import observing

try:
    import torch
    from sb3_contrib import MaskablePPO

    from pcs_racing.envs import make_sb3_vec_env
except ModuleNotFoundError as error:
    raise SystemExit(f'this example needs {error.name}: pip install ".[learning]"') from None

OUT = Path("out/maskable_ppo")
WORLD = {"archive": "contest", "rules": "contest"}
"""Archive and rules of the protocol."""
TRACKS = ["Brackwater", "Pipkin"]
"""Training tracks of the protocol."""
OPPONENTS = ["never-switch", "random-moves"]
"""Training opponents of the protocol: one keeps its policy, one draws every move."""


@dataclass(frozen=True, eq=False)
class MaskedAgent:
    """A model of sb3-contrib without its environment: the observation gives the mask."""

    policy: Any  # the network: its weights identify the agent
    spec: RaceGame
    name: str = "maskable-ppo"

    def act(self, observations: np.ndarray, turn: Any = None) -> np.ndarray:
        """Return the most probable unmasked moves."""
        archive = self.spec.archive
        # the agent's current policies
        driven = archive.nearest(observing.own(observations, len(archive.characteristics)))
        masks = ~duplicate_moves(self.spec.table[:, : self.spec.offered])[driven]
        return self.policy.predict(observations, deterministic=True, action_masks=masks)[0]


def make_agent(spec: RaceGame) -> MaskedAgent:
    """Return the trained agent; the tournament calls this function."""
    return MaskedAgent(MaskablePPO.load(OUT / "model.zip", device="cpu").policy, spec)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--steps", type=int, default=60_000, help="training moves")
    parser.add_argument("--seed", type=int, default=0, help="seed of all random numbers")
    given = parser.parse_args()
    torch.set_num_threads(1)  # the networks are small: more threads only wait for each other
    OUT.mkdir(parents=True, exist_ok=True)
    envs = make_sb3_vec_env("duel", 64, track=TRACKS, opponent=OPPONENTS, **WORLD)
    model = MaskablePPO(
        "MlpPolicy",
        envs,
        seed=given.seed,
        learning_rate=lambda left: left * 1e-3,
        n_steps=16,
        batch_size=256,
        n_epochs=8,
        gamma=1.0,
        ent_coef=0.01,
        policy_kwargs={"net_arch": [64, 64]},
        stats_window_size=2000,  # games in the mean below
        device="cpu",
    )
    model.learn(given.steps)
    games = [episode["r"] for episode in model.ep_info_buffer]
    print(f"mean return of the last {len(games)} training games: {np.mean(games):+.3f}")
    model.save(OUT / "model.zip")
    print(OUT / "model.zip")


if __name__ == "__main__":
    main()
