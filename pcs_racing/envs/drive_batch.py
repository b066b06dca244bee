"""Batch of control-level races, advanced together, for the Drive environments."""

from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.compilation import first_call
from pcs_racing.base.errors import InputError, all_finite, check_whole
from pcs_racing.base.numba_parts import compiled_address, compiled_for
from pcs_racing.car.vehicle import half_sizes
from pcs_racing.envs.batch import (
    FREE,
    BatchStep,
    Generators,
    Rows,
    check_batch_size,
    check_part,
    check_races,
    check_weights,
    check_within,
    draw_opponent,
    obstacles_option,
    place_poses,
    poses_option,
    start_option,
    weights_of,
)
from pcs_racing.envs.drive_kernel import (
    Inputs,
    Orders,
    Races,
    RewardTerms,
    StepResults,
    eyes_for,
    make_buffers,
    observe_races,
    set_commands,
    step_races,
)
from pcs_racing.envs.drive_options import (
    DriveOptions,
    drive_arguments,
    drive_elements,
    make_sight,
    rivals_of,
    samples_ahead,
    shares,
)
from pcs_racing.envs.infos import (
    Result,
    all_poses,
    common_codes,
    pose_info,
    race_info,
    race_infos,
    race_results,
)
from pcs_racing.envs.origins import mark
from pcs_racing.envs.randomization import EpisodeRandomization
from pcs_racing.race.conditions import RaceConditions, Share, runs_of
from pcs_racing.race.config import DT, load_rules
from pcs_racing.race.driving import (
    advance,
    default_threads,
    largest_scratch,
    planner_error,
    pointers_of,
)
from pcs_racing.race.kernel import (
    WORK_SIZE,
    Crew,
    KernelSettings,
    Scratch,
    advance_races,
    parts_for,
)
from pcs_racing.race.races import (
    RaceSetup,
    draw_handicaps,
    start_lines,
    start_races,
    winners,
)
from pcs_racing.race.start_grid import Starts, places_of_grid, settle
from pcs_racing.race.state import LAPS, RaceState, take
from pcs_racing.track.track import Track

if TYPE_CHECKING:  # so that a car without opponents loads none of them
    from pcs_racing.envs.opponents import MovingOpponents, Opponent
    from pcs_racing.game.rules import RaceGame
    from pcs_racing.planners.planner import Planner
    from pcs_racing.race.rendering import Renderer

US_OF_A_THREAD = 250.0  # min work of a thread in a step, us; less is not worth a handover
TICK_US, SCAN_US, BEAM_US = 0.5, 2.5, 0.005  # approximate times of a tick, a scan and a beam
MAX_NUMBERS = 250_000_000  # max size of all observations together: 1 GB
KEPT = 64  # number of cached tracks without a race


@dataclass(frozen=True, eq=False)
class DriveRules:
    """Everything about a batch of races that never changes."""

    #: Opponents of each car without an agent; one is drawn for each episode.
    rivals: "tuple[list[Opponent], ...]"
    planners: "tuple[tuple[Planner, ...], ...]"  #: Planner of each opponent in ``rivals``.
    game: "RaceGame | None"  #: Game of the opponents that make moves; None if there are none.
    setup: RaceSetup  #: Rules, planners and cars, on the first track.

    @property
    def opponents(self) -> "list[Opponent]":
        """Opponents of the only car without an agent; with several such cars none is drawn."""
        return self.rivals[0] if len(self.rivals) == 1 else []


