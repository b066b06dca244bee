"""Learn to race by self-play: one PPO policy steers both cars of every race, and learns from both
sides.

Against nobody but its equal, a policy forgets how to pass: no car is slower, and the other one
always makes room. So in every race one of the cars has less speed at its command, and in half of
them that car does not see the other.

    python examples/drive_self_play.py
    python examples/drive_self_play.py --steps 8000000

It prints a line for every tenth of the training, with the time that is left, and then races drivers
that the policy has never met: lattice planners, which are the policies of the archives, and
ppo-drive. The default is a look at how it works, in a few minutes. 8,000,000 steps took 2 min 10 s
of processor time in one thread; the policy then won 13 % of its races against lattice planners in
the paper's race and 19 % in the contest, and 45 % and 60 % against ppo-drive (seed 0). Run with
stable-baselines3 2.9.2.
"""

import argparse
import time
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from pcs_racing import load_archive
from pcs_racing.envs import DriveHeadToHeadVectorEnv, DriveVectorEnv, Result

try:
    import torch
    from stable_baselines3 import PPO
    from stable_baselines3.common.callbacks import BaseCallback
    from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper, VecNormalize

    from pcs_racing.envs import SB3VecEnv
except ModuleNotFoundError as error:
    raise SystemExit(f'this example needs {error.name}: pip install ".[learning]"') from None

RULES = {"paper": "default-early", "contest": "contest-early"}
"""Rules of the races, and the archive that was made under them."""


@dataclass(frozen=True)
class Arguments:
    """What can be chosen on the command line."""

    steps: int = 500_000
    """steps to learn from, both cars' counted"""
    track: str = "Tarnfjord"
    """name of a shipped circuit or a map folder"""
    envs: int = 512
    """cars that learn at once, a multiple of 4: half of the races under each of the two rules"""
    rollout: int = 32
    """steps of each car between two updates"""
    duration: float = 20.0
    """seconds of a race while it learns, a multiple of 0.1; afterwards races last 40 s"""
    slowest: float = 0.5
    """least share of its speed that the slower car of a race has"""
    rivalry: float = 0.5
    """share of the opponent's progress that is taken off the own one"""
    learning_rate: float = 1e-3
    """step size of the optimiser, falling to a tenth"""
    races: int = 200
    """races against each kind of opponent afterwards"""
    threads: int = 1
    """threads of torch"""
    seed: int = 0
    """root of everything random"""


