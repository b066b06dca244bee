"""Compiled loop that advances a batch of races: plan, control, drive, collide, measure.

All events happen at fixed multiples of the simulation step of 0.01 s, so that a stop between two
calls changes no result.
"""

from typing import Any, NamedTuple

import numpy as np
from numba import typeof, types
from numpy.typing import NDArray

from pcs_racing.base.compilation import inner_kernel, kernel
from pcs_racing.base.elementary import sine_cosine
from pcs_racing.base.numba_parts import address_for, call_with
from pcs_racing.base.seeds import normal_noise
from pcs_racing.car import vehicle as _vehicle
from pcs_racing.car.collision import Rectangle
from pcs_racing.car.ittc import rectangle_ittc, walls_ittc
from pcs_racing.car.lanes import (
    LANES,
    LANES_SIZE,
    load_car,
    set_target,
    step_alone,
    step_lanes,
    step_slow,
    steps_alone,
    store_car,
)
from pcs_racing.planners import view as _view
from pcs_racing.planners.calling import TRACK, call_control, call_plan
from pcs_racing.planners.pursuit import BRAKING
from pcs_racing.race import state as _state
from pcs_racing.race.config import CONTROL_EVERY, DT, FULL_SIGHT, ITTC_EVERY, PLAN_EVERY
from pcs_racing.race.contacts import END, settle_contacts
from pcs_racing.race.positions import (
    collide,
    laps_driven,
    move_along,
    nearest_car,
    touch_moving,
)
from pcs_racing.race.sensing import (
    blur_view,
    opponent_lost,
    out_of_sight,
    remember_cars,
    scan_key,
    seen_car,
    senses_exactly,
)
from pcs_racing.race.state import RaceState
from pcs_racing.race.steering import send_late, slowed
from pcs_racing.track.frenet import (
    COS,
    LATERAL_OF_PROFILE,
    SIN,
    SPEED,
    WALLS_BEGIN,
    WALLS_END,
    WallArrays,
    angle_between,
    foot,
    shorter_way,
)
from pcs_racing.track.moving import HALF_LENGTH, HALF_WIDTH, lane_at, pose_at, velocity_at

BLOCKING_REACH = 3.0  # m

USED_GRIP = 0.65  # usable share of the peak lateral acceleration of a car that brakes

FAR = 1e6  # m: distance of the dummy opponent of a car that sees none

# Layout of the loop's scratch memory: the cars in their lanes; a flag for each car stepped alone;
# steering angle and progress of each car before a control period; the velocities of the cars of a
# race; the remaining steps of each race; the cars in moving obstacles, as bits; the view of each
# car; race and car of the last call of a planner.
_ALONE = LANES_SIZE
_STEERING_BEFORE = _ALONE + LANES
_PROGRESS_BEFORE = _STEERING_BEFORE + LANES
_VELOCITIES = _PROGRESS_BEFORE + LANES
_LEFT = _VELOCITIES + 2 * LANES
_TOUCHED = _LEFT + LANES
_VIEWS = _TOUCHED + 1
ASKED = _VIEWS + LANES * _view.VIEW_SIZE
WORK_SIZE = ASKED + 2


class KernelSettings(NamedTuple):
    """Numbers of a race configuration that the compiled loop needs.

    An ``ittc_horizon`` of 0 skips the minimum time to collision, which has no effect on driving.
    """

    end_tick: int
    speed_low: float
    speed_high: float
    noise_sd: float
    noise_keep: float
    ittc_horizon: float
    contact: int  #: Index in :data:`pcs_racing.race.config.CONTACTS`.
    most_faults: int  #: Number of a car's faults that ends the race; 0 for no limit.
    sight: float  #: Visible angle around the lidar's heading, rad.


class Races(NamedTuple):
    """Races of a batch: their state, the policies and the parameters of their cars."""

    state: RaceState
    theta: NDArray[np.float64]  #: shape (B, N, P): Policy parameters.
    vehicles: NDArray[np.float64]  #: shape (B, N, 48): Parameter rows of the cars.


