"""The rules of the game: start, moves, end, winner, fault and reward.

1. **Start.** Two cars stand on the grid of a start line; each is driven by a motion planner with a policy of an
   archive. Both drive one step (8 s; none where the rules say so) in which the players only watch:
   :meth:`RaceGame.reset`.
2. **Moves.** Then each player moves: more or less of one characteristic, to the nearest policy of the archive that lies
   there (:attr:`RaceGame.table`), or to stay. Both moves are made at the same time, and a step is driven with the new
   policies: :meth:`RaceGame.step`. What the players observe is in :mod:`pcs_racing.game.observation`.
3. **End.** The game is over after the last move (4) or a crash: :meth:`RaceGame.done`.
4. **Fault.** A car that runs into a wall is at fault; of two that touch, the one that :mod:`pcs_racing.car.collision`
   finds to have caused it: :meth:`RaceGame.fault`.
5. **Winner.** The car that is ahead; after a crash nobody, or the car that is not at fault: :meth:`RaceGame.winner`.
6. **Reward.** Paid at the end, zero-sum: :meth:`RaceGame.reward` and :func:`pcs_racing.game.reward.reward`.

The numbers are settings (:class:`pcs_racing.game.config.GameConfig`). Environments, game trees and tournaments all play
through :class:`RaceGame`: functions from one :class:`GameState` to the next, for many games at once.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.errors import InputError
from pcs_racing.car.vehicle import F1TENTH, VehicleParams
from pcs_racing.game.archive import PolicyArchive
from pcs_racing.game.characteristics import Characteristic, Segment, get_characteristics, measure
from pcs_racing.game.config import GameConfig
from pcs_racing.game.moves import check_moves, duplicate_moves, move_names, move_table
from pcs_racing.game.observation import HIGH, LOW, ObservationElement, encode_observation, observation_elements
from pcs_racing.game.reward import reward
from pcs_racing.game.starting import DRAW, check_policies, driver_parameters, game_keys, random_bits
from pcs_racing.game.state import GameState, put_games
from pcs_racing.planners.planner import Planner, Policy
from pcs_racing.planners.registry import get_planner
from pcs_racing.race.conditions import AS_THE_SETUP, RaceConditions
from pcs_racing.race.races import RaceSetup, advance, start_lines, start_races, winners
from pcs_racing.race.start_grid import Starts
from pcs_racing.race.state import NO_CRASH, RaceState, take
from pcs_racing.track.track import Track

Indices = NDArray[np.int64]
Floats = NDArray[np.float64]

OUTSIDE = -1
"""In a state's ``policy``: a driver from outside the archive."""

REDRAWS = 20  # times that a game which ends before the first move is drawn again

PAPER_GAME = GameConfig()


