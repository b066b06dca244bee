"""Compiled step of the control-level environments: from commands to observations and rewards.

The first cars of a race, or all, belong to agents: its players. Rows of observations and rewards
count the players of all races: with two players, row ``2 i`` is car 0 of race ``i`` and row
``2 i + 1`` its car 1.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.compilation import inner_kernel, kernel
from pcs_racing.base.elementary import sine_cosine
from pcs_racing.base.numba_parts import call_with, compiled_address
from pcs_racing.car import vehicle as _vehicle
from pcs_racing.car.collision import Rectangle
from pcs_racing.car.lidar_errors import disturb_scan, lidar_place
from pcs_racing.car.lidar_kernel import (
    WORK_SHAPE,
    Beams,
    Pose,
    scan_car,
    scan_moving,
    scan_walls,
)
from pcs_racing.race.config import CONTROL_EVERY, DT, FULL_SIGHT
from pcs_racing.race.kernel import Crew, KernelSettings, Races, Scratch
from pcs_racing.race.positions import gap_to, laps_driven
from pcs_racing.race.sensing import UNSEEN, sense_cars
from pcs_racing.race.state import MAX_CARS
from pcs_racing.race.steering import disturbed_speed, slowed
from pcs_racing.track.frenet import (
    KAPPA,
    LEFT,
    PSI,
    RIGHT,
    SPEED,
    TrackArrays,
    angle_between,
)
from pcs_racing.track.grid import cast

OWN_ELEMENTS = 8  # numbers about the own car
STRETCH_ELEMENTS = 4  # numbers about each look-ahead distance
OPPONENT_ELEMENTS = 9  # numbers about each opponent; they follow

# Rows: velocity of each car of a race, its gap ahead of the observing car; order of the others.
_VX, _VY, _GAP, _ORDER = range(4)
SEEN_SHAPE = (4, MAX_CARS)

# Separates the noise of the lidar from the noise of the steering, which has the same key.
_LIDAR_KEY = np.uint64(0x5851F42D4C957F2D)


class Sight(NamedTuple):
    """Observation of the players of a race, in the form used by the kernels."""

    players: int  #: Number of observing cars: the first cars.
    own_state: bool  #: Flag: the numbers about the own car are included.
    own_pose: bool  #: Flag: place and heading of the own car are included.
    ahead: NDArray[Any]  #: int64: Look-ahead distances in samples of the race line, each in [0, N).
    others: int  #: Number of observed opponents, whose numbers are 0 for cars that don't exist.
    #: None for a car alone, whose kernel has no code for opponents. True: the numbers are 0 if a
    #: wall hides the opponent or it is too far away.
    in_sight: bool | None
    time_left: bool  #: Flag: the remaining share of the race is included.
    handicap: bool  #: Flag: the share of its commanded speed that the own car lacks is included.
    end_tick: int  #: Duration of a race in steps of 0.01 s.
    beams: Beams  #: Beams of the lidar; without beams there is no scan.
    low: NDArray[Any]  #: shape (n,): Lower bounds of the elements; values are clipped.
    high: NDArray[Any]  #: shape (n,): Upper bounds of the elements.
    gain: NDArray[Any]  #: shape (n,): Factor; the output is ``gain * clipped value + shift``.
    shift: NDArray[Any]  #: shape (n,): Offset of the output.


class Inputs(NamedTuple):
    """Inputs of the kernel that are the same for races on one track."""

    track: TrackArrays
    settings: KernelSettings
    sight: Sight


class Eyes(NamedTuple):
    """Addresses of the kernels that only some observations need; 0 without a use for them."""

    scan: Any = 0  #: Scan of a lidar.
    sense: Any = 0  #: Errors and delays of a car's sensors.


class Limits(NamedTuple):
    """Ends of the range of an action."""

    steer_max: float  #: Maximum steering angle, rad.
    min_speed: float  #: Target speed of the action -1, m/s.
    top_speed: float  #: Target speed of the action 1, m/s.


class RewardTerms(NamedTuple):
    """Terms of the reward, and the end of a race that it depends on."""

    weights: tuple[float, float, float]  #: Weights of :func:`step_reward`.
    decided: bool  #: Flag: the end of the time decides a race, and terminates it.


@inner_kernel
def step_reward(own, opponent, fault, weights):
    """Return the reward of one step of driving.

    It is the progress, minus a share of the opponent's progress, minus a penalty for a crash by own
    fault. The weights are the reward for a metre, the share of the opponent's progress, and the
    penalty.
    """
    per_metre, rivalry, penalty = weights
    return per_metre * (own - rivalry * opponent) - (penalty if fault == 1 else 0.0)


class Orders(NamedTuple):
    """Orders of a step: its duration, and the drivers with their commands."""

    advance: Any  #: Address of `advance_races`.
    observe: Any  #: Address of `observe_races`.
    crew: Crew
    eyes: Eyes
    rows: NDArray[np.int64]  #: shape (B,): Numbers of the races.
    ticks: int  #: Number of simulation steps.
    actions: NDArray[np.float64]  #: shape (B, players, 2): Steering and speed, in [-1, 1].
    limits: Limits
    terms: RewardTerms


class Buffers(NamedTuple):
    """Scratch memory of a thread; its contents are undefined after a call."""

    scratch: NDArray[np.float64]  #: Scratch memory of the planners.
    work: NDArray[np.float64]  #: shape (``WORK_SIZE``,): Scratch memory of the races.
    row: NDArray[np.float64]  #: shape (n,): Observation of a car.
    seen: NDArray[np.float64]  #: shape `SEEN_SHAPE`: Velocities, gaps and order of the cars.
    scan: NDArray[np.float64]  #: shape ``WORK_SHAPE``: Scratch memory of the lidar.
    cars: NDArray[np.float64]  #: shape (1, N, 7): Cars of a race as one of them measures them.
    frenet: NDArray[np.float64]  #: shape (1, N, 2): Measured Frenet coordinates.
    progress: NDArray[np.float64]  #: shape (1, N): Measured progress.


def make_buffers(scratch: int, work: int, elements: int, cars: int) -> Buffers:
    """Return scratch memory for races of so many cars, given the sizes of the other parts."""
    shapes: list[Any] = [scratch, work, elements, SEEN_SHAPE, WORK_SHAPE]
    shapes += [(1, cars, _vehicle.STATE_SIZE), (1, cars, 2), (1, cars)]
    return Buffers(*map(np.zeros, shapes))


class StepResults(NamedTuple):
    """Outputs of a step, and its inputs for the reward; players of a race have adjacent rows."""

    before: NDArray[np.float64]  #: shape (B, N): Progress before the step, m.
    faults: NDArray[np.int8]  #: shape (B, N): Faults before the step, except a race-ending fault.
    reward: NDArray[np.float64]  #: shape (B * players,)
    terminated: NDArray[np.bool_]  #: shape (B * players,)
    truncated: NDArray[np.bool_]  #: shape (B * players,)
    observations: NDArray[np.float32]  #: shape (B * players, n)


_call = call_with()


@inner_kernel
def _see_own(line, ds, cars, frenet, memory, race, car, row, k):
    """Write the numbers about the own car from ``row[k]`` on; arguments are arrays, for speed.

    ``memory`` begins with the command of the car.
    """
    s = frenet[race, car, 0]
    here = min(int(s / ds), line.shape[0] - 1)
    row[k] = cars[race, car, _vehicle.V]
    row[k + 1] = cars[race, car, _vehicle.DELTA]
    row[k + 2] = cars[race, car, _vehicle.PSI_DOT]
    row[k + 3] = angle_between(cars[race, car, _vehicle.BETA], 0.0)
    row[k + 4] = memory[0]
    row[k + 5] = memory[1]
    row[k + 6] = frenet[race, car, 1]
    # Between two samples the heading follows from the curvature, which is constant there.
    heading = line[here, PSI] + (s - here * ds) * line[here, KAPPA]
    row[k + 7] = angle_between(cars[race, car, _vehicle.PSI], heading)


@inner_kernel
def _see_line(line, ds, s, ahead, row, k):
    """Write the numbers about the race line from ``row[k]`` on."""
    n = line.shape[0]
    here = min(int(s / ds), n - 1)
    for i in range(ahead.shape[0]):
        j = here + ahead[i]
        if j >= n:
            j -= n
        row[k] = line[j, KAPPA]
        row[k + 1] = line[j, SPEED]
        row[k + 2] = line[j, LEFT]
        row[k + 3] = line[j, RIGHT]
        k += STRETCH_ELEMENTS


@inner_kernel
def _see_opponent(cars, frenet, progress, race, car, other, sn, c, seen, row, k):
    """Write the numbers about an opponent from ``row[k]`` on.

    ``sn`` and ``c`` are the sine and cosine of the own heading.
    """
    dx = cars[race, other, _vehicle.X] - cars[race, car, _vehicle.X]
    dy = cars[race, other, _vehicle.Y] - cars[race, car, _vehicle.Y]
    vx = seen[_VX, other] - seen[_VX, car]
    vy = seen[_VY, other] - seen[_VY, car]
    row[k] = 1.0
    row[k + 1] = seen[_GAP, other]
    row[k + 2] = frenet[race, other, 1] - frenet[race, car, 1]
    row[k + 3] = dx * c + dy * sn
    row[k + 4] = dy * c - dx * sn
    row[k + 5] = angle_between(cars[race, other, _vehicle.PSI], cars[race, car, _vehicle.PSI])
    row[k + 6] = vx * c + vy * sn
    row[k + 7] = vy * c - vx * sn
    row[k + 8] = progress[race, car] - progress[race, other]


@inner_kernel
def _see_velocities(cars, race, seen):
    for car in range(cars.shape[1]):
        sine, cosine = sine_cosine(cars[race, car, _vehicle.PSI] + cars[race, car, _vehicle.BETA])
        seen[_VX, car] = cars[race, car, _vehicle.V] * cosine
        seen[_VY, car] = cars[race, car, _vehicle.V] * sine


@inner_kernel
def _in_sight(track, cars, race, car, other, reach):
    """Return whether the cars are at most ``reach`` m apart and no wall separates their centres."""
    x = cars[race, car, _vehicle.X]
    y = cars[race, car, _vehicle.Y]
    dx = cars[race, other, _vehicle.X] - x
    dy = cars[race, other, _vehicle.Y] - y
    apart = np.sqrt(dx * dx + dy * dy)
    # Two cars at the same place define no ray direction; they see each other.
    if apart > reach or apart == 0.0:
        return apart == 0.0
    u = (x - track.origin_x) / track.cell
    v = (y - track.origin_y) / track.cell
    cells = apart / track.cell
    return cast(track.distance, u, v, dx / apart, dy / apart, cells)[0] >= cells


@inner_kernel
def _sort_opponents(length, cars, frenet, race, car, seen):
    """Write the gaps to the other cars, and the order of observation: the nearest car first.

    Cars at x = `UNSEEN` come last.
    """
    count = 0
    for other in range(frenet.shape[1]):
        gap = gap_to(length, frenet, race, car, other)
        if cars[race, other, _vehicle.X] == UNSEEN:
            gap = np.inf
        seen[_GAP, other] = gap
        if other != car:
            at = count
            while at > 0 and abs(seen[_GAP, int(seen[_ORDER, at - 1])]) > abs(gap):
                seen[_ORDER, at] = seen[_ORDER, at - 1]
                at -= 1
            seen[_ORDER, at] = other
            count += 1


@inner_kernel(forceinline=True)
def _scan_from(inputs, races, race, car, pose, s, work, out):
    """Write the inverse ranges to walls and cars; return False for a lidar in a wall."""
    beams, cars, vehicles = inputs.sight.beams, races.state.cars, races.vehicles
    if not scan_walls(inputs.track, beams, pose, s, work, out):
        return False
    for other in range(cars.shape[1]):
        if other != car:
            body = Rectangle(
                cars[race, other, _vehicle.X],
                cars[race, other, _vehicle.Y],
                cars[race, other, _vehicle.PSI],
                0.5 * vehicles[race, other, _vehicle.LENGTH],
                0.5 * vehicles[race, other, _vehicle.WIDTH],
            )
            scan_car(beams, pose, body, work, out)
    return True


@inner_kernel
def scan(inputs, races, race, car, buffers, out):
    """Write the ranges of a car's exact lidar in a race without moving obstacles."""
    state, row = races.state, races.state.cars[race, car]
    pose = Pose(row[_vehicle.X], row[_vehicle.Y], row[_vehicle.PSI])
    s = state.frenet[race, car, 0]
    if _scan_from(inputs, races, race, car, pose, s, buffers.scan, out):
        for i in range(out.shape[0]):
            out[i] = 1.0 / out[i]


