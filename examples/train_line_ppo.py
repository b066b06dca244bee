"""Train a network that chooses among the lattice's candidates, by PPO in self-play.

    python examples/train_line_ppo.py --minutes 30
    pcs-racing race --ego out/train_line_ppo/best --replay race.html

One file, in the style of CleanRL. The network begins level with the lattice. Half of the cars race
each other with drawn styles; the other half, in the default style, race planners and frozen copies
of the network. Every few minutes the averaged network races planners on circuits that it does not
learn on; the best one is kept. curves.csv, curves.png and TensorBoard's events show the progress.
The same command goes on after a stop.
"""

import argparse
import csv
import time
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from pcs_racing import InputError, load_track, run_races
from pcs_racing.envs import (
    LineHeadToHeadVectorEnv,
    LineVectorEnv,
    RandomCircuits,
    find_speeds,
    random_circuit,
)
from pcs_racing.planners import network_policy, save_line_planner

try:
    import torch
    from matplotlib.figure import Figure
    from torch import Tensor, nn
    from torch.utils.tensorboard import SummaryWriter

    from pcs_racing_agents import learning
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
TESTS = ("lattice", "iterated-best-response", "pure-pursuit", "gap-follower")
RIVALS = {
    "lattice": 4.0,
    "lattice:early": 1.0,
    "lattice:pace=0.9,pace_behind=0.1": 1.0,
    "lattice:pace=0.3,pace_behind=0.1": 1.0,
    "lattice:blocking=0.9": 1.0,
    "iterated-best-response": 1.5,
    "spliner": 1.0,
    "stanley": 0.5,
    "pure-pursuit": 1.0,
    "pure-pursuit:pace=0.3": 1.0,
    "gap-follower": 1.0,
    "gap-follower:top_speed=3": 1.5,
    "disparity-extender:top_speed=4": 1.0,
}
"""Opponents with their weights; slow ones, too: who never met them hits them."""
COPIES = 6
"""Number of frozen copies among the opponents; half of the races against opponents have one."""
STYLE = {"risk": (0.0, 1.0), "assertiveness": (0.0, 1.0), "pace": (0.8, 1.6)}
"""Range of the drawn styles."""
STEPS, MINIBATCH, EPOCHS, WARM, FREEZE = 32, 8192, 3, 10, 20
"""Choices of a car in an update, choices of a step, passes; first updates, of the critic alone: the
policy is good already; updates between two frozen copies.
"""
GAMMA, LAMBDA, CLIP, ENTROPY, RATE = 0.99, 0.95, 0.2, 0.001, 1e-3
KL, MAX_KL, MAX_RATE, KEPT = 0.002, 0.01, 5e-3, 0.9
"""Divergence that the learning rate aims at, divergence that ends an update, max learning rate;
share of the averaged weights that an update keeps.
"""


class Learner(nn.Module):
    """Actor and critic; the critic sees the situation, the time left and the handicap."""

    def __init__(self) -> None:
        super().__init__()
        self.actor = learning.CandidateNetwork()
        self.averaged = learning.CandidateNetwork().requires_grad_(False)
        self.averaged.load_state_dict(self.actor.state_dict())
        self.critic = nn.Sequential(
            nn.Linear(learning.CandidateNetwork.CONTEXT + 2, 128),
            nn.Tanh(),
            nn.Linear(128, 128),
            nn.Tanh(),
            nn.Linear(128, 1),
        )

    def value(self, seen: Tensor) -> Tensor:
        """Return the values of observations, shape (N,)."""
        context, rest = seen[..., : learning.CandidateNetwork.CONTEXT], seen[..., -2:]
        return self.critic(torch.cat([context, rest], dim=-1))[..., 0]

    def average(self) -> None:
        """Move the averaged actor towards the actor."""
        for slow, fast in zip(self.averaged.parameters(), self.actor.parameters(), strict=True):
            slow.lerp_(fast.detach(), 1.0 - KEPT)


