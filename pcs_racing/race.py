"""Racing two cars against each other, one race or thousands: start, advance, and what came of it."""

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing import vehicle as _vehicle
from pcs_racing.compilation import announce_compilation
from pcs_racing.elementary import exponential
from pcs_racing.errors import InputError
from pcs_racing.frenet import KAPPA, LEFT, RIGHT, SPEED, X, Y
from pcs_racing.planner import COMMAND_SLOTS, VIEW_SIZE, Planner, Policy
from pcs_racing.race_config import PAPER, RaceConfig
from pcs_racing.race_kernel import CONTROL_EVERY, DT, WORK_SIZE, KernelSettings, advance_races, fill_view, place_cars
from pcs_racing.race_state import RaceState, concatenate, empty_state, take
from pcs_racing.track import Track
from pcs_racing.vehicle import F1TENTH, VehicleParams

__all__ = [
    "RaceResult",
    "RaceSetup",
    "Starts",
    "advance",
    "draw_starts",
    "pad_parameters",
    "race_seeds",
    "run_races",
    "start_lines",
    "start_races",
    "winners",
]

DEFAULT_SPEED_RANGE = {"paper": (0.80, 1.0), "contest": (0.90, 1.14)}
TIE_WITHIN = 0.01  # m of lead
CENTRAL = 0.2  # m that the race line may run beside the middle at a start line
BEND_REACH = 15.0  # m after the start in which the first bend counts


@dataclass(frozen=True, eq=False)
class RaceSetup:
    """What stays the same during a batch of races: track, rules, the two planners and the two cars.

    Attributes
    ----------
    track : Track
    config : RaceConfig
    planners : tuple of two Planner
        Family of car 0's and car 1's policies.
    vehicles : tuple of two VehicleParams
        Car 0 and car 1.
    """

    track: Track
    config: RaceConfig
    planners: tuple[Planner, Planner]
    vehicles: tuple[VehicleParams, VehicleParams] = (F1TENTH, F1TENTH)

    @property
    def memory_size(self) -> int:
        """Numbers of memory for each car in the state."""
        return max(planner.memory_total for planner in self.planners)

    @property
    def theta_size(self) -> int:
        """Length of the longer of the two planners' parameter vectors."""
        return max(1, *(len(planner.parameters) for planner in self.planners))

    @property
    def speed_range(self) -> tuple[float, float]:
        """Speed scales for pace 0 and pace 1: the configuration's, else the circuit's, else a cautious default."""
        if self.config.speed_range is not None:
            return self.config.speed_range
        calibrated = self.track.speed_range.get(self.config.name)
        return calibrated or DEFAULT_SPEED_RANGE.get(self.config.name, DEFAULT_SPEED_RANGE["paper"])

    @property
    def settings(self) -> KernelSettings:
        """The numbers that the compiled loop needs."""
        low, high = self.speed_range
        return KernelSettings(
            end_tick=self.config.ticks,
            speed_low=low,
            speed_high=high,
            noise_sd=float(self.config.steering_noise),
            noise_keep=float(exponential(-CONTROL_EVERY * DT / self.config.noise_time)),
            ittc_horizon=float(self.config.ittc_horizon),
        )


@dataclass(frozen=True, eq=False)
class Starts:
    """Where the cars of a batch of races start.

    Attributes
    ----------
    s : ndarray, shape (B,)
        Arc length of the start line, m.
    side : ndarray, shape (B,), int64
        0 when car 0 starts on the left (side by side) or in front (staggered, rolling), 1 when car 1 does.
    """

    s: NDArray[np.float64]
    side: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.s)

    def take(self, indices: ArrayLike) -> "Starts":
        """Return some of them, in the order asked for."""
        chosen = np.asarray(indices)
        return Starts(self.s[chosen], self.side[chosen])


