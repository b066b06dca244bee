"""Compiled loop that advances a batch of races: plan, control, drive, collide, measure.

All events happen at fixed multiples of the simulation step of 0.01 s, so that a stop between two
calls changes no result.
"""

from typing import NamedTuple

import numpy as np

from pcs_racing.base.compilation import inner_kernel, kernel
from pcs_racing.base.elementary import sine_cosine
from pcs_racing.base.seeds import normal_noise
from pcs_racing.car import vehicle as _vehicle
from pcs_racing.car.ittc import rectangle_ittc, walls_ittc
from pcs_racing.car.lanes import (
    LANES,
    LANES_SIZE,
    load_car,
    set_target,
    step_alone,
    step_lanes,
    store_car,
)
from pcs_racing.planners import view as _view
from pcs_racing.planners.calling import call_control, call_plan
from pcs_racing.planners.pursuit import BRAKING
from pcs_racing.race import state as _state
from pcs_racing.race.config import CONTROL_EVERY, DT, ITTC_EVERY, PLAN_EVERY
from pcs_racing.race.contacts import END, settle_contacts
from pcs_racing.race.positions import (
    collide,
    laps_driven,
    nearest_car,
    touch_moving,
    update_progress,
)
from pcs_racing.race.sensing import (
    blur_view,
    opponent_lost,
    remember_cars,
    scan_key,
    senses_exactly,
)
from pcs_racing.race.steering import delayed, disturbed_speed, steering_sd
from pcs_racing.track.frenet import (
    COS,
    LATERAL_OF_PROFILE,
    SIN,
    SPEED,
    WALLS_BEGIN,
    WALLS_END,
    WallArrays,
    angle_between,
    shorter_way,
)
from pcs_racing.track.moving import HALF_LENGTH, HALF_WIDTH, lane_at, pose_at, velocity_at

BLOCKING_REACH = 3.0  # m

USED_GRIP = 0.65  # usable share of the peak lateral acceleration of a car that brakes

FAR = 1e6  # m: distance of the dummy opponent of a car that sees none

# Layout of the loop's scratch memory: the cars in their lanes; a flag for each car stepped alone;
# steering angle and progress of each car before a control period; the velocities of the cars of a
# race; the remaining steps of each race; the view of each car; race and car of the last call of a
# planner.
_ALONE = LANES_SIZE
_STEERING_BEFORE = _ALONE + LANES
_PROGRESS_BEFORE = _STEERING_BEFORE + LANES
_VELOCITIES = _PROGRESS_BEFORE + LANES
_LEFT = _VELOCITIES + 2 * LANES
_VIEWS = _LEFT + LANES
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


@inner_kernel
def _fill_fixed(own, settings, view):
    """Write the constants of a race into a view: the car's parameters and the range of speeds."""
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
    # Infinite for linear tyres. Bends are braked into.
    usable = USED_GRIP * _vehicle.peak_acceleration(own, -BRAKING)
    view[_view.GRIP_USE] = 1.0 / usable
    # A car whose tyres give less than the bends ask for at pace 1 drives all paces slower.
    share = min(np.sqrt(usable / LATERAL_OF_PROFILE) / settings.speed_high, 1.0)
    view[_view.SPEED_LOW] = share * settings.speed_low
    view[_view.SPEED_HIGH] = share * settings.speed_high
    for k in range(_view.SCAN_KEY - _view.LIDAR_X):
        view[_view.LIDAR_X + k] = own[_vehicle.LIDAR_X + k]


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


@inner_kernel
def _fill_own(tick, cars, frenet, race, car, view):
    """Write the changing values of the own car into a view."""
    view[_view.TIME] = tick * DT
    view[_view.OWN_X] = cars[race, car, _vehicle.X]
    view[_view.OWN_Y] = cars[race, car, _vehicle.Y]
    view[_view.OWN_DELTA] = cars[race, car, _vehicle.DELTA]
    view[_view.OWN_V] = cars[race, car, _vehicle.V]
    view[_view.OWN_PSI] = cars[race, car, _vehicle.PSI]
    view[_view.OWN_PSI_DOT] = cars[race, car, _vehicle.PSI_DOT]
    view[_view.OWN_BETA] = cars[race, car, _vehicle.BETA]
    view[_view.OWN_S] = frenet[race, car, 0]
    view[_view.OWN_D] = frenet[race, car, 1]