class UnequalCars(VecEnvWrapper):
    """Self-play with one slower car per race, blind in half of the races; redrawn for each race.

    Parameters
    ----------
    venv : VecEnv
        Races of two cars (``make_sb3_vec_env("drive-self-play", ...)``): environments ``2 i`` and
        ``2 i + 1`` are the cars of race ``i``.
    slowest : float
        Minimum speed share of the slower car of a race, in (0, 1].
    seed : int
        Seed of the random draws.
    """

    def __init__(self, venv: VecEnv, slowest: float = 0.5, seed: int = 0) -> None:
        super().__init__(venv)
        self.slowest = slowest
        names = [element.name for element in venv.get_attr("elements", 0)[0]]
        self.about_opponent = np.array(
            [name == "lead" or name.startswith("opponent") for name in names]
        )
        self.rng = np.random.default_rng(seed)
        self.speed, self.blind = np.ones(venv.num_envs), np.zeros(venv.num_envs, np.bool_)

    def reset(self) -> np.ndarray:
        """Begin new races, and draw the slower car of each."""
        self._draw(np.arange(self.num_envs // 2))
        return self._hide(self.venv.reset())

    def step_async(self, actions: np.ndarray) -> None:
        """Forward the actions, with each car's speed multiplied by its share."""
        # An action of -1 is a standstill: the share applies to the speed, not to the action.
        speed = self.speed * (1.0 + np.clip(actions[:, 1], -1.0, 1.0)) - 1.0
        self.venv.step_async(np.stack([actions[:, 0], speed], axis=1))

    def step_wait(
        self,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        """Complete the step; after the end of a race, draw its slower car again."""
        observations, rewards, done, infos = self.venv.step_wait()
        for i in np.flatnonzero(done & self.blind):
            infos[i]["terminal_observation"] = np.where(
                self.about_opponent, 0.0, infos[i]["terminal_observation"]
            )
        self._draw(np.flatnonzero(done[::2]))
        return self._hide(observations), rewards, done, infos

    def _draw(self, races: np.ndarray) -> None:
        """Draw the slower car of each race, its speed share, and its blindness."""
        slow = 2 * races + self.rng.integers(2, size=len(races))
        both = np.concatenate([2 * races, 2 * races + 1])
        self.speed[both], self.blind[both] = 1.0, False
        self.speed[slow] = self.rng.uniform(self.slowest, 1.0, len(races))
        self.blind[slow] = self.rng.random(len(races)) < 0.5

    def _hide(self, observations: np.ndarray) -> np.ndarray:
        """Set the opponent elements of blind cars' observations to 0."""
        return np.where(self.blind[:, None] & self.about_opponent, np.float32(0.0), observations)


class Progress(BaseCallback):
    """Prints a line for every tenth of the training: time left, and how the policy does."""

    def __init__(self, steps: int, races: int, seen: dict[str, Any]) -> None:
        super().__init__()
        self.steps, self.said, self.began = steps, 0, time.monotonic()
        self.rivals = [lattice_races(race, races, seen) for race in RULES]

    def _on_step(self) -> bool:
        return True

    def _on_rollout_end(self) -> None:
        share = min(self.num_timesteps / self.steps, 1.0)
        if self.said > 0 and share < self.said / 10:
            return
        self.said = int(10 * share) + 1
        won = [
            np.mean(race_against(self.model, races)["result"] == Result.WIN)
            for races in self.rivals
        ]
        spent = (time.monotonic() - self.began) / 60
        length = np.mean([episode["l"] for episode in self.model.ep_info_buffer]) / 10.0
        print(
            f"{self.num_timesteps:10,} steps  {spent:5.1f} min, about"
            f" {spent / share * (1 - share):5.1f} left   races last {length:4.1f} s   won against"
            " lattice: "
            + ", ".join(f"{rate:.0%} ({race})" for rate, race in zip(won, RULES, strict=True)),
            flush=True,
        )


def main() -> None:
    arguments = parse(Arguments)
    torch.set_num_threads(arguments.threads)
    seen = {
        "track": arguments.track,
        "time_step": 0.1,
        "look_ahead": (0.0, 1.0, 2.0, 4.0, 6.0, 9.0, 12.0),
    }
    races = [
        DriveHeadToHeadVectorEnv(
            arguments.envs // 2,
            race=race,
            duration=arguments.duration,
            rivalry=arguments.rivalry,
            autoreset_mode="SAME_STEP",
            threads=1,
            **seen,
        )
        for race in RULES
    ]
    envs = VecNormalize(
        UnequalCars(SB3VecEnv(races), arguments.slowest, arguments.seed), gamma=0.99
    )
    model = PPO(
        "MlpPolicy",
        envs,
        seed=arguments.seed,
        n_steps=arguments.rollout,
        batch_size=arguments.envs * arguments.rollout // 2,  # large: see docs/ppo.md
        n_epochs=4,
        learning_rate=lambda left: arguments.learning_rate * (0.1 + 0.9 * left),
        policy_kwargs={"log_std_init": -1.0},
        device="cpu",
    )
    model.learn(arguments.steps, callback=Progress(arguments.steps, min(40, arguments.races), seen))

    print(f"{'opponent':28} {'rules':8} {'won':>6} {'lead':>7} {'own crash':>9}")
    for race, archive in RULES.items():
        rivals = {
            f"lattice, archive {archive}": lattice_races(race, arguments.races, seen),
            "ppo-drive": DriveVectorEnv(arguments.races, opponent="ppo-drive", race=race, **seen),
        }
        for name, against in rivals.items():
            ends = race_against(model, against)
            won, crashed = ends["result"] == Result.WIN, ends["fault"] == 1
            print(
                f"{name:28} {race:8} {won.mean():6.1%} {ends['lead'].mean():7.2f}"
                f" {crashed.mean():9.1%}",
                flush=True,
            )


def lattice_races(race: str, count: int, seen: dict[str, Any]) -> DriveVectorEnv:
    """Races against the policies of the rules' archive, of which one is drawn for each race."""
    archive = load_archive(RULES[race])
    return DriveVectorEnv(
        count, opponent=[archive.policy(k) for k in range(len(archive))], race=race, **seen
    )


def race_against(model: PPO, races: DriveVectorEnv) -> dict[str, np.ndarray]:
    """Infos at the end of the first race of each environment, driven with the policy's mean."""
    scale = model.get_vec_normalize_env()
    observations, info = races.reset(seed=1_000_000)
    over = np.zeros(races.num_envs, bool)
    ends = {name: np.zeros(races.num_envs) for name in ("result", "lead", "fault")}
    while not over.all():
        actions, _ = model.predict(scale.normalize_obs(observations), deterministic=True)
        observations, _, terminated, truncated, info = races.step(actions)
        ended = (terminated | truncated) & ~over
        for name, values in ends.items():
            values[ended] = info[name][ended]
        over |= ended
    return ends


def parse(kind: type[Any]) -> Any:
    """Read the command line into a dataclass; the texts behind its fields are the help."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    for field in fields(kind):
        parser.add_argument(
            f"--{field.name.replace('_', '-')}", type=type(field.default), default=field.default
        )
    return kind(**vars(parser.parse_args()))


if __name__ == "__main__":
    main()