class Parts(NamedTuple):
    """Addresses of the kernels that only some races need; 0 in races without a use for them.

    So no race compiles or runs them without need, and the loop is compiled once for all races.
    """

    ittc: Any = 0  #: Samples of the minimum time to collision.
    settle: Any = 0  #: Contacts that do not end a race.
    sense: Any = 0  #: Limited sight, errors and delays of a car's sensors.
    send: Any = 0  #: Delays and noise of a car's commands.
    grip: Any = 0  #: Grip of cars with Pacejka tyres, in their views.
    slide: Any = 0  #: Steps of cars with Pacejka tyres.
    meet: Any = 0  #: Moving obstacles as opponents.
    touch: Any = 0  #: Contacts with moving obstacles.


class Crew(NamedTuple):
    """Functions for races by their addresses."""

    #: Plan and control of each car in every race (:func:`pcs_racing.race.driving.pointers_of`).
    drivers: Any
    parts: Parts


class Scratch(NamedTuple):
    """Scratch memory of a thread; its contents are undefined after a call.

    Except for ``work[ASKED:]``: race and car of a planner that raised an error.
    """

    planners: NDArray[np.float64]  #: Scratch memory with the max size of the planners.
    work: NDArray[np.float64]  #: shape (``WORK_SIZE``,): Scratch memory of the loop.


_PART = (
    TRACK,
    typeof(_state.empty_state(1, 1)),
    types.Array(types.float64, 2, "C"),
    typeof(KernelSettings(0, 0.0, 0.0, 0.0, 0.0, 0.0, 0, 0, 0.0)),
    types.int64,
    types.int64,
    types.Array(types.float64, 1, "C"),
)
"""Argument types of a part: track, state, cars of the race, settings, race, car, and numbers."""

_call_part = call_with(_PART)


@inner_kernel
def _fill_fixed(own, settings, usable, handicap, view):
    """Write the constants of a race into a view: the car's parameters and the range of speeds.

    ``usable`` is the car's usable lateral acceleration, infinite for linear tyres.
    """
    view[_view.OWN_LENGTH] = own[_vehicle.LENGTH]
    view[_view.OWN_WIDTH] = own[_vehicle.WIDTH]
    view[_view.WHEELBASE] = own[_vehicle.LF] + own[_vehicle.LR]
    view[_view.STEER_MAX] = own[_vehicle.STEER_MAX]
    grip = own[_vehicle.MU] * _vehicle.GRAVITY
    front, rear = _vehicle.cornering_stiffness(own)
    view[_view.UNDERSTEER] = (1.0 / front - 1.0 / rear) / grip
    view[_view.UNDERSTEER_GAIN] = (
        own[_vehicle.H]
        / (grip * _vehicle.GRAVITY)
        * (1.0 / (front * own[_vehicle.LR]) + 1.0 / (rear * own[_vehicle.LF]))
    )
    view[_view.REAR_SLIP] = 1.0 / (grip * rear)
    view[_view.REAR_AXLE] = own[_vehicle.LR]
    view[_view.GRIP_USE] = 1.0 / usable
    view[_view.STEER_LAG] = own[_vehicle.STEER_LAG]
    view[_view.SPEED_LAG] = own[_vehicle.SPEED_LAG]
    view[_view.STEER_DELAY] = own[_vehicle.STEER_DELAY] * _vehicle.COMMAND_PERIOD
    # A car whose tyres give less than the bends ask for at pace 1 drives all paces slower.
    share = min(np.sqrt(usable / LATERAL_OF_PROFILE) / settings.speed_high, 1.0)
    view[_view.SPEED_LOW] = share * settings.speed_low
    view[_view.SPEED_HIGH] = share * settings.speed_high
    view[_view.HANDICAP] = handicap
    for k in range(_view.SCAN_KEY - _view.LIDAR_X):
        view[_view.LIDAR_X + k] = own[_vehicle.LIDAR_X + k]