@inner_kernel
def scan_imperfect(inputs, races, race, car, buffers, out):
    """Write the ranges that a car's lidar reports of the race as it is."""
    track, beams, state, own = (
        inputs.track,
        inputs.sight.beams,
        races.state,
        races.vehicles[race, car],
    )
    x, y, psi, s = (
        state.cars[race, car, _vehicle.X],
        state.cars[race, car, _vehicle.Y],
        state.cars[race, car, _vehicle.PSI],
        state.frenet[race, car, 0],
    )
    x, y, s = lidar_place(track, x, y, psi, s, own[_vehicle.LIDAR_X], own[_vehicle.LIDAR_Y])
    pose = Pose(x, y, psi + own[_vehicle.LIDAR_YAW])
    if _scan_from(inputs, races, race, car, pose, s, buffers.scan, out):
        scan_moving(track, beams, pose, state.tick[race] * DT, buffers.scan, out)
        for i in range(out.shape[0]):
            out[i] = 1.0 / out[i]
    errors = own[_vehicle.LIDAR_FOV : _vehicle.LIDAR_STEP + 1]
    # Each beam has its own count at each tick: no scan repeats the noise of another scan.
    key, count = state.seed[race] ^ _LIDAR_KEY, state.tick[race] * out.shape[0]
    disturb_scan(beams, 0.0, errors, key, car, count, out)


