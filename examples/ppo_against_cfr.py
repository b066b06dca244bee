"""Train PPO in Duel, save it, and race it against the CFR agent (counterfactual regret).

    python examples/ppo_against_cfr.py --steps 20000 --races 100

The zip that Stable-Baselines3 writes races in every command, too:
``pcs-racing tournament --agents out/ppo.zip cfr-argmax``.
"""

import argparse

from stable_baselines3 import PPO

from pcs_racing import load_track
from pcs_racing.envs import make_sb3_vec_env
from pcs_racing_agents import play_tournament

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--steps", type=int, default=20_000, help="moves to learn from")
parser.add_argument("--races", type=int, default=100, help="races of each pair, even")
given = parser.parse_args()

env = make_sb3_vec_env("duel", 64, track="Tarnfjord", opponent=["never-switch", "random-moves"])
model = PPO("MlpPolicy", env, n_steps=16, batch_size=256, gamma=1.0, seed=0, device="cpu")
model.learn(given.steps)
model.save("out/ppo.zip")

rivals = {name: name for name in ("cfr-argmax", "line-ppo", "never-switch")}
print(
    play_tournament(
        load_track("Tarnfjord"), {"ppo": model, **rivals}, races_per_pair=given.races, seed=1
    )
)