@inner_kernel
def _fill_grip(track, state, vehicles, settings, race, car, view):
    """Write the constants of a race for a car with any tyres; it brakes into bends."""
    usable = USED_GRIP * _vehicle.peak_acceleration(vehicles[car], -BRAKING)
    _fill_fixed(vehicles[car], settings, usable, state.handicap[race, car], view)


@inner_kernel(forceinline=True)
def _part_at(s, size, parts):
    """Return the index of the part of the line (equal parts) at an arc length in [0, length)."""
    i = int(s / size)
    # Rounding can give an index beyond the last part, and a state from elsewhere any index; a
    # remainder would take a division.
    return i if 0 <= i < parts else 0


@inner_kernel
def _fill_nobody(length, own, view):
    """Write an opponent that no car can meet: at rest, far off the track, half a lap away."""
    view[_view.OPP_LENGTH] = own[_vehicle.LENGTH]
    view[_view.OPP_WIDTH] = own[_vehicle.WIDTH]
    view[_view.OPP_X] = view[_view.OWN_X] + FAR
    view[_view.OPP_Y] = view[_view.OWN_Y] + FAR
    view[_view.OPP_V] = 0.0
    view[_view.OPP_PSI] = 0.0
    view[_view.OPP_BETA] = 0.0
    s = view[_view.OWN_S] + 0.5 * length
    view[_view.OPP_S] = s - length if s >= length else s
    view[_view.OPP_D] = FAR
    view[_view.OPP_D_DOT] = 0.0
    view[_view.GAP] = 0.5 * length


@inner_kernel(forceinline=True)
def _fill_opponent(track, state, race, car, other, vehicles, view):
    """Write the car ``other`` as the opponent into a view."""
    cars, frenet, line = state.cars, state.frenet, track.line
    view[_view.OPP_LENGTH] = vehicles[other, _vehicle.LENGTH]
    view[_view.OPP_WIDTH] = vehicles[other, _vehicle.WIDTH]
    view[_view.OPP_X] = cars[race, other, _vehicle.X]
    view[_view.OPP_Y] = cars[race, other, _vehicle.Y]
    view[_view.OPP_V] = cars[race, other, _vehicle.V]
    view[_view.OPP_PSI] = cars[race, other, _vehicle.PSI]
    view[_view.OPP_BETA] = cars[race, other, _vehicle.BETA]
    view[_view.OPP_S] = frenet[race, other, 0]
    view[_view.OPP_D] = frenet[race, other, 1]
    i = _part_at(frenet[race, other, 0], track.ds, line.shape[0])
    sine, cosine = sine_cosine(cars[race, other, _vehicle.PSI] + cars[race, other, _vehicle.BETA])
    view[_view.OPP_D_DOT] = cars[race, other, _vehicle.V] * (
        sine * line[i, COS] - cosine * line[i, SIN]
    )
    view[_view.GAP] = state.progress[race, other] - state.progress[race, car]


@inner_kernel(forceinline=True)
def _look(track, state, vehicles, settings, race, car, view):
    """Write the nearest car in sight as the opponent into a view; return the car, -1 for none."""
    if state.cars.shape[1] == 1:
        return -1
    nearest = nearest_car(track.length, state.frenet, race, car)
    if settings.sight >= FULL_SIGHT:
        return nearest
    other = seen_car(track.length, state, race, car, vehicles, settings.sight)
    if other < 0:
        # A driver still knows who leads.
        leads = view[_view.GAP] > 0.0
        _fill_nobody(track.length, vehicles[car], view)
        view[_view.GAP] *= 1.0 if leads else -1.0
    elif other != nearest:
        _fill_opponent(track, state, race, car, other, vehicles, view)
    return other


@inner_kernel
def _look_around(track, state, vehicles, settings, race, car, view):
    """Look around, in a race of cars with exact sensors."""
    _look(track, state, vehicles, settings, race, car, view)


