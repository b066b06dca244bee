"""Opponents of an environment, by name or as objects; one is drawn for each episode."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.errors import InputError, check_number
from pcs_racing.envs.batch import FREE, WEIGHTS, Rows, check_part, check_races, check_within
from pcs_racing.game.players import Competitor, ask_moves, check_competitor, competitor
from pcs_racing.game.rules import OUTSIDE, RaceGame
from pcs_racing.game.state import GameState
from pcs_racing.planners.planner import Planner, Policy, PolicySet
from pcs_racing.race.config import CONTROL_EVERY
from pcs_racing.race.state import RaceState, empty_state, take


@dataclass(frozen=True, eq=False)
class Opponent:
    """Possible opponent of an episode."""

    name: str
    weight: float  #: Relative frequency of its draw.
    competitor: Competitor
    #: Fixed policies; one is drawn for each episode. Empty if the opponent makes moves.
    policies: tuple[Policy, ...]

    @property
    def planner(self) -> Planner | None:
        """Planner of fixed policies; None if the opponent moves between policies of the archive."""
        return self.policies[0].planner if self.policies else None

    def draw_policy(self, generator: np.random.Generator) -> Policy | None:
        """Draw the fixed policy of an episode; None if the opponent makes moves."""
        if not self.policies:
            return None
        return self.policies[
            0 if len(self.policies) == 1 else int(generator.integers(len(self.policies)))
        ]


def read_opponents(given: Any, game: Any, like: Any = None) -> list[Opponent]:
    """Read the argument ``opponent``: a racer, or a list of racers.

    Entries of a list may be (weight, racer). ``game`` is the game of the environment, or a function
    that makes it at its first use: policies need no game, which would load an archive. ``like`` are
    the arguments of models without their own. See :func:`pcs_racing.planners.racers.racer`.
    """
    if not isinstance(given, list | tuple):
        return [_opponent(given, 1.0, game, like)]
    if not given:
        raise InputError("opponent is an empty list; give at least one opponent")
    opponents = []
    for i, entry in enumerate(given):
        if isinstance(entry, list | tuple) and len(entry) != 2:
            raise InputError(
                f"opponent {i} of the mixture is {entry!r}; it must be an opponent or (weight,"
                " opponent)"
            )
        weight, one = entry if isinstance(entry, list | tuple) else (1.0, entry)
        weight = float(check_number(f"the weight of opponent {i}", weight, *WEIGHTS))
        opponents.append(_opponent(one, weight, game, like))
    return opponents


def _opponent(given: Any, weight: float, game: Any, like: Any) -> Opponent:
    found = competitor(given, game, like=like)
    if isinstance(found, PolicySet):
        return Opponent(found.name, weight, found, found.policies)
    check_competitor(game() if callable(game) else game, found)
    return Opponent(found.name, weight, found, ())


def check_games(name: str, games: GameState, game: RaceGame, lengths: NDArray[np.float64]) -> None:
    """Refuse games with a number out of its range; ``lengths`` are the track lengths, m."""
    check_races(f"{name}.race", games.race, game.rules, lengths)
    check_within(f"{name}.step", games.step, 0, game.rules.moves)
    check_within(f"{name}.policy", games.policy, OUTSIDE, len(game.archive) - 1)
    between = (games.race.tick % CONTROL_EVERY != 0) & ~games.race.crashed
    if between.any():
        raise InputError(
            f"{name}.race.tick holds {games.race.tick[between][0]}; a game stops at an even number"
        )


def shared_planner(opponents: list[Opponent], game: RaceGame) -> Planner:
    """Return the planner of the opponents of a game: the archive's planner, or another one."""
    planners = [opponent.planner or game.archive.family() for opponent in opponents]
    for opponent, planner in zip(opponents, planners, strict=True):
        if planner is not planners[0]:
            raise InputError(
                f"opponents {opponents[0].name!r} and {opponent.name!r} drive with planners"
                f" {planners[0].name!r} and {planner.name!r}; in a game of moves all opponents must"
                " share a planner; in Drive they may differ"
            )
    return planners[0] if planners else game.archive.family()


