"""Train a network that races by a lidar without a map, by PPO in self-play.

    python examples/train_lidar_ppo.py --minutes 60
    pcs-racing race --ego out/train_lidar_ppo/best --opponent pure-pursuit --replay race.html

One file, in the style of CleanRL. The network leads from the sectors of a lidar to arcs. Half of
the cars race each other; the other half race planners and frozen copies of the network. Every few
minutes the averaged network races planners on circuits that it does not learn on; the best one is
kept. curves.csv, curves.png and TensorBoard's events show the progress. The same command goes on
after a stop.
"""

import argparse
import csv
import time
from itertools import chain, pairwise
from pathlib import Path
from typing import Any

import numpy as np

from pcs_racing import InputError, load_track, run_races
from pcs_racing.envs import (
    DriveHeadToHeadVectorEnv,
    DriveVectorEnv,
    RandomCircuits,
    find_speeds,
    random_circuit,
)
from pcs_racing.planners import (
    DenseLayers,
    arc_policy,
    read_lidar_planner,
    save_lidar_planner,
)

try:
    import torch
    from matplotlib.figure import Figure
    from torch import Tensor, nn
    from torch.utils.tensorboard import SummaryWriter
except ModuleNotFoundError as error:
    raise SystemExit(f'this example needs {error.name}: pip install ".[learning,plots]"') from None

TRACKS = (
    "Brackwater",
    "Kestrelheim",
    "Pipkin",
    "Quillburg",
    "Tarnfjord",
)
"""Circuits of the training; random ones are added."""
HELD_OUT = ("Larkmoor", "Saltmere", "Vellindra")
"""Circuits of the evaluations."""
TESTS = ("pure-pursuit", "gap-follower", "lattice")
RIVALS = {
    "pure-pursuit": 4.0,
    "pure-pursuit:pace=0": 1.0,
    "pure-pursuit:pace=0.5": 2.0,
    "lattice:pace=0": 1.0,
    "lattice:early": 1.0,
    "gap-follower": 1.0,
    "gap-follower:top_speed=4": 2.0,
    "disparity-extender:top_speed=3": 1.0,
}
"""Opponents with their weights."""
COPIES = 4
"""Number of frozen copies among the opponents; a third of the races against opponents have one."""
TASK = {
    "action": "arc",
    "observation": "sectors",
    "rules": "contest",
    "time_step": 0.1,
    "progress_reward": 0.05,
    "rivalry": 0.5,
    "crash_penalty": 2.0,
    "win_reward": 1.0,
    "autoreset_mode": "SAME_STEP",
}
STEPS, MINIBATCH, EPOCHS, WARM, FREEZE = 32, 8192, 4, 10, 40
"""Actions of a car in an update, actions of a step, passes; first updates from a planner, of the
critic alone; updates between two frozen copies.
"""
GAMMA, LAMBDA, CLIP, ENTROPY, RATE = 0.99, 0.95, 0.2, 0.002, 1e-3
KL, MAX_KL, MAX_RATE, KEPT = 0.01, 0.04, 2e-3, 0.9
"""Divergence that the learning rate aims at, divergence that ends an update, max learning rate;
share of the averaged weights that an update keeps.
"""
GENTLE = 0.004, 2e-4, 0.0
"""Divergence, first rate and entropy bonus of a training that starts from a planner."""
SIZES = (230, 128, 128, 2)
"""Sizes of the actor's layers, as in `lidar-ppo`."""
SPREAD, STARTED = (0.3, 0.6), (0.12, 0.25)
"""First standard deviations of turn and push, from nothing and from a planner."""


def layers(*sizes: int) -> nn.Sequential:
    """Return fully connected layers with ReLU between them."""
    parts: list[nn.Module] = []
    for below, above in pairwise(sizes):
        parts += [nn.Linear(below, above), nn.ReLU()]
        nn.init.orthogonal_(parts[-2].weight, 2.0**0.5 if above > 2 else 0.01)
    return nn.Sequential(*parts[:-1])


def dense(state: dict[str, Tensor]) -> DenseLayers:
    """Return the numbers of the layers of a state."""
    numbers = [one.numpy() for one in state.values()]
    return DenseLayers(tuple(numbers[::2]), tuple(numbers[1::2]))


