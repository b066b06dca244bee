"""Simulation of a batch of races from a given state, without rules for starts and winners."""

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.compilation import first_call
from pcs_racing.base.elementary import exponential
from pcs_racing.base.errors import InputError, check_whole
from pcs_racing.base.numba_parts import config as numba_config
from pcs_racing.car.lanes import LANES
from pcs_racing.car.vehicle import SPEED_DELAY, SPEED_NOISE, STEER_DELAY, V, VehicleParams
from pcs_racing.planners.pursuit import COMMAND_SLOTS, held_command
from pcs_racing.planners.view import VIEW_SIZE
from pcs_racing.race.conditions import AS_THE_SETUP, RaceConditions, Share
from pcs_racing.race.config import CONTACTS, CONTROL_EVERY, DT, Rules
from pcs_racing.race.kernel import (
    ASKED,
    WORK_SIZE,
    Crew,
    KernelSettings,
    Races,
    Scratch,
    advance_races,
    fill_view,
    parts_for,
)
from pcs_racing.race.state import RaceState
from pcs_racing.race.steering import disturbed_speed, slowed
from pcs_racing.track.frenet import TrackArrays
from pcs_racing.track.track import Track

if TYPE_CHECKING:
    from pcs_racing.planners.planner import Planner, Policy


class Field(Protocol):
    """Constants of a batch of races, such as a :class:`pcs_racing.race.races.RaceSetup`."""

    @property
    def track(self) -> Track:
        """Track of the races."""

    @property
    def settings(self) -> KernelSettings:
        """Numbers that the compiled loop needs."""

    @property
    def car_planners(self) -> "tuple[Planner | None, ...]":
        """Planner of each car; None for a car that is steered from outside."""

    @property
    def vehicles(self) -> tuple[VehicleParams, ...]:
        """Vehicle of each car."""


class BareField(NamedTuple):
    """A field of races without rules for starts and winners."""

    track: Track
    settings: KernelSettings
    car_planners: "tuple[Planner | None, ...]"
    vehicles: tuple[VehicleParams, ...]


Run = tuple[Track, int, int]  # track, first race on it, last race on it + 1

# Numbers of simulation steps of 0.01 s of one race; a step takes about 1 us.
PIECE = 3000  # steps in a piece of work of a thread
TICKS_OF_A_THREAD = 500  # min steps that are worth a thread

FEW_ROUNDS = 4


def default_threads() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def kernel_settings(rules: Rules, speed_range: tuple[float, float]) -> KernelSettings:
    """Return the numbers of a race configuration that the compiled loop needs."""
    return KernelSettings(
        end_tick=rules.ticks,
        speed_low=speed_range[0],
        speed_high=speed_range[1],
        noise_sd=float(rules.steering_noise),
        noise_keep=float(exponential(-CONTROL_EVERY * DT / rules.noise_time)),
        ittc_horizon=float(rules.ittc_horizon),
        contact=CONTACTS.index(rules.contact),
        most_faults=rules.most_faults,
        sight=float(rules.sight),
    )


def pad_parameters(policies: "Sequence[Policy]", size: int) -> NDArray[np.float64]:
    """Stack the parameter vectors of policies, padded with zeros, shape (len(policies), size)."""
    theta = np.zeros((len(policies), size))
    for i, policy in enumerate(policies):
        theta[i, : len(policy.parameters)] = policy.parameters
    return theta


def largest_theta(planners: "Sequence[Planner | None]") -> int:
    """Return the maximum length of the planners' parameter vectors, at least 1."""
    return max([1, *(len(planner.parameters) for planner in planners if planner is not None)])


def largest_scratch(planners: "Sequence[Planner | None]") -> int:
    """Return the maximum size of the planners' scratch buffers, at least 1."""
    return max([1, *(planner.scratch_size for planner in planners if planner is not None)])


def pointers_of(shares: Sequence[Share], races: int) -> Any:
    """Return the addresses of plan and control of each car in every race, for the kernel.

    Each of the N cars has an array of shape (races, 2).
    """
    kind = np.object_ if numba_config.DISABLE_JIT else np.int64  # functions in place of addresses
    cars = np.empty((len(shares), races, 2), kind)
    for addresses, share in zip(cars, shares, strict=True):
        for planner, rows in share:
            addresses[rows] = held_command() if planner is None else planner.pointers()
    # From a tuple the kernel knows the number of cars at compile time: it is compiled once for one
    # car, once for two cars, and once for any other number.
    return tuple(cars) if len(cars) <= 2 else cars


