"""Rules of the game: start, moves, end, winner, fault and reward.

1. **Start.** Two cars are on the grid of a start line; a motion planner drives each of them with a
   policy of an archive. Both drive one step (8 s; no step in some rules) while the players only
   watch: :meth:`RaceGame.reset`.
2. **Moves.** Then each player moves to the nearest policy with more or less of one characteristic
   (:attr:`RaceGame.table`), or stays. Both moves are made at the same time, and a step is driven
   with the new policies: :meth:`RaceGame.step`. The observations of the players are in
   :mod:`pcs_racing.game.observation`.
3. **End.** The game is over after the last move (4), a crash or the last lap of rules with laps:
   :meth:`RaceGame.done`.
4. **Fault.** A car that runs into a wall is at fault; after a contact of two cars,
   :mod:`pcs_racing.car.collision` finds the car at fault: :meth:`RaceGame.fault`.
5. **Winner.** The car ahead; after a crash no car, or the car that is not at fault:
   :meth:`RaceGame.winner`.
6. **Reward.** Paid at the end, zero-sum: :meth:`RaceGame.reward` and
   :func:`pcs_racing.game.reward.reward`.

The numbers are settings (:class:`pcs_racing.race.config.Rules`). Environments, game trees and
tournaments all play through :class:`RaceGame`: functions from one :class:`GameState` to the next,
for many games at once.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.errors import InputError
from pcs_racing.base.seeds import random_bits
from pcs_racing.base.typing import Floats, Indices, ObservationElement
from pcs_racing.car.vehicle import F1TENTH, VehicleParams
from pcs_racing.game.archive import PolicyArchive
from pcs_racing.game.characteristics import Characteristic, Segment, get_characteristics, measure
from pcs_racing.game.identity import GameIdentity
from pcs_racing.game.moves import check_moves, duplicate_moves, move_names, move_table
from pcs_racing.game.observation import (
    HIGH,
    LOW,
    encode_observation,
    observation_elements,
)
from pcs_racing.game.reward import reward
from pcs_racing.game.starting import (
    DRAW,
    check_policies,
    game_keys,
    planner_parameters,
)
from pcs_racing.game.state import GameState, put_games
from pcs_racing.planners.planner import Planner, Policy
from pcs_racing.planners.registry import get_planner
from pcs_racing.race.conditions import AS_THE_SETUP, RaceConditions
from pcs_racing.race.config import PAPER, Rules
from pcs_racing.race.driving import advance
from pcs_racing.race.races import RaceSetup, start_lines, start_races, winners
from pcs_racing.race.start_grid import Starts
from pcs_racing.race.state import NO_CRASH, RaceState, take
from pcs_racing.track.track import Track

OUTSIDE = -1
"""Index in a state's ``policy`` of a policy from outside the archive."""

REDRAWS = 20  # max redraws of a game that ends before the first move


