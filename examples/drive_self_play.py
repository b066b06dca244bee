"""Train one PPO policy by self-play to steer both cars of every race.

    python examples/drive_self_play.py
    python examples/drive_self_play.py --steps 8000000

Between equal cars that make room for each other, a policy forgets how to overtake. Therefore one
car of every race has less speed, and in half of the races that car does not observe the other one.

A line for every tenth of the training reports the time left. The policy then races held-out
opponents: the policies of two archives, and lidar-ppo. The default takes a few minutes;
docs/environments.md has results of 8,000,000 steps. Tested with stable-baselines3 2.9.2.
"""

import argparse
import time
from typing import Any

import numpy as np

from pcs_racing import load_archive, load_rules
from pcs_racing.envs import DriveHeadToHeadVectorEnv, DriveVectorEnv, Result

try:
    import torch
    from stable_baselines3 import PPO
    from stable_baselines3.common.callbacks import BaseCallback
    from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper, VecNormalize

    from pcs_racing.envs import SB3VecEnv
except ModuleNotFoundError as error:
    raise SystemExit(f'this example needs {error.name}: pip install ".[learning]"') from None

RULES = {"paper": "default", "contest": "contest"}
"""Rules of the races, and the archive that was made under them."""


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
    """Prints a line for every tenth of the training: time left, and races won."""

    def __init__(self, steps: int, races: int, task: dict[str, Any]) -> None:
        super().__init__()
        self.steps, self.said, self.began = steps, 0, time.monotonic()
        self.rivals = [archive_races(race, races, task) for race in RULES]

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
            " the archive: "
            + ", ".join(f"{rate:.0%} ({race})" for rate, race in zip(won, RULES, strict=True)),
            flush=True,
        )


def main() -> None:
    arguments = parse()
    torch.set_num_threads(arguments.threads)
    task = {
        "track": arguments.track,
        "time_step": 0.1,
        "look_ahead": (0.0, 1.0, 2.0, 4.0, 6.0, 9.0, 12.0),
    }
    races = [
        DriveHeadToHeadVectorEnv(
            arguments.envs // 2,
            rules=rules_of(race),
            duration=arguments.duration,
            rivalry=arguments.rivalry,
            autoreset_mode="SAME_STEP",
            threads=1,
            **task,
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
    model.learn(arguments.steps, callback=Progress(arguments.steps, min(40, arguments.races), task))

    print(f"{'opponent':28} {'rules':8} {'won':>6} {'lead':>7} {'own crash':>9}")
    for race, archive in RULES.items():
        rivals = {
            f"archive {archive}": archive_races(race, arguments.races, task),
            "lidar-ppo": DriveVectorEnv(
                arguments.races, opponent="lidar-ppo", rules=rules_of(race), **task
            ),
        }
        for name, against in rivals.items():
            ends = race_against(model, against)
            won, crashed = ends["result"] == Result.WIN, ends["fault"] == 1
            print(
                f"{name:28} {race:8} {won.mean():6.1%} {ends['lead'].mean():7.2f}"
                f" {crashed.mean():9.1%}",
                flush=True,
            )


def rules_of(race: str) -> Any:
    """Return the rules without handicaps, so that observations are the same in all races."""
    return load_rules(race, front_pace=(1.0, 1.0))


def archive_races(race: str, count: int, task: dict[str, Any]) -> DriveVectorEnv:
    """Make races against the archive of the rules; the opponent's policy is drawn for each race."""
    archive = load_archive(RULES[race])
    return DriveVectorEnv(
        count,
        opponent=[archive.policy(k) for k in range(len(archive))],
        rules=rules_of(race),
        **task,
    )


def race_against(model: PPO, races: DriveVectorEnv) -> dict[str, np.ndarray]:
    """Drive a race in each environment with the policy's mean; return the infos at its end."""
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


def parse() -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    option = parser.add_argument
    option("--steps", type=int, default=500_000, help="training steps of all cars together")
    option("--track", default="Tarnfjord", help="name of a shipped track or a map folder")
    option(
        "--envs",
        type=int,
        default=512,
        help="cars at once, a multiple of 4; half of the races have the rules paper",
    )
    option("--rollout", type=int, default=32, help="steps of each car between two updates")
    option(
        "--duration",
        type=float,
        default=20.0,
        help="length of a training race in s, a multiple of 0.1; test races last 40 s",
    )
    option(
        "--slowest", type=float, default=0.5, help="minimum speed share of the slower car of a race"
    )
    option(
        "--rivalry",
        type=float,
        default=0.5,
        help="share of the opponent's progress to subtract from the reward",
    )
    option(
        "--learning-rate",
        type=float,
        default=1e-3,
        help="initial learning rate, which falls to a tenth",
    )
    option("--races", type=int, default=200, help="test races against each opponent")
    option("--threads", type=int, default=1, help="threads of torch")
    option("--seed", type=int, default=0, help="seed of all random numbers")
    return parser.parse_args()


if __name__ == "__main__":
    main()
