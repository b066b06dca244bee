"""Train ``line-ppo``, a network that chooses among the lattice's candidates, by PPO in self-play.

    python dev/training/line_ppo.py --out out/line-ppo --minutes 8

Training starts level with the default lattice. Two cars race under the rules ``contest``, on
shipped and random circuits; the opponent is the network itself, a frozen self, or another planner.
Half of the cars have the default style, the others a random one. Every minute the network with the
default style, and without exploration, races the lattice and other planners, and the weights with
the best score are saved. The same command goes on after a stop.
"""

import argparse
import csv
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
from line_races import (
    EXTRA,
    FAULT,
    FEATURES,
    FROZEN,
    HELD_OUT,
    WIDE,
    Batch,
    Circuit,
    Group,
    League,
    Options,
    make_groups,
    prepare,
)
from run_folder import RunFolder, read_arguments
from torch import Tensor, nn

from pcs_racing import InputError, load_track, parse_policy, run_races
from pcs_racing.planners.lattice import CANDIDATES, GOALS, LATTICE, SPEEDS
from pcs_racing.planners.line_ppo import (
    CONTEXT,
    LATTICE_SIZE,
    LAYERS,
    MOVE,
    PAIR,
    PARAMETERS,
    SHARPNESS,
    SPEED,
    UNITS,
    flat_weights,
    read_line_planner,
    save_line_planner,
)
from pcs_racing.planners.planner import Policy
from pcs_racing.track.maps import list_tracks

RIVALS = (
    "lattice",
    "lattice:early",
    "iterated-best-response",
    "pure-pursuit",
    "gap-follower",
    "residual",
)
DEFAULT_STYLE = [one.default for one in PARAMETERS]


