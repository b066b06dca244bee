"""The compiled loop that advances a batch of two-car races: plan, control, drive, collide, measure.

Everything happens at fixed multiples of the simulation step of 0.01 s, so that stopping and going on changes nothing.
"""

from typing import NamedTuple

import numpy as np

from pcs_racing.base.compilation import kernel
from pcs_racing.base.elementary import sine_cosine
from pcs_racing.car import vehicle as _vehicle
from pcs_racing.car.collision import contact_fault, hits_wall, rectangles_overlap
from pcs_racing.car.ittc import rectangle_ittc, walls_ittc
from pcs_racing.planners import planner as _planner
from pcs_racing.race import state as _state
from pcs_racing.track.frenet import COS, SIN, foot, locate

__all__ = [
    "CONTROL_EVERY",
    "DT",
    "ITTC_EVERY",
    "PLAN_EVERY",
    "WORK_SIZE",
    "KernelSettings",
    "advance_races",
    "collide",
    "fill_view",
    "measure_ittc",
    "place_cars",
    "steering_noise",
    "update_progress",
]

DT = 0.01  # s, one simulation step
PLAN_EVERY = 10  # steps: 10 Hz
CONTROL_EVERY = 2  # 50 Hz, as are progress and collisions
ITTC_EVERY = 5  # 20 Hz

BLOCKING_REACH = 3.0  # m

WORK_SIZE = _planner.VIEW_SIZE + 2


class KernelSettings(NamedTuple):
    """The numbers of a race configuration that the compiled loop needs.

    An ``ittc_horizon`` of 0 leaves the minimum time to collision out; nothing that drives depends on it.
    """

    end_tick: int
    speed_low: float
    speed_high: float
    noise_sd: float
    noise_keep: float
    ittc_horizon: float


