"""Batch of control-level races, advanced together, for the Drive environments."""

from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.checks import all_finite
from pcs_racing.base.compilation import compiled_for, first_call
from pcs_racing.base.errors import InputError
from pcs_racing.car.lidar import WORK_SHAPE
from pcs_racing.envs.batch import (
    FREE,
    BatchStep,
    Generators,
    Rows,
    check_batch_size,
    check_part,
    check_races,
    check_within,
    place_poses,
    poses_option,
    start_option,
)
from pcs_racing.envs.drive_kernel import (
    SEEN_SHAPE,
    Sight,
    StepResults,
    observe_races,
    restart,
    set_commands,
    step_races,
)
from pcs_racing.envs.drive_options import (
    DriveOptions,
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
from pcs_racing.envs.obstacles import obstacles_option
from pcs_racing.envs.opponents import (
    MovingOpponents,
    draw_opponent,
    drive_opponents,
    shared_planner,
)
from pcs_racing.envs.randomization import EpisodeRandomization
from pcs_racing.game.archive_files import load_archive
from pcs_racing.game.config import load_game_config
from pcs_racing.game.rules import RaceGame
from pcs_racing.planners.planner import Planner
from pcs_racing.planners.pursuit import COMMAND_SLOTS, hold_command, leave_path
from pcs_racing.race.conditions import runs_of
from pcs_racing.race.config import load_race_config
from pcs_racing.race.driving import default_threads, drive, driver_error, pointers_of
from pcs_racing.race.kernel import WORK_SIZE, KernelSettings
from pcs_racing.race.races import RaceSetup, start_lines, start_races, winners
from pcs_racing.race.rendering import Renderer, half_sizes
from pcs_racing.race.start_grid import Starts, places_of_grid, settle
from pcs_racing.race.state import LAPS, RaceState, take
from pcs_racing.track.frenet import TrackArrays
from pcs_racing.track.track import Track

EXTERNAL = Planner("external", (), leave_path, hold_command, memory_size=COMMAND_SLOTS)
"""Planner of a car driven from outside; its memory holds the target steering angle and speed."""

US_OF_A_THREAD = 250.0  # min work of a thread in a step, us; less is not worth a handover
TICK_US, SCAN_US, BEAM_US = 0.5, 2.5, 0.005  # approximate times of a tick, a scan and a beam
MOST_NUMBERS = 250_000_000  # max size of all observations together: 1 GB
KEPT = 64  # number of cached tracks without a race


class KernelInputs(NamedTuple):
    """Inputs of the kernel for a run of races: track, rules, and the players' observation."""

    arrays: TrackArrays
    settings: KernelSettings
    sight: Sight


class CircuitSetup(NamedTuple):
    """A track, with the data shared by all races on it."""

    setup: RaceSetup
    grid: RaceState  #: Races at all start places of episodes.
    inputs: KernelInputs  #: Inputs of races without obstacles.


class DriveBatch:
    """Batch of races; agents drive the first ``players`` cars of each race, opponents the others.

    Up to ``threads`` threads share a step (default: the number of cores). The other arguments are
    the fields of :class:`pcs_racing.envs.drive_options.DriveOptions`.
    """

    reset_options: tuple[str, ...] = ("start", "poses", "obstacles")  #: Options of :meth:`restart`.

    def __init__(
        self, episodes: int, *, threads: int | None = None, players: int = 1, **arguments: Any
    ) -> None:
        check_batch_size(episodes, threads)
        options = DriveOptions(**arguments)
        self.episodes, self.players, self.options = int(episodes), players, options
        given = rivals_of(options.opponent, options.opponents)
        self.cars = players + len(given)  #: Number of cars in each race.
        self.randomization = EpisodeRandomization(self.episodes, options, cars=self.cars)
        changes: dict[str, Any] = {"start_lines": options.start_lines}
        if options.duration is not None:
            changes["duration"] = options.duration
        config = load_race_config(options.race, **changes)
        self.alone = self.cars == 1
        #: Opponents of each car without an agent; one is drawn for each episode.
        self.rivals = [drive_opponents(one, self._make_game, options, self.cars) for one in given]
        movers = [one for rivals in self.rivals for one in rivals if not one.policies]
        if self.cars > 2 and (movers or any(len(rivals) > 1 for rivals in self.rivals)):
            raise InputError(
                f"opponents is {list(given)!r:.120}; in a race of {self.cars} cars each is one"
                " driver, no list, and none makes moves"
            )
        self._moving = MovingOpponents(self.episodes, self._make_game()) if movers else None
        #: Opponents of the only such car; with several cars nothing is drawn.
        self.opponents = self.rivals[0] if len(self.rivals) == 1 else []
        game = self._moving.game if self._moving else None
        planners = [EXTERNAL] * players + [shared_planner(rivals, game) for rivals in self.rivals]
        # The memory of late commands has the size of the longest delay, for all episodes.
        delay = self.randomization.ranges.most_delay
        self.setup = RaceSetup(
            self.randomization.circuits.track(0),
            config,
            tuple(planners),
            self.randomization.cars,
            delay,
        )
        #: Number of steps of an episode without an early end.
        self.horizon = -(-self.setup.config.ticks // options.ticks)
        #: Number of steps in a second of racing.
        self.frame_rate = max(1, round(1.0 / options.time_step))
        self.codes: Mapping[str, Mapping[int, str]] = {
            **common_codes(opponent.name for opponent in self.opponents),
            **self.randomization.codes,
        }
        self.elements = drive_elements(options, self.cars)
        # Refuse before arrays of this size are made.
        environments = self.episodes * players
        if environments * len(self.elements) > MOST_NUMBERS:
            raise InputError(
                f"{environments} environments observe {len(self.elements)} numbers each; take fewer"
                f" environments or beams: {MOST_NUMBERS} numbers are the limit"
            )
        noise = self.randomization.drawn.get(
            "lidar_noise", np.full(self.episodes, float(options.lidar_noise))
        )
        sight = make_sight(options, self.cars, players, self.setup.track)
        # Observation of the players; its ``ahead`` depends on the track.
        self._sight = sight._replace(end_tick=self.setup.config.ticks, noise=noise)
        self._prepare_races(threads)
        low, high = (
            bound * self._sight.gain + self._sight.shift
            for bound in (self._sight.low, self._sight.high)
        )
        self.observation_space = spaces.Box(
            low.astype(np.float32), high.astype(np.float32), dtype=np.float32
        )
        turn, low_speed, top = self._limits
        units = [[-turn, low_speed], [turn, top]]
        ends = np.array([[-1.0, -1.0], [1.0, 1.0]] if options.normalized else units, np.float32)
        self.action_space = spaces.Box(ends[0], ends[1], dtype=np.float32)

    def _make_game(self) -> RaceGame:
        """Make the game of moves for opponents that change their policy during a race."""
        track, archive = self.randomization.circuits.track(0), load_archive(self.options.archive)
        rules = load_game_config(self.options.race)
        return RaceGame(
            track, archive, rules, ego_planner=EXTERNAL, vehicles=self.randomization.cars[:2]
        )

    @property
    def track(self) -> Track:
        """Track of the first race."""
        return self.randomization.track(0)

    def _make_circuit(self, number: int) -> CircuitSetup:
        setup = replace(self.setup, track=self.randomization.circuits.track(number))
        lines = start_lines(setup.track, setup.config, 0, split="train")
        count = places_of_grid(self.cars)
        places = Starts(np.repeat(lines, count), np.tile(np.arange(count), len(lines)))
        grid = start_races(setup, places, np.zeros(len(places), np.uint64))
        settings = setup.settings
        ahead = samples_ahead(self.options, setup.track)
        # Time to collision is slow to compute; only opponents that observe characteristics need it.
        if self._moving is None:
            settings = settings._replace(ittc_horizon=0.0)
        return CircuitSetup(
            setup,
            grid,
            KernelInputs(setup.track.arrays, settings, self._sight._replace(ahead=ahead)),
        )

    def _prepare_races(self, threads: int | None) -> None:
        setup, races, options = self.setup, self.episodes, self.options
        #: Tracks by number. The number of tracks in use is at most the number of races.
        self.circuit = lru_cache(maxsize=KEPT + races)(self._make_circuit)
        circuit = self.circuit(0)
        self._inputs = [circuit.inputs] * races  # inputs of each race
        #: State of all races; `restart` and `step` write to it.
        self.state = take(circuit.grid, np.zeros(races, np.intp))
        self.drawn = np.zeros(races, np.int64)  #: Index of each race's opponent.
        # Equal weights draw a whole number, others a share; the draw is part of a seed's meaning.
        weights = np.array([opponent.weight for opponent in self.opponents] or [1.0])
        self._edges = None if (weights == weights[0]).all() else np.cumsum(weights) / weights.sum()
        self.theta = np.zeros((races, self.cars, setup.theta_size))
        #: shape (races, cars): Faults already penalised, except a race-ending fault.
        self._paid = np.zeros((races, self.cars), np.int8)
        self.vehicles = self.randomization.vehicles
        self._limits = (
            max(car.steer_max for car in setup.vehicles[: self.players]),
            *options.limits[1:],
        )
        paid = ("progress_reward", "rivalry", "crash_penalty", "win_reward")
        fault_loses = setup.config.crash_rule == "fault-loses"
        laps = np.inf if options.laps is None else float(options.laps)
        self._weights = (*(float(getattr(options, name)) for name in paid), fault_loses, laps)
        self._rows = np.arange(races)
        randomization = self.randomization
        self._uniform = not randomization.circuits.several  # False from the first obstacle on
        self._varied = bool(randomization.codes or randomization.drawn or randomization.obstacles)
        self._in_python = any(planner.drive is not None for planner in setup.planners)
        scans = self.players * (SCAN_US + BEAM_US * options.beams) if options.beams > 0 else 0.0
        enough_for = int(
            races * (0.5 * max(2, self.cars) * TICK_US * options.ticks + scans) / US_OF_A_THREAD
        )
        #: Number of threads that share a step; each has enough work.
        self.threads = (
            1 if self._in_python else min(threads or default_threads(), max(1, enough_for))
        )
        size = max(1, *(planner.scratch_size for planner in setup.planners))
        shapes: list[Any] = [size, WORK_SIZE, len(self.elements), SEEN_SHAPE, WORK_SHAPE]
        self._buffers = [tuple(np.zeros(shape) for shape in shapes) for _ in range(self.threads)]
        self._pool = ThreadPoolExecutor(max(1, self.threads - 1))  # starts threads on demand
        self._compiled: Callable[..., None] | None = None
        with first_call(step_races, "the control-level environment", 20) as compiling:
            self._pointers = pointers_of(setup.planners)
            if compiling:
                actions, results = np.empty((races, self.players, 2)), self._results()
                self._step_part(actions, 0, 0, 0, 0, results)

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
        if boxes is not None:
            for (circuit, some), grid in zip(groups, grids, strict=True):
                self._check_clear(circuit.setup, rows[some], take(grid, places[some]))
        for (circuit, some), grid in zip(groups, grids, strict=True):
            self._set_inputs(rows[some], circuit.inputs)
            restart(self.state, grid, rows[some], places[some], seeds[some])
        if self._moving is not None:
            self._moving.restart(rows, self.state, self.theta)

    def _check_clear(self, setup: RaceSetup, rows: NDArray[np.int64], placed: RaceState) -> None:
        """Refuse obstacles that overlap a car at the start."""
        settle(setup.track, setup.vehicles, placed, self.randomization.conditions(rows))
        wrong = np.flatnonzero(placed.crashed)
        if len(wrong):
            raise InputError(f"episode {rows[wrong[0]]}: a car starts in one of the obstacles")

    def _set_inputs(self, rows: Rows, inputs: KernelInputs) -> None:
        """Set the kernel inputs of some races on the same track."""
        for row in rows:
            arrays = self.randomization.track(int(row)).arrays
            # Races with obstacles have their own arrays and are stepped separately.
            own = arrays is not inputs.arrays
            self._inputs[row] = inputs._replace(arrays=arrays) if own else inputs
            self._uniform &= not own

    def _draw_opponent(self, row: int, generator: np.random.Generator) -> None:
        if self._edges is None:
            self.drawn[row] = generator.integers(max(1, len(self.opponents)))
        else:
            self.drawn[row] = draw_opponent(self._edges, generator)
        for car, rivals in enumerate(self.rivals, self.players):
            # With several opponent cars, each has a single opponent.
            opponent = rivals[self.drawn[row] if self.opponents else 0]
            policy = opponent.draw_policy(generator)
            if policy is not None:
                self.theta[row, car, : len(policy.parameters)] = policy.parameters
            if self._moving is not None:
                self._moving.draw(row, opponent, generator)

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
        for first, last in runs_of(inputs):
            one = inputs[first]
            sight, work = one.sight._replace(players=players), self._buffers[0][2:]
            observe_races(
                one.arrays, self.state, self.vehicles, sight, rows, first, last, *work, out
            )

    def check_actions(self, actions: ArrayLike, shape: tuple[int, ...]) -> NDArray[np.float64]:
        """Return actions as float64 of shape (B, players, 2).

        The error for invalid actions names the problem and the environment.
        """
        wanted = (*shape, 2)
        try:
            if np.iscomplexobj(actions):
                raise TypeError  # numpy would drop the imaginary part
            values = np.asarray(actions, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise InputError(
                f"action {actions!r:.80} must be numbers of shape {wanted}: steering and speed"
            ) from error
        if values.shape != wanted:
            raise InputError(
                f"action has shape {values.shape}; it must be {wanted}: steering and speed in"
                " [-1, 1]"
            )
        values = np.ascontiguousarray(values.reshape(self.episodes, self.players, 2))
        if not all_finite(values):
            rows = values.reshape(-1, 2)
            i = int(np.flatnonzero(~np.isfinite(rows).all(axis=1))[0])
            where = f" of environment {i}" if shape else ""
            raise InputError(
                f"action{where} is {rows[i].tolist()}; steering and speed must be finite, in"
                " [-1, 1]"
            )
        return values if self.options.normalized else shares(values, self._limits)

    def step(self, actions: NDArray[np.float64], generators: Generators = ()) -> BatchStep:
        """Advance every race by one step."""
        races, ticks = self.episodes, self.options.ticks
        results = self._results()
        if self._in_python:
            # The kernel then only computes rewards and observations: 0 ticks.
            set_commands(actions, self._limits, self.state, self.vehicles, 0, races)
            self._advance_in_python(ticks)
            ticks = 0
        if self.threads == 1:
            self._step_part(actions, ticks, 0, races, 0, results)
        else:
            edges = [races * k // self.threads for k in range(self.threads + 1)]
            parts = [
                self._pool.submit(
                    self._step_part, actions, ticks, edges[k], edges[k + 1], k, results
                )
                for k in range(1, self.threads)
            ]
            # This thread does the first part: waking another takes as long as stepping some races.
            self._step_part(actions, ticks, 0, edges[1], 0, results)
            for part in parts:
                part.result()
        if self._moving is not None:
            self._moving.move(self.state, self.theta, self.opponents, self.drawn, generators)
        return BatchStep(
            results.observations, results.reward, results.terminated, results.truncated
        )

    def _results(self) -> StepResults:
        count = self.episodes * self.players
        ended, late = np.empty(count, np.bool_), np.empty(count, np.bool_)
        observations = np.empty((count, len(self.elements)), np.float32)
        if self.setup.config.contact != "end":
            self._paid[:] = self.state.fault
        return StepResults(
            self.state.progress.copy(), self._paid, np.empty(count), ended, late, observations
        )

    def _step_part(
        self,
        actions: NDArray[np.float64],
        ticks: int,
        first: int,
        last: int,
        worker: int,
        results: StepResults,
    ) -> None:
        """Step a part of the races, on one thread."""
        # One kernel call steps a run of consecutive races on the same track.
        runs = (
            [(0, last - first)]
            if self._uniform or first == last
            else runs_of(self._inputs[first:last])
        )
        for low, high in runs:
            inputs = self._inputs[first + low]
            arguments = (
                inputs.arrays,
                self.state,
                self.theta,
                self.vehicles,
                self._pointers,
                inputs.settings,
                ticks,
                actions,
                self._limits,
                self._weights,
                inputs.sight,
                self._rows,
                first + low,
                first + high,
                self._buffers[worker],
                results,
            )
            # Looked up once: finding the machine code by all argument types is slower than a step.
            if self._compiled is None:
                self._compiled = compiled_for(step_races, arguments)
            try:
                self._compiled(*arguments)
            except Exception as error:
                raise driver_error(error, self.setup.planners, self._buffers[worker][1]) from error

    def _advance_in_python(self, ticks: int) -> None:
        """Advance every race against an opponent in plain Python."""
        circuits = self.randomization.circuits.number
        for first, last in runs_of(circuits.tolist()):
            part = RaceState._make(array[first:last] for array in self.state)
            conditions = self.randomization.conditions(np.arange(first, last))
            setup = self.circuit(int(circuits[first])).setup
            fixed = (setup.track, setup.settings, setup.planners, setup.vehicles)
            drive(*fixed, part, self.theta[first:last], ticks, conditions=conditions)

    def infos(self) -> dict[str, NDArray[Any]]:
        """Return the infos of all players, described in :mod:`pcs_racing.envs.infos`."""
        of_races = {
            "opponent": self.drawn if self.opponents else np.full(self.episodes, -1),
            **self.randomization.infos(),
        }
        return {
            **race_infos(self.state, self.players),
            **all_poses(self.state.cars, self.players),
            "result": self._outcomes().reshape(-1),
            **{name: np.repeat(values, self.players, axis=0) for name, values in of_races.items()},
        }

    def _outcomes(self) -> NDArray[np.int64]:
        """Return the result of each race for each player, shape (B, players).

        A single car wins if it reaches the end.
        """
        state, config = self.state, self.setup.config
        result = np.zeros((self.episodes, self.players), np.int64)
        # In most steps no race is over, and the winners are not needed.
        over = state.crashed | (state.tick >= config.ticks)
        if self.options.laps is not None:
            over |= state.lap_count.max(axis=1) >= self.options.laps
        if not over.any():
            return result
        rows = np.flatnonzero(over)
        ended = take(state, rows)
        if self.alone:
            result[rows, 0] = np.where(ended.crashed, Result.CRASH, Result.WIN)
            return result
        result[rows] = race_results(winners(config, ended), ended.crashed, self.players)
        return result

    def info(self, environment: int) -> dict[str, Any]:
        """Return the info of one player as plain numbers; faster than arrays of length one."""
        race, car = divmod(environment, self.players)
        info = race_info(self.state, race, car)
        over = (
            any(self.state.crash[race].tolist())
            or self.state.tick.item(race) >= self.setup.config.ticks
        )
        if self.options.laps is not None:
            over = over or self.state.laps[race, :, LAPS].max() >= self.options.laps
        info["result"] = int(self._outcomes()[race, car]) if over else int(Result.RUNNING)
        info["opponent"] = self.drawn.item(race) if self.opponents else -1
        cars = self.state.cars[race]
        info |= pose_info(
            cars
            if car == 0
            else np.concatenate([cars[car : car + 1], np.delete(cars, car, axis=0)])
        )
        if self._varied:
            info.update(self.randomization.info(race))
        return info

    def draw(self, renderer: Renderer, environment: int) -> NDArray[np.uint8] | None:
        """Draw the current state of a race."""
        race = environment // self.players
        cars = self.state.cars[race]
        info = self.info(race * self.players)
        text = f"{info['time']:.1f} s    {info['progress']:.1f} m"
        names = [f"car_{car}" for car in range(self.players)] if self.players > 1 else ["you"]
        names += [rivals[max(info["opponent"], 0)].name for rivals in self.rivals]
        if not self.alone:
            text += f"    lead of {names[0]} {info['lead']:+.1f} m"
        plans = [np.full((1, 2), np.nan)] * self.players + list(
            self.state.path[race, self.players :]
        )
        renderer.show(self.randomization.track(race), half_sizes(self.vehicles[race]))
        return renderer.render(cars, plans=plans if self.rivals else None, names=names, text=text)

    def get_state(self) -> tuple[Any, ...]:
        """Return copies of the races and of the opponents' indices, parameters and moves."""
        moving = None if self._moving is None else self._moving.get_state()
        return (
            self.state.copy(),
            self.drawn.copy(),
            self.theta.copy(),
            moving,
            self.randomization.get_state(),
        )

    def check_state(self, state: tuple[Any, ...]) -> list[Track]:
        """Refuse a state that `get_state` can't have returned.

        Return the track of each race, with its obstacles.
        """
        moving = None if self._moving is None else FREE
        check_part("the state", state, (self.state, self.drawn, self.theta, moving, FREE))
        tracks = self.randomization.check_state(state[4])
        lengths = np.array([track.length for track in tracks])
        check_races("the state's races", state[0], self.setup.config, lengths)
        check_within("the state's opponents", state[1], 0, max(1, len(self.opponents)) - 1)
        if self._moving is not None:
            self._moving.check_state(state[3], lengths)
        return tracks

    def set_state(self, state: tuple[Any, ...]) -> None:
        """Continue from a state of `get_state`, from this or an equal batch."""
        tracks = self.check_state(state)
        races, drawn, theta, moving, randomization = state
        self.randomization.set_state(randomization, tracks)
        for number, rows in self.randomization.groups(self._rows):
            self._set_inputs(rows, self.circuit(number).inputs)
        # Copy into the own arrays: the given state stays unchanged.
        for name, own in self.state._asdict().items():
            own[...] = getattr(races, name)
        self.drawn[:], self.theta[:] = drawn, theta
        if self._moving is not None:
            self._moving.set_state(moving)

    def close(self) -> None:
        """Free the threads."""
        self.randomization.circuits.close()
        self._pool.shutdown()
        self.threads = 1  # a step is still possible