def race_rules(
    options: Any,
    players: int,
    randomization: EpisodeRandomization,
    driver: "Planner | None" = None,
    like: Mapping[str, Any] | None = None,
) -> DriveRules:
    """Return the rules of a batch of races; load planners, models and archives of opponents.

    ``driver`` is the planner of the agents' cars; None if agents steer. ``like`` are the arguments
    of models without their own.
    """
    given = rivals_of(options.opponent, options.opponents)
    cars, track = players + len(given), randomization.circuits.track(0)
    changes = {name: getattr(options, name) for name in ("start_lines", "duration", "laps")}
    changes = {name: value for name, value in changes.items() if value is not None}
    config = load_rules(options.rules, **changes)

    def make_game() -> "RaceGame":
        from pcs_racing.game.archive_files import load_archive
        from pcs_racing.game.rules import RaceGame
        from pcs_racing.race.config import load_rules

        rules = load_rules(options.rules)
        return RaceGame(
            track, load_archive(options.archive), rules, vehicles=randomization.cars[:2]
        )

    rivals: tuple[list[Opponent], ...] = ()
    if given:
        from pcs_racing.envs.opponents import read_opponents

        rivals = tuple(read_opponents(one, cache(make_game), like) for one in given)
    moving = any(not one.policies for several in rivals for one in several)
    if (cars > 2 and moving) or (len(rivals) > 1 and any(len(several) > 1 for several in rivals)):
        raise InputError(
            f"opponents is {list(given)!r:.120}; in a race of {cars} cars each is one"
            " planner, no list, and none makes moves"
        )
    game = make_game() if moving else None
    # Agents of the game of moves drive with the planner of its archive.
    planners = [[one.planner or game.archive.family() for one in several] for several in rivals]  # type: ignore[union-attr]
    setup = RaceSetup(
        track,
        config,
        (() if driver is None else (driver,) * players) + tuple(several[0] for several in planners),
        randomization.cars,
        # The queue of delayed commands has the size of the max delays, for all episodes.
        randomization.ranges.max_delays,
        steered=players if driver is None else 0,
        substitutes=tuple(one for several in planners for one in several[1:]),
    )
    return DriveRules(
        rivals=rivals,
        planners=tuple(map(tuple, planners)),
        game=game,
        setup=setup,
    )


def _move_opponents(races: int, game: "RaceGame") -> "MovingOpponents":
    """Return the opponents that make moves in so many races."""
    from pcs_racing.envs.opponents import MovingOpponents

    return MovingOpponents(races, game)


class Circuit(NamedTuple):
    """A track, with the data shared by all races on it."""

    setup: RaceSetup
    grid: RaceState  #: Races at all start places of episodes.
    inputs: Any  #: Inputs of the kernels, for races without obstacles.