def advance(
    setup: Field,
    state: RaceState,
    theta: NDArray[np.float64],
    ticks: int,
    *,
    threads: int | None = None,
    ittc: bool = True,
    conditions: RaceConditions = AS_THE_SETUP,
) -> None:
    """Advance all races of a batch by ``ticks`` steps of 0.01 s, in place; ended races stand still.

    The result depends neither on the number of threads nor on the division of a race into calls.

    A ``drive`` in Python with a method ``commands`` gives the commands of all races in one call. A
    ``drive`` in Python with an attribute ``hold`` is called every ``hold`` simulation steps.
    (:class:`pcs_racing.envs.models.ModelDriver` has both.)

    Parameters
    ----------
    setup : RaceSetup or BareField
        Track, settings, planners and vehicles.
    state : RaceState
        State of the batch; overwritten.
    theta : ndarray, shape (B, N, P)
        Parameter vectors of the policies in each race, padded to the setup's ``theta_size``.
    ticks : int
        Number of steps.
    threads : int, optional
        Number of threads that share the races; all cores by default, 1 if a planner is plain
        Python.
    ittc : bool
        Whether to sample the minimum time to collision. False saves time, and changes only the sums
        ``ITTC`` and ``ITTC_SAMPLES``.
    conditions : RaceConditions
        Cars and tracks of single races.
    """
    ticks = check_whole("ticks", ticks, 0)
    settings = setup.settings if ittc else setup.settings._replace(ittc_horizon=0.0)
    cars = conditions.rows(setup.vehicles, state.races)
    runs = conditions.runs(setup.track, state.races)
    shares = conditions.shares(setup.car_planners, state.races)
    in_python = [one.drive for one in _planners_of(shares) if one is not None and one.drive]
    if not in_python:
        _drive_compiled(runs, settings, shares, cars, state, theta, ticks, threads)
        return
    # The compiled loop stops before every command, so that Python can give the command.
    holds = [getattr(function, "hold", CONTROL_EVERY) for function in in_python]
    while ticks > 0:
        for run in runs:
            _ask_python_drivers(run, settings, shares, cars, state, theta)
        going = state.tick[(state.tick < settings.end_tick) & ~state.over]
        due = min([int((hold - going % hold).min()) for hold in holds]) if len(going) else ticks
        _drive_compiled(runs, settings, shares, cars, state, theta, min(due, ticks), 1)
        ticks -= due


def _planners_of(shares: Sequence[Share]) -> "list[Planner | None]":
    return [planner for share in shares for planner, _ in share]