class Chooser(nn.Module):
    """Network of `pcs_racing.planners.line_ppo`, and a temperature of its exploration."""

    def __init__(self) -> None:
        super().__init__()
        for name, (outputs, inputs) in LAYERS.items():
            setattr(self, name, nn.Linear(inputs, outputs))
        for layer in (self.weights, self.score):  # level with the lattice
            nn.init.zeros_(layer.weight)
            nn.init.zeros_(layer.bias)
        self.sharper = nn.Parameter(torch.tensor(0.4))

    def forward(self, seen: Tensor) -> Tensor:
        """Return the log probabilities of the candidates, shape (N, 64)."""
        ends = (CONTEXT, MOVE * GOALS, SPEED * SPEEDS, PAIR * CANDIDATES)
        context, moves, speeds, pairs = seen[:, :FEATURES].split(ends, dim=1)
        # Rejected candidates, more than half, are left out.
        row, candidate = (pairs[:, -CANDIDATES:] >= 0.0).nonzero(as_tuple=True)
        each = torch.cat(
            [
                _columns(moves, MOVE, row * GOALS + candidate % GOALS),
                _columns(speeds, SPEED, row * SPEEDS + candidate // GOALS),
                _columns(pairs, PAIR, row * CANDIDATES + candidate),
            ],
            dim=1,
        )
        inner = torch.tanh(self.context(context))
        ours = torch.cat([self.situation(inner), self.weights(inner)], dim=1).index_select(0, row)
        hidden = torch.relu(self.candidate(each) + ours[:, :UNITS])
        score = hidden @ self.score.weight[0] + (ours[:, UNITS:] * each).sum(dim=1)
        score = (score - SHARPNESS * each[:, -1]) * self.sharper.exp()
        scores = torch.full((len(seen) * CANDIDATES,), -1e9, device=seen.device)
        scores = scores.index_copy(0, row * CANDIDATES + candidate, score)
        return torch.log_softmax(scores.view(-1, CANDIDATES), dim=1)


def tensors_of(numbers: np.ndarray) -> dict[str, Tensor]:
    """Return the tensors of a network's numbers, the inverse of `flat_weights`."""
    tensors, at = {}, 0
    for name, (outputs, inputs) in LAYERS.items():
        part = torch.from_numpy(numbers[at : at + outputs * (inputs + 1)].copy()).float()
        tensors[f"{name}.bias"] = part[:outputs]
        tensors[f"{name}.weight"] = part[outputs:].view(inputs, outputs).T.contiguous()
        at += outputs * (inputs + 1)
    return tensors


def _columns(features: Tensor, count: int, chosen: Tensor) -> Tensor:
    """Return columns of features (N, count * columns), one after the other, shape (., count)."""
    columns = features.unflatten(1, (count, -1)).transpose(1, 2)
    return columns.reshape(-1, count).index_select(0, chosen)


class Critic(nn.Module):
    """Value of a situation, with the time left, the lead and the opponent's family."""

    def __init__(self, width: int = 128) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            nn.Linear(CONTEXT + EXTRA, width),
            nn.Tanh(),
            nn.Linear(width, width),
            nn.Tanh(),
            nn.Linear(width, 1),
        )

    def forward(self, seen: Tensor) -> Tensor:
        """Return the values, shape (N,)."""
        return self.layers(torch.cat([seen[:, :CONTEXT], seen[:, FEATURES:]], dim=1))[:, 0]


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

    def __init__(self, settings: Settings, lattice: Policy, device: str) -> None:
        self.settings, self.lattice, self.device = settings, lattice, torch.device(device)
        self.actor, self.critic = Chooser().to(self.device), Critic().to(self.device)
        self.averaged = Chooser().to(self.device)
        self.averaged.load_state_dict(self.actor.state_dict())
        self.optimiser = torch.optim.Adam(
            [*self.actor.parameters(), *self.critic.parameters()], settings.rate, eps=1e-5
        )
        self.generator = torch.Generator(self.device)

    def start_from(self, numbers: np.ndarray) -> None:
        """Start from the numbers of a network."""
        for network in (self.actor, self.averaged):
            network.load_state_dict(tensors_of(numbers), strict=False)

    def act(self, seen: Tensor) -> tuple[Tensor, Tensor]:
        """Draw candidates; return them and their log probabilities."""
        with torch.no_grad():
            logs = self.actor(seen)
            noise = torch.empty_like(logs).exponential_(generator=self.generator)
            chosen = (logs - noise.clamp_min(1e-20).log()).argmax(dim=1)
            return chosen, logs.gather(1, chosen[:, None])[:, 0]

    def update(self, rollout: "Rollout", choices: int) -> dict[str, float]:
        """Improve actor and critic by one rollout, after some choices; return means."""
        s, left = self.settings, max(1.0 - choices / self.settings.horizon, 0.0)
        sums, count, stopped = np.zeros(4), 0, False
        total = len(rollout.chosen)
        for _ in range(s.epochs):
            order = torch.randperm(total, generator=self.generator, device=self.device)
            for rows in order.split(s.minibatch):
                logs = self.actor(rollout.seen[rows])
                mine = logs.gather(1, rollout.chosen[rows][:, None])[:, 0]
                ratio = mine - rollout.logs[rows]
                kl = (ratio.exp() - 1.0 - ratio).mean()
                gain = rollout.gains[rows]
                ratio = ratio.exp()
                actor = -torch.min(ratio * gain, ratio.clamp(1 - s.clip, 1 + s.clip) * gain).mean()
                entropy = -(logs.exp() * logs.clamp_min(-30.0)).sum(dim=1).mean()
                error = (self.critic(rollout.seen[rows]) - rollout.returns[rows]).square().mean()
                loss = actor - left * s.entropy * entropy + 0.5 * error
                self.optimiser.zero_grad(set_to_none=True)
                loss.backward()
                nn.utils.clip_grad_norm_(self.actor.parameters(), 1.0)
                nn.utils.clip_grad_norm_(self.critic.parameters(), 1.0)
                self.optimiser.step()
                values = torch.stack([kl, entropy, error, actor]).detach().cpu().numpy()
                sums, count = sums + values, count + 1
                if values[0] > s.max_kl:
                    stopped = True
                    break
            if stopped:
                break
        self._follow(float(values[0]), s.kl * (0.2 + 0.8 * left))
        with torch.no_grad():
            for slow, fast in zip(self.averaged.parameters(), self.actor.parameters(), strict=True):
                slow.lerp_(fast, 1.0 - s.average)
        return dict(zip(("kl", "entropy", "error", "actor"), sums / count, strict=True))

    def _follow(self, kl: float, aim: float) -> None:
        """Adapt the learning rate to the divergence of the last step of an update."""
        factor = 1.5 if kl < 0.5 * aim else 1.0 / 1.5 if kl > 2.0 * aim else 1.0
        for group in self.optimiser.param_groups:
            group["lr"] = min(max(group["lr"] * factor, 1e-5), self.settings.max_rate)

    def numbers(self) -> np.ndarray:
        """Return default style, lattice and the averaged actor's numbers, for `FROZEN`."""
        weights = flat_weights(self.tensors())
        return np.concatenate([DEFAULT_STYLE, self.lattice.parameters, weights])

    def tensors(self) -> dict[str, np.ndarray]:
        """Return the tensors of the averaged actor's layers."""
        return {
            key: value.detach().cpu().numpy()
            for key, value in self.averaged.state_dict().items()
            if key != "sharper"
        }