@kernel(forceinline=True)
def _mix(key):  # type: ignore[no-untyped-def]
    """Scramble 64 bits (the finaliser of splitmix64, Steele et al. 2014)."""
    key = (key ^ (key >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    key = (key ^ (key >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return key ^ (key >> np.uint64(31))


@kernel
def steering_noise(seed, car, tick):  # type: ignore[no-untyped-def]
    """One draw of nearly normal noise, mean 0 and variance 1, as a pure function of its arguments.

    The sum of four 16-bit uniform numbers: bounded by 3.5 standard deviations, excess kurtosis -0.3.
    """
    key = _mix(seed + np.uint64(0x9E3779B97F4A7C15) * np.uint64(2 * tick + car + 1))
    key = _mix(key + np.uint64(0xD1B54A32D192ED03))
    mask = np.uint64(0xFFFF)
    total = (
        float(key & mask)
        + float((key >> np.uint64(16)) & mask)
        + float((key >> np.uint64(32)) & mask)
        + float((key >> np.uint64(48)) & mask)
    )
    return (total / 65535.0 - 2.0) * 1.7320508075688772


@kernel
def fill_view(track, state, race, car, vehicles, settings, view):  # type: ignore[no-untyped-def]
    """Write what the driver of ``car`` sees (:data:`pcs_racing.planners.planner.VIEW`) into ``view``."""
    other = 1 - car
    own = state.cars[race, car]
    opponent = state.cars[race, other]
    view[_planner.TIME] = state.tick[race] * DT
    view[_planner.OWN_X] = own[_vehicle.X]
    view[_planner.OWN_Y] = own[_vehicle.Y]
    view[_planner.OWN_DELTA] = own[_vehicle.DELTA]
    view[_planner.OWN_V] = own[_vehicle.V]
    view[_planner.OWN_PSI] = own[_vehicle.PSI]
    view[_planner.OWN_PSI_DOT] = own[_vehicle.PSI_DOT]
    view[_planner.OWN_BETA] = own[_vehicle.BETA]
    view[_planner.OWN_S] = state.frenet[race, car, 0]
    view[_planner.OWN_D] = state.frenet[race, car, 1]
    view[_planner.OPP_X] = opponent[_vehicle.X]
    view[_planner.OPP_Y] = opponent[_vehicle.Y]
    view[_planner.OPP_V] = opponent[_vehicle.V]
    view[_planner.OPP_PSI] = opponent[_vehicle.PSI]
    view[_planner.OPP_BETA] = opponent[_vehicle.BETA]
    view[_planner.OPP_S] = state.frenet[race, other, 0]
    view[_planner.OPP_D] = state.frenet[race, other, 1]
    row = track.line[int(state.frenet[race, other, 0] / track.ds) % track.line.shape[0]]
    course = opponent[_vehicle.PSI] + opponent[_vehicle.BETA]
    sine, cosine = sine_cosine(course)
    view[_planner.OPP_D_DOT] = opponent[_vehicle.V] * (sine * row[COS] - cosine * row[SIN])
    view[_planner.GAP] = state.progress[race, other] - state.progress[race, car]
    view[_planner.OWN_LENGTH] = vehicles[car, _vehicle.LENGTH]
    view[_planner.OWN_WIDTH] = vehicles[car, _vehicle.WIDTH]
    view[_planner.WHEELBASE] = vehicles[car, _vehicle.LF] + vehicles[car, _vehicle.LR]
    view[_planner.STEER_MAX] = vehicles[car, _vehicle.STEER_MAX]
    p = vehicles[car]
    view[_planner.UNDERSTEER] = (1.0 / p[_vehicle.C_SF] - 1.0 / p[_vehicle.C_SR]) / (p[_vehicle.MU] * _vehicle.GRAVITY)
    view[_planner.UNDERSTEER_GAIN] = (
        p[_vehicle.H]
        / (p[_vehicle.MU] * _vehicle.GRAVITY**2)
        * (1.0 / (p[_vehicle.C_SF] * p[_vehicle.LR]) + 1.0 / (p[_vehicle.C_SR] * p[_vehicle.LF]))
    )
    view[_planner.OPP_LENGTH] = vehicles[other, _vehicle.LENGTH]
    view[_planner.OPP_WIDTH] = vehicles[other, _vehicle.WIDTH]
    view[_planner.SPEED_LOW] = settings.speed_low
    view[_planner.SPEED_HIGH] = settings.speed_high


@kernel
def update_progress(line, ds, length, cars, frenet, progress, race):  # type: ignore[no-untyped-def]
    """Project both cars onto the race line and add what they drove; crossing the start line changes nothing.

    Takes single arrays: handing whole named tuples to small functions costs more than their work, in reference counts.
    """
    half = 0.5 * length
    for car in range(2):
        before = frenet[race, car, 0]
        s, d = foot(line, ds, length, cars[race, car, _vehicle.X], cars[race, car, _vehicle.Y], before)
        driven = s - before
        if driven > half:
            driven -= length
        elif driven < -half:
            driven += length
        progress[race, car] += driven
        frenet[race, car, 0] = s
        frenet[race, car, 1] = d


@kernel
def _count_overtakes(progress, leader, overtakes, race, length):  # type: ignore[no-untyped-def]
    """Count a pass once the car that was behind leads by more than a car's length."""
    lead = progress[race, 0] - progress[race, 1]
    if abs(lead) > length:
        ahead = 0 if lead > 0.0 else 1
        if leader[race] == 1 - ahead:
            overtakes[race, ahead] += 1
        leader[race] = ahead


@kernel
def _latch(cars, crash, fault, race, vehicles, wall0, wall1):  # type: ignore[no-untyped-def]
    """Keep a crash and who is to blame for it."""
    if wall0 or wall1:
        if wall0:
            crash[race, 0] = _state.WALL_CRASH
            fault[race, 0] = 1
        if wall1:
            crash[race, 1] = _state.WALL_CRASH
            fault[race, 1] = 1
        return
    fault0, fault1 = contact_fault(
        cars[race, 0],
        cars[race, 1],
        0.5 * vehicles[0, _vehicle.LENGTH],
        0.5 * vehicles[0, _vehicle.WIDTH],
        0.5 * vehicles[1, _vehicle.LENGTH],
        0.5 * vehicles[1, _vehicle.WIDTH],
    )
    crash[race, 0] = _state.CAR_CRASH
    crash[race, 1] = _state.CAR_CRASH
    fault[race, 0] = 1 if fault0 else 0
    fault[race, 1] = 1 if fault1 else 0


@kernel
def _touch(cars, race, vehicles):  # type: ignore[no-untyped-def]
    """Whether the two cars of a race overlap."""
    return rectangles_overlap(
        cars[race, 0, _vehicle.X],
        cars[race, 0, _vehicle.Y],
        cars[race, 0, _vehicle.PSI],
        cars[race, 1, _vehicle.X],
        cars[race, 1, _vehicle.Y],
        cars[race, 1, _vehicle.PSI],
        0.5 * vehicles[0, _vehicle.LENGTH],
        0.5 * vehicles[0, _vehicle.WIDTH],
        0.5 * vehicles[1, _vehicle.LENGTH],
        0.5 * vehicles[1, _vehicle.WIDTH],
    )


@kernel
def collide(  # type: ignore[no-untyped-def]
    distance,
    origin_x,
    origin_y,
    cell,
    walls,
    seen_start,
    seen,
    seen_distance,
    seen_middle,
    seen_stretch,
    cars,
    frenet,
    crash,
    fault,
    race,
    vehicles,
):
    """Latch crashes and their faults; returns whether there is one."""
    wall0 = False
    wall1 = False
    for car in range(2):
        hit = hits_wall(
            distance,
            origin_x,
            origin_y,
            cell,
            walls,
            seen_start,
            seen,
            seen_distance,
            seen_middle,
            frenet[race, car, 0] / seen_stretch,
            cars[race, car, _vehicle.X],
            cars[race, car, _vehicle.Y],
            cars[race, car, _vehicle.PSI],
            0.5 * vehicles[car, _vehicle.LENGTH],
            0.5 * vehicles[car, _vehicle.WIDTH],
        )
        wall0 = hit if car == 0 else wall0
        wall1 = hit if car == 1 else wall1
    crashed = wall0 or wall1 or _touch(cars, race, vehicles)
    if crashed:
        _latch(cars, crash, fault, race, vehicles, wall0, wall1)
    return crashed


@kernel
def measure_ittc(  # type: ignore[no-untyped-def]
    walls, seen_start, seen, seen_distance, seen_middle, seen_stretch, cars, frenet, sums, race, vehicles, horizon
):
    """Sample the minimum time to collision of both cars."""
    sine0, cosine0 = sine_cosine(cars[race, 0, _vehicle.PSI] + cars[race, 0, _vehicle.BETA])
    sine1, cosine1 = sine_cosine(cars[race, 1, _vehicle.PSI] + cars[race, 1, _vehicle.BETA])
    v0x = cars[race, 0, _vehicle.V] * cosine0
    v0y = cars[race, 0, _vehicle.V] * sine0
    v1x = cars[race, 1, _vehicle.V] * cosine1
    v1y = cars[race, 1, _vehicle.V] * sine1
    for car in range(2):
        other = 1 - car
        x = cars[race, car, _vehicle.X]
        y = cars[race, car, _vehicle.Y]
        vx = v0x if car == 0 else v1x
        vy = v0y if car == 0 else v1y
        stretch = int(frenet[race, car, 0] / seen_stretch) % seen_middle.shape[0]
        time = walls_ittc(walls, seen_start, seen, seen_distance, seen_middle, stretch, x, y, vx, vy, horizon)
        time = rectangle_ittc(
            cars[race, other, _vehicle.X] - x,
            cars[race, other, _vehicle.Y] - y,
            cars[race, other, _vehicle.PSI],
            0.5 * vehicles[other, _vehicle.LENGTH],
            0.5 * vehicles[other, _vehicle.WIDTH],
            vx - (v1x if car == 0 else v0x),
            vy - (v1y if car == 0 else v0y),
            time,
        )
        sums[race, car, _state.ITTC] += time
        sums[race, car, _state.ITTC_SAMPLES] += 1.0


@kernel
def _measure_driving(cars, frenet, progress, sums, race, vehicles, steering_before):  # type: ignore[no-untyped-def]
    """Add what one control period contributes to the running sums."""
    period = CONTROL_EVERY * DT
    lead = progress[race, 0] - progress[race, 1]
    beside = abs(frenet[race, 0, 1] - frenet[race, 1, 1])
    in_the_way = 0.5 * (vehicles[0, _vehicle.WIDTH] + vehicles[1, _vehicle.WIDTH])
    if beside < in_the_way and 0.0 < abs(lead) < BLOCKING_REACH:
        sums[race, 0 if lead > 0.0 else 1, _state.BLOCKING] += period
    for car in range(2):
        sideways = cars[race, car, _vehicle.V] * cars[race, car, _vehicle.PSI_DOT]
        sums[race, car, _state.STEERING] += abs(cars[race, car, _vehicle.DELTA] - steering_before[car])
        sums[race, car, _state.LATERAL] += sideways * sideways * period
        sums[race, car, _state.TIME] += period


@kernel
def advance_races(  # type: ignore[no-untyped-def]
    track, state, theta, vehicles, plan0, control0, plan1, control1, settings, ticks, first, last, scratch, work
):
    """Advance races ``first`` to ``last - 1`` of a batch by ``ticks`` steps each, in place.

    A race that crashed or reached ``settings.end_tick`` stands still.

    Parameters
    ----------
    track : TrackArrays
    state : RaceState
        Overwritten.
    theta : ndarray, shape (B, 2, P)
        Parameters of the two policies of each race.
    vehicles : ndarray, shape (B, 2, 16)
        Parameter rows of the two cars of each race.
    plan0, control0, plan1, control1 : function pointers
        The planners of car 0 and car 1 (:meth:`pcs_racing.planners.planner.Planner.pointers`).
    settings : KernelSettings
    ticks : int
        Steps to drive.
    first, last : int
        The part of the batch to advance.
    scratch : ndarray
        At least as large as the larger of the two planners' scratch.
    work : ndarray, shape (WORK_SIZE,)
        Scribbled on.
    """
    # Arrays are taken out of their tuples and cut once per race: in the loop each access would count references up
    # and down.
    distance, origin_x, origin_y, cell = track.distance, track.origin_x, track.origin_y, track.cell
    walls, seen_start, seen = track.walls, track.seen_start, track.seen
    seen_distance, seen_middle, seen_stretch = track.seen_distance, track.seen_middle, track.seen_stretch
    line, ds, length = track.line, track.ds, track.length
    cars, frenet, progress, sums = state.cars, state.frenet, state.progress, state.sums
    crash, fault, leader, overtakes = state.crash, state.fault, state.leader, state.overtakes
    view = work[: _planner.VIEW_SIZE]
    steering_before = work[_planner.VIEW_SIZE : WORK_SIZE]
    noise_gain = settings.noise_sd * np.sqrt(1.0 - settings.noise_keep * settings.noise_keep)
    for race in range(first, last):
        tick = state.tick[race]
        end = min(tick + ticks, settings.end_tick)
        crashed = crash[race, 0] != 0 or crash[race, 1] != 0
        params = vehicles[race]
        params0, params1 = vehicles[race, 0], vehicles[race, 1]
        own0, own1 = cars[race, 0], cars[race, 1]
        command0, command1 = state.command[race, 0], state.command[race, 1]
        path0, path1 = state.path[race, 0], state.path[race, 1]
        memory0, memory1 = state.memory[race, 0], state.memory[race, 1]
        theta0, theta1 = theta[race, 0], theta[race, 1]
        disturbance = state.disturbance[race]
        while tick < end and not crashed:
            if tick % CONTROL_EVERY == 0:
                fill_view(track, state, race, 0, params, settings, view)
                if tick % PLAN_EVERY == 0:
                    plan0(track, theta0, view, memory0, scratch, path0)
                control0(track, theta0, view, memory0, scratch, path0, command0)
                fill_view(track, state, race, 1, params, settings, view)
                if tick % PLAN_EVERY == 0:
                    plan1(track, theta1, view, memory1, scratch, path1)
                control1(track, theta1, view, memory1, scratch, path1, command1)
                if settings.noise_sd > 0.0:
                    for car in range(2):
                        draw = steering_noise(state.seed[race], car, tick)
                        disturbance[car] = settings.noise_keep * disturbance[car] + noise_gain * draw
                    command0[0] += disturbance[0]
                    command1[0] += disturbance[1]
                steering_before[0] = own0[_vehicle.DELTA]
                steering_before[1] = own1[_vehicle.DELTA]
            rate, acceleration = _vehicle.target_inputs(own0, command0[0], command0[1], params0, DT)
            _vehicle.step(own0, rate, acceleration, params0, DT)
            rate, acceleration = _vehicle.target_inputs(own1, command1[0], command1[1], params1, DT)
            _vehicle.step(own1, rate, acceleration, params1, DT)
            tick += 1
            state.tick[race] = tick
            if tick % CONTROL_EVERY == 0:
                update_progress(line, ds, length, cars, frenet, progress, race)
                _measure_driving(cars, frenet, progress, sums, race, params, steering_before)
                crashed = collide(
                    distance,
                    origin_x,
                    origin_y,
                    cell,
                    walls,
                    seen_start,
                    seen,
                    seen_distance,
                    seen_middle,
                    seen_stretch,
                    cars,
                    frenet,
                    crash,
                    fault,
                    race,
                    params,
                )
                _count_overtakes(progress, leader, overtakes, race, params[0, _vehicle.LENGTH])
            if tick % ITTC_EVERY == 0 and settings.ittc_horizon > 0.0:
                measure_ittc(
                    walls,
                    seen_start,
                    seen,
                    seen_distance,
                    seen_middle,
                    seen_stretch,
                    cars,
                    frenet,
                    sums,
                    race,
                    params,
                    settings.ittc_horizon,
                )


@kernel
def place_cars(track, state, vehicles):  # type: ignore[no-untyped-def]
    """Set the Frenet coordinates of freshly placed cars; marks as crashed those that stand in a wall or in each
    other.
    """
    for race in range(state.tick.shape[0]):
        for car in range(2):
            s, d = locate(track, state.cars[race, car, _vehicle.X], state.cars[race, car, _vehicle.Y])
            state.frenet[race, car, 0] = s
            state.frenet[race, car, 1] = d
        collide(
            track.distance,
            track.origin_x,
            track.origin_y,
            track.cell,
            track.walls,
            track.seen_start,
            track.seen,
            track.seen_distance,
            track.seen_middle,
            track.seen_stretch,
            state.cars,
            state.frenet,
            state.crash,
            state.fault,
            race,
            vehicles[race],
        )