@inner_kernel
def _sense(track, state, vehicles, settings, race, car, view):
    """Change an exact view into a car's measurements, with the errors of its sensors."""
    own, tick, seed = vehicles[car], state.tick[race], state.seed[race]
    view[_view.SCAN_KEY] = scan_key(own, seed, car, tick)
    other = _look(track, state, vehicles, settings, race, car, view)
    if senses_exactly(own):
        return
    number = state.cars.shape[1]
    blur_view(
        track.line,
        track.ds,
        track.length,
        own,
        number,
        other,
        seed,
        car,
        tick,
        state.progress[race, car],
        state.memory[race, car],
        view,
    )
    if opponent_lost(own, seed, car, tick):
        _fill_nobody(track.length, own, view)


@inner_kernel
def _remember_and_sense(track, state, vehicles, settings, race, car, view):
    """Sense at a command: such cars are also remembered, to be seen late."""
    remember_cars(state, race, car, vehicles, settings.sight)
    _sense(track, state, vehicles, settings, race, car, view)


@inner_kernel(forceinline=True)
def _fill_exact(drivers, track, state, race, car, vehicles, view):
    """Write the changing numbers of a view without errors; ``drivers`` has an item for each car.

    The visible opponent is the other of two cars, else the nearest car.
    """
    own = state.cars[race, car]
    view[_view.TIME] = state.tick[race] * DT
    view[_view.OWN_X], view[_view.OWN_Y] = own[_vehicle.X], own[_vehicle.Y]
    view[_view.OWN_DELTA], view[_view.OWN_V] = own[_vehicle.DELTA], own[_vehicle.V]
    view[_view.OWN_PSI], view[_view.OWN_PSI_DOT] = own[_vehicle.PSI], own[_vehicle.PSI_DOT]
    view[_view.OWN_BETA] = own[_vehicle.BETA]
    view[_view.OWN_S], view[_view.OWN_D] = state.frenet[race, car, 0], state.frenet[race, car, 1]
    if len(drivers) == 1:
        _fill_nobody(track.length, vehicles[car], view)
    elif len(drivers) == 2:
        _fill_opponent(track, state, race, car, 1 - car, vehicles, view)
    else:
        other = nearest_car(track.length, state.frenet, race, car)
        _fill_opponent(track, state, race, car, other, vehicles, view)
    # For lidars.
    view[_view.TRUE_X] = view[_view.OWN_X]
    view[_view.TRUE_Y] = view[_view.OWN_Y]
    view[_view.TRUE_PSI] = view[_view.OWN_PSI]
    view[_view.TRUE_S] = view[_view.OWN_S]
    view[_view.TRUE_D] = view[_view.OWN_D]
    view[_view.TRUE_OPP_X] = view[_view.OPP_X]
    view[_view.TRUE_OPP_Y] = view[_view.OPP_Y]
    view[_view.TRUE_OPP_PSI] = view[_view.OPP_PSI]
    view[_view.TRUE_OPP_LENGTH] = view[_view.OPP_LENGTH]
    view[_view.TRUE_OPP_WIDTH] = view[_view.OPP_WIDTH]
    view[_view.SCAN_KEY] = 0.0


@inner_kernel
def _meet(track, state, vehicles, settings, race, car, view):
    """Write the nearest moving obstacle as the opponent, if it is nearer along the track."""
    moving, line, ds, length = track.moving, track.line, track.ds, track.length
    time, nearest, own = view[_view.TIME], -1, view[_view.OWN_S]
    gap = shorter_way(length, view[_view.OPP_S] - own)
    here = state.cars[race, car]
    for k in range(moving.shape[0]):
        ahead = shorter_way(length, lane_at(moving, ds, length, line.shape[0], k, time)[0] - own)
        if abs(ahead) < abs(gap):
            half = moving[k, HALF_WIDTH]
            half = half if half > 0.0 else moving[k, HALF_LENGTH]
            x, y, psi = pose_at(moving, line, ds, length, k, time)
            seen = Rectangle(x, y, psi, moving[k, HALF_LENGTH], half)
            if not out_of_sight(here, vehicles[car], seen, settings.sight):
                nearest, gap = k, ahead
    if nearest < 0:
        return
    s, d, across = lane_at(moving, ds, length, line.shape[0], nearest, time)
    x, y, psi = pose_at(moving, line, ds, length, nearest, time)
    course, speed = velocity_at(moving, line, ds, length, nearest, time)
    half_length, half_width = moving[nearest, HALF_LENGTH], moving[nearest, HALF_WIDTH]
    view[_view.OPP_LENGTH] = 2.0 * half_length
    view[_view.OPP_WIDTH] = 2.0 * (half_width if half_width > 0.0 else half_length)
    view[_view.OPP_X], view[_view.OPP_Y] = x, y
    view[_view.OPP_V], view[_view.OPP_PSI] = speed, psi
    view[_view.OPP_BETA] = angle_between(course, psi)
    view[_view.OPP_S], view[_view.OPP_D] = s, d
    view[_view.OPP_D_DOT] = across
    view[_view.GAP] = gap