@dataclass
class Rollout:
    """Choices of all cars over some steps, flat, with advantages and returns."""

    seen: Tensor
    chosen: Tensor
    logs: Tensor
    gains: Tensor
    returns: Tensor


class Collector:
    """Batches that drive in turn: while the one drives, candidates are chosen for the other."""

    def __init__(self, batches: Sequence[Batch], learner: Learner) -> None:
        self.batches, self.learner = batches, learner
        steps, device = learner.settings.steps, learner.device
        self.edges = np.cumsum([0, *(batch.cars for batch in batches)])
        cars = int(self.edges[-1])
        self.cars = cars
        self.seen = torch.zeros((steps + 1, cars, WIDE), device=device)
        self.chosen = torch.zeros((steps, cars), dtype=torch.int64, device=device)
        self.logs = torch.zeros((steps, cars), device=device)
        self.rewards = torch.zeros((steps, cars), device=device)
        self.ended = torch.zeros((steps, cars), device=device)
        for batch in batches:
            if device.type == "cuda":  # memory that the device reads without a copy
                batch.seen = torch.zeros((batch.cars, WIDE), pin_memory=True).numpy()
            batch.play(np.full(batch.cars, -1))

    def collect(self) -> Rollout:
        """Drive for the steps of a rollout."""
        steps = self.learner.settings.steps
        for t in range(steps):
            for k, batch in enumerate(self.batches):
                cars = slice(int(self.edges[k]), int(self.edges[k + 1]))
                batch.wait()
                if t > 0:
                    self._note(t - 1, cars, batch)
                self.seen[t, cars] = torch.from_numpy(batch.seen).to(self.learner.device)
                chosen, logs = self.learner.act(self.seen[t, cars])
                self.chosen[t, cars], self.logs[t, cars] = chosen, logs
                batch.play(chosen.cpu().numpy())
        for k, batch in enumerate(self.batches):
            cars = slice(int(self.edges[k]), int(self.edges[k + 1]))
            batch.wait()
            self._note(steps - 1, cars, batch)
            self.seen[steps, cars] = torch.from_numpy(batch.seen).to(self.learner.device)
        return self._rollout()

    def _note(self, t: int, cars: slice, batch: Batch) -> None:
        device = self.learner.device
        self.rewards[t, cars] = torch.from_numpy(batch.rewards).float().to(device)
        self.ended[t, cars] = torch.from_numpy(batch.ended).float().to(device)

    def _rollout(self) -> Rollout:
        """Return advantages by generalised advantage estimation; all races end truly."""
        s = self.learner.settings
        with torch.no_grad():
            values = torch.stack([self.learner.critic(row) for row in self.seen])
            gains = torch.zeros_like(self.rewards)
            last = torch.zeros_like(self.rewards[0])
            for t in reversed(range(s.steps)):
                goes_on = 1.0 - self.ended[t]
                delta = self.rewards[t] + s.gamma * goes_on * values[t + 1] - values[t]
                last = delta + s.gamma * s.lambda_ * goes_on * last
                gains[t] = last
            returns = (gains + values[:-1]).flatten()
            flat = gains.flatten()
            flat = (flat - flat.mean()) / (flat.std() + 1e-8)
        return Rollout(
            self.seen[:-1].flatten(0, 1), self.chosen.flatten(), self.logs.flatten(), flat, returns
        )