class Learner(nn.Module):
    """Actor and critic; a tanh follows the actor's layers."""

    def __init__(self, start: str | None) -> None:
        super().__init__()
        self.actor, self.critic = layers(*SIZES), layers(SIZES[0], 256, 128, 1)
        self.averaged = layers(*SIZES).requires_grad_(False)
        if start:
            found = read_lidar_planner(start)[1]
            numbers = chain.from_iterable(zip(found.weights, found.biases, strict=True))
            tensors = [torch.tensor(one) for one in numbers]
            self.actor.load_state_dict(dict(zip(self.actor.state_dict(), tensors, strict=True)))
        self.averaged.load_state_dict(self.actor.state_dict())
        self.spread = nn.Parameter(torch.tensor(STARTED if start else SPREAD).log())
        self.kl, self.rate, self.entropy = GENTLE if start else (KL, RATE, ENTROPY)

    def logs(self, means: Tensor, actions: Tensor) -> Tensor:
        """Return the log probability densities of actions, shape (N,), up to a constant."""
        far = (actions - means) / self.spread.exp()
        return (-0.5 * far.square() - self.spread).sum(dim=-1)


class Races:
    """Environments of self-play and against opponents, stepped as one."""

    def __init__(self, a: argparse.Namespace, tracks: list[Any], frozen: list[Any]) -> None:
        given = TASK | {"track": tracks, "threads": a.threads}
        share = sum(RIVALS.values()) / 2.0 / COPIES
        rivals = [(share, one) for one in frozen]
        rivals += [(weight, name) for name, weight in RIVALS.items()]
        self.self_play = DriveHeadToHeadVectorEnv(a.envs // 4, **given)
        self.against = DriveVectorEnv(a.envs - 2 * (a.envs // 4), opponent=rivals, **given)
        self.envs = self.self_play, self.against

    def reset(self, seed: int) -> np.ndarray:
        """Begin all races."""
        return np.concatenate([env.reset(seed=seed + k)[0] for k, env in enumerate(self.envs)])

    def step(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return observations, rewards and ends."""
        parts = np.split(actions, [self.self_play.num_envs])
        steps = [env.step(part) for env, part in zip(self.envs, parts, strict=True)]
        seen, rewards, ends, late = (np.concatenate([one[k] for one in steps]) for k in range(4))
        return seen, rewards, ends | late


@torch.no_grad()
def collect(learner: Learner, races: Races, seen: np.ndarray) -> tuple[dict[str, Tensor], Any]:
    """Drive for `STEPS`; return actions with advantages and returns, and the last observations."""
    steps = []
    for _ in range(STEPS):
        now = torch.from_numpy(seen)
        means = torch.tanh(learner.actor(now))
        actions = means + torch.randn_like(means) * learner.spread.exp()
        log, value = learner.logs(means, actions), learner.critic(now)[:, 0]
        seen, rewards, ends = races.step(actions.numpy())
        ended = torch.from_numpy(rewards).float(), torch.from_numpy(ends).float()
        steps.append((now, actions, log, value, *ended))
    gains, after = [], learner.critic(torch.from_numpy(seen))[:, 0]
    last = torch.zeros(len(seen))
    for *_, value, reward, end in reversed(steps):  # generalised advantage estimation
        last = reward + (1.0 - end) * GAMMA * (after + LAMBDA * last) - value
        after = value
        gains.append(last)
    names = ("seen", "actions", "logs", "values")
    found = {name: torch.cat([step[k] for step in steps]) for k, name in enumerate(names)}
    found["gains"] = torch.cat(gains[::-1])
    found["returns"] = found["gains"] + found.pop("values")
    return found, seen


def update(
    learner: Learner, optimizer: torch.optim.Adam, found: dict[str, Tensor], warm: bool
) -> dict[str, float]:
    """Improve actor and critic by a rollout; return numbers of the last step."""
    gains = found["gains"]
    found["gains"] = (gains - gains.mean()) / (gains.std() + 1e-8)
    passes = (torch.randperm(len(gains)).split(MINIBATCH) for _ in range(EPOCHS))
    for rows in chain.from_iterable(passes):
        some = {key: one[rows] for key, one in found.items()}
        logs = learner.logs(torch.tanh(learner.actor(some["seen"])), some["actions"])
        ratio = (logs - some["logs"]).clamp(-10.0, 10.0)
        kl = float((ratio.exp() - 1.0 - ratio).mean().detach())
        gain, ratio = some["gains"], ratio.exp()
        actor = -torch.min(ratio * gain, ratio.clamp(1 - CLIP, 1 + CLIP) * gain).mean()
        error = (learner.critic(some["seen"])[:, 0] - some["returns"]).square().mean()
        optimizer.zero_grad()
        (0.5 * error + (0.0 if warm else actor - learner.entropy * learner.spread.sum())).backward()
        for part in (learner.actor, learner.critic):
            nn.utils.clip_grad_norm_(part.parameters(), 1.0)
        optimizer.step()
        learner.spread.data.clamp_(-4.0, 0.0)
        if kl > MAX_KL:
            break
    for group in optimizer.param_groups:
        low, high = kl < 0.5 * learner.kl and not warm, kl > 2.0 * learner.kl
        factor = 1.5 if low else 1.0 / 1.5 if high else 1.0
        group["lr"] = min(max(group["lr"] * factor, 1e-5), MAX_RATE)
    slow, fast = learner.averaged.parameters(), learner.actor.parameters()
    for averaged, trained in zip(slow, fast, strict=True):
        averaged.lerp_(trained.detach(), 1.0 - KEPT)
    return {"kl": kl, "rate": group["lr"], "return": float(found["returns"].mean())}


def evaluate(learner: Learner, a: argparse.Namespace) -> dict[str, float]:
    """Race the averaged network; return its score and own crashes against each planner."""
    policy, row = arc_policy(dense(learner.averaged.state_dict())), {}
    for rival in TESTS:
        found = []
        for track in map(load_track, a.tests):
            result = run_races(track, [policy] * a.races, rival, "contest", threads=a.threads)
            won = np.where(result.winner == -1, 0.5, result.winner == 0)
            found.append([won.mean(), result.own_crash[:, 0].mean()])
        row[rival], row[f"{rival} own crashes"] = np.mean(found, axis=0).round(4).tolist()
    return row


def draw(file: Path) -> None:
    """Draw the curves of the csv file."""
    rows = np.genfromtxt(file, delimiter=",", names=True, deletechars="", replace_space=" ")
    rows, figure = np.atleast_1d(rows), Figure(figsize=(9, 4), layout="constrained")
    for axes, kind in zip(figure.subplots(1, 2), ("", " own crashes"), strict=True):
        for rival in TESTS:
            axes.plot(rows["actions"] / 1e6, rows[rival + kind], label=rival)
        axes.set(xlabel="actions, millions", ylabel=kind.strip() or "score", ylim=(0, 1))
        axes.legend()
    figure.savefig(file.with_suffix(".png"), dpi=120)


class Run:
    """Training in a folder; it goes on from the folder's checkpoint."""

    def __init__(self, a: argparse.Namespace) -> None:
        self.a, self.file = a, a.out / "checkpoint.pt"
        self.learner = Learner(a.start)
        a.out.mkdir(parents=True, exist_ok=True)
        self.optimizer = torch.optim.Adam(self.learner.parameters(), self.learner.rate, eps=1e-5)
        self.frozen = [
            {key: one.clone() for key, one in self.learner.averaged.state_dict().items()}
        ] * COPIES
        self.counts: dict[str, float] = {"updates": 0, "actions": 0, "best": -1e9, "seconds": 0.0}
        if self.file.exists():
            try:
                saved = torch.load(self.file, weights_only=True)
                self.learner.load_state_dict(saved["learner"])
                self.optimizer.load_state_dict(saved["optimizer"])
                self.frozen, self.counts = saved["frozen"], saved["counts"]
            except Exception:  # any error of torch: a damaged file, or another script's
                raise SystemExit(f"error: {self.file} is no checkpoint of this script") from None
            print(f"goes on after {self.counts['actions']:,} actions", flush=True)

    def report(self, writer: SummaryWriter) -> None:
        """Evaluate; save curves, weights and the checkpoint."""
        row, counts, a = evaluate(self.learner, self.a), self.counts, self.a
        found = float(np.mean([row[one] - row[f"{one} own crashes"] for one in TESTS]))
        cells = "  ".join(
            f"{one} {row[one]:.3f} ({row[f'{one} own crashes']:.3f})" for one in TESTS
        )
        print(f"{counts['seconds'] / 60:6.1f} min {counts['actions']:12,}  {cells}", flush=True)
        line = {key: round(counts[key]) for key in ("seconds", "actions")} | row
        with (a.out / "curves.csv").open("a", newline="") as file:
            if file.tell() == 0:
                csv.DictWriter(file, line).writeheader()
            csv.DictWriter(file, line).writerow(line)
        for key, value in row.items():
            writer.add_scalar(f"races/{key}", value, counts["actions"])
        draw(a.out / "curves.csv")
        about = {key: counts[key] for key in ("actions", "updates")} | {"seed": a.seed}
        for folder in ("last", "best")[: 1 + (found > counts["best"])]:
            network = dense(self.learner.averaged.state_dict())
            save_lidar_planner(a.out / folder, network, name="lidar-ppo", training=about)
        counts["best"] = max(found, counts["best"])
        state = {"learner": self.learner.state_dict(), "optimizer": self.optimizer.state_dict()}
        new = self.file.with_suffix(".new")  # the checkpoint is whole or the last one
        torch.save(state | {"frozen": self.frozen, "counts": counts}, new)
        new.replace(self.file)

    def train(self) -> None:
        """Train until the time is over."""
        a, counts = self.a, self.counts
        tracks = [load_track(name) for name in a.tracks]
        drawn = RandomCircuits(longest=300.0)
        tracks += [find_speeds(random_circuit(drawn, k)) for k in range(a.random)]
        copies = [arc_policy(dense(one), name=f"copy {k}") for k, one in enumerate(self.frozen)]
        races = Races(a, tracks, copies)
        writer = SummaryWriter(a.out / "events")
        torch.manual_seed(a.seed + int(counts["updates"]))
        seen, reported = races.reset(a.seed + int(counts["updates"])), -1e9
        while counts["seconds"] < 60.0 * a.minutes:
            if counts["seconds"] - reported >= 60.0 * a.every:
                reported = counts["seconds"]
                self.report(writer)
            began = time.monotonic()
            found, seen = collect(self.learner, races, seen)
            warm = a.start is not None and counts["updates"] < WARM
            means = update(self.learner, self.optimizer, found, warm)
            counts["updates"] += 1
            counts["actions"] += len(found["actions"])
            counts["seconds"] += time.monotonic() - began
            means["per second"] = len(found["actions"]) / (time.monotonic() - began)
            for key, value in means.items():
                writer.add_scalar(f"updates/{key}", value, counts["actions"])
            if counts["updates"] % FREEZE == 0:
                k = int(counts["updates"]) // FREEZE % COPIES
                averaged = self.learner.averaged.state_dict()
                self.frozen[k] = {key: one.clone() for key, one in averaged.items()}
                races.against.set_opponent(k, arc_policy(dense(self.frozen[k])))
        self.report(writer)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("--out", type=Path, default=Path("out/train_lidar_ppo"), help="folder of all files")
    add("--minutes", type=float, default=60.0, help="time of learning, earlier calls included")
    add("--every", type=float, default=5.0, help="minutes between evaluations")
    add("--envs", type=int, default=1024, help="cars that learn, a multiple of 8")
    add("--threads", type=int, default=2, help="threads of the races and of torch")
    add("--tracks", nargs="+", default=TRACKS, help="circuits to learn on")
    add("--random", type=int, default=40, help="random circuits in addition")
    add("--tests", nargs="+", default=HELD_OUT, help="circuits of the evaluations")
    add("--races", type=int, default=40, help="races of a test, for each circuit and planner")
    add("--start", help="lidar planner to start from, such as lidar-ppo (default: nothing)")
    add("--seed", type=int, default=0, help="seed of all random numbers")
    a = parser.parse_args()
    for name, least in {"envs": 8, "threads": 1, "races": 1, "random": 0, "minutes": 0.0}.items():
        if not getattr(a, name) >= least or (name == "envs" and a.envs % 8):
            more = ", a multiple of 8" if name == "envs" else ""
            parser.error(f"--{name} is {getattr(a, name)}; it must be at least {least}{more}")
    torch.set_num_threads(a.threads)
    try:
        Run(a).train()
    except (InputError, OSError) as error:
        raise SystemExit(f"error: {error}") from None


if __name__ == "__main__":
    main()
