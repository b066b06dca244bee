"""Opponents of Drive that change their policy while they drive, as the players of the game of moves do."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.errors import InputError
from pcs_racing.envs.batch import Generators, Rows
from pcs_racing.envs.opponents import Opponent
from pcs_racing.game.competitor import ask_moves
from pcs_racing.game.rules import OUTSIDE, RaceGame
from pcs_racing.game.state import GameState
from pcs_racing.race.state import RaceState, empty_state, take


class MovingOpponents:
    """The game of moves in which car 1 of a batch of races takes part, while car 0 is steered by an agent.

    The opponent watches for a step of the game, then moves and drives the next one, and so on; after the last
    move it keeps its policy. It observes car 0 as it would observe a driver from outside the archive. A move is made at
    the first step of the environment that ends at its time or later. The game has the external planner in car 0 and the
    archive's in car 1.
    """

    def __init__(self, episodes: int, game: RaceGame) -> None:
        self.game = game
        blank = empty_state(episodes, game.setup.memory_size)
        self._games = game.empty_state(blank)
        self._games.policy[:] = OUTSIDE
        self._before = blank.copy()  # what the current step of each game began with
        self._memories: list[Any] = [None] * episodes

    def draw(self, row: int, opponent: Opponent, generator: np.random.Generator) -> None:
        """Draw the policy that an episode's opponent starts with; a driver has its own."""
        policy = OUTSIDE if opponent.policies else int(generator.integers(len(self.game.archive)))
        self._games.policy[row, 1] = policy

    def restart(self, rows: NDArray[np.int64], races: RaceState, theta: NDArray[np.float64]) -> None:
        """Begin the games of races that are on the grid, and set the parameters of their opponents."""
        games = self._games
        for array in (games.own, games.estimates, games.leads, games.step):
            array[rows] = 0
        self._remember(rows, races)
        for row in rows:
            self._memories[row] = None
        self._set_theta(rows, theta)

    def move(
        self,
        races: RaceState,
        theta: NDArray[np.float64],
        opponents: Sequence[Opponent],
        drawn: Rows,
        generators: Generators,
    ) -> None:
        """Let the opponents move whose step of the game is over, and set their parameters."""
        # The races are the drive's own; the games only add who moved when.
        games = self._games._replace(race=races)
        due = (games.policy[:, 1] != OUTSIDE) & ~self.game.done(games)
        rows = np.flatnonzero(due & (races.tick >= self.game.config.end_ticks[games.step]))
        if len(rows) == 0:
            return
        # Only games whose step is over are measured: the others would be measured over a part of it.
        estimates = np.zeros((len(drawn), 2, len(self.game.characteristics)))
        estimates[rows] = self.game.measure(take(self._before, rows), take(races, rows))
        self.game.record_step(games, rows, estimates)
        seen = self.game.observation(games)[:, 1]
        for k, opponent in enumerate(opponents):
            asked = rows[drawn[rows] == k]
            if len(asked) == 0:
                continue
            moves = ask_moves(
                opponent.competitor,
                self.game,
                games,
                1,
                rows=asked,
                observation=seen,
                memories=self._memories,
                generators=generators,
            )
            games.policy[asked, 1] = self.game.next_policy(games.policy[asked, 1], moves[asked])
        games.step[rows] += 1
        self._remember(rows, races)
        self._set_theta(rows, theta)

    def _remember(self, rows: NDArray[np.int64], races: RaceState) -> None:
        for name in ("progress", "sums", "tick"):  # all that a measurement is made of
            getattr(self._before, name)[rows] = getattr(races, name)[rows]

    def _set_theta(self, rows: NDArray[np.int64], theta: NDArray[np.float64]) -> None:
        policy = self._games.policy[rows, 1]
        moving = policy != OUTSIDE
        theta[rows[moving], 1] = self.game.theta(policy[moving])

    def get_state(self) -> tuple[GameState, RaceState, list[Any]]:
        """Return copies of all that changes."""
        return self._games.copy(), self._before.copy(), list(self._memories)

    def set_state(self, state: tuple[GameState, RaceState, list[Any]] | None, races: RaceState) -> None:
        """Continue from what `get_state` returned."""
        if state is None:
            raise InputError("the state holds no moves of the opponent; use what get_state returned")
        games, before, memories = state
        self._games, self._before, self._memories = games.copy(), before.copy(), list(memories)
