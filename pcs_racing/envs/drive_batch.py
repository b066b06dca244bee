"""Many races at the level of steering and speed, advanced together: what both environments of this level share."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.compilation import announce_compilation
from pcs_racing.base.errors import InputError
from pcs_racing.car.lidar import MOST_BEAMS, WORK_SHAPE, Beams, Lidar
from pcs_racing.car.vehicle import F1TENTH
from pcs_racing.envs.drive_kernel import observe_races, restart, set_commands, step_races
from pcs_racing.planners.planner import COMMAND_SLOTS, Planner, Policy, hold_command, leave_path
from pcs_racing.planners.registry import parse_policy
from pcs_racing.race.config import RaceConfig, load_race_config
from pcs_racing.race.driving import default_threads, pad_parameters
from pcs_racing.race.kernel import CONTROL_EVERY, DT, WORK_SIZE
from pcs_racing.race.races import RaceSetup, advance, start_lines, start_races
from pcs_racing.race.start_grid import Starts
from pcs_racing.race.state import RaceState, take
from pcs_racing.track.track import Track, load_track

__all__ = ["EXTERNAL", "DriveBatch", "DriveOptions", "Element", "Opponent", "check_batch", "drive_elements"]

EXTERNAL = Planner("external", (), leave_path, hold_command, memory_size=COMMAND_SLOTS)
"""The planner of a car that is driven from outside: its memory holds the target steering angle and speed."""

Opponent = str | Policy | None | Sequence[str | Policy]

CRASHES = np.array(["none", "wall", "car"])
RACES_PER_THREAD = 16  # fewer are not worth handing over
MOST_RACES = 100_000
MOST_NUMBERS = 250_000_000  # of all observations together: 1 GB


class Element(NamedTuple):
    """One number of the observation: its name, unit, bounds and meaning."""

    name: str
    unit: str
    low: float
    high: float
    meaning: str


@dataclass(frozen=True, eq=False)
class DriveOptions:
    """Arguments of the control-level environments; :class:`pcs_racing.envs.drive.DriveEnv` describes them.

    Raises
    ------
    InputError
        If one is impossible; the message names it.
    """

    track: str | Path | Track = "Tarnfjord"
    opponent: Opponent = "lattice"
    race: str | Path | RaceConfig = "paper"
    duration: float | None = None
    time_step: float = 0.1
    top_speed: float = 8.0
    beams: int = 0
    fov: float = 4.7
    max_range: float = 30.0
    lidar_noise: float = 0.0
    look_ahead: tuple[float, ...] = (0.0, 1.0, 2.0, 4.0, 6.0, 9.0)
    normalize: bool = False
    progress_reward: float = 1.0
    rivalry: float = 0.0
    crash_penalty: float = 10.0
    start_lines: int = 100

    def __post_init__(self) -> None:
        for name, kind in (("track", Track), ("race", RaceConfig)):
            value = getattr(self, name)
            if not isinstance(value, str | Path | kind):
                raise InputError(f"{name} is {value!r}; it must be a name, a path or a {kind.__name__}")
        _number("time_step", self.time_step, CONTROL_EVERY * DT, 1.0)
        if abs(self.time_step / (CONTROL_EVERY * DT) - round(self.time_step / (CONTROL_EVERY * DT))) > 1e-9:
            raise InputError(f"time_step is {self.time_step!r} s; it must be a multiple of {CONTROL_EVERY * DT:g} s")
        _number("top_speed", self.top_speed, 0.1, F1TENTH.v_max)
        whole = isinstance(self.beams, int | np.integer) and not isinstance(self.beams, bool)
        if not whole or not 0 <= self.beams <= MOST_BEAMS:
            raise InputError(f"beams is {self.beams!r}; it must be a whole number from 0 to {MOST_BEAMS}")
        _number("lidar_noise", self.lidar_noise, 0.0, 10.0)
        for name in ("fov", "max_range"):  # their limits are the lidar's to judge
            _number(name, getattr(self, name), 0.0, float("inf"))
        distances = self.look_ahead if isinstance(self.look_ahead, Sequence) else ()
        if not distances or isinstance(distances, str) or len(distances) > 100:
            raise InputError(f"look_ahead is {self.look_ahead!r}; it must list 1 to 100 distances in m")
        for distance in distances:
            _number("look_ahead", distance, 0.0, 1000.0)
        if not isinstance(self.normalize, bool | np.bool_):
            raise InputError(f"normalize is {self.normalize!r}; it must be true or false")
        for name in ("progress_reward", "rivalry", "crash_penalty"):
            _number(name, getattr(self, name), -1e6 if name != "crash_penalty" else 0.0, 1e6)

    @property
    def ticks(self) -> int:
        """Simulation steps of 0.01 s in a step of the environment."""
        return CONTROL_EVERY * round(self.time_step / (CONTROL_EVERY * DT))


def _number(name: str, value: object, low: float, high: float) -> None:
    fine = isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)
    if not fine or not low <= value <= high:  # type: ignore[operator]
        raise InputError(f"{name} is {value!r}; it must be a number from {low:g} to {high:g}")


def drive_elements(options: DriveOptions) -> list[Element]:
    """Every element of the observation, in order; values beyond the bounds are clipped to them."""
    pi = float(np.pi)
    top = F1TENTH.v_max
    elements = [
        Element("speed", "m/s", F1TENTH.v_min, top, "own speed"),
        Element("steering", "rad", -F1TENTH.steer_max, F1TENTH.steer_max, "own steering angle, positive to the left"),
        Element("yaw rate", "rad/s", -20.0, 20.0, "own yaw rate"),
        Element("slip", "rad", -pi, pi, "own slip angle: course minus heading"),
        Element("target steering", "rad", -F1TENTH.steer_max, F1TENTH.steer_max, "what the last action asked for"),
        Element("target speed", "m/s", 0.0, top, "what the last action asked for"),
        Element("offset", "m", -10.0, 10.0, "distance from the race line, positive to the left"),
        Element("heading error", "rad", -pi, pi, "own heading minus that of the race line"),
    ]
    for distance in options.look_ahead:
        at = f"{distance:g} m ahead"
        elements += [
            Element(f"curvature {at}", "1/m", -5.0, 5.0, f"curvature of the race line {at}, positive to the left"),
            Element(f"line speed {at}", "m/s", 0.0, top, f"speed of the race line {at}, at speed scale 1"),
            Element(f"left {at}", "m", 0.0, 10.0, f"free width left of the race line {at}"),
            Element(f"right {at}", "m", 0.0, 10.0, f"free width right of the race line {at}"),
        ]
    elements += [
        Element("opponent", "1", 0.0, 1.0, "1 if there is an opponent; else it and the next eight are 0"),
        Element("opponent gap", "m", -30.0, 30.0, "how far ahead the opponent is along the race line, the short way"),
        Element("opponent offset", "m", -20.0, 20.0, "its distance from the race line minus the own one"),
        Element("opponent x", "m", -30.0, 30.0, "its position in the own car's frame, forward"),
        Element("opponent y", "m", -30.0, 30.0, "its position in the own car's frame, to the left"),
        Element("opponent heading", "rad", -pi, pi, "its heading minus the own one"),
        Element("opponent vx", "m/s", -30.0, 30.0, "its velocity minus the own one, forward in the own frame"),
        Element("opponent vy", "m/s", -30.0, 30.0, "its velocity minus the own one, to the left in the own frame"),
        Element("lead", "m", -1000.0, 1000.0, "own progress minus the opponent's"),
    ]
    elements += [
        Element(f"beam {k}", "m", 0.0, float(options.max_range), f"range of beam {k}, counted counter-clockwise")
        for k in range(options.beams)
    ]
    return elements


def _policies(opponent: Opponent) -> list[Policy]:
    """The policies among which an episode's opponent is drawn; they share a planner."""
    several = [opponent] if isinstance(opponent, str | Policy) else opponent
    if not isinstance(several, Sequence) or not several:
        raise InputError(f"opponent is {opponent!r}; it must be a policy, its text, a list of them, or None")
    policies = []
    for one in several:
        if not isinstance(one, str | Policy):
            raise InputError(f"opponent {one!r} is no policy; give one, or text such as 'lattice:pace=0.8'")
        policies.append(parse_policy(one) if isinstance(one, str) else one)
    for policy in policies[1:]:
        if policy.planner is not policies[0].planner:
            raise InputError(
                f"opponents {policies[0].name!r} and {policy.name!r} have different planners; the opponents of one "
                "environment must share a planner"
            )
    return policies


