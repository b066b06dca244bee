"""Train one PPO policy for both cars of a game: self-play with shared parameters.

    python examples/self_play_ppo.py
    python examples/self_play_ppo.py --steps 200000

Environments come in pairs, one for each car of a game. The policy is then tested against held-out
opponents. Tested with stable-baselines3 2.9.2.
"""

import argparse

import numpy as np

from pcs_racing.envs import DuelVectorEnv

try:
    import torch
    from stable_baselines3 import PPO

    from pcs_racing.envs import make_sb3_vec_env
except ModuleNotFoundError as error:
    raise SystemExit(f'this example needs {error.name}: pip install ".[learning]"') from None

parser = argparse.ArgumentParser(
    description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
)
parser.add_argument(
    "--steps", type=int, default=60_000, help="training moves of both cars together"
)
parser.add_argument("--track", default="Brackwater", help="name of a shipped track or a map folder")
parser.add_argument(
    "--archive", default="contest", help="archive of policies that both cars drive with"
)
parser.add_argument("--rules", default="contest", help="rules: paper, contest or a YAML file")
parser.add_argument("--games", type=int, default=500, help="test games against each opponent")
parser.add_argument("--seed", type=int, default=0, help="seed of all random numbers")
arguments = parser.parse_args()

torch.set_num_threads(1)  # the networks are small: more threads only wait for each other
game = {"track": arguments.track, "archive": arguments.archive, "rules": arguments.rules}
envs = make_sb3_vec_env("self-play", 64, **game)
model = PPO(
    "MlpPolicy",
    envs,
    seed=arguments.seed,
    n_steps=16,
    batch_size=256,
    n_epochs=8,
    gamma=1.0,
    ent_coef=0.02,  # a predictable policy loses against a copy of itself
    learning_rate=lambda left: 1e-3 * left,  # falling to 0
    device="cpu",
)
model.learn(arguments.steps)

print(f"{'opponent':28} {'utility':>8} {'+-':>6} {'won':>6}")
duel = envs.get_attr("game")[0]
names = [f"always-{move}" for move in duel.moves[: duel.offered]]
for opponent in ("random-moves", "never-switch", *names):
    duels = DuelVectorEnv(arguments.games, opponent=opponent, **game)
    observations, _ = duels.reset(seed=1_000_000 + arguments.seed)
    returns = np.full(arguments.games, np.nan)
    while np.isnan(returns).any():
        observations, rewards, done, _, info = duels.step(
            model.predict(observations, deterministic=False)[0]
        )
        ended = done & np.isnan(returns)  # the first game of each environment counts
        returns[ended] = rewards[ended]
    error = returns.std() / np.sqrt(len(returns))
    print(f"{opponent:28} {returns.mean():8.2f} {error:6.2f} {np.mean(returns > 0):6.1%}")
