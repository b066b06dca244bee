"""Learned responses: approximate best responses to a pool, by backward induction on branched games.

At the last step every move is tried in games against the pool, and a network learns the advantage
of each move from the observation. The step before follows in the same way; there this network makes
the later moves. The induction ends at the first step. This is fitted Q-iteration (Ernst et al.
2005) over a finite horizon with one pass per round, on advantages with a variance reduced by common
random numbers. Observations contain nothing about the track, so the network works on any track.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Unpack

import numpy as np
from annotated_types import Interval

from pcs_racing.base.errors import InputError
from pcs_racing.base.settings import Layers, OneOf, Settings
from pcs_racing.game.identity import game_identity
from pcs_racing.game.players import Competitor, random_moves
from pcs_racing.game.rules import RaceGame
from pcs_racing_agents.agents.from_network import network_agent
from pcs_racing_agents.agents.game_spec import GameSpec
from pcs_racing_agents.base.chunks import Arrays
from pcs_racing_agents.base.configurations import load_config
from pcs_racing_agents.base.jobs import Job, Workers
from pcs_racing_agents.learning.responses.branches import (
    PAYOFFS,
    GameBlock,
    block_rows,
    branch_games,
    game_blocks,
)
from pcs_racing_agents.learning.responses.kept_networks import merge_networks, train_kept
from pcs_racing_agents.networks import RegretNetwork, Rows, join_rows
from pcs_racing_agents.networks.network_files import check_weights
from pcs_racing_agents.networks.settings import TrainSettings
from pcs_racing_agents.tournament.games import game_between

ROWS_PER_EPOCH = 50_000


@dataclass(frozen=True)
class LearnerSettings(Settings):
    """Settings of the payoff of branched games and of network training."""

    # The name of this option is in the files of shipped networks.
    worth: Annotated[
        str, OneOf(PAYOFFS), "Payoff of a game: a race won, or the game's utility."
    ] = "win"
    hidden: Annotated[Layers, "Units of each hidden layer of a network."] = (64, 64)
    learning_rate: Annotated[
        float, Interval(ge=1e-8, le=10.0), "Initial learning rate of Adam."
    ] = 3e-3
    weight_decay: Annotated[float, Interval(ge=0.0, le=10.0), "Weight decay of AdamW."] = 1e-3
    batch_size: Annotated[
        int, Interval(ge=1, le=1_000_000), "Rows in the batch of a gradient step."
    ] = 512
    epochs: Annotated[int, Interval(ge=1, le=100_000), "Maximum number of epochs."] = 60
    patience: Annotated[
        int,
        Interval(ge=1, le=100_000),
        "Epochs without a lower validation loss after which training stops.",
    ] = 12

    def fit_settings(self, seed: int) -> TrainSettings:
        """Return the settings of one network's training."""
        return TrainSettings(
            hidden=self.hidden,
            learning_rate=self.learning_rate,
            weight_decay=self.weight_decay,
            batch_size=self.batch_size,
            epochs=self.epochs,
            patience=self.patience,
            rows_per_epoch=ROWS_PER_EPOCH,
            seed=seed,
        )


@dataclass(frozen=True)
class ResponseSettings(LearnerSettings):
    """Settings of response training."""

    starts: Annotated[
        int,
        Interval(ge=4, le=1_000_000),
        "Games branched at every step of a round, on each circuit: against each opponent of the"
        " pool or, where the opponents have shares, against all of them together.",
    ] = 1024
    rounds: Annotated[
        int,
        Interval(ge=1, le=20),
        "Passes from the last step to the first. In the first pass, games reach a step by random"
        " moves; in later passes, every other game reaches it by the moves of the current network.",
    ] = 2
    members: Annotated[
        int, Interval(ge=1, le=32), "Networks of the ensemble; the response is their mean."
    ] = 4
    seed: Annotated[int, Interval(ge=0, le=2**57 - 1), "Seed of the games and of the networks."] = 0

    def train_settings(self, member: int) -> TrainSettings:
        """Return the training settings of a member of the ensemble."""
        return self.fit_settings(self.seed * 64 + member)


def load_response_settings(
    source: str | Path | ResponseSettings | None = None, **changes: Any
) -> ResponseSettings:
    """Return settings from a name, a YAML file or settings, with changes (:func:`load_config`)."""
    return load_config("response", ResponseSettings(), source, **changes)