def _drive_compiled(
    runs: list[Run],
    settings: KernelSettings,
    shares: Sequence[Share],
    cars: NDArray[np.float64],
    state: RaceState,
    theta: NDArray[np.float64],
    ticks: int,
    threads: int | None,
) -> None:
    races, planners = state.races, _planners_of(shares)
    wanted = (races, len(shares), largest_theta(planners))
    fits = theta.ndim == 3 and theta.shape[:2] == wanted[:2] and theta.shape[2] >= wanted[2]
    if not fits or theta.dtype != np.float64 or not theta.flags.c_contiguous:
        raise InputError(
            f"theta has shape {theta.shape} and type {theta.dtype}; it must be C-contiguous float64"
            f" of shape {wanted}"
        )
    size, batch = largest_scratch(planners), Races(state, theta, cars)
    moving = any(len(track.arrays.moving) for track, _, _ in runs)

    def part(arrays: TrackArrays, first: int, last: int) -> None:  # `crew` is bound below
        buffers = Scratch(np.empty(size), np.zeros(WORK_SIZE))
        try:
            advance_races(arrays, batch, settings, crew, ticks, first, last, buffers)
        except Exception as error:
            raise planner_error(error, shares, buffers.work) from error

    with first_call(advance_races, "the planners and the race kernel", 240.0) as compiling:
        crew = Crew(pointers_of(shares, races), parts_for(settings, cars, moving))
        if compiling and runs:
            part(runs[0][0].arrays, 0, 0)
    given = default_threads() if threads is None else check_whole("threads", threads, 1)
    workers = min(given, races, races * ticks // TICKS_OF_A_THREAD)
    # A thread pool costs as much as some hundred steps.
    if workers <= 1:
        for track, first, last in runs:
            part(track.arrays, first, last)
        return
    # Other types of arguments are compiled for here, before several threads would do so.
    part(runs[0][0].arrays, 0, 0)
    pieces = _pieces(runs, races, ticks, workers, len(shares))
    with ThreadPoolExecutor(workers) as pool:
        list(pool.map(part, *zip(*pieces, strict=True)))


def planner_error(
    error: Exception, shares: Sequence[Share], work: NDArray[np.float64]
) -> InputError:
    """Return an error with race, car and planner for an exception of a compiled planner."""
    race, car = map(int, work[ASKED:])
    name = next((getattr(one, "name", None) for one, rows in shares[car] if race in rows), None)
    return InputError(
        f"race {race}, car {car}: planner {name!r} raised {type(error).__name__}: {error}"
    )


def _pieces(
    runs: list[Run], races: int, ticks: int, workers: int, cars: int = 2
) -> list[tuple[TrackArrays, int, int]]:
    """Cut runs into pieces of work; a thread takes the next piece after it has finished one.

    Many pieces consist of whole groups, which are driven in lockstep. If there are few pieces, they
    have equal sizes instead, so that no thread waits for the last piece.
    """
    group = LANES // cars
    size = group * max(1, PIECE // (group * ticks))
    rounds = max(1, round(races / (workers * size)))
    if rounds < FEW_ROUNDS:
        size = -(-races // (workers * rounds))
    pieces = [
        (track.arrays, at, min(at + size, last))
        for track, first, last in runs
        for at in range(first, last, size)
    ]
    # Neighbouring pieces are not driven at the same time: their states share cache lines.
    return pieces[::2] + pieces[1::2]


def _ask_python_drivers(
    run: Run,
    settings: KernelSettings,
    shares: Sequence[Share],
    cars: NDArray[np.float64],
    state: RaceState,
    theta: NDArray[np.float64],
) -> None:
    track, first, last = run
    view, part = np.zeros(VIEW_SIZE), slice(first, last)
    going = np.zeros(state.races, np.bool_)
    going[part] = (state.tick[part] < settings.end_tick) & ~state.over[part]
    driven = [(car, *one) for car, share in enumerate(shares) for one in share]
    for car, planner, own in driven:
        if planner is None or planner.drive is None:
            continue
        hold = getattr(planner.drive, "hold", CONTROL_EVERY)
        rows = own[going[own] & (state.tick[own] % hold == 0)]
        if hasattr(planner.drive, "commands"):  # one call for all races
            if len(rows) == 0:
                continue
            given = planner.drive.commands(track, state, rows, car, cars, settings)
            state.memory[rows, car, :COMMAND_SLOTS] = given
            # Between two commands of the loop the new command takes effect here, where it is not
            # late.
            now = state.tick[rows] % CONTROL_EVERY != 0
            prompt = now & (cars[rows, car, SPEED_DELAY] == 0.0)
            state.command[rows[prompt], car, 1] = given[prompt, 1]
            changed = (cars[rows, car, SPEED_NOISE] > 0.0) | (state.handicap[rows, car] > 0.0)
            for row in rows[prompt & changed]:
                v, vehicle = state.cars[row, car, V], cars[row, car]
                speed = slowed(state.memory[row, car, 1], state.handicap[row, car], v, vehicle)
                state.command[row, car, 1] = disturbed_speed(
                    speed, vehicle, state.seed[row], car, state.tick[row]
                )
            now &= cars[rows, car, STEER_DELAY] == 0.0
            state.command[rows[now], car, 0] = given[now, 0] + state.disturbance[rows[now], car]
            continue
        for race in rows:
            fill_view(track.arrays, state, race, car, cars[race], settings, view)
            memory = state.memory[race, car]
            # The first numbers hold the command until the next command; the planner's own memory
            # follows.
            own = memory[COMMAND_SLOTS : COMMAND_SLOTS + planner.memory_size]
            given = theta[race, car, : len(planner.parameters)]
            given.flags.writeable = False
            who = f"race {race}, car {car}: planner {planner.name!r}"
            more = (int(state.seed[race]), car) if hasattr(planner.drive, "takes_seed") else ()
            try:
                answer = planner.drive(track, given, view.copy(), own, *more)
            except (Exception, SystemExit) as error:  # third-party code may raise anything
                raise InputError(f"{who} raised {type(error).__name__}: {error}") from error
            try:
                command = np.asarray(answer, dtype=np.float64)
            except Exception:  # a third-party object may raise anything
                command = np.array(np.nan)
            if command.shape != (2,) or not np.isfinite(command).all():
                raise InputError(
                    f"{who} returned {answer!r:.80}; it must return two finite numbers, steering"
                    " angle (rad) and speed (m/s)"
                )
            memory[:COMMAND_SLOTS] = command
