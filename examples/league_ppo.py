"""Train PPO against a league of planners and frozen copies of the policy.

    python examples/league_ppo.py
    python examples/league_ppo.py --steps 8000000 --rounds 16

A round trains PPO with large batches. The opponent of each race is drawn; opponents that give even
races are drawn most often, so the difficulty rises with success. At the end of a round a copy of
the policy joins the league, and a line reports the races won against planners. A stopped training
resumes from its folder, with the same league and the saved weights. Tested with stable-baselines3
2.9.2.
"""

import argparse
import time
from pathlib import Path

import numpy as np

from pcs_racing.envs import DriveVectorEnv, Result

try:
    import torch
    from stable_baselines3 import PPO
    from stable_baselines3.common.vec_env import VecEnv

    from pcs_racing.envs import make_sb3_vec_env
except ModuleNotFoundError as error:
    raise SystemExit(f'this example needs {error.name}: pip install ".[learning]"') from None

from pcs_racing_agents import learning
from pcs_racing_agents.agents import save_model

PLANNERS = {
    "gap-follower:top_speed=4": 1,
    "pure-pursuit:pace=0": 1,
    "lattice:pace=0": 1,
    "lattice:pace=0.5": 1,
    "pure-pursuit": 1,
    "lattice": 1,
}
"""Planners of the league at its start, with their weights."""

TESTS = ("gap-follower:top_speed=4", "pure-pursuit", "stanley", "lattice")
"""Opponents of the test races; ``stanley`` is never in the league."""


def main() -> None:
    given = parse()
    torch.set_num_threads(1)  # the networks are small: more threads only wait for each other
    task = {"track": given.track, "rules": "contest", "normalize": True, "duration": 20.0}
    pay = {"progress_reward": 0.1, "rivalry": 0.5, "crash_penalty": 1.0}
    folder, file = given.out / "league", given.out / "model.zip"
    league = learning.load_league(folder) if folder.exists() else learning.make_league(PLANNERS)
    tests = {
        name: DriveVectorEnv(given.races, opponent=name, **task | {"duration": 40.0})
        for name in TESTS
    }
    print(f"{'steps':>10} {'minutes':>8} {'copies':>7}  won against " + ", ".join(tests))
    begun = time.process_time()
    model: PPO | None = None
    for _ in range(given.rounds):
        envs = make_sb3_vec_env("drive", given.envs, opponent=league.opponents(), **task, **pay)
        if model is None:
            model = PPO.load(file, envs) if file.exists() else make_model(envs, given.seed)
        model.set_env(envs)
        callback = learning.league_callback(league)
        model.learn(given.steps // given.rounds, callback, reset_num_timesteps=False)
        league = callback.league.with_copy(model, folder)
        learning.save_league(folder, league)
        save_model(file, model)
        won = [f"{test(model, races):.0%}" for races in tests.values()]
        minutes = (time.process_time() - begun) / 60
        print(f"{model.num_timesteps:10,} {minutes:8.1f} {copies(league):7}  {' '.join(won)}")
    for member in league.members:
        print(f"{member.name:28} won {member.won_share:.0%}")


def make_model(envs: VecEnv, seed: int) -> PPO:
    """A policy of two layers of 64, trained in large batches."""
    return PPO(
        "MlpPolicy",
        envs,
        seed=seed,
        n_steps=32,
        batch_size=min(8192, 32 * envs.num_envs),
        n_epochs=4,
        learning_rate=1e-3,
        policy_kwargs={"net_arch": [64, 64], "log_std_init": -1.0},
        device="cpu",
    )


def copies(league: learning.League) -> int:
    """Number of frozen copies of a league."""
    return sum(member.is_copy for member in league.members)


def test(model: PPO, races: DriveVectorEnv) -> float:
    """Share of races that the policy wins without exploration noise: the first of each env."""
    observations, _ = races.reset(seed=1_000_000)
    over, won = np.zeros(races.num_envs, bool), np.zeros(races.num_envs, bool)
    while not over.all():
        observations, _, ended, late, info = races.step(
            model.predict(observations, deterministic=True)[0]
        )
        won |= (ended | late) & ~over & (info["result"] == Result.WIN)
        over |= ended | late
    return won.mean()


def parse() -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    option = parser.add_argument
    option("--steps", type=int, default=1_000_000, help="training steps of all races together")
    option(
        "--rounds", type=int, default=4, help="rounds; each adds a copy of the policy to the league"
    )
    option("--track", default="Tarnfjord", help="name of a shipped track or a map folder")
    option("--envs", type=int, default=512, help="races at once")
    option("--races", type=int, default=100, help="test races against each planner after a round")
    option("--seed", type=int, default=0, help="seed of all random numbers")
    option(
        "--out",
        type=Path,
        default=Path("out/league_ppo"),
        help="folder of the league and model.zip",
    )
    return parser.parse_args()


if __name__ == "__main__":
    main()
