"""What an answer to opponents needs in the contest: how many games, which inputs, which network.

    python benchmarks/response_ablation.py --starts 768 --out out/ablation

Games are branched at every step and played on by the answer that is shipped. Learners learn from three quarters of them
what to do in the last quarter, in turn; the table says what their moves add to races won over the shipped answer's, and
so what there is left to be learned, and what an answer loses that is not shown the opponent's coordinates, or the lead.
Seeds are other ones than those of any study; a stopped run goes on.
"""

import argparse
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcs_racing import RaceGame, make_game
from pcs_racing.base.seeds import race_seeds
from pcs_racing.game.config import load_game_config
from pcs_racing_agents.agents import Agent, Setting, make_setting
from pcs_racing_agents.agents.blind import never_switch, random_moves
from pcs_racing_agents.agents.from_network import NetworkStrategy
from pcs_racing_agents.jobs.chunks import Arrays
from pcs_racing_agents.jobs.executors import add_executor_options, executor_from
from pcs_racing_agents.jobs.jobs import Job, open_job
from pcs_racing_agents.jobs.progress import show_progress
from pcs_racing_agents.learning.responses import branch_games, load_response_settings
from pcs_racing_agents.networks import RegretNetwork, Rows, load_network
from pcs_racing_agents.networks.settings import TrainSettings
from pcs_racing_agents.networks.training import train_layers
from pcs_racing_agents.tournament.games import game_between

SEED = 9_000_000  # of shares of the games
BRANCH_SEED = 77
RANDOM_SEED = 5  # of random moves
BLOCK = 256
FOLDS = 4
OPPONENTS = ("never-switch", "random-moves")
CIRCUITS = ("Brackwater", "Pipkin", "Tarnfjord")  # two that the shipped answer learned on, and one that it did not

Floats = NDArray[np.float64]


class Options(NamedTuple):
    """What the command line says."""

    archive: str
    starts: int
    circuits: tuple[str, ...]
    members: int


def setting_of(archive: str) -> Setting:
    return make_setting(archive, load_game_config("contest", epsilon=0.5))


def game_on(circuit: str, setting: Setting) -> RaceGame:
    return make_game(circuit, setting.archive, setting.config, threads=1)


def opponent_of(name: str, setting: Setting) -> Agent:
    return {"never-switch": never_switch, "random-moves": random_moves}[name](setting, seed=RANDOM_SEED)


def follow(network: RegretNetwork, setting: Setting) -> Agent:
    return Agent("response", NetworkStrategy(network, "argmax", len(setting.moves)), setting)


# What is left to be learned


@dataclass(frozen=True)
class Data:
    """Branched games of all circuits, opponents and steps, one row each."""

    observations: NDArray[np.float32]
    wins: Floats
    opponent: Floats
    played: NDArray[np.int64]
    place: NDArray[np.int64]

    def take(self, rows: NDArray[Any]) -> "Data":
        """Return some rows."""
        return Data(*(getattr(self, key)[rows] for key in self.__dataclass_fields__))

    def columns(self, *keys: str) -> NDArray[np.int64]:
        """Some of circuit, opponent, step and number of the game, as one number for each combination."""
        names = ("circuit", "opponent", "step", "game")
        picked = self.place[:, [names.index(key) for key in keys]]
        return np.unique(picked, axis=0, return_inverse=True)[1].ravel()


class BranchTask(NamedTuple):
    """Games that are branched together."""

    circuit: str
    opponent: str
    step: int
    first: int
    last: int


def branch(setting: Setting, network: RegretNetwork, task: BranchTask) -> Arrays:
    pilots = [random_moves(setting, seed=RANDOM_SEED), follow(network, setting)]
    opponent = opponent_of(task.opponent, setting)
    arena = game_between(game_on(task.circuit, setting), pilots[0], opponent)
    key = (sum(task.circuit.encode()), OPPONENTS.index(task.opponent), task.step)
    root = int(np.random.SeedSequence(BRANCH_SEED, spawn_key=key).generate_state(1, np.uint64)[0] >> np.uint64(1))
    keys = race_seeds(root, task.last)[task.first :]
    found = branch_games(arena, opponent, keys, task.step, pilots, pilots[1])
    return {**found._asdict(), "game": found.game + task.first}


