"""Rules of a match: a series of races against the same opponent.

1. **Before each race** each player chooses the policy of the archive that its car starts with; both
   choose at the same time (:meth:`MatchGame.start`). The players have observed the earlier races
   (:mod:`pcs_racing.game.observation`).
2. **The race** is a game of :class:`pcs_racing.game.rules.RaceGame` on a start line of its own: its
   players watch the first step, and may then move (:meth:`MatchGame.move`). A player that keeps the
   policy of the start makes the move "stay". The two cars swap their places on the grid from race
   to race.
3. **Score.** A race counts 1 for the winner, 1/2 for both cars in a tie, and 0 for the loser and in
   a no-contest crash. A player's reward is the score of each race, paid when the race is over; the
   sum is the number of races won.

A race that ends by a crash in its first step counts, because its policies were chosen; a single
game would be drawn again.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.checks import check_whole_array
from pcs_racing.game.competitor import Chooser, competitor_name
from pcs_racing.game.observation import ObservationElement, encode_match, match_elements
from pcs_racing.game.rules import OUTSIDE, RaceGame
from pcs_racing.game.starting import DRAW, check_policies, random_bits
from pcs_racing.game.state import GameState, put_games, take_games
from pcs_racing.planners.planner import Policy
from pcs_racing.race.conditions import AS_THE_SETUP, RaceConditions
from pcs_racing.race.races import start_races, winners
from pcs_racing.race.start_grid import Starts

Indices = NDArray[np.int64]
Floats = NDArray[np.float64]

KEEP = -1
"""Choice that repeats the car's policy at the start of the last race."""


class MatchState(NamedTuple):
    """A batch of B matches of R races at one moment: plain arrays, match axis first."""

    #: Running race; between two races the finished race, before the first race the cars on the
    #: grid.
    game: GameState
    race: Indices  #: shape (B,): Number of finished races.
    racing: NDArray[np.bool_]  #: shape (B,): True while a race is running.
    starts: Floats  #: shape (B, R): Arc length of the start line of each race, m.
    sides: Indices  #: shape (B, R): Car that starts a race on the left or in front, 0 or 1.
    noise: NDArray[np.uint64]  #: shape (B, R): Key of the noise of each race.
    #: shape (B, 2): Policy of each car at the start of the next race if its player does not choose;
    #: -1 for a policy from outside the archive.
    policy: Indices
    theta: Floats  #: shape (B, 2, P): Parameters of the policies from outside the archive.
    #: shape (B, 2, R, G): Mean over each race of the normalised archive coordinates of each car's
    #: policy; measured coordinates for a policy from outside.
    own: Floats
    #: shape (B, 2, R, G): Measured normalised coordinates of each car over each race: mean of its
    #: steps, weighted by their time.
    measured: Floats
    leads: Floats  #: shape (B, R): Lead of car 0 at the end of each race, m.
    #: shape (B, R): Share of its duration that each race lasted; 0 until it is over.
    driven: Floats
    scores: Floats  #: shape (B, 2, R): Score of each car in each race: 1, 1/2 or 0.

    @property
    def matches(self) -> int:
        """Number of matches in the batch."""
        return len(self.race)

    def copy(self) -> "MatchState":
        """Return an independent copy."""
        rest: Any = self[1:]
        return MatchState(self.game.copy(), *(array.copy() for array in rest))


def put_matches(state: MatchState, indices: ArrayLike, values: MatchState) -> None:
    """Overwrite some matches of a batch, in place, with the matches of another batch."""
    chosen = np.asarray(indices)
    put_games(state.game, chosen, values.game)
    for array, new in zip(state[1:], values[1:], strict=True):
        array[chosen] = new