class DriveBatch:
    """Batch of races; agents drive the first ``players`` cars of each race, opponents the others.

    Up to ``threads`` threads share a step (default: the number of cores). ``rules`` never change;
    the state of the batch is in ``races``, ``drawn``, ``randomization`` and the games of opponents
    that make moves.
    """

    reset_options: tuple[str, ...] = ("start", "poses", "obstacles")  #: Options of :meth:`restart`.
    step_kernel: ClassVar[Any] = step_races
    observe_kernel: ClassVar[Any] = observe_races
    driver: "ClassVar[Planner | None]" = None  #: Planner of the agents' cars, unless they steer.
    action_dtype: ClassVar[Any] = np.float64
    noun: ClassVar[str] = "the control-level environment"
    options: Any  #: Arguments of the environment.
    elements: list[Any]  #: Elements of an observation.
    sight: Any  #: Observation of the players.
    terms: Any  #: Terms of the reward.
    kept: tuple[NDArray[Any], ...] = ()  #: Further arrays of the batch's state.

    def __init__(
        self,
        episodes: int,
        options: DriveOptions,
        *,
        threads: int | None = None,
        players: int = 1,
    ) -> None:
        check_batch_size(episodes, threads)
        self.episodes, self.players, self.options = int(episodes), players, options
        self.cars = players + len(rivals_of(options.opponent, options.opponents))
        self.randomization = EpisodeRandomization(self.episodes, options, cars=self.cars)
        # Actions, observations and saved models follow from the agents' cars alone.
        self.rules = self._make_rules(replace(options, vehicle=self.randomization.widest(players)))
        self.setup, self.opponents = self.rules.setup, self.rules.opponents
        if self.episodes * players * len(self.elements) > MAX_NUMBERS:
            raise InputError(
                f"{self.episodes * players} environments observe {len(self.elements)} numbers each;"
                f" take fewer environments or beams: {MAX_NUMBERS} numbers are the limit"
            )
        self.handicaps = self.setup.rules.gives_handicaps
        #: Number of steps of an episode without an early end.
        self.horizon = -(-self.setup.rules.ticks // options.ticks)
        #: Number of steps in a second of racing.
        self.frame_rate = max(1, round(1.0 / (options.ticks * DT)))
        self.codes: Mapping[str, Mapping[int, str]] = {
            **common_codes(opponent.name for opponent in self.opponents),
            **self.randomization.codes,
        }
        self.observation_space, self.action_space = self._make_spaces()
        self._begin()
        self._hire(threads)

    @property
    def effort(self) -> float:
        """Effort of the compilation of the observation, in the unit of `first_call`."""
        return 100.0 * (self.options.beams > 0)

    def _make_rules(self, options: DriveOptions) -> DriveRules:
        """Return the rules; set the elements, the observation and the reward."""
        arguments = drive_arguments(options, self.cars)
        like = {"environment": "drive", **arguments}
        rules = race_rules(options, self.players, self.randomization, self.driver, like)
        self._arguments, self.limits = arguments, options.limits
        self.elements = drive_elements(options, self.cars)
        # `ahead` depends on the track.
        sight = make_sight(options, self.cars, self.players, rules.setup.track)
        self.sight = sight._replace(end_tick=rules.setup.rules.ticks)
        weights = options.progress_reward, options.rivalry, options.crash_penalty
        self.terms = RewardTerms(
            weights=(float(weights[0]), float(weights[1]), float(weights[2])),
            decided=options.win_reward > 0.0,
        )
        return rules

    def _make_spaces(self) -> tuple[spaces.Space[Any], spaces.Space[Any]]:
        """Return the spaces of observations and actions."""
        sight = self.sight
        low, high = (bound * sight.gain + sight.shift for bound in (sight.low, sight.high))
        turn, low_speed, top = self.limits
        units = [[-turn, low_speed], [turn, top]]
        whole = [[-1.0, -1.0], [1.0, 1.0]]
        ends = np.array(whole if self.options.normalized else units, np.float32)
        seen = spaces.Box(low.astype(np.float32), high.astype(np.float32), dtype=np.float32)
        acts = spaces.Box(ends[0], ends[1], dtype=np.float32)
        return mark(seen, "drive", self._arguments), mark(acts, "drive", self._arguments)

    def _make_circuit(self, number: int) -> Circuit:
        """Return the data of a track, on whose grid all drawn cars fit."""
        track = self.randomization.circuits.track(number)
        setup = replace(self.setup, track=track)
        lines = start_lines(track, setup.rules, 0, split="train")
        self.randomization.check_bodies(setup, lines)
        count = places_of_grid(self.cars)
        places = Starts(np.repeat(lines, count), np.tile(np.arange(count), len(lines)))
        grid = start_races(setup, places, np.zeros(len(places), np.uint64))
        settings = setup.settings
        # Time to collision is slow to compute; only opponents that observe characteristics need it.
        if self.rules.game is None:
            settings = settings._replace(ittc_horizon=0.0)
        return Circuit(setup, grid, self._make_inputs(track, settings))

    def _make_inputs(self, track: Track, settings: KernelSettings) -> Any:
        """Return the inputs of the kernels on a track."""
        sight = self.sight._replace(ahead=samples_ahead(self.options, track))
        return Inputs(track.arrays, settings, sight)

    def _begin(self) -> None:
        """Make the state: a race on the first start place of the first track for each episode."""
        races, randomization, opponents = self.episodes, self.randomization, self.opponents
        #: Data of the tracks by number. At most as many tracks are in use as there are races.
        self.circuit = lru_cache(maxsize=KEPT + races)(self._make_circuit)
        circuit = self.circuit(0)
        self._inputs = [circuit.inputs] * races  # inputs of each race
        self._uniform = not randomization.circuits.several  # False from the first obstacle on
        #: State, policies and cars of all races; `restart` and `step` write to their arrays.
        self.races = Races(
            take(circuit.grid, np.zeros(races, np.intp)),
            np.zeros((races, self.cars, self.setup.theta_size)),
            randomization.vehicles,
        )
        self.state, self.theta, _ = self.races
        self.drawn = np.zeros(races, np.int64)  #: Index of each race's opponent.
        self.weights = weights_of(opponents)  #: Weights of the opponents in the draw.
        #: shape (races, cars): Faults before the last step, except a race-ending fault.
        self._paid = np.zeros((races, self.cars), np.int8)
        #: shape (races, cars): Planner of each car, None for an agent's car.
        self._planners = np.full((races, self.cars), None, np.object_)
        self._planners[:] = self.setup.car_planners
        self._several = len({id(one) for own in self.rules.planners for one in own}) > len(
            self.rules.planners
        )
        self._moving = None if self.rules.game is None else _move_opponents(races, self.rules.game)
        self._rows = np.arange(races)

    def _hire(self, threads: int | None) -> None:
        """Start the threads that share a step, each with enough work, and compile the step."""
        planners, options = [one for own in self.rules.planners for one in own], self.options
        self._in_python = any(planner.drive is not None for planner in planners)
        work = self.episodes * (0.5 * max(2, self.cars) * TICK_US * options.ticks + self._look_us())
        #: Number of threads that share a step.
        self.threads = min(threads or default_threads(), max(1, int(work / US_OF_A_THREAD)))
        if self._in_python:
            self.threads = 1
        size = largest_scratch(planners)
        self._buffers = [self._make_buffers(size) for _ in range(self.threads)]
        self._pool = ThreadPoolExecutor(max(1, self.threads - 1))  # starts threads on demand
        self._compiled: Callable[..., None] | None = None
        effort = 160.0 + 200.0 * bool(planners) + self.effort
        with first_call(self.step_kernel, self.noun, effort) as compiling:
            for planner in planners:  # all that may be drawn
                planner.pointers()
            self._pointers = pointers_of(self._shares(), self.episodes)
            self._obstructed = False
            self._equip(self._rows)
            inputs, buffers = self._inputs[0], self._buffers[0]
            own = Scratch(buffers.scratch, buffers.work)
            self._advance = compiled_address(
                advance_races, inputs.track, self.races, inputs.settings, self._crew, 0, 0, 0, own
            )
            self._compile()
            if compiling:
                shape = self.episodes, self.players, *(self.action_space.shape or ())
                actions = np.zeros(shape, self.action_dtype)
                self._step_part(self._orders(actions, 0), 0, 0, 0, self._results())

    def _make_eyes(self, inputs: Any, moving: bool) -> Any:
        """Return the kernels that observations need; ``moving``: obstacles move."""
        return eyes_for(inputs, self.races, self._buffers[0], moving)

    def _look_us(self) -> float:
        """Return the time of the observations of a race, us."""
        beams = self.options.beams
        return self.players * (SCAN_US + BEAM_US * beams) if beams > 0 else 0.0

    def _make_buffers(self, scratch: int) -> Any:
        """Return the scratch memory of a thread, with the given size for planners."""
        return make_buffers(scratch, WORK_SIZE, len(self.elements), self.cars)

    def _compile(self) -> None:
        """Compile the observation."""
        inputs, buffers, seen = self._inputs[0], self._buffers[0], self._results().observations
        self._observe = compiled_address(
            self.observe_kernel, inputs, self.races, self._eyes, self._rows, 0, 0, buffers, seen
        )

    def _equip(self, rows: Rows) -> None:
        """Compile the kernels that the races need, after changes to cars or tracks of some."""
        tracks = [self._inputs[row].track for row in rows]
        self._obstructed = self._obstructed or any(len(track.moving) for track in tracks)
        inputs, races, moving = self._inputs[0], self.races, self._obstructed
        parts = parts_for(inputs.settings, races.vehicles, moving)
        self._crew = Crew(self._pointers, parts)
        self._eyes = self._make_eyes(inputs, moving)

    @property
    def track(self) -> Track:
        """Track of the first race."""
        return self.randomization.track(0)

    def value(self) -> RaceState:
        """Return the state of the races."""
        return self.state

    def restart(self, rows: Rows, generators: Generators, options: Mapping[str, Any] = {}) -> None:
        """Begin new episodes in some races, with options for each or for all.

        Each episode is drawn from its own generator.

        :class:`pcs_racing.envs.drive.DriveEnv` describes the options.
        """
        count = len(rows)
        starts, poses = (
            start_option(options, count, self.cars),
            poses_option(options, count, self.cars),
        )
        if starts is not None and poses is not None:
            raise InputError(
                "reset options 'start' and 'poses' were both given; give one of the two"
            )
        boxes = obstacles_option(options, len(rows))
        self.randomization.draw(rows, generators)
        groups = [(self.circuit(number), some) for number, some in self.randomization.groups(rows)]
        places, seeds, at = (
            np.zeros(count, np.int64),
            np.zeros(count, np.uint64),
            np.zeros((count, self.cars)),
        )
        grids: list[RaceState] = []
        # The order of draws does not depend on the options, so a seed gives the same episode.
        for circuit, some in groups:
            grid = circuit.grid
            if starts is not None:
                grid = start_races(circuit.setup, starts.take(some), np.zeros(len(some), np.uint64))
            elif poses is not None:
                grid = place_poses(circuit.setup, poses[some])
            for k, i in enumerate(some):
                generator = generators[i]
                places[i] = generator.integers(circuit.grid.races)
                self._draw_opponent(int(rows[i]), generator)
                seeds[i] = generator.integers(2**64, dtype=np.uint64)
                # Cars placed by options have their own row instead of a place on the grid.
                if grid is not circuit.grid:
                    places[i] = k
            at[some] = grid.frenet[places[some], :, 0]
            grids.append(grid)
        self.randomization.place_obstacles(rows, at, generators, boxes)
        # Check before anything is written: a refused reset leaves the races unchanged.
        given = starts is not None or poses is not None
        if boxes is not None or (given and self.randomization.draws_bodies):
            where = "one of the obstacles" if boxes is not None else "a wall or in another car"
            for (circuit, some), grid in zip(groups, grids, strict=True):
                self._check_clear(circuit.setup, rows[some], take(grid, places[some]), where)
        for (circuit, some), grid in zip(groups, grids, strict=True):
            self._set_inputs(rows[some], circuit.inputs)
            begun = take(grid, places[some])._replace(seed=seeds[some])
            if self.handicaps:
                front = begun.handicap > 0.0
                begun = begun._replace(handicap=draw_handicaps(self.setup.rules, front, begun.seed))
            for name, own in self.state._asdict().items():
                own[rows[some]] = getattr(begun, name)
        self._equip(rows)
        if self._moving is not None:
            self._moving.restart(rows, self.state, self.theta)

    def _check_clear(
        self, setup: RaceSetup, rows: NDArray[np.int64], placed: RaceState, where: str
    ) -> None:
        """Refuse given obstacles, starts and poses with a drawn car that starts in something."""
        settle(setup.track, setup.vehicles, placed, self.randomization.conditions(rows))
        wrong = np.flatnonzero(placed.crashed)
        if len(wrong):
            raise InputError(f"episode {rows[wrong[0]]}: a car starts in {where}")

    def _set_inputs(self, rows: Rows, inputs: Inputs) -> None:
        """Set the kernel inputs of some races on the same track."""
        for row in rows:
            arrays = self.randomization.track(int(row)).arrays
            # Races with obstacles have their own arrays and are stepped separately.
            own = arrays is not inputs.track
            self._inputs[row] = inputs._replace(track=arrays) if own else inputs
            self._uniform &= not own

    def set_opponent(self, index: int, policy: Any) -> None:
        """Replace one of the opponents by another policy of its planner."""
        from pcs_racing.planners.racers import policy_racer

        if not self.opponents:
            raise InputError("only an opponent that is drawn for each episode can be replaced")
        check_whole("index", index, 0, len(self.opponents) - 1)
        old, new = self.opponents[index], policy_racer(policy)
        if new.planner != old.planner:
            raise InputError(
                f"opponent {index} is {new.name!r}, a policy of {new.planner.name!r}; only another"
                f" policy of {old.name!r}'s planner can replace it"
            )
        self.opponents[index] = replace(old, policies=(new,))

    def _draw_opponent(self, row: int, generator: np.random.Generator) -> None:
        # Equal weights draw a whole number, others a share; the draw is part of a seed's meaning.
        if (self.weights == self.weights[0]).all():
            self.drawn[row] = generator.integers(len(self.weights))
        else:
            self.drawn[row] = draw_opponent(self.weights, generator)
        for car, rivals in enumerate(self.rules.rivals, self.players):
            # With several opponent cars, each has a single opponent.
            opponent = rivals[self.drawn[row] if self.opponents else 0]
            policy = opponent.draw_policy(generator)
            self.theta[row, car] = 0.0
            if policy is not None:
                self.theta[row, car, : len(policy.parameters)] = policy.parameters
            if self._moving is not None:
                self._moving.draw(row, opponent, generator)
        self._seat(row)

    def _seat(self, row: int) -> None:
        """Give the car of a race's opponent to the drawn planner, which drives to the end."""
        if self._several:
            planner = self.rules.planners[0][self.drawn[row]]
            self._planners[row, self.players] = planner
            self._pointers[self.players][row] = planner.pointers()

    def _shares(self) -> list[Share]:
        return RaceConditions(planners=self._planners).shares(
            self.setup.car_planners, self.episodes
        )

    def observe(self, rows: NDArray[np.int64], out: NDArray[np.float32]) -> None:
        """Write the observations of some races' players to their rows of ``out``.

        ``out`` has the shape (B * players, n).
        """
        self._see(rows, self.players, out)

    def both_views(self) -> NDArray[np.float32]:
        """Return the observation of each car of every race, shape (B, cars, n).

        Cars of opponents are observed as if a player drove them.
        """
        out = np.empty((self.cars * self.episodes, len(self.elements)), np.float32)
        self._see(self._rows, self.cars, out)
        return out.reshape(self.episodes, self.cars, -1)

    def _see(self, rows: NDArray[np.int64], players: int, out: NDArray[np.float32]) -> None:
        inputs = [self._inputs[row] for row in rows]
        seen = np.empty((len(rows), players, out.shape[1]), np.float32)
        for first, last in runs_of(inputs):
            part = seen[first:last].reshape(-1, out.shape[1])
            self._see_run(inputs[first], rows[first:last], players, part)
        out.reshape(-1, players, out.shape[1])[rows] = seen

    def _see_run(self, inputs: Any, rows: Rows, players: int, out: NDArray[np.float32]) -> None:
        """Write the observations of races on one track as successive rows of ``out``."""
        own = inputs, self.races, self._eyes, rows, 0, players, self._buffers[0], out
        type(self).observe_kernel(*own)

    def check_actions(self, actions: ArrayLike, shape: tuple[int, ...]) -> NDArray[np.float64]:
        """Return actions as float64 of shape (B, players, 2).

        The error for invalid actions names the problem and the environment.
        """
        wanted = (*shape, 2)
        try:
            if np.iscomplexobj(actions):
                raise TypeError  # numpy would drop the imaginary part
            values = np.array(actions, dtype=np.float64, order="C")
        except (TypeError, ValueError) as error:
            raise InputError(
                f"action {actions!r:.80} must be numbers of shape {wanted}: steering and speed"
            ) from error
        if values.shape != wanted:
            raise InputError(
                f"action has shape {values.shape}; it must be {wanted}: steering and speed in"
                " [-1, 1]"
            )
        values = values.reshape(self.episodes, self.players, 2)
        if not all_finite(values):
            rows = values.reshape(-1, 2)
            i = int(np.flatnonzero(~np.isfinite(rows).all(axis=1))[0])
            where = f" of environment {i}" if shape else ""
            raise InputError(
                f"action{where} is {rows[i].tolist()}; steering and speed must be finite, in"
                " [-1, 1]"
            )
        return values if self.options.normalized else shares(values, self.limits)

    def step(self, actions: NDArray[np.float64], generators: Generators = ()) -> BatchStep:
        """Advance every race by one step."""
        races, ticks, results = self.episodes, self.options.ticks, self._results()
        if self._in_python:
            # The kernel then only computes rewards and observations: 0 ticks.
            self._command(actions)
            self._advance_in_python(ticks)
            ticks = 0
        orders = self._orders(actions, ticks)
        if self.threads == 1:
            self._step_part(orders, 0, races, 0, results)
        else:
            edges = [races * k // self.threads for k in range(self.threads + 1)]
            parts = [
                self._pool.submit(self._step_part, orders, edges[k], edges[k + 1], k, results)
                for k in range(1, self.threads)
            ]
            # This thread does the first part: waking another takes as long as stepping some races.
            self._step_part(orders, 0, edges[1], 0, results)
            for part in parts:
                part.result()
        if self.terms.decided and self.cars > 1:
            self._pay_winners(results)
        if self._moving is not None:
            self._moving.move(self.state, self.theta, self.opponents, self.drawn)
        return BatchStep(
            results.observations, results.reward, results.terminated, results.truncated
        )

    def _pay_winners(self, results: StepResults) -> None:
        """Add the reward of a win, or of a defeat, in races that are over."""
        rows = np.flatnonzero((results.terminated | results.truncated)[:: self.players])
        if len(rows):
            winner = winners(self.setup.rules, take(self.state, rows))[:, None]
            won = np.where(winner == np.arange(self.players), 1.0, -1.0) * (winner >= 0)
            rewards = results.reward.reshape(-1, self.players)
            rewards[rows] += self._win_rewards(rows) * won

    def _win_rewards(self, rows: Rows) -> Any:
        """Return the rewards of wins in some races, for all players or shape (n, players)."""
        return float(self.options.win_reward)

    def _command(self, actions: NDArray[np.float64]) -> None:
        """Give the actions to the cars of all races."""
        set_commands(actions, self.limits, self.races, 0, self.episodes)

    def _orders(self, actions: NDArray[Any], ticks: int) -> Any:
        return Orders(
            self._advance,
            self._observe,
            self._crew,
            self._eyes,
            self._rows,
            ticks,
            actions,
            self.limits,
            self.terms,
        )

    def _results(self) -> StepResults:
        count = self.episodes * self.players
        ended, late = np.empty(count, np.bool_), np.empty(count, np.bool_)
        observations = np.empty((count, len(self.elements)), np.float32)
        if self.setup.rules.contact != "end":
            self._paid[:] = self.state.fault
        return StepResults(
            self.state.progress.copy(), self._paid, np.empty(count), ended, late, observations
        )

    def _step_part(
        self, orders: Any, first: int, last: int, worker: int, results: StepResults
    ) -> None:
        """Step a part of the races, on one thread."""
        # One kernel call steps a run of consecutive races on the same track.
        one = self._uniform or first == last
        runs = [(0, last - first)] if one else runs_of(self._inputs[first:last])
        buffers = self._buffers[worker]
        for low, high in runs:
            inputs = self._inputs[first + low]
            arguments = inputs, self.races, orders, first + low, first + high, buffers, results
            # Looked up once: finding the machine code by all argument types is slower than a step.
            if self._compiled is None:
                self._compiled = compiled_for(self.step_kernel, arguments)
            try:
                self._compiled(*arguments)
            except Exception as error:
                raise planner_error(error, self._shares(), buffers.work) from error

    def _advance_in_python(self, ticks: int) -> None:
        """Advance every race against an opponent in plain Python."""
        circuits = self.randomization.circuits.number
        for first, last in runs_of(circuits.tolist()):
            part = RaceState._make(array[first:last] for array in self.state)
            conditions = replace(
                self.randomization.conditions(np.arange(first, last)),
                planners=self._planners[first:last] if self._several else None,
            )
            setup = self.circuit(int(circuits[first])).setup
            advance(setup, part, self.theta[first:last], ticks, conditions=conditions)

    def infos(self) -> dict[str, NDArray[Any]]:
        """Return the infos of all players, described in :mod:`pcs_racing.envs.infos`."""
        opponents = self.drawn if self.opponents else np.full(self.episodes, -1)
        return {
            **race_infos(self.state, self.players, self.state.fault > self._paid, self.handicaps),
            **all_poses(self.state.cars, self.players),
            "result": self._outcomes().reshape(-1),
            "opponent": np.repeat(opponents, self.players),
            **self.randomization.infos(self.players),
        }

    def _outcomes(self) -> NDArray[np.int64]:
        """Return the result of each race for each player, shape (B, players).

        A single car wins if it reaches the end; in a race with laps it loses without all laps.
        """
        state, config = self.state, self.setup.rules
        result = np.zeros((self.episodes, self.players), np.int64)
        # In most steps no race is over, and the winners are not needed.
        over = state.over | (state.tick >= config.ticks)
        if not over.any():
            return result
        rows = np.flatnonzero(over)
        ended = take(state, rows)
        if self.cars == 1:
            done = config.laps is None or np.isfinite(ended.finish_time[:, 0])
            driven = np.where(done, Result.WIN, Result.LOSS)
            result[rows, 0] = np.where(ended.crashed, Result.CRASH, driven)
            return result
        result[rows] = race_results(winners(config, ended), ended.crashed, self.players)
        return result

    def info(self, environment: int) -> dict[str, Any]:
        """Return the info of one player as plain numbers; faster than arrays of length one."""
        race, car = divmod(environment, self.players)
        blamed = self.state.fault.item(race, car) > self._paid.item(race, car)
        info = race_info(self.state, race, car, blamed, self.handicaps)
        over = (
            any(self.state.crash[race].tolist())
            or self.state.tick.item(race) >= self._inputs[race].settings.end_tick
        )
        if (laps := self.setup.rules.laps) is not None:
            over = over or self.state.laps[race, :, LAPS].max() >= laps
        info["result"] = int(self._outcomes()[race, car]) if over else int(Result.RUNNING)
        info["opponent"] = self.drawn.item(race) if self.opponents else -1
        cars = self.state.cars[race]
        info |= pose_info(
            cars
            if car == 0
            else np.concatenate([cars[car : car + 1], np.delete(cars, car, axis=0)])
        )
        info |= self.randomization.info(race, car)
        return info

    def draw(self, renderer: "Renderer", environment: int) -> NDArray[np.uint8] | None:
        """Draw the current state of a race."""
        race = environment // self.players
        cars = self.state.cars[race]
        info = self.info(race * self.players)
        text = f"{info['time']:.1f} s    {info['progress']:.1f} m"
        names = [f"car_{car}" for car in range(self.players)] if self.players > 1 else ["you"]
        names += [rivals[max(info["opponent"], 0)].name for rivals in self.rules.rivals]
        if self.cars > 1:
            text += f"    lead of {names[0]} {info['lead']:+.1f} m"
        steered = self.setup.steered
        plans = [np.full((1, 2), np.nan)] * steered + list(self.state.path[race, steered:])
        renderer.show(self.randomization.track(race), half_sizes(self.races.vehicles[race]))
        return renderer.render(
            cars,
            plans=plans if self.cars > steered else None,
            names=names,
            text=text,
            time=info["time"],
        )

    def get_state(self) -> tuple[Any, ...]:
        """Return copies of the races, of the opponents' indices, parameters, moves, weights, of the
        faults before the last step, and of `kept`.
        """
        moving = None if self._moving is None else self._moving.get_state()
        return (
            self.state.copy(),
            self.drawn.copy(),
            self.theta.copy(),
            moving,
            self.randomization.get_state(),
            self.weights.copy(),
            self._paid.copy(),
            tuple(array.copy() for array in self.kept),
        )

    def check_state(self, state: tuple[Any, ...]) -> list[Track]:
        """Refuse a state that `get_state` can't have returned.

        Return the track of each race, with its obstacles.
        """
        moving = None if self._moving is None else FREE
        mine = self.state, self.drawn, self.theta, moving, FREE, self.weights, self._paid
        check_part("the state", state, (*mine, self.kept))
        check_weights(state[5], self.weights)
        tracks = self.randomization.check_state(state[4])
        lengths = np.array([track.length for track in tracks])
        check_races("the state's races", state[0], self.setup.rules, lengths)
        check_within("the state's opponents", state[1], 0, max(1, len(self.opponents)) - 1)
        if self._moving is not None:
            self._moving.check_state(state[3], lengths)
        return tracks

    def set_state(self, state: tuple[Any, ...]) -> None:
        """Continue from a state of `get_state`, from this or an equal batch."""
        tracks = self.check_state(state)
        races, drawn, theta, moving, randomization, weights, paid, kept = state
        self.randomization.set_state(randomization, tracks)
        for number, rows in self.randomization.groups(self._rows):
            self._set_inputs(rows, self.circuit(number).inputs)
        # Copy into the own arrays: the given state stays unchanged.
        for name, own in self.state._asdict().items():
            own[...] = getattr(races, name)
        self.drawn[:], self.theta[:], self.weights = drawn, theta, weights.copy()
        self._paid[:] = paid
        for array, value in zip(self.kept, kept, strict=True):
            array[:] = value
        for row in range(self.episodes):
            self._seat(row)
        self._equip(self._rows)
        if self._moving is not None:
            self._moving.set_state(moving)

    def close(self) -> None:
        """Free the threads."""
        self.randomization.circuits.close()
        self._pool.shutdown()
        self.threads = 1  # a step is still possible
