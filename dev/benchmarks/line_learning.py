"""Measure the learning of ten lines of Stable-Baselines3 in `Line`: PPO with `CandidatePolicy`.

    python dev/benchmarks/line_learning.py --maps ../shared/maps --steps 15000000

The model and its scores against the default lattice, on circuits that it did not learn on, under
the rules ``contest``, are written at each tenth of the training.
"""

import argparse
import time
from pathlib import Path

import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback

from pcs_racing import load_track, run_races
from pcs_racing.envs import RandomCircuits, find_speeds, make_sb3_vec_env, random_circuit
from pcs_racing.planners.line_ppo import network_policy
from pcs_racing.track.maps import list_tracks
from pcs_racing_agents.learning import CandidatePolicy

OPPONENTS = [
    (3.0, "lattice"),
    "iterated-best-response",
    "spliner",
    "pure-pursuit",
    "gap-follower",
    "gap-follower:top_speed=3",
    "disparity-extender:top_speed=4",
]
HELD_OUT = ("Saltmere", "Vellindra", "Austin", "Monza", "Sepang", "Zandvoort")
STYLE = {"assertiveness": 0.4, "pace": 1.4}
WIDTHS = (2.2, 2.0, 3.0, 2.5)  # m, of the random circuits
SEED = 20_261_129  # seed of the test races


class Report(BaseCallback):
    """Races and saves the network at each tenth of the training."""

    def __init__(self, given: argparse.Namespace) -> None:
        super().__init__()
        self.given, self.said, self.began = given, 0, (time.monotonic(), time.process_time())

    def _on_step(self) -> bool:
        return True

    def _on_rollout_start(self) -> None:
        if self.num_timesteps * 10 >= self.said * self.given.steps:
            self.said += 1
            self.report()

    def _on_training_end(self) -> None:
        self.report()

    def report(self) -> None:
        """Print scores and own crashes on each circuit."""
        wall, cpu = time.monotonic() - self.began[0], time.process_time() - self.began[1]
        policy = network_policy(self.model.policy.action_net.tensors(), style=STYLE)
        found = []
        for name in HELD_OUT:
            shipped = name in list_tracks()
            track = load_track(name if shipped else self.given.maps / name)
            ours = [policy] * self.given.races
            result = run_races(track, ours, "lattice", "contest", seed=SEED, threads=1)
            won = np.where(result.winner == -1, 0.5, result.winner == 0)
            found.append((won.mean(), result.own_crash[:, 0].mean()))
        score, crashes = np.mean(found, axis=0)
        cells = "  ".join(f"{a:.3f} ({b:.3f})" for a, b in found)
        print(
            f"{self.num_timesteps:12,} {wall / 60:6.1f} min, {cpu / 60:6.1f} of the processor "
            f" score {score:.3f} own crashes {crashes:.3f}   {cells}",
            flush=True,
        )
        self.model.save(self.given.out)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    add = parser.add_argument
    add("--maps", type=Path, required=True, help="folder of the real circuits")
    add("--steps", type=int, default=15_000_000, help="choices")
    add("--envs", type=int, default=512)
    add("--races", type=int, default=200, help="test races on each circuit")
    add("--random", type=int, default=40, help="number of random circuits in addition")
    add("--out", type=Path, default=Path("out/line.zip"))
    given = parser.parse_args()
    torch.set_num_threads(1)
    tracks = [load_track(name) for name in list_tracks() if name not in (*HELD_OUT, "Larkmoor")]
    for k in range(given.random):
        drawn = RandomCircuits(width=WIDTHS[k % len(WIDTHS)], longest=120.0 + 30.0 * (k % 7))
        tracks.append(find_speeds(random_circuit(drawn, k)))
    task = {"track": tracks, "opponent": OPPONENTS, "style": STYLE, "fault_penalty": 2.0}
    env = make_sb3_vec_env("line", given.envs, threads=1, **task)
    model = PPO(
        CandidatePolicy,
        env,
        n_steps=64,
        batch_size=8192,
        n_epochs=3,
        learning_rate=lambda left: 5e-4 * (0.1 + 0.9 * left),
        ent_coef=0.001,
        target_kl=0.02,
        seed=0,
        device="cpu",
    )
    model.learn(given.steps, Report(given))


if __name__ == "__main__":
    main()
