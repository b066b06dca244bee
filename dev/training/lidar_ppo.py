"""Train ``lidar-ppo``, a network that races by lidar without a map, by PPO in self-play.

    python dev/training/lidar_ppo.py --out out/lidar-ppo --minutes 8

The network first imitates a planner with a map in the places where both drive (`--warm`), then
learns from rewards while the weight of the imitation falls to 0 (`--fade`). Two cars race under the
rules ``contest``, on shipped and random circuits; the opponent is the network itself, at a share of
its speed or at full speed, a frozen self, or another planner. Every minute the network without
exploration races other planners, on the shipped circuits and on random ones that it does not learn
on, and the weights with the best score are saved. The same command goes on after a stop.
``--randomize cars.yaml`` draws the cars of all races (`pcs_racing.envs.draws`).
"""

import argparse
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

try:
    import torch
except ModuleNotFoundError as error:
    raise SystemExit(f'this example needs {error.name}: pip install ".[learning]"') from None
from lidar_races import (
    ACTIONS,
    BY_THETA,
    EXTRA,
    FAMILIES,
    FROZEN,
    LIVE,
    OLD,
    WIDE,
    LidarBatch,
    Options,
    compile_for,
    make_groups,
)
from line_races import Circuit, prepare
from ppo import (
    Collector,
    Learner,
    Log,
    Settings,
    about,
    add_arguments,
    evaluate,
    settings_of,
    standardised,
)
from run_folder import RunFolder, read_arguments
from torch import Tensor, nn

from pcs_racing import InputError, racer
from pcs_racing.base.dense import DenseLayers
from pcs_racing.planners.field.lidar_ppo import SEEN, SIZES, save_lidar_planner

RIVALS = ("pure-pursuit", "gap-follower", "lattice:early")
FIRST_CHECK = 100_000  # first number of the random circuits of the evaluations
SPREAD = (0.12, 0.4)  # first standard deviations of the exploration: turn, push
UNIT = (0.15, 0.4)  # errors of the imitation are counted in these


class Driver(nn.Module):
    """Network of `pcs_racing.planners.field.lidar_ppo`, and the spread of its exploration."""

    def __init__(self) -> None:
        super().__init__()
        self.layers = nn.ModuleList(nn.Linear(*pair) for pair in pairwise(SIZES))
        for layer in self.layers[:-1]:
            nn.init.orthogonal_(layer.weight, 2.0**0.5)
            nn.init.zeros_(layer.bias)
        nn.init.orthogonal_(self.layers[-1].weight, 0.01)
        nn.init.zeros_(self.layers[-1].bias)
        self.spread = nn.Parameter(torch.tensor(SPREAD).log())

    def forward(self, seen: Tensor) -> Tensor:
        """Return the mean commands, shape (N, 2)."""
        x = seen[:, :SEEN]
        for layer in self.layers[:-1]:
            x = torch.relu(layer(x))
        return torch.tanh(self.layers[-1](x))

    def logs(self, means: Tensor, actions: Tensor) -> Tensor:
        """Return the log probability densities of actions, shape (N,)."""
        far = (actions - means) / self.spread.exp()
        return (-0.5 * far.square() - self.spread).sum(dim=1)


