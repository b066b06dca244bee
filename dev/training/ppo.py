"""PPO as both trainings use it: the learner, the collection of choices, evaluations, progress."""

import argparse
import csv
import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from line_races import HELD_OUT, drawn_pairs
from torch import Tensor, nn

from pcs_racing import racer
from pcs_racing.base.seeds import race_seeds
from pcs_racing.envs.draws import Randomization
from pcs_racing.planners.planner import Policy
from pcs_racing.race.conditions import AS_THE_SETUP, RaceConditions
from pcs_racing.race.config import CONTEST
from pcs_racing.race.driving import advance, pad_parameters
from pcs_racing.race.races import RaceResult, RaceSetup, draw_starts, start_races
from pcs_racing.track.maps import list_tracks
from pcs_racing.track.track import Track

SEED = 11  # of the evaluations


@dataclass(frozen=True)
class Settings:
    """Numbers of PPO."""

    steps: int = 32  #: Choices of a car between two updates.
    minibatch: int = 16_384
    epochs: int = 3
    rate: float = 1e-3  #: First learning rate of Adam; it follows the divergence.
    max_rate: float = 5e-3
    gamma: float = 0.99
    lambda_: float = 0.95
    clip: float = 0.2
    entropy: float = 0.001  #: Weight of the entropy; falls to 0 at the horizon.
    #: Divergence of an update that the learning rate aims at; falls to a fifth at the horizon.
    kl: float = 0.008
    horizon: float = 1e9  #: Choices of the whole training.
    max_kl: float = 0.03  #: Above it an update ends early.
    average: float = 0.9  #: Share of the averaged weights that an update keeps.


class Learner:
    """Actor, critic, their optimiser, and the averaged actor that is evaluated and saved."""

    def __init__(
        self,
        settings: Settings,
        network: Callable[[], nn.Module],
        critic: Callable[[], nn.Module],
        device: str,
    ) -> None:
        self.settings, self.device = settings, torch.device(device)
        self.actor: Any = network().to(self.device)
        self.critic: Any = critic().to(self.device)
        self.averaged: Any = network().to(self.device)
        self.averaged.load_state_dict(self.actor.state_dict())
        self.optimiser = torch.optim.Adam(
            [*self.actor.parameters(), *self.critic.parameters()], settings.rate, eps=1e-5
        )
        self.generator = torch.Generator(self.device)

    @property
    def rate(self) -> float:
        """Present learning rate."""
        return float(self.optimiser.param_groups[0]["lr"])

    def step(self, loss: Tensor) -> None:
        """Take a step of the optimiser."""
        self.optimiser.zero_grad(set_to_none=True)
        loss.backward()
        nn.utils.clip_grad_norm_(self.actor.parameters(), 1.0)
        nn.utils.clip_grad_norm_(self.critic.parameters(), 1.0)
        self.optimiser.step()

    def follow(self, kl: float, left: float) -> None:
        """Adapt the learning rate to the divergence of the last step of an update.

        ``left`` is the share of the training that is left.
        """
        aim = self.settings.kl * (0.2 + 0.8 * left)
        factor = 1.5 if kl < 0.5 * aim else 1.0 / 1.5 if kl > 2.0 * aim else 1.0
        for group in self.optimiser.param_groups:
            group["lr"] = min(max(group["lr"] * factor, 1e-5), self.settings.max_rate)

    def average(self) -> None:
        """Move the averaged actor towards the actor."""
        with torch.no_grad():
            for slow, fast in zip(self.averaged.parameters(), self.actor.parameters(), strict=True):
                slow.lerp_(fast, 1.0 - self.settings.average)

    def state(self) -> dict[str, Any]:
        """Return all that changes while the learner learns, for a checkpoint."""
        parts = ("actor", "critic", "averaged", "optimiser")
        state = {name: getattr(self, name).state_dict() for name in parts}
        return state | {"generator": self.generator.get_state()}

    def restore(self, saved: Mapping[str, Any], seed: int) -> None:
        """Go on from a checkpoint; ``seed`` serves a checkpoint of another kind of device."""
        for name in ("actor", "critic", "averaged", "optimiser"):
            getattr(self, name).load_state_dict(saved[name])
        if saved["generator"].shape == self.generator.get_state().shape:
            self.generator.set_state(saved["generator"])
        else:
            self.generator.manual_seed(seed)