@inner_kernel
def sense(inputs, races, race, car, buffers):
    """Write the cars of a race as one of them measures them."""
    seen = buffers.cars, buffers.frenet, buffers.progress
    sight = inputs.settings.sight
    sense_cars(inputs.track, races.state, race, car, races.vehicles[race], sight, seen)


@inner_kernel(forceinline=True)
def _see_others(inputs, races, race, car, measured, at, seen, row, k):
    """Write the numbers about the opponents from ``row[k]`` on.

    ``measured`` are the states, Frenet coordinates and progress of the cars of a race ``at``.
    """
    track, sight = inputs.track, inputs.sight
    cars, frenet, progress = measured
    number = cars.shape[1]
    _see_velocities(cars, at, seen)
    sine, cosine = sine_cosine(cars[at, car, _vehicle.PSI])
    _sort_opponents(track.length, cars, frenet, at, car, seen)
    for nth in range(sight.others):
        hidden = nth >= number - 1
        other = 0 if hidden else int(seen[_ORDER, nth])
        hidden = hidden or cars[at, other, _vehicle.X] == UNSEEN
        if sight.in_sight and not hidden:
            reach = sight.beams.max_range
            hidden = not _in_sight(track, races.state.cars, race, car, other, reach)
        if hidden:
            row[k : k + OPPONENT_ELEMENTS] = 0.0
        else:
            _see_opponent(cars, frenet, progress, at, car, other, sine, cosine, seen, row, k)
        k += OPPONENT_ELEMENTS