@dataclass(frozen=True, eq=False)
class RaceGame:
    """The game on one track with one archive."""

    track: Track
    archive: PolicyArchive  #: Where both players' policies come from.
    config: GameConfig = PAPER_GAME  #: The rules.
    #: Planner of car 1, where its drivers come from outside the archive (``reset(opponents=...)``); by default the
    #: archive's.
    opponent_planner: Planner | str | None = None
    #: Threads to share the races of a batch; all cores by default. It does not change the result.
    threads: int | None = None
    ego_planner: Planner | str | None = None  #: The same for car 0 (``reset(egos=...)``).
    vehicles: tuple[VehicleParams, ...] = (F1TENTH, F1TENTH)  #: Car 0 and car 1.
    most_delay: float = 0.0  #: Longest ``steer_delay`` of a car in a game that has cars of its own (``conditions``), s.

    def __post_init__(self) -> None:
        if self.config.characteristics is not None and self.config.characteristics != self.archive.characteristics:
            object.__setattr__(self, "archive", self.archive.project(self.config.characteristics))
        # What can't be raced is refused here, not when games begin: unknown planners, a circuit without start lines.
        _ = self.start_lines

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle what the game was made of, not what was derived from it."""
        return RaceGame, tuple(getattr(self, one.name) for one in fields(self))

    def __copy__(self) -> "RaceGame":
        """Return the game itself: it never changes."""
        return self

    def __deepcopy__(self, memo: dict[int, Any]) -> "RaceGame":
        """Return the game itself: it never changes."""
        return self

    # What is known before a game begins

    @cached_property
    def setup(self) -> RaceSetup:
        """Track, race rules and planners, as :func:`pcs_racing.advance` wants them."""
        family = self.archive.family()
        first, second = (
            get_planner(planner) if isinstance(planner, str) else planner or family
            for planner in (self.ego_planner, self.opponent_planner)
        )
        return RaceSetup(self.track, self.config.race_rules, (first, second), self.vehicles, self.most_delay)

    @cached_property
    def _theta(self) -> Floats:
        theta = np.zeros((len(self.archive), self.setup.theta_size))
        policies = self.archive.complete(self.archive.parameters)
        width = min(theta.shape[1], policies.shape[1])  # less if neither car can drive its policies
        theta[:, :width] = policies[:, :width]
        return theta

    @cached_property
    def characteristics(self) -> tuple[Characteristic, ...]:
        """Axes of the game."""
        return get_characteristics(self.archive.characteristics)

    @cached_property
    def table(self) -> Indices:
        """Policy that each move leads to from every policy, shape (K, M)."""
        return move_table(self.archive, self.config.epsilon, bool(self.config.stay))

    @cached_property
    def _table_with_stay(self) -> Indices:
        return move_table(self.archive, self.config.epsilon, True)

    @cached_property
    def points(self) -> Floats:
        """Normalised coordinates of the archive's policies as the players observe them, shape (K, G)."""
        return np.clip(self.archive.normalised, LOW, HIGH)

    @cached_property
    def start_lines(self) -> Floats:
        """Arc lengths of the lines that :meth:`reset` draws from, m; places of training, which no table uses."""
        return start_lines(self.track, self.setup.config, np.random.SeedSequence(0, spawn_key=(0,)), split="train")

    @cached_property
    def move_names(self) -> tuple[str, ...]:
        """Names of the M moves that the rules offer."""
        return move_names(self.archive, self.config.epsilon, bool(self.config.stay))

    @cached_property
    def competitor_moves(self) -> tuple[str, ...]:
        """Names of the moves that a competitor may make: those of the rules and, whatever the rules offer, to stay."""
        return move_names(self.archive, self.config.epsilon, True)

    @cached_property
    def observation_elements(self) -> tuple[ObservationElement, ...]:
        """Name, unit, bounds and meaning of each of the D numbers of an observation."""
        return observation_elements(self.characteristics, self.config.moves)

    # Start

    def reset(
        self,
        seeds: ArrayLike | None = None,
        *,
        games: int | None = None,
        seed: int = 0,
        policies: ArrayLike | None = None,
        starts: Starts | None = None,
        opponents: Policy | Sequence[Policy | None] | None = None,
        egos: Policy | Sequence[Policy | None] | None = None,
        redraw: bool = True,
        conditions: RaceConditions = AS_THE_SETUP,
    ) -> GameState:
        """Start a batch of games and drive the step in which the players only watch.

        Everything that is drawn for a game (start line, side, policies, noise) is a function of its own key, whatever
        the size of the batch.

        Parameters
        ----------
        seeds : int or array of int, shape (B,), optional
            Key of each game. By default they are derived from ``seed`` for as many games as ``games`` says (1).
        games : int, optional
            Number of games, if there are no ``seeds``.
        seed : int
            Root of the keys, if there are no ``seeds``.
        policies : array of int, shape (B, 2) or (2,), optional
            Policies that the cars of each game start with; -1 draws one, uniformly from the archive.
        starts : Starts, optional
            Where the cars start; by default drawn out of ``config.race.start_lines`` lines and both sides.
        opponents : Policy or sequence of B (Policy or None), optional
            Drivers of car 1 from outside the archive, all of ``opponent_planner``: its moves do nothing then.
        egos : Policy or sequence of B (Policy or None), optional
            The same for car 0 and ``ego_planner``.
        redraw : bool
            Draw a game again (up to 20 times) if it ends by a crash before the first move. A game of which start and
            policies are given is never drawn again: it is over at once.
        conditions : RaceConditions
            Cars and tracks of single games.
        """
        keys = game_keys(seeds, games, seed)
        count = len(keys)
        first = check_policies(self.archive, policies, count)
        outside, theta = self.outside_drivers((egos, opponents), count)
        if starts is not None and len(starts) != count:
            raise InputError(f"there are {count} games but {len(starts)} starts; give one start for each game")
        drawn = (first == DRAW) & ~outside
        first[outside] = OUTSIDE

        def begin(rows: Indices, attempt: int) -> GameState:
            bits = random_bits(keys[rows], attempt)
            drawn_policies = (bits[:, 2:4] % np.uint64(len(self.archive))).astype(np.int64)
            policy = np.where(drawn[rows], drawn_policies, first[rows])
            grid = self._starts(bits) if starts is None else starts.take(rows)
            return self.start(policy, grid, bits[:, 4], theta[rows], outside[rows], conditions.take(rows))

        state = begin(np.arange(count), 0)
        # Drawn again the same way, a game that is fixed would crash again.
        free = drawn.any(axis=1) | (starts is None)
        for attempt in range(1, REDRAWS + 1):
            again = np.flatnonzero(state.race.crashed & free)
            if not redraw or len(again) == 0:
                break
            put_games(state, again, begin(again, attempt))
        return state

    def outside_drivers(self, given: Sequence[Any], games: int) -> tuple[NDArray[np.bool_], Floats]:
        """Which cars have drivers from outside the archive, shape (games, 2), and their parameters, (games, 2, P)."""
        drivers = [
            driver_parameters(self.archive, self.setup.planners[car], car, drivers, games, self.setup.theta_size)
            for car, drivers in enumerate(given)
        ]
        outside, theta = (np.stack(pair, axis=1) for pair in zip(*drivers, strict=True))
        return outside, theta

    def start(
        self,
        policy: Indices,
        starts: Starts,
        noise: NDArray[np.uint64],
        theta: Floats,
        outside: NDArray[np.bool_],
        conditions: RaceConditions = AS_THE_SETUP,
    ) -> GameState:
        """Put the cars of B games on the grid, and drive the step in which the players only watch.

        Policies are those of the archive that each car starts with, shape (B, 2); where its driver is from ``outside``,
        it is -1, and ``theta``, of shape (B, 2, P), holds its parameters.
        """
        state = self.empty_state(start_races(self.setup, starts, noise, conditions))
        state.policy[:] = policy
        state.theta[:] = self.theta(policy)
        state.theta[outside] = theta[outside]
        everybody = np.ones(len(policy), np.bool_)
        if self.config.end_ticks[0] > 0:
            self._drive(state, everybody, conditions)
        else:
            self.record_step(state, np.flatnonzero(everybody), self.measure(state.race, state.race))
        return state

    def _starts(self, bits: NDArray[np.uint64]) -> Starts:
        """Lines and sides that follow from the random bits of games, shape (B, 5)."""
        line = (bits[:, 0] % np.uint64(len(self.start_lines))).astype(np.int64)
        return Starts(self.start_lines[line], (bits[:, 1] % np.uint64(2)).astype(np.int64))

    def grid(
        self,
        key: NDArray[np.uint64],
        noise: NDArray[np.uint64],
        starts: Starts | None = None,
        conditions: RaceConditions = AS_THE_SETUP,
    ) -> RaceState:
        """Return the race on the grid from which :meth:`reset` drove the first step of the game with this key.

        The key of its race's noise says how often the game was drawn again; starts and conditions are those of
        :meth:`reset`.
        """
        attempts = [random_bits(key, attempt) for attempt in range(REDRAWS + 1)]
        bits = next(bits for bits in attempts if bits[0, 4] == noise[0])
        return start_races(self.setup, self._starts(bits) if starts is None else starts, noise, conditions)

    def empty_state(self, races: RaceState) -> GameState:
        """Games of which these races are on the grid and nothing else is known yet: every other number is 0."""
        games, steps, axes = races.races, self.config.moves + 1, len(self.characteristics)
        return GameState(
            race=races,
            step=np.zeros(games, np.int64),
            policy=np.zeros((games, 2), np.int64),
            theta=np.zeros((games, 2, self.setup.theta_size)),
            own=np.zeros((games, 2, steps, axes)),
            estimates=np.zeros((games, 2, steps, axes)),
            leads=np.zeros((games, steps)),
        )

    # Moves

    def step(self, state: GameState, actions: ArrayLike) -> GameState:
        """Let both players of every game move, and drive on for a step.

        Actions, shape (B, 2), are indices of each car's move in :attr:`move_names`; that of a driver from outside the
        archive does nothing. Games that are over stand still. The state that is given stays as it is.
        """
        return self.apply(state, check_moves(actions, self.move_names, (state.games, 2), ("game", "car")))

    def apply(self, state: GameState, moves: Indices, conditions: RaceConditions = AS_THE_SETUP) -> GameState:
        """Do what :meth:`step` does with moves that were checked already, indices in :attr:`competitor_moves`.

        The conditions are those of :meth:`reset`.
        """
        new = state.copy()
        going = ~self.done(state)
        moving = going[:, None] & (state.policy != OUTSIDE)
        # What is looked up for a driver from outside (policy -1) is not used.
        new.policy[:] = np.where(moving, self.next_policy(state.policy, moves), state.policy)
        new.theta[:] = np.where(moving[..., None], self.theta(new.policy), state.theta)
        new.step[:] = state.step + going
        self._drive(new, going, conditions)
        return new

    def next_policy(self, policies: Indices, moves: Indices) -> Indices:
        """Policies of the archive that moves lead to, indices in :attr:`competitor_moves`."""
        return self._table_with_stay[policies, moves]

    def action_mask(self, state: GameState) -> NDArray[np.bool_]:
        """Moves that a player may make, shape (B, 2, M).

        With ``mask_duplicates`` those that lead where "stay", or else an earlier one, leads are ruled out.
        """
        if not self.config.mask_duplicates:
            return np.ones((state.games, 2, len(self.move_names)), np.bool_)
        allowed = ~self._duplicates[state.policy]
        allowed[state.policy == OUTSIDE] = True
        return allowed

    @cached_property
    def _duplicates(self) -> NDArray[np.bool_]:
        if not self.config.stay:
            return duplicate_moves(self.table)
        # "stay" comes last, and is the one to keep among moves that change nothing.
        return np.roll(duplicate_moves(np.roll(self.table, 1, axis=1)), -1, axis=1)

    # End, fault, winner, reward

    def done(self, state: GameState) -> NDArray[np.bool_]:
        """Whether each game is over, shape (B,): all moves made and driven, or a crash."""
        return (state.step >= self.config.moves) | state.race.crashed

    def fault(self, state: GameState) -> NDArray[np.bool_]:
        """Whether each car is to blame for the crash that ended its game, shape (B, 2)."""
        return (state.race.fault > 0) & (state.race.crash != NO_CRASH)

    def winner(self, state: GameState) -> NDArray[np.int8]:
        """The car that won (0 or 1), shape (B,); -1 for a tie, a no-contest crash, and while a game goes on."""
        over = self.done(state)
        if not over.any():
            return np.full(state.games, -1, np.int8)
        return np.where(over, winners(self.config.race, state.race), -1).astype(np.int8)

    def reward(self, state: GameState) -> Floats:
        """Reward of each car, shape (B, 2): 0 while a game goes on, then :func:`pcs_racing.game.reward.reward`."""
        over, both = self.done(state), np.zeros((state.games, 2))
        if over.any():
            both[:, 0] = np.where(over, reward(self.config, state.race, state.step), 0.0)
            both[:, 1] = 0.0 - both[:, 0]
        return both

    # Observations

    def observation(self, state: GameState) -> NDArray[np.float32]:
        """What each player observes, shape (B, 2, D), in the order of :attr:`observation_elements`."""
        return encode_observation(state.own, state.estimates, state.leads, state.step)

    # A step of driving

    def _drive(self, state: GameState, going: NDArray[np.bool_], conditions: RaceConditions) -> None:
        """Drive a step in place, and record what can be observed of the games that went on."""
        estimates = self._advance(state.race, state.theta, conditions)
        self.record_step(state, np.flatnonzero(going), estimates)

    def record_step(self, state: GameState, rows: Indices, estimates: Floats) -> None:
        """Write, in place, what can be observed of the step that some of the games have just driven.

        The estimates, of shape (B, 2, G), are what :meth:`measure` says of it.
        """
        now = state.step[rows]
        estimates = estimates[rows]
        state.estimates[rows, :, now] = estimates
        state.own[rows, :, now] = np.where(
            state.policy[rows, :, None] != OUTSIDE, self.points[state.policy[rows]], estimates
        )
        state.leads[rows, now] = state.race.lead[rows]

    def _advance(self, races: RaceState, theta: Floats, conditions: RaceConditions = AS_THE_SETUP) -> Floats:
        before = races._replace(progress=races.progress.copy(), sums=races.sums.copy(), tick=races.tick.copy())
        self.drive_step(races, theta, conditions)
        return self.measure(before, races)

    def drive_step(
        self, races: RaceState, theta: Floats, conditions: RaceConditions = AS_THE_SETUP, *, ittc: bool = True
    ) -> None:
        """Drive races in place to the end of their next step, each of its own; those that are over stand still."""
        ends = self.config.end_ticks
        lengths = np.append(ends, ends[-1])[np.searchsorted(ends, races.tick, side="right")] - races.tick
        lengths[races.crashed] = 0
        different = np.unique(lengths[lengths > 0])
        if len(different) == 1:
            # Steps of a usual batch are equally long: no races are taken out and put back. Those that are over stand.
            advance(self.setup, races, theta, int(different[0]), threads=self.threads, ittc=ittc, conditions=conditions)
            return
        for ticks in different:
            rows = np.flatnonzero(lengths == ticks)
            some, own = take(races, rows), conditions.take(rows)
            advance(self.setup, some, theta[rows], int(ticks), threads=self.threads, ittc=ittc, conditions=own)
            for name, driven in some._asdict().items():
                getattr(races, name)[rows] = driven

    def measure(self, before: RaceState, after: RaceState) -> Floats:
        """Normalised coordinates of each car as measured between two moments a step apart, shape (B, 2, G)."""
        segment = Segment.between(before, after, self.config.step_seconds)
        so_far = Segment.so_far(after, self.config.step_seconds)
        points = self.archive.normalise(measure(segment, self.characteristics, so_far))
        return np.minimum(np.maximum(points, LOW), HIGH)  # in a third of the time of np.clip

    def drive(self, races: RaceState, policies: Indices) -> Floats:
        """Drive a step of the game in place, with policies of the archive: what :meth:`step` does between two moves.

        For those who keep no :class:`GameState`, such as builders of game trees. Races that are over stand still.
        Returns what :attr:`GameState.estimates` would hold of this step, shape (B, 2, G).
        """
        return self._advance(races, self.theta(policies))

    def theta(self, policies: Indices) -> Floats:
        """Parameters of policies of the archive, as :func:`pcs_racing.advance` wants them, shape (..., P)."""
        return self._theta[policies]