@dataclass(frozen=True, eq=False)
class RaceGame:
    """Game with one archive on one track, or on any track: the game that an agent is made for."""

    track: Track  #: Track; None for any track, without starts and races.
    archive: PolicyArchive  #: Archive of both players' policies.
    rules: Rules = PAPER  #: Rules of the game.
    #: Planner of car 1 for policies from outside the archive (``reset(opponents=...)``); by default
    #: the archive's planner.
    opponent_planner: Planner | str | None = None
    #: Threads that share the races of a batch; all cores by default. The number does not change the
    #: result.
    threads: int | None = None
    #: Planner of car 0, as ``opponent_planner`` (``reset(egos=...)``).
    ego_planner: Planner | str | None = None
    vehicles: tuple[VehicleParams, ...] = (F1TENTH, F1TENTH)  #: Vehicles of car 0 and car 1.
    #: Car with the max of each delay of the cars in games with their own cars (``conditions``).
    max_delays: VehicleParams = F1TENTH

    def __post_init__(self) -> None:
        axes = self.rules.characteristics
        if axes is not None and axes != self.archive.characteristics:
            object.__setattr__(self, "archive", self.archive.project(axes))
        # Reject unknown planners and a track without start lines here, not when games begin.
        _ = self.rules.end_ticks if self.track is None else self.start_lines

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the fields of the game, not the values derived from them."""
        return RaceGame, tuple(getattr(self, one.name) for one in fields(self))

    def __copy__(self) -> "RaceGame":
        """Return the game itself: it never changes."""
        return self

    def __deepcopy__(self, memo: dict[int, Any]) -> "RaceGame":
        """Return the game itself: it never changes."""
        return self

    # Properties of a game before it begins

    @cached_property
    def setup(self) -> RaceSetup:
        """Track, rules and planners, as input of :func:`pcs_racing.race.driving.advance`."""
        family = self.archive.family()
        first, second = (
            get_planner(planner) if isinstance(planner, str) else planner or family
            for planner in (self.ego_planner, self.opponent_planner)
        )
        return RaceSetup(
            self.track, self.rules.for_game, (first, second), self.vehicles, self.max_delays
        )

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
        return move_table(self.archive, self.rules.epsilon)

    @cached_property
    def points(self) -> Floats:
        """Normalised coordinates of the archive's policies as the players observe them, shape (K,
        G).
        """
        return np.clip(self.archive.normalised, LOW, HIGH)

    @cached_property
    def start_lines(self) -> Floats:
        """Arc lengths of the start lines of :meth:`reset`, m; train places, which no table uses."""
        return start_lines(
            self.track, self.setup.rules, np.random.SeedSequence(0, spawn_key=(0,)), split="train"
        )

    @cached_property
    def identity(self) -> GameIdentity:
        """Identity of the game, with the moves that the rules offer."""
        epsilon = self.rules.epsilon
        return GameIdentity(
            elements=tuple(element.name for element in self.observation_elements),
            moves=self.moves[: self.offered],
            epsilon=epsilon if isinstance(epsilon, tuple) else (epsilon,),
            archive=self.archive.name,
            archive_sha256=self.archive.content_hash,
            rules=self.rules.name,
            decisions=self.rules.moves,
        )

    @property
    def anywhere(self) -> "RaceGame":
        """Game on any track, with the archive's planner."""
        return RaceGame(None, self.archive, self.rules)  # type: ignore[arg-type]

    @cached_property
    def moves(self) -> tuple[str, ...]:
        """Names of the M moves; the last one is "stay"."""
        return move_names(self.archive, self.rules.epsilon)

    def move(self, name: str) -> int:
        """Return the index of a move by its name, with or without spaces."""
        plain = ["".join(one.split()) for one in self.moves]
        wanted = "".join(str(name).split())
        if wanted not in plain:
            raise InputError(f"{name!r} is no move; the moves are {', '.join(self.moves)}")
        return plain.index(wanted)

    @property
    def offered(self) -> int:
        """Number of first moves that the rules offer: all, or all but "stay"."""
        return len(self.moves) - (not self.rules.stay)

    @cached_property
    def observation_elements(self) -> tuple[ObservationElement, ...]:
        """Name, unit, bounds and meaning of each of the D numbers of an observation."""
        rules = self.rules
        return observation_elements(self.characteristics, rules.moves, rules.gives_handicaps)

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
        """Start a batch of games and drive the first step, which the players only watch.

        All random values of a game (start line, side, policies, noise) are a function of its own
        key, for any batch size.

        Parameters
        ----------
        seeds : int or array of int, shape (B,), optional
            Key of each game. By default ``games`` keys (1) are derived from ``seed``.
        games : int, optional
            Number of games, if there are no ``seeds``.
        seed : int
            Root of the keys, if there are no ``seeds``.
        policies : array of int, shape (B, 2) or (2,), optional
            Policies of the cars at the start of each game; -1 draws a policy uniformly from the
            archive.
        starts : Starts, optional
            Start positions of the cars; by default drawn from ``rules.start_lines`` lines
            and both sides.
        opponents : Policy or sequence of B (Policy or None), optional
            Policies of car 1 from outside the archive, all of ``opponent_planner``; the moves of
            car 1 have no effect then.
        egos : Policy or sequence of B (Policy or None), optional
            Policies of car 0 from outside the archive, all of ``ego_planner``; likewise.
        redraw : bool
            Draw a game again (up to 20 times) if it ends by a crash before the first move. A game
            with given start and policies is never drawn again: it is over at once.
        conditions : RaceConditions
            Cars and tracks of single games.
        """
        keys = game_keys(seeds, games, seed)
        count = len(keys)
        first = check_policies(self.archive, policies, count)
        outside, theta = self.outside_planners((egos, opponents), count)
        if starts is not None and len(starts) != count:
            raise InputError(
                f"there are {count} games but {len(starts)} starts; give one start for each game"
            )
        drawn = (first == DRAW) & ~outside
        first[outside] = OUTSIDE

        def begin(rows: Indices, attempt: int) -> GameState:
            bits = random_bits(keys[rows], attempt)
            drawn_policies = (bits[:, 2:4] % np.uint64(len(self.archive))).astype(np.int64)
            policy = np.where(drawn[rows], drawn_policies, first[rows])
            grid = self._starts(bits) if starts is None else starts.take(rows)
            return self.start(
                policy, grid, bits[:, 4], theta[rows], outside[rows], conditions.take(rows)
            )

        state = begin(np.arange(count), 0)
        # A fully specified game would crash again.
        free = drawn.any(axis=1) | (starts is None)
        for attempt in range(1, REDRAWS + 1):
            again = np.flatnonzero(state.race.crashed & free)
            if not redraw or len(again) == 0:
                break
            put_games(state, again, begin(again, attempt))
        return state

    def outside_planners(
        self, given: Sequence[Any], games: int
    ) -> tuple[NDArray[np.bool_], Floats]:
        """Return which cars have policies from outside the archive, and their parameters.

        The shapes are (games, 2) and (games, 2, P).
        """
        drivers = [
            planner_parameters(
                self.archive, self.setup.planners[car], car, drivers, games, self.setup.theta_size
            )
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
        """Put the cars of B games on the grid, and drive the step that the players only watch.

        ``policy``, shape (B, 2), is the index of each car's first policy in the archive, or -1 for
        a policy from ``outside``; ``theta``, of shape (B, 2, P), holds the parameters of the
        latter.
        """
        state = self.empty_state(start_races(self.setup, starts, noise, conditions))
        state.policy[:] = policy
        state.theta[:] = self.theta(policy)
        state.theta[outside] = theta[outside]
        if self.rules.end_ticks[0] > 0:
            estimates = self.drive(state.race, state.theta, conditions)
        else:
            estimates = self.measure(state.race, state.race)
        self.record_step(state, np.arange(len(policy)), estimates)
        return state

    def _starts(self, bits: NDArray[np.uint64]) -> Starts:
        """Return lines and sides from the random bits of games, shape (B, 5)."""
        line = (bits[:, 0] % np.uint64(len(self.start_lines))).astype(np.int64)
        return Starts(self.start_lines[line], (bits[:, 1] % np.uint64(2)).astype(np.int64))

    def grid(
        self,
        key: NDArray[np.uint64],
        noise: NDArray[np.uint64],
        starts: Starts | None = None,
        conditions: RaceConditions = AS_THE_SETUP,
    ) -> RaceState:
        """Return the race on the grid at the start of a game of :meth:`reset` with this key.

        ``noise``, the key of its race's noise, shows how often the game was drawn again; starts and
        conditions are the arguments of :meth:`reset`.
        """
        attempts = [random_bits(key, attempt) for attempt in range(REDRAWS + 1)]
        bits = next(bits for bits in attempts if bits[0, 4] == noise[0])
        return start_races(
            self.setup, self._starts(bits) if starts is None else starts, noise, conditions
        )

    def empty_state(self, races: RaceState) -> GameState:
        """Return games with these races on the grid; every other number is 0."""
        games, steps, axes = races.races, self.rules.moves + 1, len(self.characteristics)
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

    def step(
        self,
        state: GameState,
        actions: ArrayLike,
        conditions: RaceConditions = AS_THE_SETUP,
        *,
        checked: bool = False,
    ) -> GameState:
        """Let both players of every game move, and drive a step.

        Finished games do not change. The given state is not modified.

        Parameters
        ----------
        state : GameState
        actions : array of int, shape (B, 2)
            Index of each car's move among the :attr:`offered` ones; the action of a policy from
            outside the archive has no effect.
        conditions : RaceConditions
            Cars and tracks of single games, as in :meth:`reset`.
        checked : bool
            True for an array of int64 that was checked already, with indices in :attr:`moves`.
        """
        moves = np.asarray(actions)
        if not checked:
            offered = self.moves[: self.offered]
            moves = check_moves(actions, offered, (state.games, 2), ("game", "car"))
        new = state.copy()
        going = ~self.done(state)
        moving = going[:, None] & (state.policy != OUTSIDE)
        # The value looked up for a policy from outside (-1) is not used.
        new.policy[:] = np.where(moving, self.table[state.policy, moves], state.policy)
        new.theta[:] = np.where(moving[..., None], self.theta(new.policy), state.theta)
        new.step[:] = state.step + going
        estimates = self.drive(new.race, new.theta, conditions)
        self.record_step(new, np.flatnonzero(going), estimates)
        return new

    def action_mask(self, state: GameState) -> NDArray[np.bool_]:
        """Return which of the :attr:`offered` moves are allowed, shape (B, 2, offered).

        With ``mask_duplicates`` it excludes moves with the same target as "stay" or an earlier
        move.
        """
        if not self.rules.mask_duplicates:
            return np.ones((state.games, 2, self.offered), np.bool_)
        allowed = ~self._duplicates[state.policy]
        allowed[state.policy == OUTSIDE] = True
        return allowed

    @cached_property
    def _duplicates(self) -> NDArray[np.bool_]:
        if self.offered < len(self.moves):
            return duplicate_moves(self.table[:, : self.offered])
        # "stay" comes last, and stays allowed among the moves that change nothing.
        return np.roll(duplicate_moves(np.roll(self.table, 1, axis=1)), -1, axis=1)

    # End, fault, winner, reward

    def done(self, state: GameState) -> NDArray[np.bool_]:
        """Return whether each game is over, shape (B,): all moves made and driven, or the race
        ended before, by a crash or by its laps.
        """
        return (state.step >= self.rules.moves) | state.race.over

    def fault(self, state: GameState) -> NDArray[np.bool_]:
        """Return whether each car is to blame for the crash that ended its game, shape (B, 2)."""
        return (state.race.fault > 0) & (state.race.crash != NO_CRASH)

    def winner(self, state: GameState) -> NDArray[np.int8]:
        """Return the winner (0 or 1), (B,); -1 for ties, no-contest crashes and running games."""
        over = self.done(state)
        if not over.any():
            return np.full(state.games, -1, np.int8)
        return np.where(over, winners(self.rules, state.race), -1).astype(np.int8)

    def reward(self, state: GameState) -> Floats:
        """Return the reward of each car, shape (B, 2).

        It is 0 while a game is running, then :func:`pcs_racing.game.reward.reward`.
        """
        over, both = self.done(state), np.zeros((state.games, 2))
        if over.any():
            both[:, 0] = np.where(over, reward(self.rules, state.race, state.step), 0.0)
            both[:, 1] = 0.0 - both[:, 0]
        return both

    # Observations

    def observation(self, state: GameState) -> NDArray[np.float32]:
        """Return each player's observation, shape (B, 2, D).

        The numbers are in the order of :attr:`observation_elements`.
        """
        handicaps = state.race.handicap if self.rules.gives_handicaps else None
        return encode_observation(state.own, state.estimates, state.leads, state.step, handicaps)

    # A step of driving

    def drive(
        self, races: RaceState, theta: Floats, conditions: RaceConditions = AS_THE_SETUP
    ) -> Floats:
        """Drive each race in place to the end of its next step; finished races do not change.

        This is the driving part of :meth:`step`, for callers without a :class:`GameState`, such as
        builders of game trees. ``theta``, shape (B, 2, P), holds the parameters of the cars'
        policies. Returns the entry of :attr:`GameState.estimates` for this step, shape (B, 2, G).
        """
        before = races._replace(
            progress=races.progress.copy(), sums=races.sums.copy(), tick=races.tick.copy()
        )
        ends = self.rules.end_ticks
        lengths = (
            np.append(ends, ends[-1])[np.searchsorted(ends, races.tick, side="right")] - races.tick
        )
        lengths[races.over] = 0
        different = np.unique(lengths[lengths > 0])
        for ticks in different.tolist():
            if len(different) == 1:
                # Steps of a usual batch are equally long: no races are taken out and put back.
                # Finished races do not move.
                advance(
                    self.setup, races, theta, ticks, threads=self.threads, conditions=conditions
                )
                break
            rows = np.flatnonzero(lengths == ticks)
            some, own = take(races, rows), conditions.take(rows)
            advance(self.setup, some, theta[rows], ticks, threads=self.threads, conditions=own)
            for name, driven in some._asdict().items():
                getattr(races, name)[rows] = driven
        return self.measure(before, races)

    def record_step(self, state: GameState, rows: Indices, estimates: Floats) -> None:
        """Write, in place, the observable values of the last step of some games.

        The estimates, of shape (B, 2, G), are the result of :meth:`measure`.
        """
        now = state.step[rows]
        estimates = estimates[rows]
        state.estimates[rows, :, now] = estimates
        state.own[rows, :, now] = np.where(
            state.policy[rows, :, None] != OUTSIDE, self.points[state.policy[rows]], estimates
        )
        state.leads[rows, now] = state.race.lead[rows]

    def measure(self, before: RaceState, after: RaceState) -> Floats:
        """Return the cars' measured coordinates (normalised) over one step, shape (B, 2, G)."""
        segment = Segment.between(before, after, self.rules.step_seconds)
        so_far = Segment.so_far(after, self.rules.step_seconds)
        points = self.archive.normalise(measure(segment, self.characteristics, so_far))
        return np.minimum(np.maximum(points, LOW), HIGH)  # in a third of the time of np.clip

    def theta(self, policies: Indices) -> Floats:
        """Return the parameters (..., P) of archive policies for the simulator."""
        return self._theta[policies]
