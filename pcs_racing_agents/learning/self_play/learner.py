"""Single deep CFR (Steinberger 2019) with external sampling on branched games.

In iteration t both cars play regret matching on the advantages that the network of iteration t - 1 predicts. At every
step of many games all moves of one car are tried with the same noise, and how much better each is than the strategy
itself is a row. After each iteration a network is fitted to the rows of all iterations, in which iteration t has
weight t (linear CFR, Brown and Sandholm 2019): it predicts the mean counterfactual regret of every move.

No player knows the noise, the start line or the opponent's policy: rows hold observations alone, and what follows a
branch is played from observations, too. The strategy to play is the average of the iterations, in which each has the
weight t and its own probability of coming to the situation: one iteration's network is drawn for each game, and
:class:`pcs_racing_agents.agents.mixture.Mixture` turns that draw into probabilities of moves.
"""

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.errors import InputError
from pcs_racing.base.seeds import race_seeds
from pcs_racing.base.settings import choice, number, setting, whole
from pcs_racing.game.identity import GameIdentity
from pcs_racing_agents.jobs.chunks import Arrays
from pcs_racing_agents.jobs.configuration import load_config
from pcs_racing_agents.jobs.jobs import Job
from pcs_racing_agents.jobs.progress import Progress
from pcs_racing_agents.learning.responses.kept_networks import merge_networks, train_kept
from pcs_racing_agents.learning.responses.learner import LearnerSettings
from pcs_racing_agents.networks import NetworkSet, RegretNetwork, Rows, join_rows
from pcs_racing_agents.networks.settings import TrainSettings

WEIGHTS = ("linear", "uniform")
"""Weight of iteration t in regrets and in the average strategy: t (linear CFR), or 1 (vanilla CFR, as in the paper)."""


@dataclass(frozen=True)
class SelfPlaySettings(LearnerSettings):
    """Settings of the training in self-play."""

    iterations: int = setting(16, whole(1, 63), "Iterations of CFR; after each the network is fitted to all rows.")
    starts: int = setting(
        512, whole(4, 1_000_000), "Games branched in each iteration, at every step and on each circuit."
    )
    exploration: float = setting(
        0.1,
        number(0.0, 1.0),
        "Probability of a uniformly random move in place of one by regret matching, for both cars.",
    )
    weights: str = setting(
        "linear",
        choice(WEIGHTS),
        "Weight of iteration t in the regrets and in the average strategy: t (linear), or 1 (uniform).",
    )
    members: int = setting(1, whole(1, 32), "Networks fitted in each iteration; their mean is used.")
    seed: int = setting(0, whole(0, 2**50), "Seed of the games and of the networks.")

    def iteration_weight(self, iteration: int) -> float:
        """Return the weight of an iteration, counted from 1."""
        return float(iteration) if self.weights == "linear" else 1.0

    def train_settings(self, iteration: int, member: int) -> TrainSettings:
        """Return the settings of a network of an iteration, counted from 1."""
        return self.fit_settings((self.seed * 64 + iteration) * 32 + member)


def load_self_play_settings(source: str | Path | SelfPlaySettings | None = None, **changes: Any) -> SelfPlaySettings:
    """Return settings from a name, a YAML file or settings, with some fields changed; see :func:`load_config`."""
    return load_config("self-play", SelfPlaySettings(), source, **changes)


BLOCK = 256
"""Games branched in one task: about a second of work."""


class Arena(Protocol):
    """A game that can be branched, the protocol of what self-play learns in."""

    @property
    def identity(self) -> GameIdentity:
        """The game that the network learns; several arenas, such as circuits, may be one game."""

    @property
    def steps(self) -> int:
        """Number of moves that each player makes."""

    def traverse(
        self, network: RegretNetwork | None, exploration: float, step: int, keys: NDArray[np.uint64]
    ) -> Arrays:
        """Play games up to a step, and try all moves of one player in each.

        Parameters
        ----------
        network : RegretNetwork or None
            Advantages by which both players do regret matching; None for uniformly random moves.
        exploration : float
            Probability of a random move in place of one by regret matching.
        keys : ndarray, shape (B,)
            Of the games: everything that is drawn depends on them alone.

        Returns
        -------
        dict of ndarray
            ``observations`` (R, D) of the player; ``advantages`` (R, A), the value of each move minus that of the
            strategy; ``game`` (R,), the number of the key.
        """


