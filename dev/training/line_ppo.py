"""Train ``line-ppo``, a network that chooses among the lattice's candidates, by PPO in self-play.

    python dev/training/line_ppo.py --out out/line-ppo --minutes 8

Training starts level with the default lattice. Two cars race under the rules ``contest``, on
shipped and random circuits; the opponent is the network itself, a frozen self, or another planner.
Half of the cars have the default style, the others a random one. Every minute the network with the
default style, and without exploration, races the lattice and other planners, and the weights with
the best score are saved. The same command goes on after a stop.
``--randomize cars.yaml`` draws the cars of all races (`pcs_racing.envs.draws`).
"""

import argparse
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np

try:
    import torch
except ModuleNotFoundError as error:
    raise SystemExit(f'this example needs {error.name}: pip install ".[learning]"') from None
from line_races import (
    EXTRA,
    FAMILIES,
    FAULT,
    FEATURES,
    FROZEN,
    WIDE,
    Batch,
    Circuit,
    Group,
    League,
    Options,
    compile_for,
    make_groups,
    prepare,
)
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

from pcs_racing import InputError, load_track, racer
from pcs_racing.planners.candidate_rows import CANDIDATES, GOALS, SPEEDS
from pcs_racing.planners.lattice import LATTICE
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

RIVALS = (
    "lattice",
    "lattice:early",
    "iterated-best-response",
    "pure-pursuit",
    "gap-follower",
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


class LineLearner(Learner):
    """Learner of the choice among the lattice's candidates."""

    def __init__(self, settings: Settings, lattice: Policy, device: str) -> None:
        super().__init__(settings, Chooser, Critic, device)
        self.lattice = lattice

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
                self.step(loss)
                values = torch.stack([kl, entropy, error, actor]).detach().cpu().numpy()
                sums, count = sums + values, count + 1
                if values[0] > s.max_kl:
                    stopped = True
                    break
            if stopped:
                break
        self.follow(float(values[0]), left)
        self.average()
        return dict(zip(("kl", "entropy", "error", "actor"), sums / count, strict=True))

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


class LineCollector(Collector):
    """Collector of choices among candidates."""

    def __init__(self, batches: Sequence[Batch], learner: LineLearner) -> None:
        super().__init__(batches, learner, WIDE)
        self.chosen = torch.zeros_like(self.logs, dtype=torch.int64)
        for batch in batches:
            batch.play(np.full(batch.cars, -1))

    def send(self, t: int, k: int, cars: slice) -> None:
        """Draw candidates, and begin to drive by them."""
        chosen, logs = self.learner.act(self.seen[t, cars])
        self.chosen[t, cars], self.logs[t, cars] = chosen, logs
        self.batches[k].play(chosen.cpu().numpy())

    def collect(self) -> Rollout:
        """Drive for the steps of a rollout."""
        self.drive()
        with torch.no_grad():
            gains, returns = self.advantages()
        return Rollout(
            self.seen[:-1].flatten(0, 1),
            self.chosen.flatten(),
            self.logs.flatten(),
            standardised(gains),
            returns.flatten(),
        )


def merit(rows: Sequence[dict[str, Any]]) -> float:
    """Return the criteria of the best weights: scores, and own crashes."""
    return float(
        rows[0]["score"]
        + 0.5 * np.mean([row["score"] for row in rows])
        - np.mean([row["own_crash"] for row in rows])
    )


class Run:
    """A training run in a folder; it goes on from the folder's checkpoint."""

    def __init__(self, arguments: argparse.Namespace) -> None:
        self.arguments, self.folder = arguments, arguments.out
        self.log, self.shipped = Log(self.folder), list(arguments.tracks)
        self.run = RunFolder(arguments, self.log.say)
        circuits = self._circuits()
        torch.manual_seed(arguments.seed)
        settings = Settings(**settings_of(arguments))
        lattice = racer(arguments.lattice)
        self.learner = LineLearner(settings, lattice, arguments.device)
        self.learner.generator.manual_seed(arguments.seed)
        if arguments.start:
            self.learner.start_from(read_line_planner(arguments.start)[1][LATTICE_SIZE:])
        self.league = League(self.learner.numbers())
        self.updates, self.choices, self.best = 0, 0, -1e9
        if (saved := self.run.checkpoint()) is not None:
            self._restore(saved)
        cars = max(2, arguments.cars // len(circuits))
        options = Options(fault=arguments.fault)
        groups = make_groups(circuits, cars, arguments.seed, self.league, arguments.randomize)
        self._restore_races(groups)
        pool, self.groups = ThreadPoolExecutor(arguments.threads), groups
        given = {"options": options, "lattice": lattice.parameters.copy()}
        self.batches = [
            Batch(groups[k :: arguments.batches], pool, arguments.threads, WIDE, **given)
            for k in range(arguments.batches)
        ]
        self.collector = LineCollector(self.batches, self.learner)
        for batch in self.batches:
            batch.wait()
        self.log.say(f"{self.collector.cars} cars ready")

    def _circuits(self) -> list[Circuit]:
        """Return the circuits of the groups: shipped ones several times, then random ones."""
        a = self.arguments
        families = [(one,) for one in FAMILIES]
        found = prepare([*self.shipped, *range(a.random)], a.workers, compile_for, *families)
        self.log.say(f"{len(found)} circuits")
        shipped, random = found[: len(self.shipped)], found[len(self.shipped) :]
        return shipped * a.each + random

    def train(self) -> None:
        """Train for the minutes, which begin now, after the preparation."""
        a, learner = self.arguments, self.learner
        self._evaluate()
        end, saved = self.log.begin(a.minutes), self.log.seconds
        while self.updates < a.updates and self.log.seconds < end:
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
                "rate": learner.rate,
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
        policy = FROZEN.policy(self.learner.numbers(), "line-ppo")
        tracks = [load_track(name) for name in self.shipped]
        rows = evaluate(policy, a.rivals, tracks, a.races, a.threads, a.randomize)
        found, training = merit(rows), about(a, self.choices, self.updates)
        self.log.curve(self.choices, rows, found)
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
        races = [[torch.from_numpy(one) for one in group.saved()] for group in self.groups]
        checkpoint = self.learner.state() | {
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
        self.learner.restore(saved, self.arguments.seed + saved["updates"])
        league = saved["league"].numpy()
        self.league.numbers[: len(league)] = league
        self.league.count = len(league)
        self.updates, self.choices = saved["updates"], saved["choices"]
        self.best = self.run.best(saved)
        self.log.say(f"goes on after {self.choices / 1e6:.1f} M choices")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add_arguments(parser, RIVALS, each=2, entropy=0.001)
    add("--lattice", default="lattice", help="policy that lays the candidates")
    add("--start", help="folder of a line planner to start from (default: level with the lattice)")
    add("--fault", type=float, default=FAULT[0], help="cost of an own crash at risk 0")
    arguments = read_arguments(parser)
    try:
        if racer(arguments.lattice).planner is not LATTICE:
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