def compiled_for(function: Any, arguments: tuple[Any, ...]) -> Callable[..., None]:
    """Return the machine code of a compiled function for arguments of these types.

    Calling it spares looking up the types of all arguments, which takes 40 us where function pointers are among them.
    All later arguments must have exactly these types. Without compilation (``NUMBA_DISABLE_JIT``) it is the function.
    """
    if not hasattr(function, "typeof_pyval"):
        return function
    return function.compile(tuple(function.typeof_pyval(argument) for argument in arguments))


def check_batch(races: int, threads: int | None) -> None:
    """Check how many environments a batch is to have, and on how many threads.

    Raises
    ------
    InputError
        If there are none or too many.
    """
    whole = isinstance(races, int | np.integer) and not isinstance(races, bool)
    if not whole or not 1 <= races <= MOST_RACES:
        raise InputError(f"num_envs is {races!r}; it must be a whole number from 1 to {MOST_RACES}")
    if threads is not None and (isinstance(threads, bool) or not isinstance(threads, int) or threads < 1):
        raise InputError(f"threads is {threads!r}; it must be a whole number from 1, or None")


class DriveBatch:
    """A number of races side by side; car 0 of each is driven from outside, car 1 by a policy.

    Parameters
    ----------
    races : int
        How many.
    options : DriveOptions
    threads : int, optional
        Threads that share a step; as many as there are cores (and work for) by default.

    Attributes
    ----------
    state : RaceState
        All races; written to by `restart` and `step`.
    elements : list of Element
    """

    def __init__(self, races: int, options: DriveOptions, *, threads: int | None = None) -> None:
        check_batch(races, threads)
        self.races, self.options = int(races), options
        self.track = options.track if isinstance(options.track, Track) else load_track(options.track)
        changes: dict[str, Any] = {"start_lines": options.start_lines}
        if options.duration is not None:
            changes["duration"] = options.duration
        config = load_race_config(options.race, **changes)
        self.alone = options.opponent is None
        self.opponents = [] if self.alone else _policies(options.opponent)
        planner = EXTERNAL if self.alone else self.opponents[0].planner
        self.setup = RaceSetup(self.track, config, (EXTERNAL, planner))
        self.elements = drive_elements(options)
        if self.races * len(self.elements) > MOST_NUMBERS:
            raise InputError(
                f"{self.races} environments see {len(self.elements)} numbers each; take fewer environments or beams: "
                f"{MOST_NUMBERS} numbers are the limit"
            )
        self._prepare_observations(options)
        self._prepare_races(threads)

    def _prepare_observations(self, options: DriveOptions) -> None:
        low = np.array([element.low for element in self.elements])
        high = np.array([element.high for element in self.elements])
        scale = 2.0 / (high - low) if options.normalize else np.ones(len(low))
        shift = -1.0 - low * scale if options.normalize else np.zeros(len(low))
        self.high = (high * scale + shift).astype(np.float32)
        self.low = (low * scale + shift).astype(np.float32)
        self._writing = (low, high, scale, shift)
        line, ds = self.track.arrays.line, self.track.arrays.ds
        ahead = np.array([round(distance / ds) % len(line) for distance in options.look_ahead], np.int64)
        if options.beams > 0:
            beams = Lidar(self.track, options.beams, options.fov, options.max_range).kernel
        else:
            nothing = np.empty(0)
            nothing.flags.writeable = False  # as a lidar's are: both have the same compiled type then
            beams = Beams(0.0, 1.0, 1.0, nothing, nothing)
        self._sight = (ahead, self.alone, beams, float(options.lidar_noise))

    def _prepare_races(self, threads: int | None) -> None:
        setup, races = self.setup, self.races
        lines = start_lines(self.track, setup.config, 0, split="train")
        places = Starts(np.repeat(lines, 2), np.tile(np.array([0, 1]), len(lines)))
        self.grid = start_races(setup, places, np.zeros(len(places), np.uint64))
        self.state = take(self.grid, np.zeros(races, np.intp))
        self.chosen = np.zeros(races, np.int64)
        self.parameters = pad_parameters(self.opponents, setup.theta_size) if self.opponents else np.zeros((1, 1))
        self.names = np.array([policy.name for policy in self.opponents] or ["none"], dtype=object)
        self.theta = np.zeros((races, 2, setup.theta_size))
        cars = np.stack([vehicle.as_row() for vehicle in setup.vehicles])
        self.vehicles = np.tile(cars, (races, 1, 1))  # never read-only, which would be another type to compile
        # Nobody asks a control-level environment for characteristics: no time to collision is measured.
        self._settings = setup.settings._replace(ittc_horizon=0.0)
        with announce_compilation(step_races, "the control-level environment", 15):
            self._pointers = (*setup.planners[0].pointers(), *setup.planners[1].pointers())
        self._limits = (setup.vehicles[0].steer_max, float(self.options.top_speed))
        self._weights = tuple(
            float(getattr(self.options, name)) for name in ("progress_reward", "rivalry", "crash_penalty")
        )
        self._rows = np.arange(races)
        self._in_python = setup.planners[1].drive is not None
        workers = 1 if self._in_python else min(threads or default_threads(), max(1, races // RACES_PER_THREAD))
        size = max(1, setup.planners[1].scratch_size)
        self._buffers = [
            (np.empty(size), np.empty(WORK_SIZE), np.empty(len(self.elements)), np.empty(WORK_SHAPE))
            for _ in range(workers)
        ]
        self._pool = ThreadPoolExecutor(workers) if workers > 1 else None
        self._compiled: Callable[..., None] | None = None

    def draw(self, rng: np.random.Generator) -> tuple[int, int, np.uint64]:
        """Draw what tells one episode from another: place on the grid, opponent, and key of the noise."""
        place = int(rng.integers(self.grid.races))
        opponent = int(rng.integers(max(1, len(self.opponents))))
        return place, opponent, rng.integers(2**64, dtype=np.uint64)

    def restart(self, rows: NDArray[np.int64], rngs: Sequence[np.random.Generator]) -> None:
        """Start new episodes in some races, each drawn from its own generator."""
        drawn = [self.draw(rng) for rng in rngs]
        places = np.array([place for place, _, _ in drawn], np.int64)
        seeds = np.array([seed for _, _, seed in drawn], np.uint64)
        restart(self.state, self.grid, rows, places, seeds)
        self.choose(rows, np.array([opponent for _, opponent, _ in drawn], np.int64))

    def choose(self, rows: NDArray[np.int64], chosen: NDArray[np.int64]) -> None:
        """Let these opponents drive in some races."""
        self.chosen[rows] = chosen
        self.theta[rows, 1] = self.parameters[chosen]

    def observe(self, rows: NDArray[np.int64], out: NDArray[np.float32]) -> None:
        """Write the observations of some races into their rows of ``out``, shape (B, n)."""
        observe_races(
            self.track.arrays,
            self.state,
            self.vehicles,
            *self._sight,
            *self._writing,
            rows,
            0,
            len(rows),
            *self._buffers[0][2:],
            out,
        )

    def check_actions(self, actions: ArrayLike, shape: tuple[int, ...]) -> NDArray[np.float64]:
        """Return actions as float64 of shape (B, 2), or say what is wrong with them, and where."""
        try:
            values = np.asarray(actions, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise InputError(f"action {actions!r} must be numbers of shape {shape}: steering and speed") from error
        if values.shape != shape:
            raise InputError(f"action has shape {values.shape}; it must be {shape}: steering and speed in [-1, 1]")
        if not np.isfinite(values).all():
            if len(shape) == 1:
                raise InputError(f"action is {values.tolist()}; steering and speed must be finite, in [-1, 1]")
            i = int(np.flatnonzero(~np.isfinite(values).all(axis=1))[0])
            raise InputError(
                f"action of environment {i} is {values[i].tolist()}; steering and speed must be finite, in [-1, 1]"
            )
        return np.ascontiguousarray(values.reshape(self.races, 2))

    def step(
        self, actions: NDArray[np.float64]
    ) -> tuple[NDArray[np.float32], NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_]]:
        """Drive every race one step on; returns fresh arrays of observations, rewards and the two kinds of end."""
        races = self.races
        out = np.empty((races, len(self.elements)), np.float32)
        reward = np.empty(races)
        terminated = np.empty(races, np.bool_)
        truncated = np.empty(races, np.bool_)
        before = self.state.progress.copy()
        ticks = self.options.ticks
        if self._in_python:
            set_commands(actions, *self._limits, self.state.memory, 0, races)
            advance(self.setup, self.state, self.theta, ticks)
            ticks = 0
        results = (before, reward, terminated, truncated, out)
        if self._pool is None:
            self._step_part(actions, ticks, 0, races, 0, results)
        else:
            workers = len(self._buffers)
            edges = [races * k // workers for k in range(workers + 1)]
            parts = [
                self._pool.submit(self._step_part, actions, ticks, edges[k], edges[k + 1], k, results)
                for k in range(workers)
            ]
            for part in parts:
                part.result()
        return out, reward, terminated, truncated

    def _step_part(
        self, actions: NDArray[np.float64], ticks: int, first: int, last: int, worker: int, results: tuple[Any, ...]
    ) -> None:
        """Step a part of the races, on one thread."""
        arguments = (
            self.track.arrays,
            self.state,
            self.theta,
            self.vehicles,
            *self._pointers,
            self._settings,
            ticks,
            actions,
            self._limits,
            self._weights,
            self._sight,
            *self._writing,
            self._rows,
            first,
            last,
            self._buffers[worker],
            *results,
        )
        if self._compiled is None:
            self._compiled = compiled_for(step_races, arguments)
        self._compiled(*arguments)

    def facts(self, rows: NDArray[np.int64] | slice) -> dict[str, NDArray[Any]]:
        """What the info of each race says: arrays by name."""
        state = self.state
        progress = state.progress[rows]
        crash = state.crash[rows]
        return {
            "time": state.tick[rows] * DT,
            "progress": progress[:, 0].copy(),
            "lead": np.zeros(len(progress)) if self.alone else progress[:, 0] - progress[:, 1],
            "crash": CRASHES[crash[:, 0]],
            "opponent_crash": CRASHES[crash[:, 1]],
            "at_fault": state.fault[rows, 0] == 1,
            "overtakes": state.overtakes[rows, 0].copy(),
            "opponent": self.names[self.chosen[rows]],
        }

    def facts_of(self, race: int) -> dict[str, Any]:
        """The same for one race, as plain numbers and texts; faster than taking it from arrays of one."""
        state = self.state
        progress = float(state.progress[race, 0])
        return {
            "time": state.tick.item(race) * DT,
            "progress": progress,
            "lead": 0.0 if self.alone else progress - float(state.progress[race, 1]),
            "crash": str(CRASHES[state.crash[race, 0]]),
            "opponent_crash": str(CRASHES[state.crash[race, 1]]),
            "at_fault": bool(state.fault[race, 0] == 1),
            "overtakes": int(state.overtakes[race, 0]),
            "opponent": self.names[self.chosen[race]],
        }

    def get_state(self) -> tuple[RaceState, NDArray[np.int64]]:
        """Copies of the races and of who drives in them."""
        return self.state.copy(), self.chosen.copy()

    def set_state(self, state: RaceState, chosen: NDArray[np.int64]) -> None:
        """Go on from what `get_state` returned, here or in an equal batch."""
        if not isinstance(state, RaceState) or [a.shape for a in state] != [a.shape for a in self.state]:
            raise InputError(
                f"the state is not one of {self.races} races with these planners; use what get_state returned"
            )
        if np.shape(chosen) != (self.races,) or not ((chosen >= 0) & (chosen < max(1, len(self.opponents)))).all():
            raise InputError(f"the state's opponents {chosen!r} are not among the {len(self.opponents)} that there are")
        for name, own in self.state._asdict().items():
            own[...] = getattr(state, name)
        self.choose(self._rows, np.asarray(chosen, np.int64))

    def close(self) -> None:
        """Let the threads go."""
        if self._pool is not None:
            self._pool.shutdown()
            self._pool = None