class Critic(nn.Module):
    """Value of a situation; it knows the map, the opponent and the time left."""

    def __init__(self, width: int = 256) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            nn.Linear(SEEN + EXTRA, width),
            nn.Tanh(),
            nn.Linear(width, width // 2),
            nn.Tanh(),
            nn.Linear(width // 2, 1),
        )

    def forward(self, seen: Tensor) -> Tensor:
        """Return the values, shape (N,)."""
        return self.layers(seen)[:, 0]


@dataclass(frozen=True)
class LidarSettings(Settings):
    """Numbers of imitation and PPO."""

    max_rate: float = 2e-3
    entropy: float = 0.002
    kl: float = 0.01
    max_kl: float = 0.04
    warm: float = 3e6  #: Choices with imitation alone.
    fade: float = 20e6  #: Number of choices until the imitation has no weight.
    imitation: float = 0.1  #: Weight of the imitation after the warm choices.


class LidarLearner(Learner):
    """Learner of commands, with frozen selves; first it imitates."""

    settings: LidarSettings

    def __init__(self, settings: LidarSettings, device: str) -> None:
        super().__init__(settings, Driver, Critic, device)
        self.old = [Driver().to(self.device) for _ in range(OLD)]
        self.choices, self.frozen = 0, 0
        for _ in range(OLD):
            self.freeze()

    @property
    def warms(self) -> bool:
        """Whether the network only imitates."""
        return self.choices < self.settings.warm

    @property
    def imitation(self) -> float:
        """Weight of the imitation."""
        s = self.settings
        if self.warms:
            return 1.0
        left = 1.0 - (self.choices - s.warm) / max(s.fade - s.warm, 1.0)
        return s.imitation * max(left, 0.0)

    def freeze(self) -> None:
        """Replace the oldest frozen network by the averaged one."""
        self.old[self.frozen % OLD].load_state_dict(self.averaged.state_dict())
        self.frozen += 1

    def act(self, seen: Tensor) -> tuple[Tensor, Tensor]:
        """Draw actions; return them and their log probability densities."""
        means = self.actor(seen)
        noise = torch.empty_like(means).normal_(generator=self.generator)
        actions = means + noise * self.actor.spread.exp()
        return actions, self.actor.logs(means, actions)

    def update(self, rollout: "Rollout") -> dict[str, float]:
        """Improve actor and critic by one rollout; return means."""
        s, left = self.settings, max(1.0 - self.choices / self.settings.horizon, 0.0)
        sums = torch.zeros(4, device=self.device)
        unit, count = torch.tensor(UNIT, device=self.device), 0
        weight, warms = self.imitation, self.warms
        for _ in range(s.epochs):
            order = torch.randperm(len(rollout.logs), generator=self.generator, device=self.device)
            for rows in order.split(s.minibatch):
                seen, gain = rollout.seen[rows], rollout.gains[rows]
                means = self.actor(seen)
                ratio = self.actor.logs(means, rollout.actions[rows]) - rollout.logs[rows]
                kl = (ratio.clamp(-10.0, 10.0).exp() - 1.0 - ratio).mean()
                ratio = ratio.clamp(-10.0, 10.0).exp()
                actor = -torch.min(ratio * gain, ratio.clamp(1 - s.clip, 1 + s.clip) * gain).mean()
                error = (self.critic(seen) - rollout.returns[rows]).square().mean()
                loss = 0.5 * error
                if not warms:
                    loss = loss + actor - left * s.entropy * self.actor.spread.sum()
                apart = torch.zeros((), device=self.device)
                if weight > 0.0:
                    apart = ((means - rollout.taught[rows]) / unit).square().mean()
                    loss = loss + weight * apart
                self.step(loss)
                sums += torch.stack([kl, error, actor, apart]).detach()
                count += 1
            last = float(kl.detach())
            if not warms and last > s.max_kl:
                break
        if not warms:
            self.follow(last, left)
        with torch.no_grad():
            self.actor.spread.clamp_(-4.0, 0.0)
        self.average()
        self.choices += len(rollout.logs)
        names = ("kl", "error", "actor", "apart")
        return dict(zip(names, (sums / count).tolist(), strict=True))

    def layers(self) -> DenseLayers:
        """Return the averaged actor's layers."""
        weights, biases = (
            tuple(getattr(one, name).detach().cpu().numpy() for one in self.averaged.layers)
            for name in ("weight", "bias")
        )
        return DenseLayers(weights, biases)


@dataclass
class Rollout:
    """Choices of the cars that learn over some steps, flat, with advantages and returns."""

    seen: Tensor
    actions: Tensor
    taught: Tensor
    logs: Tensor
    gains: Tensor
    returns: Tensor


class LidarCollector(Collector):
    """Collector of commands and of a teacher's commands."""

    def __init__(self, batches: Sequence[LidarBatch], learner: LidarLearner) -> None:
        super().__init__(batches, learner, WIDE)
        steps, cars, device = learner.settings.steps, self.cars, learner.device
        kinds = torch.from_numpy(np.concatenate([batch.kinds for batch in batches]))
        self.live = (kinds == LIVE).nonzero()[:, 0].to(device)
        self.old = [
            [torch.from_numpy(np.flatnonzero(batch.kinds == FROZEN + k)).to(device)
             for k in range(OLD)]
            for batch in batches
        ]  # fmt: skip
        # In the warm choices the teacher drives half of the cars.
        self.shown = torch.arange(cars, device=device)[:, None] % 4 >= 2
        self.actions = torch.zeros((steps, cars, ACTIONS), device=device)
        self.taught = torch.zeros((steps, cars, ACTIONS), device=device)

    def collect(self) -> Rollout:
        """Drive for the steps of a rollout."""
        live = self.live
        with torch.no_grad():
            self.drive()
            gains, returns = self.advantages()
        return Rollout(
            self.seen[:-1, live].flatten(0, 1),
            self.actions[:, live].flatten(0, 1),
            self.taught[:, live].flatten(0, 1),
            self.logs[:, live].flatten(),
            standardised(gains[:, live]),
            returns[:, live].flatten(),
        )

    def send(self, t: int, k: int, cars: slice) -> None:
        """Draw commands, and begin to drive by them."""
        learner, device, batch = self.learner, self.learner.device, self.batches[k]
        seen = self.seen[t, cars]
        actions, logs = learner.act(seen)
        teach = learner.imitation > 0.0
        if teach:
            self.taught[t, cars] = torch.from_numpy(batch.taught).to(device)
        if learner.warms:
            spread = learner.actor.spread.exp()
            noise = torch.empty_like(actions).normal_(generator=learner.generator)
            shown = self.taught[t, cars] + 0.5 * spread * noise
            actions = torch.where(self.shown[cars], shown, actions)
        for rows, old in zip(self.old[k], learner.old, strict=True):
            if len(rows):
                actions[rows] = old(seen[rows])
        self.actions[t, cars], self.logs[t, cars] = actions, logs
        batch.actions[:] = actions.cpu().numpy()
        batch.play(batch.actions, batch.taught, teach=teach)


def merit(rows: Sequence[dict[str, Any]]) -> float:
    """Return the criteria of the best weights: scores, and own crashes."""
    return float(np.mean([row["score"] - row["own_crash"] for row in rows]))


class Run:
    """A training run in a folder; it goes on from the folder's checkpoint."""

    def __init__(self, arguments: argparse.Namespace) -> None:
        self.arguments, self.folder = arguments, arguments.out
        self.log, teacher = Log(self.folder), racer(arguments.teacher)
        self.run = RunFolder(arguments, self.log.say)
        circuits = self._circuits(teacher)
        torch.manual_seed(arguments.seed)
        settings = LidarSettings(
            **settings_of(arguments),
            warm=1e6 * arguments.warm,
            fade=1e6 * arguments.fade,
            gamma=arguments.gamma,
            kl=arguments.kl,
        )
        self.learner = LidarLearner(settings, arguments.device)
        self.learner.generator.manual_seed(arguments.seed)
        self.updates, self.best = 0, -1e9
        if (saved := self.run.checkpoint()) is not None:
            self._restore(saved)
        options = Options(
            progress=arguments.progress,
            gain=arguments.gain,
            win=arguments.win,
            passing=arguments.passing,
        )
        cars = max(2, arguments.cars // len(circuits))
        self.groups = make_groups(circuits, cars, arguments.seed, teacher, arguments.randomize)
        pool, count = ThreadPoolExecutor(arguments.threads), arguments.batches
        self.batches = [
            LidarBatch(self.groups[k::count], pool, arguments.threads, options)
            for k in range(count)
        ]
        self.collector = LidarCollector(self.batches, self.learner)
        if not self._restore_races():
            for batch in self.batches:
                batch.play(batch.actions, batch.taught, first=True)
                batch.wait()
        self.log.say(f"{self.collector.cars} cars ready, {len(self.collector.live)} of them learn")

    def _circuits(self, teacher: Any) -> list[Circuit]:
        """Return the circuits of the groups: shipped ones several times, then random ones."""
        a, shipped = self.arguments, list(self.arguments.tracks)
        checks = range(FIRST_CHECK, FIRST_CHECK + a.checks)
        names = [*shipped, *checks, *range(a.random)]
        families = [(one, teacher) for one in FAMILIES]
        found = prepare(names, a.workers, compile_for, *families)
        self.log.say(f"{len(found)} circuits")
        self.checked = [one.track for one in found[: len(shipped) + a.checks]]
        return found[: len(shipped)] * a.each + found[len(shipped) + a.checks :]

    def train(self) -> None:
        """Train for the minutes, which begin now, after the preparation."""
        a, learner = self.arguments, self.learner
        end, saved = self.log.begin(a.minutes), self.log.seconds
        while self.updates < a.updates and self.log.seconds < end:
            begun = time.monotonic()
            self._price()
            rollout = self.collector.collect()
            middle = time.monotonic()
            means = learner.update(rollout)
            self.updates += 1
            done = time.monotonic()
            spread = learner.actor.spread.detach().exp().tolist()
            means |= {
                "per s": len(rollout.logs) / (done - begun),
                "drive": (middle - begun) / (done - begun),
                "value": float(rollout.returns.mean()),
                "turn": spread[0],
                "push": spread[1],
                "rate": learner.rate,
            }
            self.log.note(means, learner.choices, self.batches)
            if self.updates % a.freeze == 0:
                learner.freeze()
            if self.log.seconds - saved > a.every:
                self._evaluate()
                saved = self.log.seconds
        self._evaluate()

    def _price(self) -> None:
        """Raise the cost of an own crash: with a high cost from the start, no car tries to pass."""
        a = self.arguments
        share = min(self.learner.choices / (1e6 * a.bold), 1.0) if a.bold > 0.0 else 1.0
        for batch in self.batches:
            batch.price(share * a.fault)

    def _evaluate(self) -> None:
        a, layers = self.arguments, self.learner.layers()
        numbers = np.concatenate([[1.0], layers.flat()])
        policy = BY_THETA.policy(numbers, "lidar-ppo")
        rows = evaluate(policy, a.rivals, self.checked, a.races, a.threads, a.randomize)
        found, training = merit(rows), about(a, self.learner.choices, self.updates)
        self.log.curve(self.learner.choices, rows, found)
        folders = [self.folder / "last"]
        if found > self.best and not self.learner.warms:
            self.best = found
            folders.append(self.folder / "best")
        for folder in folders:
            save_lidar_planner(folder, layers, name="lidar-ppo", training=training)
        self._save()

    def _save(self) -> None:
        """Write the checkpoint, whole or not at all; the races first, in their own file."""
        learner = self.learner
        races = [[torch.from_numpy(one) for one in group.saved()] for group in self.groups]
        seen = [torch.from_numpy(batch.seen) for batch in self.batches]
        taught = [torch.from_numpy(batch.taught) for batch in self.batches]
        driven = {"races": races, "seen": seen, "taught": taught}
        checkpoint = learner.state() | {
            "old": [one.state_dict() for one in learner.old],
            "frozen": learner.frozen,
            "choices": learner.choices,
            "best": self.best,
        }
        self.run.save(self.updates, driven, checkpoint)

    def _restore_races(self) -> bool:
        """Let the races of the checkpoint go on; without them (False), races begin again."""
        saved = self.run.races(self.updates)
        if saved is None:
            return False
        for group, arrays in zip(self.groups, saved["races"], strict=True):
            group.restore([one.numpy() for one in arrays])
        for batch, seen, taught in zip(self.batches, saved["seen"], saved["taught"], strict=True):
            batch.seen[:], batch.taught[:] = seen.numpy(), taught.numpy()
        return True

    def _restore(self, saved: dict[str, Any]) -> None:
        learner = self.learner
        learner.restore(saved, self.arguments.seed + saved["updates"])
        for one, values in zip(learner.old, saved["old"], strict=True):
            one.load_state_dict(values)
        learner.frozen, learner.choices = saved["frozen"], saved["choices"]
        self.updates, self.best = saved["updates"], self.run.best(saved)
        self.log.say(f"goes on after {learner.choices / 1e6:.1f} M choices")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add_arguments(parser, RIVALS, each=1, entropy=0.002)
    add("--checks", type=int, default=4, help="random circuits of the evaluation alone")
    add("--teacher", default="predictive-spliner", help="planner that the network imitates first")
    add("--warm", type=float, default=1.0, help="choices with imitation alone, in millions")
    add("--fade", type=float, default=4.0, help="choices until imitation has no weight, millions")
    add("--progress", type=float, default=0.01, help="reward of a metre")
    add("--gain", type=float, default=0.02, help="reward of a metre gained on the other car")
    add("--win", type=float, default=1.0, help="reward of a win")
    add(
        "--fault",
        type=float,
        default=2.0,
        help="cost of an own crash, without the lost race",
    )
    add("--passing", type=float, default=2.0, help="reward of a pass")
    add("--bold", type=float, default=30.0, help="choices until --fault is reached, in millions")
    add("--gamma", type=float, default=0.995, help="discount of a choice")
    add("--kl", type=float, default=0.01, help="divergence of an update that is aimed at")
    arguments = read_arguments(parser)
    try:
        racer(arguments.teacher)
    except InputError as error:
        parser.error(str(error))
    torch.set_num_threads(max(1, arguments.threads if arguments.device == "cpu" else 1))
    # A thread that drives needs the interpreter for microseconds, between two groups.
    sys.setswitchinterval(2e-4)
    Run(arguments).train()


if __name__ == "__main__":
    main()