def replies(
    opponents: Sequence[Opponent],
    drawn: Rows,
    game: RaceGame,
    state: GameState,
    rows: Rows,
    **asked: Any,
) -> NDArray[np.int64]:
    """Return the drawn opponents' moves in the games ``rows``, 0 in all others, shape (B,).

    The opponents drive car 1. ``asked`` are the other arguments of
    :func:`pcs_racing.game.players.ask_moves`.
    """
    moves = np.zeros(state.games, np.int64)
    for k, opponent in enumerate(opponents):
        own = rows[drawn[rows] == k]
        moves[own] = ask_moves(opponent.competitor, game, state, 1, rows=own, **asked)[own]
    return moves


class MovingOpponents:
    """Games of moves of car 1 in a batch of races, with an agent steering car 0.

    The opponent watches for one step of the game, then moves before each later step. After the last
    move it keeps its policy. It observes car 0 as a policy from outside the archive. A move is made
    after the first environment step that ends at its time or later. The game has the external
    planner in car 0 and the archive's planner in car 1.
    """

    def __init__(self, episodes: int, game: RaceGame) -> None:
        self.game = game
        blank = empty_state(episodes, game.setup.memory_size, laps=game.setup.rules.laps)
        self._games = game.empty_state(blank)
        self._games.policy[:] = OUTSIDE
        self._before = blank.copy()  # state at the start of each game's current step
        self._memories: list[Any] = [None] * episodes

    def draw(self, row: int, opponent: Opponent, generator: np.random.Generator) -> None:
        """Draw the initial policy of an episode's opponent, except for a fixed policy."""
        policy = OUTSIDE if opponent.policies else int(generator.integers(len(self.game.archive)))
        self._games.policy[row, 1] = policy

    def restart(
        self, rows: NDArray[np.int64], races: RaceState, theta: NDArray[np.float64]
    ) -> None:
        """Begin the games of races on the grid, and set the parameters of their opponents."""
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
    ) -> None:
        """Move the opponents at the end of their game step, and set their parameters."""
        # The races belong to the Drive batch; the games only add the moves.
        games = self._games._replace(race=races)
        due = (games.policy[:, 1] != OUTSIDE) & ~self.game.done(games)
        rows = np.flatnonzero(due & (races.tick >= self.game.rules.end_ticks[games.step]))
        if len(rows) == 0:
            return
        # Only finished steps are measured: other games are in the middle of a step.
        estimates = np.zeros((len(drawn), 2, len(self.game.characteristics)))
        estimates[rows] = self.game.measure(take(self._before, rows), take(races, rows))
        self.game.record_step(games, rows, estimates)
        asked = {"observation": self.game.observation(games)[:, 1], "memories": self._memories}
        moves = replies(opponents, drawn, self.game, games, rows, **asked)
        games.policy[rows, 1] = self.game.table[games.policy[rows, 1], moves[rows]]
        games.step[rows] += 1
        self._remember(rows, races)
        self._set_theta(rows, theta)

    def _remember(self, rows: NDArray[np.int64], races: RaceState) -> None:
        for name in ("progress", "sums", "tick"):  # all inputs of a measurement
            getattr(self._before, name)[rows] = getattr(races, name)[rows]

    def _set_theta(self, rows: NDArray[np.int64], theta: NDArray[np.float64]) -> None:
        policy = self._games.policy[rows, 1]
        moving = policy != OUTSIDE
        own = self.game.theta(policy[moving])
        theta[rows[moving], 1, : own.shape[1]] = own

    def get_state(self) -> tuple[GameState, RaceState, list[Any]]:
        """Return copies of all variables."""
        return self._games.copy(), self._before.copy(), list(self._memories)

    def check_state(
        self, state: tuple[GameState, RaceState, list[Any]], lengths: NDArray[np.float64]
    ) -> None:
        """Refuse a state that `get_state` can't have returned; ``lengths`` are track lengths, m."""
        name = "the state's moves of the opponent"
        check_part(name, state, (self._games, self._before, [FREE] * len(self._memories)))
        check_games(name, state[0], self.game, lengths)
        check_races(name, state[1], self.game.rules, lengths)

    def set_state(self, state: tuple[GameState, RaceState, list[Any]]) -> None:
        """Continue from a state of `get_state`."""
        games, before, memories = state
        self._games, self._before, self._memories = games.copy(), before.copy(), list(memories)