class Collector:
    """Batches that alternate: one drives while the choices of the other are computed."""

    def __init__(self, batches: Sequence[Any], learner: Any, wide: int) -> None:
        self.batches, self.learner = batches, learner
        steps, device = learner.settings.steps, learner.device
        self.edges = np.cumsum([0, *(batch.cars for batch in batches)])
        self.cars = cars = int(self.edges[-1])
        self.seen = torch.zeros((steps + 1, cars, wide), device=device)
        self.logs = torch.zeros((steps, cars), device=device)
        self.rewards = torch.zeros((steps, cars), device=device)
        self.ended = torch.zeros((steps, cars), device=device)
        for batch in batches:
            if device.type == "cuda":  # memory that the device reads without a copy
                batch.seen = torch.zeros((batch.cars, wide), pin_memory=True).numpy()

    def drive(self) -> None:
        """Drive for the steps of a rollout; `send` makes the choices."""
        steps, device = self.learner.settings.steps, self.learner.device
        for t in range(steps + 1):
            for k, batch in enumerate(self.batches):
                cars = slice(int(self.edges[k]), int(self.edges[k + 1]))
                batch.wait()
                if t > 0:
                    self.rewards[t - 1, cars] = torch.from_numpy(batch.rewards).float().to(device)
                    self.ended[t - 1, cars] = torch.from_numpy(batch.ended).float().to(device)
                self.seen[t, cars] = torch.from_numpy(batch.seen).to(device)
                if t < steps:
                    self.send(t, k, cars)

    def send(self, t: int, k: int, cars: slice) -> None:
        """Choose for the cars of a batch at a step, and begin to drive by the choices."""
        raise NotImplementedError

    def advantages(self) -> tuple[Tensor, Tensor]:
        """Return advantages, by generalised advantage estimation, and returns, (steps, cars).

        All races end truly.
        """
        s = self.learner.settings
        values = torch.stack([self.learner.critic(row) for row in self.seen])
        gains = torch.zeros_like(self.rewards)
        last = torch.zeros_like(self.rewards[0])
        for t in reversed(range(s.steps)):
            goes_on = 1.0 - self.ended[t]
            delta = self.rewards[t] + s.gamma * goes_on * values[t + 1] - values[t]
            last = delta + s.gamma * s.lambda_ * goes_on * last
            gains[t] = last
        return gains, gains + values[:-1]


def standardised(gains: Tensor) -> Tensor:
    """Return advantages, flat, with a mean of 0 and a standard deviation of 1."""
    flat = gains.flatten()
    return (flat - flat.mean()) / (flat.std() + 1e-8)


def race_on_drawn_cars(
    track: Track, policies: Sequence[Policy], races: int, threads: int, ranges: Randomization
) -> RaceResult:
    """Race two policies under the rules ``contest``, with cars drawn for each race."""
    planners = tuple(policy.planner for policy in policies)
    setup = RaceSetup(track, CONTEST, planners, max_delays=ranges.max_delays)
    cars = drawn_pairs(ranges, SEED, races)
    conditions = RaceConditions(cars) if ranges.names else AS_THE_SETUP
    starts = draw_starts(track, CONTEST, races, SEED)
    state = start_races(setup, starts, race_seeds(SEED, races), conditions)
    theta = [pad_parameters([policy] * races, setup.theta_size) for policy in policies]
    ticks = CONTEST.ticks
    advance(setup, state, np.stack(theta, 1), ticks, threads=threads, conditions=conditions)
    return RaceResult(CONTEST, state, starts)


def evaluate(
    policy: Policy,
    rivals: Sequence[str],
    tracks: Sequence[Track],
    races: int,
    threads: int,
    ranges: Randomization,
) -> list[dict[str, Any]]:
    """Race a policy against other planners on drawn cars; return a row for each."""
    rows = []
    for name in rivals:
        rival, found = racer(name), []
        for track in tracks:
            result = race_on_drawn_cars(track, (policy, rival), races, threads, ranges)
            won = np.where(result.winner == -1, 0.5, result.winner == 0)
            found.append([won.mean(), *result.own_crash.mean(axis=0)])
        score, own, other = np.mean(found, axis=0)
        worst = float(np.max([row[1] for row in found]))
        rows.append(
            {"rival": name, "score": score, "own_crash": own, "worst": worst, "their_crash": other}
        )
    return rows


