"""Branching games: from one moment every move is tried in turn, against the same opponent and with the same noise.

What is the same in all branches of a game cancels in their differences (common random numbers), so the advantage of a
move over another can be seen in far fewer games than by playing each move in games of its own.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.errors import InputError
from pcs_racing.game.competitor import ask_moves
from pcs_racing.game.rules import RaceGame
from pcs_racing.game.state import GameState, take_games
from pcs_racing_agents.agents.agent import Competitor, Driver

__all__ = ["WORTH", "Branches", "branch_games", "outcome"]

WORTH = ("win", "utility")
"""What an outcome is worth: 1 for a race won, 0.5 for a tie and 0 otherwise, or the game's utility."""


class Branches(NamedTuple):
    """What every move led to in some games that were still going on.

    Attributes
    ----------
    observations : ndarray, shape (R, D), float32
        What car 0 saw.
    outcomes : ndarray, shape (R, A)
        What the game was worth to car 0 in the end after each move.
    game : ndarray, shape (R,), int64
        Which of the games it is; those that were over before the moment are absent.
    behaviour : ndarray, shape (R,), int64
        Index of the behaviour that played car 0 until then.
    rival : ndarray, shape (R,), int64
        Policy of car 1 at the moment, which car 0 can only guess; -1 for a driver.
    leads : ndarray, shape (R, A)
        Lead of car 0 when the race ended, m.
    crashed : ndarray, shape (R, A), bool
        Whether it ended in a crash.
    """

    observations: NDArray[np.float32]
    outcomes: NDArray[np.float64]
    game: NDArray[np.int64]
    behaviour: NDArray[np.int64]
    rival: NDArray[np.int64]
    leads: NDArray[np.float64]
    crashed: NDArray[np.bool_]


def outcome(game: RaceGame, state: GameState, worth: str = "win") -> NDArray[np.float64]:
    """What games that are over were worth to car 0, shape (B,).

    Raises
    ------
    InputError
        If ``worth`` is not one of :data:`WORTH`.
    """
    if worth not in WORTH:
        raise InputError(f"worth is {worth!r}; it must be one of {', '.join(WORTH)}")
    if worth == "utility":
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
    worth: str = "win",
    count: int | None = None,
) -> Branches:
    """Play games up to a step, try every move there, and play all branches to their end.

    Parameters
    ----------
    game : RaceGame
    opponent : Competitor
        Of car 1. A driver's policies are taken in turn, by the game's key.
    keys : array of int, shape (B,)
        Keys of the games (:func:`pcs_racing.race_seeds`): they decide starts, policies and noise.
    step : int
        Moves made before the branching, 0 to ``moves - 1``.
    behaviours : sequence of Competitor
        Who plays car 0 until then; taken in turn, game by game.
    continuation : Competitor
        Who plays it afterwards.
    worth : {"win", "utility"}
        What outcomes are worth.
    count : int, optional
        How many of the moves are tried, from the first on; by default all.

    Raises
    ------
    InputError
        If the step is impossible.
    """
    if not 0 <= step < game.config.moves:
        raise InputError(f"step is {step}; it must lie in 0 to {game.config.moves - 1}")
    numbers = np.asarray(keys, np.uint64)
    drivers = None
    if isinstance(opponent, Driver):
        drivers = [opponent.policies[int(key % np.uint64(len(opponent.policies)))] for key in numbers]
    state = game.reset(numbers, opponents=drivers)
    turn = np.arange(state.games) % len(behaviours)
    for _ in range(step):
        moves = np.zeros(state.games, np.int64)
        for i, behaviour in enumerate(behaviours):
            rows = np.flatnonzero(turn == i)
            moves[rows] = ask_moves(behaviour, game, take_games(state, rows), 0)
        state = game.step(state, np.stack([moves, _reply(opponent, game, state)], axis=1))
    going = np.flatnonzero(~game.done(state))
    count = len(game.move_names) if count is None else count
    state = take_games(state, going)
    seen, rival = game.observation(state)[:, 0], state.policy[:, 1].copy()
    reply = _reply(opponent, game, state)
    tried = np.tile(np.arange(count), len(going))
    state = take_games(state, np.repeat(np.arange(len(going)), count))
    state = game.step(state, np.stack([tried, np.repeat(reply, count)], axis=1))
    while not game.done(state).all():
        moves = ask_moves(continuation, game, state, 0)
        state = game.step(state, np.stack([moves, _reply(opponent, game, state)], axis=1))
    shape = len(going), count
    return Branches(
        observations=seen,
        outcomes=outcome(game, state, worth).reshape(shape),
        game=going,
        behaviour=turn[going],
        rival=rival,
        leads=np.asarray(state.race.lead, np.float64).reshape(shape),
        crashed=state.race.crashed.reshape(shape),
    )


def _reply(opponent: Competitor, game: RaceGame, state: GameState) -> NDArray[np.int64]:
    """Moves of car 1; those of a driver do nothing."""
    if isinstance(opponent, Driver):
        return np.zeros(state.games, np.int64)
    return ask_moves(opponent, game, state, 1)