@inner_kernel
def _touch(track, state, vehicles, settings, race, car, touched):
    """Write the cars of a race that touch a moving obstacle, one bit for each car."""
    touched[0] = touch_moving(track, state.tick[race], state.cars, race, vehicles)


@kernel
def fill_view(track, state, race, car, vehicles, settings, view):
    """Write the view of ``car`` (:data:`pcs_racing.planners.view.VIEW`) into ``view``."""
    _fill_grip(track, state, vehicles, settings, race, car, view)
    _fill_exact(state.cars[race], track, state, race, car, vehicles, view)
    _sense(track, state, vehicles, settings, race, car, view)
    if track.moving.shape[0] > 0:
        _meet(track, state, vehicles, settings, race, car, view)


@inner_kernel(forceinline=True)
def _count_overtakes(drivers, state, race, vehicles):
    """Count an overtake once the car that was behind leads by more than a car's length."""
    progress, leader, overtakes, ahead = state.progress, state.leader, state.overtakes, state.ahead
    number = len(drivers)
    for one in range(number):
        for two in range(one + 1, number):
            # More than a length, so that two cars side by side do not overtake each other at every
            # step.
            lead = progress[race, one] - progress[race, two]
            if abs(lead) > vehicles[one, _vehicle.LENGTH]:
                first, second = (one, two) if lead > 0.0 else (two, one)
                if ahead[race, first] >> second & 1:
                    continue
                if ahead[race, second] >> first & 1:
                    overtakes[race, first] += 1
                    ahead[race, second] &= 0xFF ^ (1 << first)  # ~ is negative in plain Python
                ahead[race, first] |= 1 << second
                if ahead[race, first] | 1 << first == (1 << number) - 1:
                    leader[race] = first


@inner_kernel
def _measure_ittc(track, state, vehicles, settings, race, car, work):
    """Sample the minimum time to collision of the cars of a race."""
    near = WallArrays(*track[WALLS_BEGIN:WALLS_END])
    cars, frenet, number = state.cars, state.frenet, state.cars.shape[1]
    # All velocities are computed once, before the loop: each car also needs the velocities of the
    # other cars.
    for car in range(number):
        sine, cosine = sine_cosine(cars[race, car, _vehicle.PSI] + cars[race, car, _vehicle.BETA])
        work[car], work[LANES + car] = (
            cars[race, car, _vehicle.V] * cosine,
            cars[race, car, _vehicle.V] * sine,
        )
    for car in range(number):
        x = cars[race, car, _vehicle.X]
        y = cars[race, car, _vehicle.Y]
        stretch = _part_at(frenet[race, car, 0], near.seen_stretch, near.seen_middle.shape[0])
        time = walls_ittc(near, stretch, x, y, work[car], work[LANES + car], settings.ittc_horizon)
        for other in range(number):
            if other != car:
                time = rectangle_ittc(
                    cars[race, other, _vehicle.X] - x,
                    cars[race, other, _vehicle.Y] - y,
                    cars[race, other, _vehicle.PSI],
                    0.5 * vehicles[other, _vehicle.LENGTH],
                    0.5 * vehicles[other, _vehicle.WIDTH],
                    work[car] - work[other],
                    work[LANES + car] - work[LANES + other],
                    time,
                )
        state.sums[race, car, _state.ITTC] += time
        state.sums[race, car, _state.ITTC_SAMPLES] += 1.0