def branched(options: Options, job: Job, executor: Executor | None) -> tuple[Data, RegretNetwork]:
    setting = setting_of(options.archive)
    network = load_network(f"{options.archive}-contest-gain")
    tasks = [
        BranchTask(circuit, opponent, step, first, min(first + BLOCK, options.starts))
        for circuit in options.circuits
        for opponent in OPPONENTS
        for step in range(setting.config.moves)
        for first in range(0, options.starts, BLOCK)
    ]
    work = partial(branch, setting, network)
    found = job.run("branches", work, tasks, executor=executor, progress=show_progress("branch tasks"))
    points = setting.archive.normalised
    parts = []
    for arrays, task in zip(found, tasks, strict=True):
        where = options.circuits.index(task.circuit), OPPONENTS.index(task.opponent), task.step
        place = [(*where, int(number)) for number in arrays["game"]]
        given = [arrays[key] for key in ("observations", "outcomes")]
        parts.append((*given, points[arrays["opponent_policy"]], arrays["behaviour"], np.reshape(place, (-1, 4))))
    return Data(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True))), network


Learner = Callable[[Data, Data], Floats]
"""From data to learn from and situations, to what each move is worth there."""


def learner(
    members: int,
    *,
    share: float = 1.0,
    apart: Sequence[str] = (),
    sees: str = "",
    unseen: Sequence[int] = (),
    kept: int | None = None,
    **settings: Any,
) -> Learner:
    """Return a learner: networks as those of a response, with one thing changed."""

    def inputs(data: Data) -> NDArray[np.float32]:
        more = {
            "": np.zeros((len(data.wins), 0)),
            "opponent": data.opponent,
            "circuit": np.eye(len(CIRCUITS) + 8)[data.place[:, 0]],
        }[sees]
        shown = np.delete(data.observations, list(unseen), axis=1)
        return np.concatenate([shown, more], axis=1).astype(np.float32)

    def learn(known: Data, asked: Data) -> Floats:
        lot = np.random.default_rng(SEED).random(len(known.wins)) < share
        if kept is not None:
            lot &= known.played == kept
        known = known.take(lot)
        rows = Rows(
            inputs(known),
            known.wins - known.wins.mean(axis=1, keepdims=True),
            np.ones(len(known.wins)),
            np.arange(len(known.wins)),
            known.place[:, 2],
        )
        values = np.zeros(asked.wins.shape)
        for member in range(members):
            like = load_response_settings(**settings).train_settings(member)
            values += predict(rows, like, inputs(asked)) / members
        return values

    def learn_apart(known: Data, asked: Data) -> Floats:
        group = replace(asked, place=np.concatenate([known.place, asked.place])).columns(*apart)
        mine, theirs = group[: len(known.wins)], group[len(known.wins) :]
        values = np.zeros(asked.wins.shape)
        for number in np.unique(theirs):
            values[theirs == number] = learn(known.take(mine == number), asked.take(theirs == number))
        return values

    return learn_apart if apart else learn


def predict(rows: Rows, settings: TrainSettings, inputs: NDArray[np.float32]) -> Floats:
    found = train_layers(rows, settings)
    x, layers = (inputs - found.mean) / found.scale, found.layers
    for weight, bias in zip(layers.weights[:-1], layers.biases[:-1], strict=True):
        x = np.maximum(x @ weight.T + bias, 0.0)
    return np.asarray(x @ layers.weights[-1].T + layers.biases[-1], np.float64)