class Log:
    """Progress on the screen, and learning curves in a csv file."""

    def __init__(self, folder: Path) -> None:
        self.file, self.start, self.last = folder / "curves.csv", time.monotonic(), 0.0
        self.sums: list[dict[str, float]] = []

    @property
    def seconds(self) -> float:
        """Time since the start."""
        return time.monotonic() - self.start

    def note(self, means: dict[str, float], steps: int, batches: Sequence[Any]) -> None:
        """Print a line every 15 s."""
        self.sums.append(means)
        if self.seconds - self.last < 15.0:
            return
        mean = {key: np.mean([one[key] for one in self.sums]) for key in means}
        parts = [f"{key} {value:.4g}" for key, value in mean.items()]
        tallies: dict[str, np.ndarray] = {}
        for batch in batches:
            for group in batch.groups:
                found = group.tally.sum(axis=0)
                name = group.family
                tallies[name] = tallies.get(name, 0.0) + found
                group.tally[:] = 0.0
        parts += [
            f"{name[:9]} {row[1] / row[0]:.2f}/{row[2] / row[0]:.2f}"
            for name, row in tallies.items()
            if row[0] > 0
        ]
        print(f"{self.seconds:6.0f} s {steps / 1e6:8.2f} M  " + "  ".join(parts), flush=True)
        self.last, self.sums = self.seconds, []

    def say(self, text: str) -> None:
        """Print a line with the time."""
        print(f"{self.seconds:6.0f} s  {text}", flush=True)

    def begin(self, minutes: float) -> float:
        """Print that the training begins, and return the time of its end."""
        self.say(f"prepared; the training begins now and takes {minutes:g} minutes")
        return self.seconds + 60.0 * minutes

    def curve(self, steps: int, rows: Sequence[dict[str, Any]], found: float) -> None:
        """Print an evaluation with its merit, and add it to the csv file."""
        new = not self.file.exists()
        with self.file.open("a", newline="") as file:
            writer = csv.DictWriter(file, ["seconds", "steps", *rows[0]])
            if new:
                writer.writeheader()
            for row in rows:
                rounded = {
                    k: v if isinstance(v, str) else round(float(v), 4) for k, v in row.items()
                }
                writer.writerow({"seconds": round(self.seconds), "steps": steps, **rounded})
        cells = [f"{row['rival'][:9]} {row['score']:.3f}/{row['own_crash']:.3f}" for row in rows]
        print(f"  eval {found:.3f}  " + "  ".join(cells), flush=True)


def add_arguments(
    parser: argparse.ArgumentParser, rivals: Sequence[str], *, each: int, entropy: float
) -> None:
    """Add the options that both trainings have, with their defaults that differ."""
    add = parser.add_argument
    add("--out", type=Path, required=True, help="folder of weights, checkpoint and curves")
    add("--minutes", type=float, default=10.0, help="wall-clock time of the training itself")
    add("--updates", type=int, default=1_000_000, help="updates, if they end before the time")
    add("--every", type=float, default=60.0, help="seconds between evaluations and checkpoints")
    add("--device", default="cuda" if torch.cuda.is_available() else "cpu", help="of torch")
    add("--threads", type=int, default=1, help="threads that drive")
    add("--workers", type=int, default=1, help="processes that make circuits")
    add("--cars", type=int, default=1024, help="cars of networks, shared by the circuits")
    known = [name for name in list_tracks() if name not in HELD_OUT]
    add("--tracks", nargs="*", default=known, help="shipped circuits")
    add("--randomize", help="YAML file of draws of the cars (pcs_racing.envs.draws)")
    add("--rivals", nargs="*", default=rivals, help="planners of the evaluation")
    add("--random", type=int, default=24, help="random circuits")
    add("--each", type=int, default=each, help="groups on each shipped circuit")
    add("--batches", type=int, default=1, help="batches that drive alternately")
    add("--steps", type=int, default=32, help="choices of a car between two updates")
    add("--minibatch", type=int, default=8192, help="choices of a step of the optimiser")
    add("--epochs", type=int, default=3, help="passes over a rollout")
    add("--rate", type=float, default=1e-3, help="first learning rate")
    add("--horizon", type=float, default=1000.0, help="choices of the whole training, in millions")
    add("--entropy", type=float, default=entropy, help="weight of the entropy")
    add("--freeze", type=int, default=20, help="updates between two frozen selves")
    add("--races", type=int, default=16, help="races of an evaluation, for each circuit and rival")
    add("--seed", type=int, default=0)


def settings_of(arguments: argparse.Namespace) -> dict[str, Any]:
    """Return the settings of PPO that both command lines give."""
    names = ("steps", "minibatch", "epochs", "rate", "entropy")
    given = {name: getattr(arguments, name) for name in names}
    return given | {"horizon": 1e6 * arguments.horizon}


def about(arguments: argparse.Namespace, choices: int, updates: int) -> dict[str, Any]:
    """Return the description of a training, for a manifest."""
    names = ("cars", "random", "each", "steps", "seed")
    given = {name: getattr(arguments, name) for name in names}
    drawn = json.dumps(arguments.randomize.plain())
    return given | {"randomize": drawn, "choices": choices, "updates": updates}