class Races:
    """Environments of self-play and against opponents, stepped as one."""

    def __init__(self, a: argparse.Namespace, tracks: list[Any], frozen: list[Any]) -> None:
        given = {"track": tracks, "autoreset_mode": "SAME_STEP", "threads": a.threads}
        total = sum(RIVALS.values())
        rivals = [(total / COPIES, one) for one in frozen]
        rivals += [(weight, name) for name, weight in RIVALS.items()]
        self.self_play = LineHeadToHeadVectorEnv(a.envs // 4, style=STYLE, **given)
        self.against = LineVectorEnv(a.envs - 2 * (a.envs // 4), opponent=rivals, **given)
        self.envs = self.self_play, self.against
        self.edge = self.self_play.num_envs

    def reset(self, seed: int) -> np.ndarray:
        """Begin all races."""
        return np.concatenate([env.reset(seed=seed + k)[0] for k, env in enumerate(self.envs)])

    def step(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return observations, rewards and ends."""
        steps = [
            env.step(part)
            for env, part in zip(self.envs, np.split(actions, [self.edge]), strict=True)
        ]
        seen, rewards, ends, late = (np.concatenate([one[k] for one in steps]) for k in range(4))
        return seen, rewards, ends | late


@torch.no_grad()
def collect(learner: Learner, races: Races, seen: np.ndarray) -> tuple[dict[str, Tensor], Any]:
    """Drive for `STEPS`; return choices with advantages and returns, and the last observations."""
    steps = []
    for _ in range(STEPS):
        now = torch.from_numpy(seen)
        logs = torch.log_softmax(learner.actor(now), dim=1)
        chosen = (logs - torch.empty_like(logs).exponential_().log()).argmax(dim=1)
        log, value = logs.gather(1, chosen[:, None])[:, 0], learner.value(now)
        seen, rewards, ends = races.step(chosen.numpy())
        ended = torch.from_numpy(rewards).float(), torch.from_numpy(ends).float()
        steps.append((now, chosen, log, value, *ended))
    gains, after, last = [], learner.value(torch.from_numpy(seen)), torch.zeros(len(seen))
    for *_, value, reward, end in reversed(steps):  # generalised advantage estimation
        last = reward + (1.0 - end) * GAMMA * (after + LAMBDA * last) - value
        after = value
        gains.append(last)
    names = ("seen", "chosen", "logs", "values")
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
        logs = torch.log_softmax(learner.actor(some["seen"]), dim=1)
        ratio = logs.gather(1, some["chosen"][:, None])[:, 0] - some["logs"]
        kl = float((ratio.exp() - 1.0 - ratio).mean().detach())
        gain, ratio = some["gains"], ratio.exp()
        actor = -torch.min(ratio * gain, ratio.clamp(1 - CLIP, 1 + CLIP) * gain).mean()
        entropy = -(logs.exp() * logs.clamp_min(-30.0)).sum(dim=1).mean()
        error = (learner.value(some["seen"]) - some["returns"]).square().mean()
        optimizer.zero_grad()
        (0.5 * error + (0.0 if warm else actor - ENTROPY * entropy)).backward()
        for part in (learner.actor, learner.critic):
            nn.utils.clip_grad_norm_(part.parameters(), 1.0)
        optimizer.step()
        if kl > MAX_KL:
            break
    for group in optimizer.param_groups:
        factor = 1.5 if kl < 0.5 * KL and not warm else 1.0 / 1.5 if kl > 2.0 * KL else 1.0
        group["lr"] = min(max(group["lr"] * factor, 1e-5), MAX_RATE)
    learner.average()
    last = {"kl": kl, "entropy": float(entropy.detach()), "error": float(error.detach())}
    return last | {"rate": group["lr"], "return": float(found["returns"].mean())}


def evaluate(learner: Learner, a: argparse.Namespace) -> dict[str, float]:
    """Race the averaged network; return its score and own crashes against each planner."""
    policy, row = network_policy(learner.averaged.tensors()), {}
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
            axes.plot(rows["choices"] / 1e6, rows[rival + kind], label=rival)
        axes.set(xlabel="choices, millions", ylabel=kind.strip() or "score", ylim=(0, 1))
        axes.legend()
    figure.savefig(file.with_suffix(".png"), dpi=120)


class Run:
    """Training in a folder; it goes on from the folder's checkpoint."""

    def __init__(self, a: argparse.Namespace) -> None:
        self.a, self.file = a, a.out / "checkpoint.pt"
        self.learner = Learner()
        if a.start:
            self.learner.actor.load(a.start)
            self.learner.averaged.load(a.start)
        a.out.mkdir(parents=True, exist_ok=True)
        own = [*self.learner.actor.parameters(), *self.learner.critic.parameters()]
        self.optimizer = torch.optim.Adam(own, RATE, eps=1e-5)
        self.frozen = [self.learner.averaged.tensors()] * COPIES
        self.counts: dict[str, float] = {"updates": 0, "choices": 0, "best": -1e9, "seconds": 0.0}
        if self.file.exists():
            try:
                saved = torch.load(self.file, weights_only=True)
                self.learner.load_state_dict(saved["learner"])
                self.optimizer.load_state_dict(saved["optimizer"])
                self.frozen = [
                    {key: one.numpy() for key, one in copy.items()} for copy in saved["frozen"]
                ]
                self.counts = saved["counts"]
            except Exception:  # any error of torch: a damaged file, or another script's
                raise SystemExit(f"error: {self.file} is no checkpoint of this script") from None
            print(f"goes on after {self.counts['choices']:,} choices", flush=True)

    def report(self, writer: SummaryWriter) -> None:
        """Evaluate; save curves, weights and the checkpoint."""
        row, counts, a = evaluate(self.learner, self.a), self.counts, self.a
        scores, crashes = ([row[one + kind] for one in TESTS] for kind in ("", " own crashes"))
        found = float(0.5 * scores[0] + np.mean(scores) - np.mean(crashes))
        curves = a.out / "curves.csv"
        cells = "  ".join(
            f"{one} {row[one]:.3f} ({row[f'{one} own crashes']:.3f})" for one in TESTS
        )
        print(f"{counts['seconds'] / 60:6.1f} min {counts['choices']:12,}  {cells}", flush=True)
        line = {key: round(counts[key]) for key in ("seconds", "choices")} | row
        with curves.open("a", newline="") as file:
            if file.tell() == 0:
                csv.DictWriter(file, line).writeheader()
            csv.DictWriter(file, line).writerow(line)
        for key, value in row.items():
            writer.add_scalar(f"races/{key}", value, counts["choices"])
        draw(curves)
        about = {key: counts[key] for key in ("choices", "updates")} | {"seed": a.seed}
        for folder in ("last", "best")[: 1 + (found > counts["best"])]:
            save_line_planner(a.out / folder, self.learner.averaged.tensors(), training=about)
        counts["best"] = max(found, counts["best"])
        copies = [{key: torch.tensor(one) for key, one in copy.items()} for copy in self.frozen]
        state = {"learner": self.learner.state_dict(), "optimizer": self.optimizer.state_dict()}
        new = self.file.with_suffix(".new")  # the checkpoint is whole or the last one
        torch.save(state | {"frozen": copies, "counts": counts}, new)
        new.replace(self.file)

    def train(self) -> None:
        """Train until the time is over."""
        a, counts = self.a, self.counts
        tracks = [load_track(name) for name in a.tracks]
        drawn = RandomCircuits(longest=300.0)
        tracks += [find_speeds(random_circuit(drawn, k)) for k in range(a.random)]
        policies = [network_policy(one, name=f"copy {k}") for k, one in enumerate(self.frozen)]
        races, writer = Races(a, tracks, policies), SummaryWriter(a.out / "events")
        torch.manual_seed(a.seed + int(counts["updates"]))
        seen, reported = races.reset(a.seed + int(counts["updates"])), -1e9
        while counts["seconds"] < 60.0 * a.minutes:
            if counts["seconds"] - reported >= 60.0 * a.every:
                reported = counts["seconds"]
                self.report(writer)
            began = time.monotonic()
            found, seen = collect(self.learner, races, seen)
            warm = counts["updates"] < WARM
            means = update(self.learner, self.optimizer, found, warm)
            counts["updates"] += 1
            counts["choices"] += len(found["chosen"])
            counts["seconds"] += time.monotonic() - began
            means["per second"] = len(found["chosen"]) / (time.monotonic() - began)
            for key, value in means.items():
                writer.add_scalar(f"updates/{key}", value, counts["choices"])
            if counts["updates"] % FREEZE == 0:
                k = int(counts["updates"]) // FREEZE % COPIES
                self.frozen[k] = self.learner.averaged.tensors()
                races.against.set_opponent(k, network_policy(self.frozen[k], name=f"copy {k}"))
        self.report(writer)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("--out", type=Path, default=Path("out/train_line_ppo"), help="folder of all files")
    add("--minutes", type=float, default=30.0, help="time of learning, earlier calls included")
    add("--every", type=float, default=5.0, help="minutes between evaluations")
    add("--envs", type=int, default=2048, help="cars that learn, a multiple of 8")
    add("--threads", type=int, default=2, help="threads of the races and of torch")
    add("--tracks", nargs="+", default=TRACKS, help="circuits to learn on")
    add("--random", type=int, default=40, help="random circuits in addition")
    add("--tests", nargs="+", default=HELD_OUT, help="circuits of the evaluations")
    add("--races", type=int, default=40, help="races of a test, for each circuit and planner")
    add("--start", help="line planner to start from, such as line-ppo (default: the lattice)")
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
