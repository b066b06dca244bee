"""Train ``lidar-ppo``, a network that races by lidar without a map, by PPO in self-play.

    python dev/training/lidar_ppo.py --out out/lidar-ppo --minutes 8

The network first imitates a planner with a map in the places where both drive (`--warm`), then
learns from rewards while the weight of the imitation falls to 0 (`--fade`). Two cars race under the
rules ``contest``, on shipped and random circuits; the opponent is the network itself, at a share of
its speed or at full speed, a frozen self, or another planner. Every minute the network without
exploration races other planners on circuits that it does not learn on, and the weights with the
best score are saved. The same command goes on after a stop.
"""

import argparse
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
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
    FROZEN,
    LIVE,
    OLD,
    WIDE,
    Batch,
    Options,
    make_groups,
    prepare,
)
from line_ppo import Log
from line_races import HELD_OUT, Circuit
from run_folder import RunFolder, read_arguments
from torch import Tensor, nn

from pcs_racing import InputError, parse_policy, run_races
from pcs_racing.planners.field.lidar_networks import flat_weights, save_lidar_planner
from pcs_racing.planners.field.lidar_ppo import LAYERS, SEEN
from pcs_racing.track.maps import list_tracks
from pcs_racing.track.track import Track

RIVALS = ("pure-pursuit", "residual", "gap-follower", "lattice:early")
FIRST_CHECK = 100_000  # first number of the random circuits of the evaluations
SPREAD = (0.12, 0.4)  # first standard deviations of the exploration: turn, push
UNIT = (0.15, 0.4)  # errors of the imitation are counted in these


class Driver(nn.Module):
    """Network of `pcs_racing.planners.field.lidar_ppo`, and the spread of its exploration."""

    def __init__(self) -> None:
        super().__init__()
        self.layers = nn.ModuleList(nn.Linear(*pair) for pair in LAYERS)
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
class Settings:
    """Numbers of imitation and PPO."""

    steps: int = 32  #: Choices of a car between two updates.
    minibatch: int = 16_384
    epochs: int = 3
    rate: float = 1e-3  #: First learning rate of Adam; it follows the divergence.
    max_rate: float = 2e-3
    gamma: float = 0.99
    lambda_: float = 0.95
    clip: float = 0.2
    entropy: float = 0.002  #: Weight of the entropy; falls to 0 at the horizon.
    #: Divergence of an update that the learning rate aims at; falls to a fifth at the horizon.
    kl: float = 0.01
    horizon: float = 1e9  #: Choices of the whole training.
    max_kl: float = 0.04  #: Above it an update ends early.
    average: float = 0.9  #: Share of the averaged weights that an update keeps.
    warm: float = 3e6  #: Choices with imitation alone.
    fade: float = 20e6  #: Choices after which the imitation has no weight.
    imitation: float = 0.1  #: Weight of the imitation after the warm choices.