@inner_kernel
def _fill_opponent(line, ds, cars, frenet, progress, race, car, other, vehicles, view):
    """Write the car ``other`` as the opponent into a view."""
    view[_view.OPP_LENGTH] = vehicles[other, _vehicle.LENGTH]
    view[_view.OPP_WIDTH] = vehicles[other, _vehicle.WIDTH]
    view[_view.OPP_X] = cars[race, other, _vehicle.X]
    view[_view.OPP_Y] = cars[race, other, _vehicle.Y]
    view[_view.OPP_V] = cars[race, other, _vehicle.V]
    view[_view.OPP_PSI] = cars[race, other, _vehicle.PSI]
    view[_view.OPP_BETA] = cars[race, other, _vehicle.BETA]
    view[_view.OPP_S] = frenet[race, other, 0]
    view[_view.OPP_D] = frenet[race, other, 1]
    i = _part_at(frenet[race, other, 0], ds, line.shape[0])
    sine, cosine = sine_cosine(cars[race, other, _vehicle.PSI] + cars[race, other, _vehicle.BETA])
    view[_view.OPP_D_DOT] = cars[race, other, _vehicle.V] * (
        sine * line[i, COS] - cosine * line[i, SIN]
    )
    view[_view.GAP] = progress[race, other] - progress[race, car]


@inner_kernel(forceinline=True)
def _fill_other(line, ds, length, cars, frenet, progress, race, car, number, vehicles, view):
    """Write the visible opponent into a view: the other of two cars, else the nearest car.

    Return its number, -1 for a car alone.
    """
    if number == 1:
        _fill_nobody(length, vehicles[car], view)
        return -1
    other = 1 - car if number == 2 else nearest_car(length, frenet, race, car)
    _fill_opponent(line, ds, cars, frenet, progress, race, car, other, vehicles, view)
    return other


@inner_kernel(forceinline=True)
def _keep_truth(view):
    """Copy the exact poses of a view to the numbers for lidars."""
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


@inner_kernel  # not inlined: most cars see exactly
def _sense(line, ds, length, own, number, other, seed, car, tick, progress, memory, view):
    """Change an exact view into what a car measures, with the errors of its sensors."""
    blur_view(line, ds, length, own, number, other, seed, car, tick, progress, memory, view)
    if opponent_lost(own, seed, car, tick):
        _fill_nobody(length, own, view)


@inner_kernel(forceinline=True)
def _fill_changing(
    line, ds, length, cars, frenet, progress, seed, tick, race, car, number, vehicles, memory, view
):
    """Write the changing numbers of a view."""
    _fill_own(tick, cars, frenet, race, car, view)
    other = _fill_other(line, ds, length, cars, frenet, progress, race, car, number, vehicles, view)
    _keep_truth(view)
    own = vehicles[car]
    view[_view.SCAN_KEY] = scan_key(own, seed, car, tick)
    if not senses_exactly(own):
        _sense(
            line, ds, length, own, number, other, seed, car, tick, progress[race, car], memory, view
        )


@inner_kernel
def _fill_moving(moving, line, ds, length, view):
    """Write the nearest moving obstacle as the opponent, if it is nearer along the track."""
    time, nearest, own = view[_view.TIME], -1, view[_view.OWN_S]
    gap = shorter_way(length, view[_view.OPP_S] - own)
    for k in range(moving.shape[0]):
        ahead = shorter_way(length, lane_at(moving, ds, length, line.shape[0], k, time)[0] - own)
        if abs(ahead) < abs(gap):
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


@kernel
def fill_view(track, state, race, car, vehicles, settings, view):
    """Write the view of ``car`` (:data:`pcs_racing.planners.view.VIEW`) into ``view``."""
    _fill_fixed(vehicles[car], settings, view)
    _fill_changing(
        track.line,
        track.ds,
        track.length,
        state.cars,
        state.frenet,
        state.progress,
        state.seed[race],
        state.tick[race],
        race,
        car,
        state.cars.shape[1],
        vehicles,
        state.memory[race, car],
        view,
    )
    if track.moving.shape[0] > 0:
        _fill_moving(track.moving, track.line, track.ds, track.length, view)


@inner_kernel(forceinline=True)
def _count_overtakes(progress, leader, overtakes, ahead, race, vehicles, number):
    """Count an overtake once the car that was behind leads by more than a car's length."""
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


