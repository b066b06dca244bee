"""Branched games: at one step every move is tried, against the same opponent with the same noise.

With common random numbers the noise of a difference between two moves is small: far fewer games are
needed than with separate games for each move.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple, Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.errors import InputError
from pcs_racing.base.seeds import race_seeds, signed_seed
from pcs_racing.game.identity import GameIdentity
from pcs_racing.game.players import Competitor, ask_moves
from pcs_racing.game.rules import RaceGame
from pcs_racing.game.state import GameState, take_games
from pcs_racing.planners.planner import PolicySet
from pcs_racing_agents.base.jobs import Arrays, Job, Workers
from pcs_racing_agents.networks import Rows

PAYOFFS = ("win", "utility")
"""Payoffs of a game: 1 for a win, 0.5 for a tie and 0 otherwise ("win"), or the utility."""

BLOCK = 256
"""Number of branched games in one task, about a second of work."""


class GameBlock(NamedTuple):
    """Branched games of one task, with all random draws."""

    place: tuple[int, ...]  #: Indices of track, opponent (if any), step and round of the games.
    first: int  #: Number of the first game.
    keys: NDArray[np.uint64]  #: Keys of the games.


def game_blocks(seed: int, place: tuple[int, ...], count: int) -> list[GameBlock]:
    """Return ``count`` games in blocks; a game depends only on seed, place and its number."""
    keys = race_seeds(signed_seed(np.random.SeedSequence(seed, spawn_key=place)), count)
    return [GameBlock(place, k, keys[k : k + BLOCK]) for k in range(0, count, BLOCK)]


def branched_rows(
    job: Job,
    part: str,
    branch: Callable[[GameBlock], Arrays],
    blocks: Sequence[GameBlock],
    weight: float = 1.0,
    **workers: Unpack[Workers],
) -> list[Rows]:
    """Return the training rows of blocks of games, stored in a job.

    ``branch`` returns ``observations``, ``advantages`` and the index ``game`` in the block of the
    games that were running at the step.
    """
    rows = []
    for arrays, block in zip(job.run(part, branch, blocks, **workers), blocks, strict=True):
        count = len(arrays["game"])
        if count:
            track, *opponent, step, round_ = block.place
            place = (round_ * 100 + step) * 1000 + (50 * track + opponent[0] if opponent else track)
            rows.append(
                Rows(
                    observations=arrays["observations"],
                    targets=arrays["advantages"].astype(np.float32),
                    weights=np.full(count, weight),
                    # A number of each game: its row belongs to training or to validation.
                    pair=place * 1_000_000 + block.first + arrays["game"],
                    step=np.full(count, step),
                )
            )
    return rows


def common_identity(games: Sequence[RaceGame]) -> GameIdentity:
    """Return the identity of games that must have one archive and one set of rules."""
    if len(games) == 0:
        raise InputError("there is no game to learn; give at least one")
    identity = games[0].identity
    for game in games:
        if game.identity != identity:
            raise InputError(
                f"the game on {game.track.name!r} differs from the first in archive, moves or rules"
            )
    return identity


class _Branches(NamedTuple):
    """Outcomes of every move in R games that were running at the branching step."""

    observations: NDArray[np.float32]  #: shape (R, D): Observations of car 0.
    outcomes: NDArray[np.float64]  #: shape (R, A): Payoff of the game for car 0 after each move.
    game: NDArray[np.int64]  #: shape (R,): Index of the game; games that ended earlier are absent.


def outcome(game: RaceGame, state: GameState, payoff: str = "win") -> NDArray[np.float64]:
    """Return the payoff of finished games for car 0, shape (B,)."""
    if payoff == "utility":
        return game.reward(state)[:, 0]
    winner = game.winner(state)
    tie = np.where(state.race.crashed, 0.0, 0.5)
    return np.where(winner == 0, 1.0, np.where(winner == 1, 0.0, tie))


def branch_games(
    game: RaceGame,
    opponent: Competitor,
    keys: ArrayLike,
    step: int,
    behaviours: Sequence[Competitor],
    continuation: Competitor,
    payoff: str = "win",
    count: int | None = None,
) -> _Branches:
    """Play games up to a step, branch them into all moves, and play all branches to their end.

    Parameters
    ----------
    opponent : Competitor
        Competitor in car 1. For a planner, the game's key selects the policy.
    keys : array of int, shape (B,)
        Keys of the games (:func:`pcs_racing.base.seeds.race_seeds`), determining starts, policies
        and noise.
    step : int
        Number of moves before the branching, 0 to ``moves - 1``.
    behaviours : sequence of Competitor
        Competitors in car 0 before the branching, assigned to the games cyclically.
    continuation : Competitor
        Competitor in car 0 after the branching.
    payoff : {"win", "utility"}
        Payoff of a game.
    count : int, optional
        Number of moves to try, starting with the first; by default all.
    """
    numbers = np.asarray(keys, np.uint64)
    policies = None
    if isinstance(opponent, PolicySet):
        # By key, not by game number: a block must not depend on the rest of the batch.
        policies = [
            opponent.policies[int(key % np.uint64(len(opponent.policies)))] for key in numbers
        ]
    state = game.reset(numbers, opponents=policies)
    behaviour_of = np.arange(state.games) % len(behaviours)
    for _ in range(step):
        moves = np.zeros(state.games, np.int64)
        for i, behaviour in enumerate(behaviours):
            rows = np.flatnonzero(behaviour_of == i)
            moves[rows] = ask_moves(behaviour, game, take_games(state, rows), 0)
        state = game.step(state, np.stack([moves, ask_moves(opponent, game, state, 1)], axis=1))
    running = np.flatnonzero(~game.done(state))
    count = game.offered if count is None else count
    state = take_games(state, running)
    observations = game.observation(state)[:, 0]
    # The opponent moves simultaneously, without knowing the branch: one query serves all branches.
    opponent_moves = ask_moves(opponent, game, state, 1)
    rows, moves, branch = _different_branches(game, state, count)
    state = take_games(state, rows)
    state = game.step(state, np.stack([moves, opponent_moves[rows]], axis=1))
    while not game.done(state).all():
        moves = ask_moves(continuation, game, state, 0)
        state = game.step(state, np.stack([moves, ask_moves(opponent, game, state, 1)], axis=1))
    return _Branches(observations, outcome(game, state, payoff)[branch], running)


def _different_branches(
    game: RaceGame, state: GameState, count: int
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Return the branches to simulate: the first of all moves of car 0 to the same policy.

    The other branches would be bit-identical races: a game continues from the state of the cars and
    their policies, without a record of the moves.

    Returns
    -------
    rows, moves : ndarray, shape (N,)
        Game and move of each branch.
    branch : ndarray, shape (R, count)
        Index of the branch of each game after each move.
    """
    after = game.table[state.policy[:, :1], np.arange(count)]
    first = np.argmax(after[:, :, None] == after[:, None, :], axis=2)
    driven = first == np.arange(count)
    rows, moves = np.nonzero(driven)
    number = np.cumsum(driven).reshape(driven.shape) - 1
    return rows, moves, np.take_along_axis(number, first, axis=1)