def learners(members: int, elements: Sequence[str]) -> dict[str, Learner]:
    """The learners that are compared, by name."""
    make = partial(learner, members)

    def without(*beginnings: str) -> list[int]:
        return [i for i, element in enumerate(elements) if element.startswith(beginnings)]

    return {
        "as the response's": make(),
        "without the opponent's coordinates": make(unseen=without("opponent_")),
        "without the lead": make(unseen=without("lead_")),
        "without either": make(unseen=without("opponent_", "lead_")),
        "told the opponent's policy": make(sees="opponent"),
        "told the circuit": make(sees="circuit"),
        "a tenth of the games": make(share=0.1),
        "half": make(share=0.5),
        "one network": learner(1),
        "linear": make(hidden=()),
        "width 16": make(hidden=(16, 16)),
        "a network for each circuit": make(apart=["circuit"]),
        "learns from random moves only": make(kept=0),
        "learns from the answer's games only": make(kept=1),
    }


def crossed(data: Data, learn: Learner) -> Floats:
    """What each move is worth in every situation, as learned from the games of the other folds."""
    fold = data.columns("circuit", "opponent", "step", "game") % FOLDS
    values = np.zeros(data.wins.shape)
    for k in range(FOLDS):
        values[fold == k] = learn(data.take(fold != k), data.take(fold == k))
    return values


def added(data: Data, chosen: NDArray[np.int64], instead: NDArray[np.int64]) -> tuple[float, float]:
    """What moves add to races won over others in games of the answer: summed over the steps; and its standard error."""
    rows = np.arange(len(chosen))
    won = data.wins[rows, chosen] - data.wins[rows, instead]
    group = data.columns("circuit", "opponent")
    gains, variances = [], []
    for g in np.unique(group):
        mine = (group == g) & (data.played == 1)
        counts = np.bincount(data.place[mine, 2])
        # Games that are over before a step gain nothing there.
        gains.append(won[mine].sum() / counts.max())
        parts = [won[mine & (data.place[:, 2] == step)] for step in range(len(counts))]
        variances.append(sum(part.var() * len(part) for part in parts) / counts.max() ** 2)
    return float(np.mean(gains)), float(np.sqrt(np.sum(variances)) / len(variances))


def compare_learners(options: Options, job: Job, executor: Executor | None) -> None:
    data, network = branched(options, job, executor)
    base = network.unclipped(data.observations).argmax(axis=1)
    moves = network.moves
    print(f"{len(base)} situations, {np.mean(data.wins.std(axis=1) == 0):.0%} of them decided whatever the move\n")
    print("| learner | races won over the shipped answer |\n| --- | --- |")
    for i, move in enumerate(moves):
        gain, error = added(data, np.full(len(base), i), base)
        print(f"| (always {move}, then the answer) | {gain:+.3f} +- {error:.3f} |")
    for name, learn in learners(options.members, network.identity.elements).items():
        values = crossed(data, learn)
        gain, error = added(data, values.argmax(axis=1), base)
        print(f"| {name} | {gain:+.3f} +- {error:.3f} |", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0], allow_abbrev=False)
    parser.add_argument("--out", type=Path, required=True, help="folder that keeps what was driven")
    parser.add_argument("--archive", default="contest")
    parser.add_argument("--starts", type=int, default=256, help="games that are branched at a step (default: 256)")
    parser.add_argument("--circuits", nargs="+", default=list(CIRCUITS), help="names or folders")
    parser.add_argument("--members", type=int, default=2, help="networks of a learner (default: 2)")
    add_executor_options(parser)
    given = parser.parse_args()
    options = Options(given.archive, given.starts, tuple(given.circuits), given.members)
    settings = {"archive": options.archive, "starts": options.starts, "circuits": list(options.circuits)}
    with executor_from(given) as executor, open_job(given.out, "response-ablation", settings) as job:
        compare_learners(options, job, executor)


if __name__ == "__main__":
    main()