@kernel(forceinline=True)
def measure_ittc(near, cars, frenet, sums, race, vehicles, horizon, work, number):
    """Sample the minimum time to collision of ``number`` cars."""
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
        time = walls_ittc(near, stretch, x, y, work[car], work[LANES + car], horizon)
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
        sums[race, car, _state.ITTC] += time
        sums[race, car, _state.ITTC_SAMPLES] += 1.0


@inner_kernel(forceinline=True)
def _measure_driving(
    line, ds, speed_high, cars, frenet, progress, sums, race, vehicles, before, number
):
    """Add the contribution of one control period to the running sums.

    ``before`` begins with the steering angles of the cars before the period, followed by their
    progress.
    """
    period = CONTROL_EVERY * DT
    for car in range(number):
        # Time that the profile of pace 1 takes for the driven distance.
        driven = progress[race, car] - before[LANES + car]
        i = _part_at(frenet[race, car, 0], ds, line.shape[0])
        profile = driven / (speed_high * line[i, SPEED])
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
def _begin(state, vehicles, settings, ticks, race, place, number, work):
    """Load the cars of a race into the lanes from ``place`` on; return the steps to drive."""
    over = laps_driven(state.laps, race)
    for car in range(number):
        over |= state.crash[race, car] != 0
        lane = place + car
        load_car(work, lane, state.cars[race, car], vehicles[race, car], DT)
        if state.tick[race] % CONTROL_EVERY != 0:  # stopped between two commands
            set_target(work, lane, state.command[race, car, 0], state.command[race, car, 1])
            work[_STEERING_BEFORE + lane] = state.cars[race, car, _vehicle.DELTA]
        at = _VIEWS + lane * _view.VIEW_SIZE
        _fill_fixed(vehicles[race, car], settings, work[at : at + _view.VIEW_SIZE])
    return 0.0 if over else min(ticks, settings.end_tick - state.tick[race])


@inner_kernel(forceinline=True)
def _send(state, vehicle, settings, noise_share, race, car, tick, command, memory):
    """Disturb a command when it is sent, and delay it until it reaches the car."""
    noise_sd = steering_sd(settings, vehicle)
    if noise_sd > 0.0:
        draw = noise_sd * noise_share * normal_noise(state.seed[race], car, tick)
        state.disturbance[race, car] = settings.noise_keep * state.disturbance[race, car] + draw
        command[0] += state.disturbance[race, car]
    delay = vehicle[_vehicle.STEER_DELAY]
    if delay > 0.0:
        command[0] = delayed(memory, delay, tick, command[0])
    command[1] = disturbed_speed(command[1], vehicle, state.seed[race], car, tick)
    late = vehicle[_vehicle.SPEED_DELAY]
    if late > 0.0:
        command[1] = delayed(memory, late, tick, command[1], delay)
        if tick < late * CONTROL_EVERY:  # before the first command arrives
            command[1] = state.cars[race, car, _vehicle.V]


@inner_kernel(forceinline=True)
def _command(
    track,
    state,
    theta,
    vehicles,
    drivers,
    settings,
    noise_share,
    race,
    place,
    number,
    scratch,
    work,
):
    """Ask the planners of a race for commands, and set the targets of its cars."""
    cars, frenet, tick = state.cars, state.frenet, state.tick[race]
    for car in range(number):
        lane = place + car
        at = _VIEWS + lane * _view.VIEW_SIZE
        view, own = work[at : at + _view.VIEW_SIZE], theta[race, car]
        path, memory, command = (
            state.path[race, car],
            state.memory[race, car],
            state.command[race, car],
        )
        work[ASKED], work[ASKED + 1] = race, car
        remember_cars(cars, frenet, state.progress, race, vehicles[race, car], tick, memory)
        _fill_changing(
            track.line,
            track.ds,
            track.length,
            cars,
            frenet,
            state.progress,
            state.seed[race],
            tick,
            race,
            car,
            number,
            vehicles[race],
            memory,
            view,
        )
        if track.moving.shape[0] > 0:
            _fill_moving(track.moving, track.line, track.ds, track.length, view)
        if tick % PLAN_EVERY == 0:
            call_plan(drivers[car][race, 0], (track, own, view, memory, scratch, path))
        call_control(drivers[car][race, 1], (track, own, view, memory, scratch, path, command))
        if not np.isfinite(command[0] + command[1]):
            raise FloatingPointError("its command is not finite")
        _send(state, vehicles[race, car], settings, noise_share, race, car, tick, command, memory)
        set_target(work, lane, command[0], command[1])
        work[_STEERING_BEFORE + lane] = cars[race, car, _vehicle.DELTA]