@inner_kernel(forceinline=True)
def _observe(in_sight, inputs, races, eyes, race, car, buffers):
    """Write the observation of a car, in the units of the elements.

    ``in_sight`` is the sight's, as an argument: no code is compiled for opponents of a car alone.
    """
    track, sight, state = inputs.track, inputs.sight, races.state
    row, memory = buffers.row, state.memory[race, car]
    cars, frenet, progress, at = state.cars, state.frenet, state.progress, race
    if eyes.sense != 0:
        _call(eyes.sense, (inputs, races, race, car, buffers))
        cars, frenet, progress, at = buffers.cars, buffers.frenet, buffers.progress, 0
    k = 0
    if sight.own_state:
        _see_own(track.line, track.ds, cars, frenet, memory, at, car, row, k)
        k += OWN_ELEMENTS
    if sight.own_pose:
        row[k], row[k + 1] = cars[at, car, _vehicle.X], cars[at, car, _vehicle.Y]
        row[k + 2] = angle_between(cars[at, car, _vehicle.PSI], 0.0)
        k += 3
    _see_line(track.line, track.ds, frenet[at, car, 0], sight.ahead, row, k)
    k += STRETCH_ELEMENTS * sight.ahead.shape[0]
    if in_sight is None:
        row[k : k + OPPONENT_ELEMENTS * sight.others] = 0.0
    else:
        measured = cars, frenet, progress
        _see_others(inputs, races, race, car, measured, at, buffers.seen, row, k)
    k += OPPONENT_ELEMENTS * sight.others
    if sight.time_left:
        row[k] = 1.0 - state.tick[race] / sight.end_tick
        k += 1
    if sight.handicap:
        row[k] = state.handicap[race, car]
        k += 1
    if eyes.scan != 0:
        _call(eyes.scan, (inputs, races, race, car, buffers, row[k:]))