class _TraversalTask(NamedTuple):
    """The games of one task."""

    arena: int
    step: int
    iteration: int
    first: int  #: ``first``, ``last``: Numbers of the games.
    last: int
    root: int  #: Seed of all games of this arena, step and iteration.


def learn_self_play(
    arenas: Sequence[Arena],
    settings: SelfPlaySettings,
    job: Job,
    *,
    name: str = "self-play",
    executor: Executor | None = None,
    progress: Progress | None = None,
) -> NetworkSet:
    """Learn a strategy for both cars by counterfactual regret minimisation in self-play.

    Parameters
    ----------
    arenas : sequence of Arena
        One for each circuit (:class:`pcs_racing_agents.learning.self_play.RaceArena`), all of one game; they share
        one network.
    job : Job
        Stores rows and networks, so that a stopped run can be resumed.

    Returns
    -------
    NetworkSet
        A network of advantages for each iteration, to be played by regret matching, with the weights of the average
        strategy. The last one was fitted to the rows of all iterations: it predicts the mean counterfactual regrets.
    """
    if len(arenas) == 0:
        raise InputError("there is no arena to learn in; give at least one")
    identity, steps = arenas[0].identity, arenas[0].steps
    for i, arena in enumerate(arenas):
        if arena.identity != identity or arena.steps != steps:
            raise InputError(f"arena {i} is another game than arena 0; all must have one archive and one set of rules")
    rows: list[Rows] = []
    networks: list[RegretNetwork] = []
    for iteration in range(1, settings.iterations + 1):
        place = f"iteration-{iteration}"
        tasks = list(_tasks(len(arenas), steps, settings, iteration))
        work = partial(_traverse, arenas, networks[-1] if networks else None, settings.exploration)
        results = job.run(place, work, tasks, executor=executor, progress=progress)
        weight = settings.iteration_weight(iteration)
        rows += [
            _rows(arrays, task, weight) for arrays, task in zip(results, tasks, strict=True) if len(arrays["game"])
        ]
        members = [settings.train_settings(iteration, member) for member in range(settings.members)]
        fitted = train_kept(job, f"{place}-networks", join_rows(rows), identity, members, place, executor)
        networks.append(merge_networks(fitted, place))
    # The network of iteration t is the strategy of iteration t + 1; that of the first, random moves, is left out.
    weights = [settings.iteration_weight(iteration + 2) for iteration in range(settings.iterations)]
    facts: dict[str, str | int | float | bool] = {
        "rows": sum(map(len, rows)),
        "iterations": settings.iterations,
        "starts": settings.starts,
        "exploration": settings.exploration,
        "weights": settings.weights,
        "worth": settings.worth,
        "seed": settings.seed,
    }
    return NetworkSet(name, tuple(networks), np.array(weights), "regret-matching", facts)


def _tasks(arenas: int, steps: int, settings: SelfPlaySettings, iteration: int) -> list[_TraversalTask]:
    tasks = []
    for arena in range(arenas):
        for step in range(steps):
            spawn = np.random.SeedSequence(settings.seed, spawn_key=(arena, step, iteration))
            root = int(spawn.generate_state(1, np.uint64)[0] >> np.uint64(1))
            for first in range(0, settings.starts, BLOCK):
                last = min(first + BLOCK, settings.starts)
                tasks.append(_TraversalTask(arena, step, iteration, first, last, root))
    return tasks


def _traverse(
    arenas: Sequence[Arena], network: RegretNetwork | None, exploration: float, task: _TraversalTask
) -> Arrays:
    keys = race_seeds(task.root, task.last)[task.first :]
    return arenas[task.arena].traverse(network, exploration, task.step, keys)


def _rows(arrays: Arrays, task: _TraversalTask, weight: float) -> Rows:
    count = len(arrays["game"])
    # A number of its own for each game: its row is either learned from or validated on.
    offset = ((task.iteration * 100 + task.step) * 1000 + task.arena) * 1_000_000
    return Rows(
        observations=arrays["observations"],
        targets=arrays["advantages"].astype(np.float32),
        weights=np.full(count, weight),
        pair=offset + task.first + arrays["game"],
        step=np.full(count, task.step),
    )