@inner_kernel(forceinline=True)
def _end_period(track, near, state, settings, race, place, number, params, work):
    """Update a race at the end of a control period; return whether the race ends.

    The period is measured before the check for contacts: a race that ends now has driven it.
    """
    cars, frenet, progress, tick = state.cars, state.frenet, state.progress, state.tick[race]
    for car in range(number):
        work[_PROGRESS_BEFORE + place + car] = progress[race, car]
        update_progress(
            track.line, track.ds, track.length, cars, frenet, progress, state.laps, tick, race, car
        )
    before = work[_STEERING_BEFORE + place :]
    _measure_driving(
        track.line,
        track.ds,
        settings.speed_high,
        cars,
        frenet,
        progress,
        state.sums,
        race,
        params,
        before,
        number,
    )
    ended = False
    if settings.contact == END:
        touched = 0
        if track.moving.shape[0] > 0:
            touched = touch_moving(
                track.moving, track.line, track.ds, track.length, tick, cars, race, params
            )
        ended = collide(near, cars, frenet, state.crash, state.fault, race, params, number, touched)
    else:
        before = work[_VIEWS + _view.VIEW_SIZE * place :]
        if settle_contacts(track, state, race, params, settings.contact, before):
            for car in range(number):
                load_car(work, place + car, cars[race, car], params[car], DT)
        for car in range(number):
            if 0 < settings.most_faults <= state.fault[race, car]:
                state.crash[race, car] = state.contact[race, car]
                ended = True
    _count_overtakes(progress, state.leader, state.overtakes, state.ahead, race, params, number)
    return ended or laps_driven(state.laps, race)


@kernel
def advance_races(
    track, state, theta, vehicles, drivers, settings, ticks, first, last, scratch, work
):
    """Advance races ``first`` to ``last - 1`` of a batch by ``ticks`` steps each, in place.

    A race stands still after a crash, its last lap or ``settings.end_tick``. Races are driven in
    groups whose cars share the processor's vectors, eight cars at a time; no race depends on the
    others in its group.

    ``theta``, shape (B, N, P), holds the policy parameters of each race, and ``vehicles``, shape
    (B, N, 48), the parameter rows of its cars. ``drivers`` holds for each car the addresses of
    plan and control in every race (:func:`pcs_racing.race.driving.pointers_of`). ``scratch`` has
    the maximum scratch size of the planners, and ``work`` has ``WORK_SIZE`` numbers. Their contents
    are undefined after the call, except for ``work[ASKED:]``: race and car of a planner that raised
    an error.
    """
    near = WallArrays(*track[WALLS_BEGIN:WALLS_END])
    # A number of cars known at compile time makes races of two cars faster: `pointers_of` provides
    # it.
    number = len(drivers)
    group = LANES // number
    noise_share = np.sqrt(1.0 - settings.noise_keep * settings.noise_keep)
    # Left-over numbers may be denormal, and arithmetic with denormal numbers is slow.
    work[:LANES_SIZE] = 0.0
    for start in range(first, last, group):
        stop = min(start + group, last)
        for race in range(start, stop):
            place = number * (race - start)  # first lane of the race's cars
            work[_LEFT + race - start] = _begin(
                state, vehicles, settings, ticks, race, place, number, work
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
                    _command(
                        track,
                        state,
                        theta,
                        vehicles,
                        drivers,
                        settings,
                        noise_share,
                        race,
                        place,
                        number,
                        scratch,
                        work,
                    )
                # Some cars are stepped one by one; their lanes are computed as well, and
                # overwritten below.
                for car in range(number):
                    lane = place + car
                    alone = step_alone(work, lane, state.cars[race, car], vehicles[race, car], DT)
                    work[_ALONE + lane] = 1.0 if alone else 0.0
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
                    track, near, state, settings, race, place, number, params, work
                ):
                    work[_LEFT + race - start] = 0.0
                if tick % ITTC_EVERY == 0 and settings.ittc_horizon > 0.0:
                    measure_ittc(
                        near,
                        state.cars,
                        state.frenet,
                        state.sums,
                        race,
                        params,
                        settings.ittc_horizon,
                        work[_VELOCITIES:],
                        number,
                    )