@inner_kernel
def _write(row, sight, out):
    """Clip an observation to its bounds, scale it if asked, and round it to float32."""
    low, high, gain, shift = sight.low, sight.high, sight.gain, sight.shift
    count = row.shape[0]
    first_beam = count - sight.beams.cos.shape[0]
    # Unsigned counters avoid the test for negative indices.
    for k in range(np.uint64(first_beam)):
        out[k] = np.float32(min(max(row[k], low[k]), high[k]) * gain[k] + shift[k])
    # The beams come last and share their bounds: a single read leaves room in the CPU's cache.
    least, most, factor, offset = low[count - 1], high[count - 1], gain[count - 1], shift[count - 1]
    for k in range(np.uint64(first_beam), np.uint64(count)):
        out[k] = np.float32(min(max(row[k], least), most) * factor + offset)


@kernel
def observe_races(inputs, races, eyes, rows, first, last, buffers, out):
    """Write the observations of cars ``first`` to ``last - 1`` of the races ``rows``.

    The cars of a race have successive rows of ``out``, races in the order of ``rows``. A car is
    observed as if a player drove it.
    """
    row = 0
    for race in rows:
        for car in range(first, last):
            _observe(inputs.sight.in_sight, inputs, races, eyes, race, car, buffers)
            _write(buffers.row, inputs.sight, out[row])
            row += 1


@kernel
def set_commands(actions, limits, races, first, last):
    """Write actions in [-1, 1] as target steering angles and speeds to the cars' memory.

    ``actions`` has the shape (B, players, 2).
    """
    state, vehicles = races.state, races.vehicles
    steer_max, min_speed, top_speed = limits
    for race in range(first, last):
        # Cars get commands every second tick; in the other ticks a command takes effect from here.
        now = state.tick[race] % CONTROL_EVERY != 0
        for car in range(actions.shape[1]):
            memory, command = state.memory[race, car], state.command[race, car]
            memory[0] = steer_max * min(max(actions[race, car, 0], -1.0), 1.0)
            memory[1] = min_speed + 0.5 * (top_speed - min_speed) * (
                1.0 + min(max(actions[race, car, 1], -1.0), 1.0)
            )
            if now:
                # Late commands follow the period of their queue.
                if vehicles[race, car, _vehicle.SPEED_DELAY] == 0.0:
                    v, own = state.cars[race, car, _vehicle.V], vehicles[race, car]
                    speed = slowed(memory[1], state.handicap[race, car], v, own)
                    command[1] = disturbed_speed(
                        speed, own, state.seed[race], car, state.tick[race]
                    )
                if vehicles[race, car, _vehicle.STEER_DELAY] == 0.0:
                    command[0] = memory[0] + state.disturbance[race, car]