@inner_kernel
def _slide(track, state, vehicles, settings, race, car, lanes):
    """Step a car with any tyres alone; its lane is the first of ``lanes``."""
    step_alone(lanes, 0, state.cars[race, car], vehicles[car], DT)


@inner_kernel(forceinline=True)
def _measure_driving(drivers, track, state, settings, race, vehicles, before):
    """Add the contribution of one control period to the running sums.

    ``before`` begins with the steering angles of the cars before the period, followed by their
    progress.
    """
    cars, frenet, progress, sums = state.cars, state.frenet, state.progress, state.sums
    period, number, line = CONTROL_EVERY * DT, len(drivers), track.line
    for car in range(number):
        # Time that the profile of pace 1 takes for the driven distance.
        driven = progress[race, car] - before[LANES + car]
        i = _part_at(frenet[race, car, 0], track.ds, line.shape[0])
        profile = driven / (settings.speed_high * line[i, SPEED])
        sums[race, car, _state.PROFILE] += profile
        behind = False
        for other in range(number):
            behind = behind or before[LANES + other] > before[LANES + car]
        if behind:
            sums[race, car, _state.TIME_BEHIND] += period
            sums[race, car, _state.PROFILE_BEHIND] += profile
        for other in range(number):
            lead = progress[race, car] - progress[race, other]
            beside = abs(frenet[race, car, 1] - frenet[race, other, 1])
            in_the_way = 0.5 * (vehicles[car, _vehicle.WIDTH] + vehicles[other, _vehicle.WIDTH])
            if beside < in_the_way and 0.0 < lead < BLOCKING_REACH:
                sums[race, car, _state.BLOCKING] += period
                break
        sideways = cars[race, car, _vehicle.V] * cars[race, car, _vehicle.PSI_DOT]
        sums[race, car, _state.STEERING] += abs(cars[race, car, _vehicle.DELTA] - before[car])
        sums[race, car, _state.LATERAL] += sideways * sideways * period
        sums[race, car, _state.TIME] += period


@inner_kernel(forceinline=True)
def _begin(track, races, settings, crew, ticks, race, place, work):
    """Load the cars of a race into the lanes from ``place`` on; return the steps to drive."""
    state, vehicles = races.state, races.vehicles[race]
    over = laps_driven(state.laps, race)
    for car in range(len(crew.drivers)):
        over |= state.crash[race, car] != 0
        lane = place + car
        load_car(work, lane, state.cars[race, car], vehicles[car], DT)
        if state.tick[race] % CONTROL_EVERY != 0:  # stopped between two commands
            set_target(work, lane, state.command[race, car, 0], state.command[race, car, 1])
            work[_STEERING_BEFORE + lane] = state.cars[race, car, _vehicle.DELTA]
        at = _VIEWS + lane * _view.VIEW_SIZE
        view = work[at : at + _view.VIEW_SIZE]
        if crew.parts.grip == 0:
            _fill_fixed(vehicles[car], settings, np.inf, state.handicap[race, car], view)
        else:
            _call_part(crew.parts.grip, (track, state, vehicles, settings, race, car, view))
    left = settings.end_tick - state.tick[race]
    return 0.0 if over else ticks if ticks < left else left