def evaluate(
    numbers: np.ndarray, rivals: Sequence[str], tracks: Sequence[str], races: int, threads: int
) -> list[dict[str, Any]]:
    """Race the network, without exploration, against other planners; return a row for each."""
    policy, rows = FROZEN.policy(numbers, "line-ppo"), []
    for name in rivals:
        rival, found = parse_policy(name), []
        for track in tracks:
            result = run_races(
                load_track(track), [policy] * races, rival, "contest", seed=11, threads=threads
            )
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
    return float(
        rows[0]["score"]
        + 0.5 * np.mean([row["score"] for row in rows])
        - np.mean([row["own_crash"] for row in rows])
    )


class Log:
    """Progress on the screen, and learning curves in a csv file."""

    def __init__(self, folder: Path) -> None:
        self.file, self.start, self.last = folder / "curves.csv", time.monotonic(), 0.0
        self.sums: list[dict[str, float]] = []

    @property
    def seconds(self) -> float:
        """Time since the start."""
        return time.monotonic() - self.start

    def note(self, means: dict[str, float], steps: int, batches: Sequence[Batch]) -> None:
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


class Run:
    """A training run in a folder; it goes on from the folder's checkpoint."""

    def __init__(self, arguments: argparse.Namespace) -> None:
        self.arguments, self.folder = arguments, arguments.out
        self.run = RunFolder(arguments, self._say)
        self.log, self.shipped = Log(self.folder), list(arguments.tracks)
        circuits = self._circuits()
        torch.manual_seed(arguments.seed)
        settings = Settings(
            steps=arguments.steps,
            minibatch=arguments.minibatch,
            epochs=arguments.epochs,
            rate=arguments.rate,
            entropy=arguments.entropy,
            horizon=1e6 * arguments.horizon,
        )
        lattice = parse_policy(arguments.lattice)
        self.learner = Learner(settings, lattice, arguments.device)
        self.learner.generator.manual_seed(arguments.seed)
        if arguments.start:
            self.learner.start_from(read_line_planner(arguments.start)[1][LATTICE_SIZE:])
        self.league = League(self.learner.numbers())
        self.updates, self.choices, self.best = 0, 0, -1e9
        if (saved := self.run.checkpoint()) is not None:
            self._restore(saved)
        cars = max(2, arguments.cars // len(circuits))
        options = Options(fault=arguments.fault)
        groups = make_groups(circuits, cars, arguments.seed, self.league)
        self._restore_races(groups)
        pool, self.groups = ThreadPoolExecutor(arguments.threads), groups
        self.batches = [
            Batch(
                groups[k :: arguments.batches],
                pool,
                arguments.threads,
                options,
                lattice.parameters.copy(),
            )
            for k in range(arguments.batches)
        ]
        self.collector = Collector(self.batches, self.learner)
        for batch in self.batches:
            batch.wait()
        self._say(f"{self.collector.cars} cars ready")

    def _circuits(self) -> list[Circuit]:
        """Return the circuits of the groups: shipped ones several times, then random ones."""
        a = self.arguments
        found = prepare([*self.shipped, *range(a.random)], a.workers)
        self._say(f"{len(found)} circuits")
        shipped, random = found[: len(self.shipped)], found[len(self.shipped) :]
        return shipped * a.each + random

    def train(self) -> None:
        """Train until the time is over."""
        a, learner = self.arguments, self.learner
        end, saved = 60.0 * a.minutes, self.log.seconds
        self._evaluate()
        while self.updates < a.updates and self.log.seconds < end - a.spare:
            begun = time.monotonic()
            rollout = self.collector.collect()
            middle = time.monotonic()
            means = learner.update(rollout, self.choices)
            self.updates += 1
            self.choices += len(rollout.chosen)
            done = time.monotonic()
            means |= {
                "per s": len(rollout.chosen) / (done - begun),
                "drive": (middle - begun) / (done - begun),
                "value": float(rollout.returns.mean()),
                "sharp": float(learner.actor.sharper.detach().exp()),
                "rate": float(learner.optimiser.param_groups[0]["lr"]),
            }
            self.log.note(means, self.choices, self.batches)
            if self.updates % a.freeze == 0:
                self.league.add(learner.numbers())
            if self.log.seconds - saved > a.every:
                saved = self.log.seconds
                self._evaluate()
        self._evaluate()

    def _evaluate(self) -> None:
        a = self.arguments
        numbers = self.learner.numbers()
        rows = evaluate(numbers, a.rivals, self.shipped, a.races, a.threads)
        found = merit(rows)
        self.log.curve(self.choices, rows, found)
        training = {key: getattr(a, key) for key in ("cars", "random", "each", "steps", "seed")}
        training |= {"choices": self.choices, "updates": self.updates}
        folders = [self.folder / "last"]
        if found > self.best:
            self.best = found
            folders.append(self.folder / "best")
        for folder in folders:
            values = self.learner.lattice.parameters.tolist()
            lattice = dict(zip(LATTICE.parameter_names, values, strict=True))
            save_line_planner(folder, self.learner.tensors(), lattice=lattice, training=training)
        self._save()

    def _save(self) -> None:
        """Write the checkpoint, whole or not at all; the races first, in their own file."""
        learner = self.learner
        races = [[torch.from_numpy(one) for one in group.saved()] for group in self.groups]
        checkpoint = {
            "actor": learner.actor.state_dict(),
            "critic": learner.critic.state_dict(),
            "averaged": learner.averaged.state_dict(),
            "optimiser": learner.optimiser.state_dict(),
            "generator": learner.generator.get_state(),
            "league": torch.from_numpy(self.league.numbers[: self.league.count].copy()),
            "choices": self.choices,
            "best": self.best,
        }
        self.run.save(self.updates, {"races": races}, checkpoint)

    def _restore_races(self, groups: Sequence[Group]) -> None:
        """Let the races of the checkpoint go on; without them, races begin again."""
        saved = self.run.races(self.updates)
        for group, arrays in zip(groups, saved["races"], strict=True) if saved else ():
            group.restore([one.numpy() for one in arrays])

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
        league = saved["league"].numpy()
        self.league.numbers[: len(league)] = league
        self.league.count = len(league)
        self.updates, self.choices = saved["updates"], saved["choices"]
        self.best = saved["best"]
        self._say(f"goes on after {self.choices / 1e6:.1f} M choices")

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
    add("--cars", type=int, default=1024, help="learning cars, shared by the circuits")
    known = [name for name in list_tracks() if name not in HELD_OUT]
    add("--tracks", nargs="*", default=known, help="shipped circuits")
    add("--rivals", nargs="*", default=RIVALS, help="planners of the evaluation")
    add("--random", type=int, default=24, help="random circuits")
    add("--each", type=int, default=2, help="groups on each shipped circuit")
    add("--batches", type=int, default=1, help="batches that drive in turn")
    add("--steps", type=int, default=32, help="choices of a car between two updates")
    add("--minibatch", type=int, default=8192, help="choices of a step of the optimiser")
    add("--epochs", type=int, default=3, help="passes over a rollout")
    add("--lattice", default="lattice", help="policy that lays the candidates")
    add("--start", help="folder of a line planner to start from (default: level with the lattice)")
    add("--rate", type=float, default=1e-3, help="first learning rate")
    add("--horizon", type=float, default=1000.0, help="choices of the whole training, in millions")
    add("--entropy", type=float, default=0.001, help="weight of the entropy")
    add("--fault", type=float, default=FAULT[0], help="cost of an own crash at risk 0")
    add("--freeze", type=int, default=20, help="updates between two frozen selves")
    add("--races", type=int, default=16, help="races of an evaluation, for each circuit and rival")
    add("--seed", type=int, default=0)
    arguments = read_arguments(parser)
    try:
        if parse_policy(arguments.lattice).planner is not LATTICE:
            parser.error(f"--lattice is {arguments.lattice!r}; it must be a policy of lattice")
        if arguments.start:
            read_line_planner(arguments.start)
    except InputError as error:
        parser.error(str(error))
    torch.set_num_threads(max(1, arguments.threads if arguments.device == "cpu" else 1))
    # A thread that drives needs the interpreter for microseconds, between two groups.
    sys.setswitchinterval(2e-4)
    Run(arguments).train()


if __name__ == "__main__":
    main()
