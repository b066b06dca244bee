"""Many duels side by side: what the scalar and the vector environment of the strategy level share."""

import copy
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.errors import InputError
from pcs_racing.envs.drive_batch import check_batch
from pcs_racing.envs.opponents import NEVER_SWITCH, Opponent, as_array, checked_move, choose, parse_opponents
from pcs_racing.game.archive import PolicyArchive
from pcs_racing.game.archive_files import load_archive
from pcs_racing.game.config import GameConfig
from pcs_racing.game.game import RaceGame, make_game, with_opponent
from pcs_racing.game.state import GameState, put_games
from pcs_racing.planners.planner import Policy
from pcs_racing.planners.registry import get_planner
from pcs_racing.race.config import RaceConfig
from pcs_racing.track.track import Track

__all__ = ["DuelBatch"]

CRASHES = np.array(["", "wall", "car"])


class DuelBatch:
    """A number of games side by side; car 0 belongs to the agent, car 1 to an opponent or to a second agent.

    Parameters
    ----------
    games : int
        How many.
    track, archive, race, **settings
        As in :func:`pcs_racing.game.game.make_game`.
    opponent : see :func:`pcs_racing.envs.opponents.parse_opponents`
        None where a second agent moves car 1.
    deterministic_opponent : bool
        Whether trained models take their best move or draw one.
    threads : int, optional
        Threads that share a step.

    Attributes
    ----------
    game : RaceGame
    state : GameState or None
        None before the first `restart`.
    seen : ndarray, shape (games, 2, D)
        What both players see.
    """

    def __init__(
        self,
        games: int,
        *,
        track: Track | str | Path,
        archive: PolicyArchive | str | Path,
        opponent: Any,
        race: GameConfig | RaceConfig | str | Path,
        deterministic_opponent: bool = True,
        threads: int | None = None,
        **settings: Any,
    ) -> None:
        check_batch(games, threads)
        self.games = int(games)
        game = make_game(track, load_archive(archive), race, threads=threads, **settings)
        self.opponents = [] if opponent is None else parse_opponents(opponent, game.move_names)
        self.game = _with_planner(game, self.opponents)
        weights = np.array([one.weight for one in self.opponents] or [1.0])
        self._until = np.cumsum(weights) / weights.sum()
        self._deterministic = deterministic_opponent
        elements = self.game.observation_elements
        self.low = np.array([element.low for element in elements], np.float32)
        self.high = np.array([element.high for element in elements], np.float32)
        self.state: GameState | None = None
        self.seen = np.zeros((self.games, 2, len(elements)), np.float32)
        self.chosen = np.zeros(self.games, np.int64)
        self.moves = np.full((self.games, 2), -1, np.int64)
        self.memories: list[Any] = [None] * self.games

    def restart(self, rows: NDArray[np.int64], rngs: Sequence[np.random.Generator]) -> None:
        """Begin new games in some places, each drawn from its own generator."""
        keys = np.array([rng.integers(2**63) for rng in rngs], np.uint64)
        drivers: list[Policy | None] = []
        for row, rng in zip(rows, rngs, strict=True):
            driver: Policy | str | None = None
            if self.opponents:
                self.chosen[row] = min(int(np.searchsorted(self._until, rng.random(), "right")), len(self._until) - 1)
                driver = self.opponents[self.chosen[row]].driver
            if driver == NEVER_SWITCH:
                driver = self.game.archive.policy(int(rng.integers(len(self.game.archive))))
            drivers.append(driver)  # type: ignore[arg-type]
            self.memories[row] = None
        fresh = self.game.reset(keys, opponents=drivers)
        if self.state is None:
            self.state = fresh
        else:
            put_games(self.state, rows, fresh)
        self.moves[rows] = -1
        self.seen = self.game.observation(self.state)

    def check_actions(self, actions: ArrayLike, players: int) -> NDArray[np.int64]:
        """Return moves as (games, players), or say what is wrong with them, and where."""
        names = self.game.move_names
        moves = as_array(actions)
        if moves.size != self.games * players or moves.dtype.kind not in "iu":
            raise InputError(
                f"actions {actions!r:.60} have shape {moves.shape} and type {moves.dtype}; they must be "
                f"{self.games * players} whole numbers from 0 to {len(names) - 1}"
            )
        moves = moves.reshape(-1).astype(np.int64)
        wrong = np.flatnonzero((moves < 0) | (moves >= len(names)))
        if len(wrong):
            where = f"action of environment {wrong[0]}" if len(moves) > 1 else "action"
            raise InputError(
                f"{where} is {moves[wrong[0]]}; it must be from 0 to {len(names) - 1} ({', '.join(names)})"
            )
        return moves.reshape(self.games, players)

    def started(self) -> GameState:
        """Return the state, or say that there is none yet."""
        if self.state is None:
            raise InputError("the episode has not begun; call reset() before step()")
        return self.state

    def step(
        self, moves: NDArray[np.int64], rngs: Sequence[np.random.Generator]
    ) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """Let both cars of every game move, and drive a step.

        Parameters
        ----------
        moves : ndarray, shape (games, 1 or 2)
            Moves of car 0, or of both where there is no opponent.
        rngs : sequence of Generator
            One for each game.

        Returns
        -------
        utility : ndarray, shape (games, 2)
        done : ndarray, shape (games,)
        """
        state = self.started()
        both = moves if moves.shape[1] == 2 else np.stack([moves[:, 0], self._replies(state, rngs)], axis=1)
        self.state = self.game.step(state, both)
        self.moves = both.copy()
        self.seen = self.game.observation(self.state)
        return self.game.utility(self.state), self.game.done(self.state)

    def _replies(self, state: GameState, rngs: Sequence[np.random.Generator]) -> NDArray[np.int64]:
        replies = np.zeros(self.games, np.int64)
        masks = self.game.action_mask(state)[:, 1]
        for k, opponent in enumerate(self.opponents):
            rows = np.flatnonzero(self.chosen == k)
            if len(rows) == 0:
                continue
            memories = [self.memories[row] for row in rows]
            chosen = choose(
                opponent,
                self.seen[rows, 1],
                masks[rows],
                [rngs[int(row)] for row in rows],
                memories,
                self._deterministic,
            )
            for row, move, memory in zip(rows, chosen, memories, strict=True):
                try:
                    replies[row] = checked_move(opponent, move, self.game.move_names)
                except InputError as error:
                    raise InputError(f"environment {row}: {error}") from None
                self.memories[row] = memory
        return replies

    def facts(self, car: int = 0) -> dict[str, NDArray[Any]]:
        """What the info of each game says to one of the players: arrays by name."""
        state = self.started()
        other = 1 - car
        winner = self.game.winner(state)
        done = self.game.done(state)
        result = np.where(winner == car, "win", np.where(winner == other, "loss", "tie"))
        result = np.where((winner < 0) & state.race.crashed, "crash", result)
        names = np.array([*self.game.move_names, ""], dtype=object)  # index -1: no move yet
        opponents = np.array([one.name for one in self.opponents] or ["self-play"], dtype=object)
        acts = np.array([one.driver is None for one in self.opponents] or [True])[self.chosen]
        return {
            "move": names[self.moves[:, car]],
            "opponent_move": np.where(acts, names[self.moves[:, other]], ""),
            "policy": state.policy[:, car].copy(),
            "lead": state.race.lead if car == 0 else -state.race.lead,
            "crash": CRASHES[state.race.crash[:, car]],
            "opponent_crash": CRASHES[state.race.crash[:, other]],
            "fault": state.race.fault[:, car] == 1,
            "result": np.where(done, result, ""),
            "opponent": opponents[self.chosen],
            "action_mask": self.game.action_mask(state)[:, car].astype(np.int8),
        }

    def get_state(self) -> tuple[Any, ...]:
        """Copies of all that changes: games, opponents, last moves, and what the opponents remember."""
        state = None if self.state is None else self.state.copy()
        return state, self.chosen.copy(), self.moves.copy(), copy.deepcopy(self.memories)

    def set_state(self, values: tuple[Any, ...]) -> None:
        """Go on from what `get_state` returned, here or in an equal batch."""
        state, chosen, moves, memories = values
        if state is not None and (not isinstance(state, GameState) or state.games != self.games):
            raise InputError(f"the state is not one of {self.games} games; use what get_state returned")
        if state is not None and state.leads.shape[1] != self.game.config.moves + 1:
            raise InputError(
                f"the state's games have {state.leads.shape[1] - 1} moves, these {self.game.config.moves}; use what "
                "get_state of an environment with equal arguments returned"
            )
        self.state = None if state is None else state.copy()
        self.chosen, self.moves, self.memories = chosen.copy(), moves.copy(), copy.deepcopy(memories)
        if self.state is not None:
            self.seen = self.game.observation(self.state)


def _with_planner(game: RaceGame, opponents: list[Opponent]) -> RaceGame:
    """The game with the planner of those opponents that bring their own policy."""
    planners = [one.driver.planner for one in opponents if isinstance(one.driver, Policy)]
    others = [planner for planner in planners if planner is not get_planner(game.archive.planner)]
    if not others:
        return game
    for one in opponents:
        if not isinstance(one.driver, Policy) or one.driver.planner is not others[0]:
            raise InputError(
                f"opponent {one.name!r} does not drive with planner {others[0].name!r}, but another of the mixture "
                "does; the opponents of one environment must share a planner"
            )
    return with_opponent(game, others[0])