@dataclass(frozen=True, eq=False)
class MatchGame:
    """Game of a match: functions from one :class:`MatchState` to the next, for many matches."""

    game: RaceGame  #: Track, archive and rules of the races.
    races: int = 3  #: Number of races in a match, at least 1.
    #: True if a player that chooses before the races also makes the moves of the races.
    race_moves: bool = False

    @cached_property
    def observation_elements(self) -> tuple[ObservationElement, ...]:
        """Name, unit, bounds and meaning of each of the D numbers of an observation."""
        elements = match_elements(self.game.characteristics, self.races)
        if not self.race_moves:
            return elements
        racing = ObservationElement(
            "racing", "1", 0.0, 1.0, "1 while a race goes on; else the numbers below are 0"
        )
        return (*elements, racing, *self.game.observation_elements)

    # Start of a match

    def begin(
        self,
        keys: NDArray[np.uint64],
        *,
        policies: ArrayLike | None = None,
        lines: ArrayLike | None = None,
        sides: ArrayLike | None = None,
        opponents: Policy | Sequence[Policy | None] | None = None,
    ) -> MatchState:
        """Return matches before their first race, each drawn from its own key, for any batch size.

        Arguments that are not given are drawn. ``policies``, shape (B, 2) or (2,), are the first
        policies of cars whose players do not choose; -1 draws a policy uniformly from the archive.
        ``lines``, shape (B, R) or (B, 1), are arc lengths of the start line of each race, or of all
        races of a match, m. ``sides``, shape (B,), are the cars (0 or 1) that start the first race
        on the left or in front. ``opponents`` are policies of car 1 from outside the archive, as in
        :meth:`RaceGame.reset`.
        """
        game, races, count = self.game, self.races, len(keys)
        first = check_policies(game.archive, policies, count)
        outside, theta = game.outside_planners((None, opponents), count)
        bits = np.stack([random_bits(keys, race) for race in range(races)], axis=1)
        drawn = (bits[:, 0, 2:4] % np.uint64(len(game.archive))).astype(np.int64)
        policy = np.where(outside, OUTSIDE, np.where(first == DRAW, drawn, first))
        drawn_lines = game.start_lines[
            (bits[:, :, 0] % np.uint64(len(game.start_lines))).astype(np.int64)
        ]
        places = np.array(
            np.broadcast_to(drawn_lines if lines is None else np.asarray(lines), (count, races))
        )
        side = (
            (bits[:, 0, 1] % np.uint64(2)).astype(np.int64)
            if sides is None
            else np.asarray(sides, np.int64)
        )
        # Places swap from race to race, so that neither side of the grid decides a match.
        turns = (side[:, None] + np.arange(races)) % 2
        axes = len(game.characteristics)
        grid = game.empty_state(
            start_races(game.setup, Starts(places[:, 0], turns[:, 0]), bits[:, 0, 4])
        )
        grid.policy[:] = policy
        return MatchState(
            game=grid,
            race=np.zeros(count, np.int64),
            racing=np.zeros(count, np.bool_),
            starts=places,
            sides=turns,
            noise=np.ascontiguousarray(bits[:, :, 4]),
            policy=policy,
            theta=theta,
            own=np.zeros((count, 2, races, axes)),
            measured=np.zeros((count, 2, races, axes)),
            leads=np.zeros((count, races)),
            driven=np.zeros((count, races)),
            scores=np.zeros((count, 2, races)),
        )

    # Races

    def done(self, state: MatchState) -> NDArray[np.bool_]:
        """Return whether each match is over, shape (B,)."""
        return state.race >= self.races

    def start(
        self,
        state: MatchState,
        choices: Indices,
        rows: Indices | None = None,
        conditions: RaceConditions = AS_THE_SETUP,
    ) -> MatchState:
        """Start the next race of matches that are between two races, and drive its first step.

        It starts all such matches, or only ``rows``. ``choices``, shape (B, 2), are the policies of
        the archive at the start of the race, or :data:`KEEP`. A choice has no effect on a car with
        a policy from outside the archive.
        """
        new = state.copy()
        between = np.flatnonzero(~state.racing & ~self.done(state))
        rows = between if rows is None else np.intersect1d(rows, between)
        if len(rows) == 0:
            return new
        race = state.race[rows]
        outside = state.policy[rows] == OUTSIDE
        policy = np.where(outside | (choices[rows] == KEEP), state.policy[rows], choices[rows])
        starts = Starts(state.starts[rows, race], state.sides[rows, race])
        noise = state.noise[rows, race]
        games = self.game.start(
            policy, starts, noise, state.theta[rows], outside, conditions.take(rows)
        )
        put_games(new.game, rows, games)
        new.policy[rows] = policy
        new.racing[rows] = True
        self._finish(new)
        return new

    def move(
        self,
        state: MatchState,
        moves: Indices,
        rows: Indices | None = None,
        conditions: RaceConditions = AS_THE_SETUP,
    ) -> MatchState:
        """Let both players move in the running races, or only in ``rows``, and drive a step.

        ``moves``, shape (B, 2), are indices in :attr:`RaceGame.competitor_moves`; ``conditions``
        are as in :meth:`start`.
        """
        new = state.copy()
        going = np.flatnonzero(state.racing)
        rows = going if rows is None else np.intersect1d(rows, going)
        if len(rows) == 0:
            return new
        games = self.game.apply(take_games(state.game, rows), moves[rows], conditions.take(rows))
        put_games(new.game, rows, games)
        self._finish(new)
        return new

    def _finish(self, state: MatchState) -> None:
        """Record, in place, the races that have just ended."""
        rows = np.flatnonzero(state.racing & self.game.done(state.game))
        if len(rows) == 0:
            return
        game, race = take_games(state.game, rows), state.race[rows]
        config = self.game.config
        # The last step of a crash is shorter than the others and counts less.
        begins = np.append(0, config.end_ticks[:-1])
        ticks = game.race.tick[:, None] - begins
        weights = (
            np.clip(ticks, 0, config.end_ticks - begins) / np.maximum(game.race.tick, 1)[:, None]
        )
        # Step by step, in an order that depends neither on the batch nor on the processor.
        for step in range(config.moves + 1):
            weight = weights[:, step, None, None]
            state.own[rows, :, race] += weight * game.own[:, :, step]
            state.measured[rows, :, race] += weight * game.estimates[:, :, step]
        state.leads[rows, race] = game.race.lead
        state.driven[rows, race] = game.race.tick / config.end_ticks[-1]
        winner = winners(config.race, game.race)
        tie = (winner < 0) & ~game.race.crashed
        for car in range(2):
            state.scores[rows, car, race] = (winner == car) + 0.5 * tie
        state.race[rows] += 1
        state.racing[rows] = False

    # Rewards and observations

    def reward(self, before: MatchState, after: MatchState) -> Floats:
        """Return the reward of each car, (B, 2): its score in races ended between two moments."""
        return after.scores.sum(axis=2) - before.scores.sum(axis=2)

    def memory(self, state: MatchState) -> NDArray[np.float32]:
        """Return each player's observation between races, (B, 2, D): its knowledge of the match."""
        between = ~state.racing & ~self.done(state)
        # After the last race there is no next side; the index stays inside the array and is masked.
        side = state.sides[np.arange(state.matches), np.minimum(state.race, self.races - 1)]
        front = np.stack([side == 0, side == 1], axis=1) & between[:, None]
        return encode_match(
            state.own, state.measured, state.leads, state.scores, state.driven, state.race, front
        )

    def observation(self, state: MatchState) -> NDArray[np.float32]:
        """Return each player's observation, shape (B, 2, D).

        The numbers are in the order of :attr:`observation_elements`.
        """
        match = self.memory(state)
        if not self.race_moves:
            return match
        racing = state.racing[:, None, None]
        seen = np.where(racing, self.game.observation(state.game), np.float32(0.0))
        flags = np.broadcast_to(racing, (state.matches, 2, 1)).astype(np.float32)
        return np.concatenate([match, flags, seen], axis=2)


def ask_choices(
    competitor: Any,
    match: MatchGame,
    state: MatchState,
    car: int,
    *,
    rows: NDArray[np.int64] | None = None,
    memory: NDArray[np.float32] | None = None,
) -> NDArray[np.int64]:
    """Ask a competitor for the policy of one car in the next race of matches between two races.

    Returns policies of the archive, shape (B,); :data:`KEEP` in matches without a request, and for
    a competitor that does not choose. The request covers ``rows``, all matches by default.
    ``memory``, shape (B, D), is the car's observation between races (:meth:`MatchGame.memory`), if
    it is known already.
    """
    choices = np.full(state.matches, KEEP, np.int64)
    between = np.flatnonzero(~state.racing & ~match.done(state))
    rows = between if rows is None else np.intersect1d(rows, between)
    if not isinstance(competitor, Chooser) or len(rows) == 0:
        return choices
    seen = match.memory(state)[:, car] if memory is None else memory
    name = f"competitor {competitor_name(competitor)!r}: its choice"
    answer, last = competitor.choose(seen[rows]), len(match.game.archive) - 1
    choices[rows] = check_whole_array(name, answer, rows.shape, minimum=0, maximum=last)
    return choices