class Learner:
    """Actor, critic, their optimiser, and the averaged actor that is evaluated and saved."""

    def __init__(self, settings: Settings, device: str) -> None:
        self.settings, self.device = settings, torch.device(device)
        self.actor, self.critic = Driver().to(self.device), Critic().to(self.device)
        self.averaged = Driver().to(self.device)
        self.averaged.load_state_dict(self.actor.state_dict())
        self.optimiser = torch.optim.Adam(
            [*self.actor.parameters(), *self.critic.parameters()], settings.rate, eps=1e-5
        )
        self.generator = torch.Generator(self.device)
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
                self.optimiser.zero_grad(set_to_none=True)
                loss.backward()
                nn.utils.clip_grad_norm_(self.actor.parameters(), 1.0)
                nn.utils.clip_grad_norm_(self.critic.parameters(), 1.0)
                self.optimiser.step()
                sums += torch.stack([kl, error, actor, apart]).detach()
                count += 1
            last = float(kl.detach())
            if not warms and last > s.max_kl:
                break
        if not warms:
            self._follow(last, s.kl * (0.2 + 0.8 * left))
        with torch.no_grad():
            self.actor.spread.clamp_(-4.0, 0.0)
            for slow, fast in zip(self.averaged.parameters(), self.actor.parameters(), strict=True):
                slow.lerp_(fast, 1.0 - s.average)
        self.choices += len(rollout.logs)
        names = ("kl", "error", "actor", "apart")
        return dict(zip(names, (sums / count).tolist(), strict=True))

    def _follow(self, kl: float, aim: float) -> None:
        """Adapt the learning rate to the divergence of the last step of an update."""
        factor = 1.5 if kl < 0.5 * aim else 1.0 / 1.5 if kl > 2.0 * aim else 1.0
        for group in self.optimiser.param_groups:
            group["lr"] = min(max(group["lr"] * factor, 1e-5), self.settings.max_rate)

    def layers(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Return weights and biases of the averaged actor's layers."""
        return [
            (one.weight.detach().cpu().numpy().copy(), one.bias.detach().cpu().numpy().copy())
            for one in self.averaged.layers
        ]


@dataclass
class Rollout:
    """Choices of the cars that learn over some steps, flat, with advantages and returns."""

    seen: Tensor
    actions: Tensor
    taught: Tensor
    logs: Tensor
    gains: Tensor
    returns: Tensor


class Collector:
    """Batches that drive in turn: while the one drives, commands are drawn for the other."""

    def __init__(self, batches: Sequence[Batch], learner: Learner) -> None:
        self.batches, self.learner = batches, learner
        steps, device = learner.settings.steps, learner.device
        self.edges = np.cumsum([0, *(batch.cars for batch in batches)])
        cars = int(self.edges[-1])
        self.cars = cars
        kinds = torch.from_numpy(np.concatenate([batch.kinds for batch in batches]))
        self.live = (kinds == LIVE).nonzero()[:, 0].to(device)
        self.old = [
            [torch.from_numpy(np.flatnonzero(batch.kinds == FROZEN + k)).to(device)
             for k in range(OLD)]
            for batch in batches
        ]  # fmt: skip
        # In the warm choices the teacher drives half of the cars.
        self.shown = torch.arange(cars, device=device)[:, None] % 4 >= 2
        self.seen = torch.zeros((steps + 1, cars, WIDE), device=device)
        self.actions = torch.zeros((steps, cars, ACTIONS), device=device)
        self.taught = torch.zeros((steps, cars, ACTIONS), device=device)
        self.logs = torch.zeros((steps, cars), device=device)
        self.rewards = torch.zeros((steps, cars), device=device)
        self.ended = torch.zeros((steps, cars), device=device)
        for batch in batches:
            if device.type == "cuda":  # memory that the device reads without a copy
                batch.seen = torch.zeros((batch.cars, WIDE), pin_memory=True).numpy()

    def collect(self) -> Rollout:
        """Drive for the steps of a rollout."""
        steps = self.learner.settings.steps
        with torch.no_grad():
            for t in range(steps):
                for k, batch in enumerate(self.batches):
                    cars = slice(int(self.edges[k]), int(self.edges[k + 1]))
                    batch.wait()
                    if t > 0:
                        self._note(t - 1, cars, batch)
                    self._send(t, k, cars, batch)
            for k, batch in enumerate(self.batches):
                cars = slice(int(self.edges[k]), int(self.edges[k + 1]))
                batch.wait()
                self._note(steps - 1, cars, batch)
                self.seen[steps, cars] = torch.from_numpy(batch.seen).to(self.learner.device)
            return self._rollout()

    def _send(self, t: int, k: int, cars: slice, batch: Batch) -> None:
        """Draw commands, and begin to drive by them."""
        learner, device = self.learner, self.learner.device
        seen = self.seen[t, cars]
        seen.copy_(torch.from_numpy(batch.seen))
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
        batch.play(teach=teach)

    def _note(self, t: int, cars: slice, batch: Batch) -> None:
        device = self.learner.device
        self.rewards[t, cars] = torch.from_numpy(batch.rewards).float().to(device)
        self.ended[t, cars] = torch.from_numpy(batch.ended).float().to(device)

    def _rollout(self) -> Rollout:
        """Return advantages by generalised advantage estimation; all races end truly."""
        s = self.learner.settings
        values = torch.stack([self.learner.critic(row) for row in self.seen])
        gains = torch.zeros_like(self.rewards)
        last = torch.zeros_like(self.rewards[0])
        for t in reversed(range(s.steps)):
            goes_on = 1.0 - self.ended[t]
            delta = self.rewards[t] + s.gamma * goes_on * values[t + 1] - values[t]
            last = delta + s.gamma * s.lambda_ * goes_on * last
            gains[t] = last
        returns = gains + values[:-1]
        live = self.live
        flat = gains[:, live].flatten()
        flat = (flat - flat.mean()) / (flat.std() + 1e-8)
        return Rollout(
            self.seen[:-1, live].flatten(0, 1),
            self.actions[:, live].flatten(0, 1),
            self.taught[:, live].flatten(0, 1),
            self.logs[:, live].flatten(),
            flat,
            returns[:, live].flatten(),
        )


def evaluate(
    numbers: np.ndarray, rivals: Sequence[str], tracks: Sequence[Track], races: int, threads: int
) -> list[dict[str, Any]]:
    """Race the network, without exploration, against other planners; return a row for each."""
    policy, rows = BY_THETA.policy(np.concatenate([[1.0], numbers]), "lidar-ppo"), []
    for name in rivals:
        rival, found = parse_policy(name), []
        for track in tracks:
            result = run_races(track, [policy] * races, rival, "contest", seed=11, threads=threads)
            won = np.where(result.winner == -1, 0.5, result.winner == 0)
            found.append([won.mean(), *result.own_crash.mean(axis=0)])
        score, own, other = np.mean(found, axis=0)
        worst = float(np.max([row[1] for row in found]))
        rows.append(
            {"rival": name, "score": score, "own_crash": own, "worst": worst, "their_crash": other}
        )
    return rows


def merit(rows: Sequence[dict[str, Any]]) -> float:
    """Return what the best weights are chosen by: scores, and own crashes."""
    return float(np.mean([row["score"] - row["own_crash"] for row in rows]))


class Run:
    """A training run in a folder; it goes on from the folder's checkpoint."""

    def __init__(self, arguments: argparse.Namespace) -> None:
        self.arguments, self.folder = arguments, arguments.out
        self.run = RunFolder(arguments, self._say)
        self.log, teacher = Log(self.folder), parse_policy(arguments.teacher)
        circuits = self._circuits(teacher)
        torch.manual_seed(arguments.seed)
        settings = Settings(
            steps=arguments.steps,
            minibatch=arguments.minibatch,
            epochs=arguments.epochs,
            rate=arguments.rate,
            entropy=arguments.entropy,
            horizon=1e6 * arguments.horizon,
            warm=1e6 * arguments.warm,
            fade=1e6 * arguments.fade,
            gamma=arguments.gamma,
            kl=arguments.kl,
        )
        self.learner = Learner(settings, arguments.device)
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
        self.groups = make_groups(circuits, cars, arguments.seed, teacher)
        pool, count = ThreadPoolExecutor(arguments.threads), arguments.batches
        self.batches = [
            Batch(self.groups[k::count], pool, arguments.threads, options) for k in range(count)
        ]
        self.collector = Collector(self.batches, self.learner)
        if not self._restore_races():
            for batch in self.batches:
                batch.play(first=True)
                batch.wait()
        self._say(f"{self.collector.cars} cars ready, {len(self.collector.live)} of them learn")

    def _circuits(self, teacher: Any) -> list[Circuit]:
        """Return the circuits of the groups: shipped ones several times, then random ones."""
        a, shipped = self.arguments, list(self.arguments.tracks)
        checks = range(FIRST_CHECK, FIRST_CHECK + a.checks)
        found = prepare([*shipped, *checks, *range(a.random)], a.workers, teacher)
        self._say(f"{len(found)} circuits")
        self.checked = [one.track for one in found[: len(shipped) + a.checks]]
        return found[: len(shipped)] * a.each + found[len(shipped) + a.checks :]

    def train(self) -> None:
        """Train until the time is over."""
        a, learner = self.arguments, self.learner
        end, saved = 60.0 * a.minutes, self.log.seconds
        while self.updates < a.updates and self.log.seconds < end - a.spare:
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
                "rate": float(learner.optimiser.param_groups[0]["lr"]),
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
            batch.options = batch.options._replace(fault=share * a.fault)

    def _evaluate(self) -> None:
        a, layers = self.arguments, self.learner.layers()
        rows = evaluate(flat_weights(layers), a.rivals, self.checked, a.races, a.threads)
        found = merit(rows)
        self.log.curve(self.learner.choices, rows, found)
        training = {key: getattr(a, key) for key in ("cars", "random", "each", "steps", "seed")}
        training |= {"choices": self.learner.choices, "updates": self.updates}
        folders = [self.folder / "last"]
        if found > self.best and not self.learner.warms:
            self.best = found
            folders.append(self.folder / "best")
        for folder in folders:
            save_lidar_planner(folder, "ppo", layers, name="lidar-ppo", training=training)
        self._save()

    def _save(self) -> None:
        """Write the checkpoint, whole or not at all; the races first, in their own file."""
        learner = self.learner
        races = [[torch.from_numpy(one) for one in group.saved()] for group in self.groups]
        seen = [torch.from_numpy(batch.seen) for batch in self.batches]
        taught = [torch.from_numpy(batch.taught) for batch in self.batches]
        driven = {"races": races, "seen": seen, "taught": taught}
        checkpoint = {
            "actor": learner.actor.state_dict(),
            "critic": learner.critic.state_dict(),
            "averaged": learner.averaged.state_dict(),
            "optimiser": learner.optimiser.state_dict(),
            "generator": learner.generator.get_state(),
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
        learner.actor.load_state_dict(saved["actor"])
        learner.critic.load_state_dict(saved["critic"])
        learner.averaged.load_state_dict(saved["averaged"])
        learner.optimiser.load_state_dict(saved["optimiser"])
        if saved["generator"].shape == learner.generator.get_state().shape:
            learner.generator.set_state(saved["generator"])
        else:  # from another kind of device
            learner.generator.manual_seed(self.arguments.seed + saved["updates"])
        for one, values in zip(learner.old, saved["old"], strict=True):
            one.load_state_dict(values)
        learner.frozen, learner.choices = saved["frozen"], saved["choices"]
        self.updates, self.best = saved["updates"], saved["best"]
        self._say(f"goes on after {learner.choices / 1e6:.1f} M choices")

    def _say(self, text: str) -> None:
        print(f"{self.log.seconds:6.0f} s  {text}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("--out", type=Path, required=True, help="folder of weights, checkpoint and curves")
    add("--minutes", type=float, default=10.0, help="wall-clock time, preparation included")
    add("--updates", type=int, default=1_000_000, help="updates, if they end before the time")
    add("--spare", type=float, default=10.0, help="seconds kept for the last evaluation")
    add("--every", type=float, default=60.0, help="seconds between evaluations and checkpoints")
    add("--device", default="cuda" if torch.cuda.is_available() else "cpu", help="of torch")
    add("--threads", type=int, default=1, help="threads that drive")
    add("--workers", type=int, default=1, help="processes that make circuits")
    add("--cars", type=int, default=1024, help="cars of networks, shared by the circuits")
    known = [name for name in list_tracks() if name not in HELD_OUT]
    add("--tracks", nargs="*", default=known, help="shipped circuits")
    add("--rivals", nargs="*", default=RIVALS, help="planners of the evaluation")
    add("--random", type=int, default=24, help="random circuits")
    add("--each", type=int, default=1, help="groups on each shipped circuit")
    add("--checks", type=int, default=4, help="random circuits of the evaluation alone")
    add("--batches", type=int, default=1, help="batches that drive in turn")
    add("--steps", type=int, default=32, help="choices of a car between two updates")
    add("--minibatch", type=int, default=8192, help="choices of a step of the optimiser")
    add("--epochs", type=int, default=3, help="passes over a rollout")
    add("--rate", type=float, default=1e-3, help="first learning rate")
    add("--horizon", type=float, default=1000.0, help="choices of the whole training, in millions")
    add("--teacher", default="predictive-spliner", help="planner that the network imitates first")
    add("--warm", type=float, default=1.0, help="choices with imitation alone, in millions")
    add("--fade", type=float, default=4.0, help="choices until imitation has no weight, millions")
    add("--entropy", type=float, default=0.002, help="weight of the entropy")
    add("--progress", type=float, default=0.01, help="reward of a metre")
    add("--gain", type=float, default=0.02, help="reward of a metre gained on the other car")
    add("--win", type=float, default=1.0, help="reward of a win")
    add("--fault", type=float, default=2.0, help="cost of an own crash, beside the lost race")
    add("--passing", type=float, default=2.0, help="reward of a pass")
    add("--bold", type=float, default=30.0, help="choices until --fault is reached, in millions")
    add("--gamma", type=float, default=0.995, help="discount of a choice")
    add("--kl", type=float, default=0.01, help="divergence of an update that is aimed at")
    add("--freeze", type=int, default=20, help="updates between two frozen selves")
    add("--races", type=int, default=16, help="races of an evaluation, for each circuit and rival")
    add("--seed", type=int, default=0)
    arguments = read_arguments(parser)
    try:
        parse_policy(arguments.teacher)
    except InputError as error:
        parser.error(str(error))
    torch.set_num_threads(max(1, arguments.threads if arguments.device == "cpu" else 1))
    # A thread that drives needs the interpreter for microseconds, between two groups.
    sys.setswitchinterval(2e-4)
    Run(arguments).train()


if __name__ == "__main__":
    main()