@inner_kernel(forceinline=True)
def _command(drivers, track, races, settings, parts, race, place, buffers):
    """Ask the planners of a race for commands, and set the targets of its cars."""
    state, vehicles, (scratch, work) = races.state, races.vehicles[race], buffers
    tick = state.tick[race]
    for car in range(len(drivers)):
        lane = place + car
        at = _VIEWS + lane * _view.VIEW_SIZE
        view, own = work[at : at + _view.VIEW_SIZE], races.theta[race, car]
        path, memory, command = (
            state.path[race, car],
            state.memory[race, car],
            state.command[race, car],
        )
        work[ASKED], work[ASKED + 1] = race, car
        _fill_exact(drivers, track, state, race, car, vehicles, view)
        if parts.sense != 0:
            _call_part(parts.sense, (track, state, vehicles, settings, race, car, view))
        if parts.meet != 0:
            _call_part(parts.meet, (track, state, vehicles, settings, race, car, view))
        if tick % PLAN_EVERY == 0:
            call_plan(drivers[car][race, 0], (track, own, view, memory, scratch, path))
        call_control(drivers[car][race, 1], (track, own, view, memory, scratch, path, command))
        if not np.isfinite(command[0] + command[1]):
            raise FloatingPointError("its command is not finite")
        noise_sd = vehicles[car, _vehicle.STEER_NOISE]
        if noise_sd < 0.0:
            noise_sd = settings.noise_sd
        if noise_sd > 0.0:
            share = np.sqrt(1.0 - settings.noise_keep * settings.noise_keep)
            draw = noise_sd * share * normal_noise(state.seed[race], car, tick)
            state.disturbance[race, car] = settings.noise_keep * state.disturbance[race, car] + draw
            command[0] += state.disturbance[race, car]
        v = state.cars[race, car, _vehicle.V]
        command[1] = slowed(command[1], state.handicap[race, car], v, vehicles[car])
        if parts.send != 0:
            _call_part(parts.send, (track, state, vehicles, settings, race, car, command))
        set_target(work, lane, command[0], command[1])
        work[_STEERING_BEFORE + lane] = state.cars[race, car, _vehicle.DELTA]


@inner_kernel(forceinline=True)
def _end_period(drivers, track, races, settings, parts, race, place, work):
    """Update a race at the end of a control period; return whether the race ends.

    The period is measured before the check for contacts: a race that ends now has driven it.
    """
    state, params = races.state, races.vehicles[race]
    cars, frenet, progress, tick = state.cars, state.frenet, state.progress, state.tick[race]
    for car in range(len(drivers)):
        work[_PROGRESS_BEFORE + place + car] = progress[race, car]
        x, y = cars[race, car, _vehicle.X], cars[race, car, _vehicle.Y]
        s, d = foot(track.line, track.ds, track.length, x, y, frenet[race, car, 0])
        move_along(track.length, frenet, progress, state.laps, tick, race, car, s, d)
    before = work[_STEERING_BEFORE + place :]
    _measure_driving(drivers, track, state, settings, race, params, before)
    if parts.settle == 0:
        work[_TOUCHED] = 0.0
        if parts.touch != 0:
            touched = work[_TOUCHED:]
            _call_part(parts.touch, (track, state, params, settings, race, place, touched))
        near = WallArrays(*track[WALLS_BEGIN:WALLS_END])
        ended = collide(drivers, near, state, race, params, int(work[_TOUCHED]))
    else:
        before = work[_VIEWS + _view.VIEW_SIZE * place :]
        _call_part(parts.settle, (track, state, params, settings, race, place, before))
        ended = False
        for car in range(len(drivers)):
            load_car(work, place + car, cars[race, car], params[car], DT)  # it may have been moved
            ended |= state.crash[race, car] != 0
    if len(drivers) > 1:
        _count_overtakes(drivers, state, race, params)
    return ended or laps_driven(state.laps, race)