@inner_kernel(forceinline=True)
def end_race(state, race, end_tick, decided, players, results):
    """Write whether a race has ended for its players; ``decided``: the time's end decides it."""
    over = laps_driven(state.laps, race)
    for car in range(state.crash.shape[1]):
        over |= state.crash[race, car] != 0
    late = state.tick[race] >= end_tick
    ended = over or (late and decided)
    for player in range(race * players, (race + 1) * players):
        results.terminated[player] = ended
        results.truncated[player] = late and not ended


@inner_kernel
def _end_step(state, end_tick, terms, players, results, first, last):
    """Write rewards and ends of a step, from the progress before it and the state after it."""
    progress, fault, before = state.progress, state.fault, results.before
    number = progress.shape[1]
    for race in range(first, last):
        end_race(state, race, end_tick, terms.decided, players, results)
        for car in range(players):
            own = progress[race, car] - before[race, car]
            opponents = 0.0
            for other in range(number):
                if other != car:
                    opponents += progress[race, other] - before[race, other]
            rival = opponents / max(1, number - 1)
            blamed = 1 if fault[race, car] > results.faults[race, car] else 0
            results.reward[race * players + car] = step_reward(own, rival, blamed, terms.weights)


@kernel
def step_races(inputs, races, orders, first, last, buffers, results):
    """Step races ``first`` to ``last - 1``: drive, then reward and observe."""
    track, settings, sight = inputs
    set_commands(orders.actions, orders.limits, races, first, last)
    own = Scratch(buffers.scratch, buffers.work)
    _call(orders.advance, (track, races, settings, orders.crew, orders.ticks, first, last, own))
    _end_step(races.state, settings.end_tick, orders.terms, sight.players, results, first, last)
    rows = orders.rows[first:last]
    out = results.observations[first * sight.players : last * sight.players]
    _call(orders.observe, (inputs, races, orders.eyes, rows, 0, sight.players, buffers, out))


def eyes_for(inputs: Inputs, races: Races, buffers: Buffers, moving: bool) -> Eyes:
    """Return the kernels that observations of the races need; ``moving``: obstacles move."""
    vehicles = races.vehicles.reshape(-1, races.vehicles.shape[-1])
    used = (vehicles != 0.0).any(axis=0).tolist()
    blurred = any(used[_vehicle.POSE_NOISE : _vehicle.OPPONENT_LOST + 1])
    arguments = inputs, races, 0, 0, buffers
    blurred |= inputs.settings.sight < FULL_SIGHT and races.vehicles.shape[1] > 1
    eyes = Eyes(sense=_eye(sense, *arguments) if blurred else 0)
    if len(inputs.sight.beams.cos) == 0:
        return eyes
    whole = (vehicles[:, _vehicle.LIDAR_FOV] >= 2.0 * np.pi).all() and not moving
    errors = used[_vehicle.LIDAR_X : _vehicle.LIDAR_FOV]
    errors += used[_vehicle.LIDAR_NOISE : _vehicle.LIDAR_STEP + 1]
    kernel = scan if whole and not any(errors) else scan_imperfect
    return eyes._replace(scan=_eye(kernel, *arguments, buffers.row))


_EYES: dict[tuple[Any, bool], Any] = {}


def _eye(kernel: Any, inputs: Inputs, *arguments: Any) -> Any:
    """Return the address of a kernel; looking up the types of its arguments takes a millisecond."""
    # Only this one of the arguments has several types.
    key = kernel, inputs.sight.in_sight is None
    if key not in _EYES:
        _EYES[key] = compiled_address(kernel, inputs, *arguments)
    return _EYES[key]