def learn_response(
    games: Sequence[RaceGame],
    pool: Sequence[Competitor],
    spec: GameSpec,
    settings: ResponseSettings,
    job: Job,
    *,
    shares: Sequence[float] | None = None,
    name: str = "response",
    part: str = "",
    **workers: Unpack[Workers],
) -> RegretNetwork:
    """Learn the advantage of each move against a pool of opponents.

    Parameters
    ----------
    games : sequence of RaceGame
        Games with equal archive and rules, one on each track.
    shares : sequence of float, optional
        Relative frequency of each opponent, in any unit. By default each opponent is met
        ``settings.starts`` times; with shares, ``settings.starts`` is the total.
    part : str
        Prefix of the names of this work in the job, for jobs that learn several networks.

    Returns
    -------
    RegretNetwork
        Network that predicts advantages over the mean of all moves, in shares of races won (or in
        units of utility).
    """
    if len(games) == 0 or len(pool) == 0:
        raise InputError(
            f"there are {len(games)} games and {len(pool)} opponents; give at least one of each"
        )
    starts = _starts(settings.starts, len(pool), shares)
    identity = game_identity(games[0])
    at_random: Competitor = random_moves(games[0], seed=settings.seed)
    played = [[game_between(game, at_random, opponent) for opponent in pool] for game in games]
    for game in games:
        if game_identity(game) != identity:
            raise InputError(
                f"the game on {game.track.name!r} differs from the first in archive, moves or rules"
            )
    rows: list[Rows] = []
    network: RegretNetwork | None = None

    def fit(members: int, part_name: str) -> RegretNetwork:
        member_settings = [settings.train_settings(i) for i in range(members)]
        networks = train_kept(
            job,
            f"{part_name}-networks",
            join_rows(rows),
            identity,
            member_settings,
            name,
            workers.get("executor"),
        )
        return merge_networks(networks, name)

    for round_ in range(settings.rounds):
        behaviours = [at_random] if network is None else [at_random, network_agent(network, spec)]
        for step in reversed(range(games[0].config.moves)):
            # In the first pass, branches of the last step have no later moves: the continuation is
            # irrelevant.
            continuation = at_random if network is None else network_agent(network, spec)
            blocks = [
                block
                for i in range(len(games))
                for j, count in enumerate(starts)
                for block in game_blocks(settings.seed, (i, j, step, round_), count)
            ]
            work = partial(
                _branch, played, pool, behaviours, continuation, settings.worth, len(identity.moves)
            )
            part_name = f"{part}round-{round_}-step-{step}"
            branched = job.run(part_name, work, blocks, **workers)
            for arrays, block in zip(branched, blocks, strict=True):
                if len(arrays["game"]):  # some of its games were still running
                    i, j, _, _ = block.place
                    rows.append(
                        block_rows(arrays, block, (round_ * 100 + step) * 1000 + i * 50 + j, step)
                    )
            # Intermediate networks only continue branches; more members would change little.
            last = round_ == settings.rounds - 1 and step == 0
            network = fit(settings.members if last else min(settings.members, 2), part_name)
    assert network is not None
    rest = {key: value for key, value in network.training.items() if key != "rows"}
    summary = {"rows": sum(len(block) for block in rows), "worth": settings.worth, **rest}
    return replace(network, training=summary)


def _starts(total: int, opponents: int, shares: Sequence[float] | None) -> list[int]:
    """Return the number of games against each opponent."""
    if shares is None:
        return [total] * opponents
    weights = check_weights("shares", shares, opponents)
    ends = np.rint(total * np.cumsum(weights) / weights.sum()).astype(int)
    return np.diff(ends, prepend=0).tolist()


def _branch(
    played: Sequence[Sequence[RaceGame]],
    pool: Sequence[Competitor],
    behaviours: Sequence[Competitor],
    continuation: Competitor,
    payoff: str,
    count: int,
    block: GameBlock,
) -> Arrays:
    i, j, step, _ = block.place
    branches = branch_games(
        played[i][j], pool[j], block.keys, step, behaviours, continuation, payoff, count
    )
    # The mean over all moves is the value of the situation, irrelevant for the choice of a move.
    advantages = branches.outcomes - branches.outcomes.mean(axis=1, keepdims=True)
    return {"observations": branches.observations, "advantages": advantages, "game": branches.game}