@kernel
def advance_races(track, races, settings, crew, ticks, first, last, buffers):
    """Advance races ``first`` to ``last - 1`` of a batch by ``ticks`` steps each, in place.

    A race stands still after a crash, its last lap or ``settings.end_tick``. Races are driven in
    groups whose cars share the processor's vectors, eight cars at a time; no race depends on the
    others in its group.

    The arguments are :class:`pcs_racing.track.frenet.TrackArrays`, :class:`Races`,
    :class:`KernelSettings`, :class:`Crew` and :class:`Scratch`.
    """
    state, vehicles, work, parts = races.state, races.vehicles, buffers.work, crew.parts
    # A number of cars known at compile time makes races of two cars faster: `pointers_of` provides
    # it.
    number = len(crew.drivers)
    group = LANES // number
    # Left-over numbers may be denormal, and arithmetic with denormal numbers is slow.
    work[:LANES_SIZE] = 0.0
    for start in range(first, last, group):
        stop = start + group if start + group < last else last
        for race in range(start, stop):
            place = number * (race - start)  # first lane of the race's cars
            work[_LEFT + race - start] = _begin(
                track, races, settings, crew, ticks, race, place, work
            )
        # One iteration is one step of all races of the group that still drive.
        driving = True
        while driving:
            driving = False
            for race in range(start, stop):
                if work[_LEFT + race - start] <= 0.0:
                    continue
                driving = True
                place = number * (race - start)
                if state.tick[race] % CONTROL_EVERY == 0:
                    _command(crew.drivers, track, races, settings, parts, race, place, buffers)
                # Some cars are stepped one by one; their lanes are computed as well, and
                # overwritten below.
                for car in range(number):
                    lane, own = place + car, state.cars[race, car]
                    alone = steps_alone(work, lane)
                    work[_ALONE + lane] = 1.0 if alone else 0.0
                    if alone and parts.slide == 0:
                        step_slow(work, lane, own, vehicles[race, car], DT)
                    elif alone:
                        lanes = work[lane:]
                        _call_part(
                            parts.slide,
                            (track, state, vehicles[race], settings, race, car, lanes),
                        )
            step_lanes(work, number * (stop - start), DT)
            for race in range(start, stop):
                if work[_LEFT + race - start] <= 0.0:
                    continue
                work[_LEFT + race - start] -= 1.0
                params = vehicles[race]
                place = number * (race - start)
                for car in range(number):
                    if work[_ALONE + place + car] != 0.0:
                        load_car(work, place + car, state.cars[race, car], params[car], DT)
                    else:
                        store_car(work, place + car, state.cars[race, car])
                tick = state.tick[race] + 1
                state.tick[race] = tick
                if tick % CONTROL_EVERY == 0 and _end_period(
                    crew.drivers, track, races, settings, parts, race, place, work
                ):
                    work[_LEFT + race - start] = 0.0
                if tick % ITTC_EVERY == 0 and parts.ittc != 0:
                    own = work[_VELOCITIES:]
                    _call_part(parts.ittc, (track, state, params, settings, race, place, own))


_KERNELS = Parts(
    ittc=_measure_ittc,
    settle=settle_contacts,
    sense=_look_around,
    send=send_late,
    grip=_fill_grip,
    slide=_slide,
    meet=_meet,
    touch=_touch,
)


def parts_for(settings: KernelSettings, vehicles: NDArray[np.float64], moving: bool) -> Parts:
    """Return the parts of the loop that races with these rules and cars need.

    ``moving``: there are moving obstacles.
    """
    used = (vehicles.reshape(-1, vehicles.shape[-1]) != 0.0).any(axis=0).tolist()
    blurred = used[_vehicle.LIDAR_NOISE] or used[_vehicle.LIDAR_LOST]
    blurred = blurred or any(used[_vehicle.POSE_NOISE : _vehicle.OPPONENT_LOST + 1])
    kernels = _KERNELS._replace(sense=_remember_and_sense) if blurred else _KERNELS
    wanted = Parts(
        ittc=settings.ittc_horizon > 0.0,
        settle=settings.contact != END,
        sense=blurred or (settings.sight < FULL_SIGHT and vehicles.shape[-2] > 1),
        send=used[_vehicle.STEER_DELAY] or used[_vehicle.SPEED_DELAY] or used[_vehicle.SPEED_NOISE],
        grip=used[_vehicle.TYRES],
        slide=used[_vehicle.TYRES],
        meet=moving,
        touch=moving,
    )
    both = zip(kernels, wanted, strict=True)
    return Parts._make(address_for(part, _PART) if needed else 0 for part, needed in both)