def _places(track: Track, config: RaceConfig) -> NDArray[np.intp]:
    """Samples of the race line that are straight and wide enough for the start, the room behind them included."""
    line = track.arrays.line
    bend = np.abs(line[:, KAPPA])
    room = line[:, RIGHT] + line[:, LEFT]
    need = config.start_spacing + F1TENTH.width + 0.3
    good = (bend < 0.15) & (room > need)
    behind = round((config.start_gap + 1.0) / track.arrays.ds)
    ahead = round(2.0 / track.arrays.ds)
    every = np.logical_and.reduce([np.roll(good, shift) for shift in range(-ahead, behind + 1, 5)])
    # The car nearer to the race line has the right of way, so where it can be had the line runs in the middle.
    central = every & (np.abs(line[:, LEFT] - line[:, RIGHT]) < 2.0 * CENTRAL)
    return np.flatnonzero(central if central.any() else every)


def start_lines(track: Track, config: RaceConfig, seed: int | np.random.SeedSequence) -> NDArray[np.float64]:
    """Arc lengths of ``config.start_lines`` random start lines on straight pieces of the circuit, m, ascending.

    Raises
    ------
    InputError
        If the circuit has no place for the start that the configuration asks for.
    """
    places = _places(track, config)
    if len(places) == 0:
        raise InputError(
            f"track {track.name!r} has no straight piece wide and long enough for a {config.start} start with gap "
            f"{config.start_gap:g} m and spacing {config.start_spacing:g} m; make them smaller"
        )
    rng = np.random.default_rng(seed)
    # The car on the inside of the next bend has an advantage, so half of the lines lead into bends of either side.
    line = track.arrays.line
    reach = round(BEND_REACH / track.arrays.ds)
    turned = np.cumsum(np.concatenate([line[:, KAPPA], line[:, KAPPA]]))
    leftward = (turned[places + reach] - turned[places]) > 0.0
    sides = [places[leftward], places[~leftward]]
    count = config.start_lines
    first = int(rng.integers(2))
    wanted = [count // 2, count // 2]
    wanted[first] += count % 2
    if min(len(side) for side in sides) == 0:
        sides, wanted = [places, places[:0]], [count, 0]
    chosen = [_spread(side, number, rng) for side, number in zip(sides, wanted, strict=True)]
    return np.sort(np.concatenate(chosen)).astype(np.float64) * track.arrays.ds


def _spread(places: NDArray[np.intp], number: int, rng: np.random.Generator) -> NDArray[np.intp]:
    """One random place from each of as many equal parts: random, yet never two in one spot where there is room."""
    edges = np.linspace(0.0, len(places), number + 1)
    at = rng.uniform(edges[:-1], edges[1:]).astype(np.intp)
    return places[np.minimum(at, len(places) - 1)] if number else places[:0]


def draw_starts(track: Track, config: RaceConfig, races: int, seed: int) -> Starts:
    """Draw the starts of a batch: several random start lines, and on each of them both sides in turn.

    Race ``i`` starts on line ``(i // 2) % config.start_lines`` with side ``i % 2``, whatever the size of the batch.
    """
    lines = start_lines(track, config, np.random.SeedSequence(_checked_seed(seed), spawn_key=(0,)))
    index = np.arange(races)
    return Starts(lines[(index // 2) % len(lines)], (index % 2).astype(np.int64))


def race_seeds(seed: int, races: int) -> NDArray[np.uint64]:
    """Noise key of each race: a function of the root seed and the race's index alone, shape (B,)."""
    root = _checked_seed(seed)
    return np.array(
        [np.random.SeedSequence(root, spawn_key=(1, i)).generate_state(1, np.uint64)[0] for i in range(races)],
        np.uint64,
    )


def _checked_seed(seed: int) -> int:
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
        raise InputError(f"seed is {seed!r}; it must be a whole number from 0")
    return int(seed)


def start_races(setup: RaceSetup, starts: Starts, seeds: NDArray[np.uint64]) -> RaceState:
    """Put both cars of every race on the grid.

    Side by side, the two cars are centred between the walls; staggered and rolling, the rear car stands ``start_gap``
    behind and both are ``start_spacing`` apart across the track. Progress is counted from the front car's line.

    Raises
    ------
    InputError
        If a start lies off the track, or the cars would stand in a wall or in each other; the race's index is named.
    """
    track, config = setup.track, setup.config
    arrays = track.arrays
    if len(starts) != len(seeds):
        raise InputError(f"there are {len(starts)} starts but {len(seeds)} seeds; give one seed for each race")
    outside = ~((starts.s >= 0.0) & (starts.s < arrays.length))
    if outside.any():
        i = int(np.flatnonzero(outside)[0])
        raise InputError(
            f"race {i}: the start line {starts.s[i]} m is not on track {track.name!r}; it must lie in "
            f"[0, {arrays.length:.2f})"
        )
    if not np.isin(starts.side, (0, 1)).all():
        raise InputError(f"start sides must be 0 or 1; found {starts.side[~np.isin(starts.side, (0, 1))][0]}")
    races = len(starts)
    state = empty_state(races, setup.memory_size)
    state.seed[:] = seeds
    low = setup.speed_range[0]
    rows = np.arange(races)
    for place in range(2):  # 0: left or front, 1: right or rear
        car = np.where(starts.side == 0, place, 1 - place)
        behind = 0.0 if config.start == "side-by-side" else place * config.start_gap
        s = np.mod(starts.s - behind, arrays.length)
        sample = arrays.line[(s / arrays.ds).astype(np.intp) % len(arrays.line)]
        middle = 0.5 * (sample[:, LEFT] - sample[:, RIGHT])
        d = middle + (0.5 if place == 0 else -0.5) * config.start_spacing
        pose = track.to_cartesian(np.stack([s, d], axis=-1))
        profile = low * sample[:, SPEED]
        speed = profile if config.start == "rolling" else np.minimum(config.start_speed, profile)
        state.cars[rows, car, X] = pose[:, 0]
        state.cars[rows, car, Y] = pose[:, 1]
        state.cars[rows, car, _vehicle.V] = speed
        state.cars[rows, car, _vehicle.PSI] = np.mod(pose[:, 2], 2.0 * np.pi)
        state.progress[rows, car] = -behind
    place_cars(arrays, state, _vehicle_rows(setup, races))
    if state.crashed.any():
        i = int(np.flatnonzero(state.crashed)[0])
        raise InputError(
            f"race {i}: at start line {starts.s[i]:.2f} m of track {track.name!r} a car would stand in a wall or in "
            f"the other car; choose another line or a smaller start_spacing than {config.start_spacing:g} m"
        )
    return state


def _vehicle_rows(setup: RaceSetup, races: int) -> NDArray[np.float64]:
    rows = np.stack([vehicle.as_row() for vehicle in setup.vehicles])
    return np.ascontiguousarray(np.broadcast_to(rows, (races, *rows.shape)))


def default_threads() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def advance(
    setup: RaceSetup,
    state: RaceState,
    theta: NDArray[np.float64],
    ticks: int,
    *,
    threads: int | None = None,
    ittc: bool = True,
) -> None:
    """Advance every race of a batch by ``ticks`` steps of 0.01 s, in place; finished races stand still.

    The result does not depend on the number of threads, nor on how a race is cut into calls.

    Parameters
    ----------
    setup : RaceSetup
    state : RaceState
        Overwritten.
    theta : ndarray, shape (B, 2, P)
        Parameter vectors of the two policies in each race, padded to the longer planner's.
    ticks : int
        Steps to drive, an even number: drivers are asked every second step.
    threads : int, optional
        Threads to share the races; all cores by default, one where a driver is plain Python.
    ittc : bool
        Whether to sample the minimum time to collision. Without it everything but the sums ``ITTC`` and
        ``ITTC_SAMPLES`` is the same, in less time.

    Raises
    ------
    InputError
        If ``ticks`` is odd or negative, or ``theta`` does not fit the batch.
    """
    if ticks < 0 or ticks % CONTROL_EVERY:
        raise InputError(f"ticks is {ticks}; it must be an even number from 0")
    if setup.planners[0].drive is None and setup.planners[1].drive is None:
        _advance_compiled(setup, state, theta, ticks, threads, ittc)
        return
    for _ in range(ticks // CONTROL_EVERY):
        _ask_python_drivers(setup, state, theta)
        _advance_compiled(setup, state, theta, CONTROL_EVERY, 1, ittc)


def _advance_compiled(
    setup: RaceSetup, state: RaceState, theta: NDArray[np.float64], ticks: int, threads: int | None, ittc: bool
) -> None:
    races = state.races
    if theta.shape != (races, 2, setup.theta_size) or theta.dtype != np.float64 or not theta.flags.c_contiguous:
        raise InputError(
            f"theta has shape {theta.shape} and type {theta.dtype}; it must be C-contiguous float64 of shape "
            f"{(races, 2, setup.theta_size)}"
        )
    with announce_compilation(advance_races, "the planners and the race kernel", 30):
        plan0, control0 = setup.planners[0].pointers()
        plan1, control1 = setup.planners[1].pointers()
    vehicles = _vehicle_rows(setup, races)
    settings = setup.settings if ittc else setup.settings._replace(ittc_horizon=0.0)
    size = max(1, *(planner.scratch_size for planner in setup.planners))

    def part(first: int, last: int) -> None:
        scratch = np.empty(size)
        work = np.empty(WORK_SIZE)
        advance_races(
            setup.track.arrays,
            state,
            theta,
            vehicles,
            plan0,
            control0,
            plan1,
            control1,
            settings,
            ticks,
            first,
            last,
            scratch,
            work,
        )

    workers = min(threads or default_threads(), races)
    if workers <= 1:
        part(0, races)
        return
    part(0, 0)  # compiles before the threads need it
    edges = np.linspace(0, races, min(races, 4 * workers) + 1).astype(int)
    with ThreadPoolExecutor(workers) as pool:
        list(pool.map(part, edges[:-1], edges[1:]))


def _ask_python_drivers(setup: RaceSetup, state: RaceState, theta: NDArray[np.float64]) -> None:
    vehicles = _vehicle_rows(setup, 1)[0]
    view = np.zeros(VIEW_SIZE)
    for race in range(state.races):
        if state.tick[race] % CONTROL_EVERY or state.tick[race] >= setup.config.ticks or state.crash[race].any():
            continue
        for car, planner in enumerate(setup.planners):
            if planner.drive is None:
                continue
            fill_view(setup.track.arrays, state, race, car, vehicles, setup.settings, view)
            memory = state.memory[race, car]
            own = memory[COMMAND_SLOTS : COMMAND_SLOTS + planner.memory_size]
            answer = planner.drive(setup.track, theta[race, car, : len(planner.parameters)], view.copy(), own)
            command = np.asarray(answer, dtype=np.float64)
            if command.shape != (2,) or not np.isfinite(command).all():
                raise InputError(
                    f"race {race}, car {car}: planner {planner.name!r} returned {command!r}; it must return two finite "
                    "numbers, steering angle (rad) and speed (m/s)"
                )
            memory[:COMMAND_SLOTS] = command


@dataclass(frozen=True, eq=False)
class RaceResult:
    """What came of a batch of races.

    Attributes
    ----------
    config : RaceConfig
    state : RaceState
        Where every race ended.
    starts : Starts
    """

    config: RaceConfig
    state: RaceState
    starts: Starts

    @property
    def lead(self) -> NDArray[np.float64]:
        """Progress of car 0 minus that of car 1 at the end, m, shape (B,)."""
        return self.state.lead

    @property
    def crashed(self) -> NDArray[np.bool_]:
        """Whether the race ended in a crash, shape (B,)."""
        return self.state.crashed

    @property
    def winner(self) -> NDArray[np.int8]:
        """The car that won, shape (B,): see :func:`winners`."""
        return winners(self.config, self.state)

    @property
    def own_crash(self) -> NDArray[np.bool_]:
        """Whether each car is to blame for the end of its race, shape (B, 2)."""
        return self.state.fault == 1

    @property
    def time(self) -> NDArray[np.float64]:
        """How long each race lasted, s, shape (B,)."""
        return self.state.tick.astype(np.float64) * DT


def winners(config: RaceConfig, state: RaceState) -> NDArray[np.int8]:
    """The car that won each race, 0 or 1, or -1 for a tie and for a crash that pays nobody, shape (B,)."""
    ahead = np.where(state.lead > TIE_WITHIN, 0, np.where(state.lead < -TIE_WITHIN, 1, -1))
    if config.crash_rule == "nobody":
        after_crash = np.full(len(ahead), -1)
    else:
        fault = state.fault
        after_crash = np.where(fault[:, 0] == fault[:, 1], -1, np.where(fault[:, 0] == 1, 1, 0))
    return np.where(state.crashed, after_crash, ahead).astype(np.int8)


def pad_parameters(policies: Sequence[Policy], size: int) -> NDArray[np.float64]:
    """Stack the parameter vectors of policies, padded with zeros, shape (len(policies), size)."""
    theta = np.zeros((len(policies), size))
    for i, policy in enumerate(policies):
        theta[i, : len(policy.parameters)] = policy.parameters
    return theta


def run_races(
    track: Track,
    egos: Policy | Sequence[Policy],
    opponents: Policy | Sequence[Policy],
    config: RaceConfig = PAPER,
    *,
    seed: int = 0,
    starts: Starts | None = None,
    vehicles: tuple[VehicleParams, VehicleParams] = (F1TENTH, F1TENTH),
    threads: int | None = None,
) -> RaceResult:
    """Run races between pairs of policies, from the start to the end.

    Parameters
    ----------
    track : Track
    egos, opponents : Policy or sequence of Policy
        Drivers of car 0 and car 1 in each race; a single policy drives in all of them. Planners may differ from race to
        race.
    config : RaceConfig
        The rules.
    seed : int
        Root of the start lines and of every race's noise.
    starts : Starts, optional
        Where to start; drawn from the seed by default (:func:`draw_starts`).
    vehicles : tuple of two VehicleParams
        The cars.
    threads : int, optional
        Threads to share the races; all cores by default. It does not change the result.

    Returns
    -------
    RaceResult

    Raises
    ------
    InputError
        If the numbers of egos, opponents and starts do not fit, or a start is impossible.
    """
    if isinstance(egos, Policy):
        egos = [egos] * (1 if isinstance(opponents, Policy) and starts is None else len(starts or opponents))  # type: ignore[arg-type]
    if isinstance(opponents, Policy):
        opponents = [opponents] * len(egos)
    races = len(egos)
    if len(opponents) != races:
        raise InputError(f"there are {races} egos but {len(opponents)} opponents; give one opponent for each ego")
    if starts is None:
        starts = draw_starts(track, config, races, seed)
    if len(starts) != races:
        raise InputError(f"there are {races} races but {len(starts)} starts; give one start for each race")
    seeds = race_seeds(seed, races)
    groups: dict[tuple[int, int], list[int]] = {}
    for i, (ego, opponent) in enumerate(zip(egos, opponents, strict=True)):
        groups.setdefault((id(ego.planner), id(opponent.planner)), []).append(i)
    parts: list[tuple[list[int], RaceState]] = []
    for members in groups.values():
        setup = RaceSetup(track, config, (egos[members[0]].planner, opponents[members[0]].planner), vehicles)
        state = start_races(setup, starts.take(members), seeds[members])
        theta = np.stack(
            [
                pad_parameters([egos[i] for i in members], setup.theta_size),
                pad_parameters([opponents[i] for i in members], setup.theta_size),
            ],
            axis=1,
        )
        advance(setup, state, theta, config.ticks, threads=threads)
        parts.append((members, state))
    widest = max((state.memory.shape[2] for _, state in parts), default=0)
    joined = concatenate([_widen_memory(state, widest) for _, state in parts]) if parts else empty_state(0, 0)
    order = np.argsort(np.concatenate([members for members, _ in parts])) if parts else np.array([], np.intp)
    return RaceResult(config, take(joined, order), starts)


def _widen_memory(state: RaceState, size: int) -> RaceState:
    extra = size - state.memory.shape[2]
    return state._replace(memory=np.pad(state.memory, ((0, 0), (0, 0), (0, extra)))) if extra else state
