"""The compiled loop that advances a batch of two-car races: plan, control, drive, collide, measure.

Everything happens at fixed multiples of the simulation step of 0.01 s, so that stopping and going on changes nothing.
"""

from typing import NamedTuple

import numpy as np

from pcs_racing import planner as _planner
from pcs_racing import race_state as _state
from pcs_racing import vehicle as _vehicle
from pcs_racing.collision import car_hits_wall, contact_fault, rectangles_overlap
from pcs_racing.compilation import compiled
from pcs_racing.frenet import COS, SIN, locate, project
from pcs_racing.ittc import minimum_ittc

__all__ = ["CONTROL_EVERY", "DT", "ITTC_EVERY", "PLAN_EVERY", "KernelSettings", "advance_races", "fill_view", "steering_noise"]

DT = 0.01  # s, one simulation step
PLAN_EVERY = 10  # steps: 10 Hz
CONTROL_EVERY = 2  # 50 Hz, as are progress and collisions
ITTC_EVERY = 5  # 20 Hz

BLOCKING_REACH = 3.0  # m


class KernelSettings(NamedTuple):
    """The numbers of a race configuration that the compiled loop needs."""

    end_tick: int
    speed_low: float
    speed_high: float
    noise_sd: float
    noise_keep: float
    ittc_horizon: float


@compiled(inline="always")
def _mix(key):  # type: ignore[no-untyped-def]
    """Scramble 64 bits (the finaliser of splitmix64, Steele et al. 2014)."""
    key = (key ^ (key >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    key = (key ^ (key >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return key ^ (key >> np.uint64(31))


@compiled
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


@compiled
def fill_view(track, state, race, car, vehicles, settings, view):  # type: ignore[no-untyped-def]
    """Write what the driver of ``car`` sees (:data:`pcs_racing.planner.VIEW`) into ``view``."""
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
    view[_planner.OPP_D_DOT] = opponent[_vehicle.V] * (np.sin(course) * row[COS] - np.cos(course) * row[SIN])
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


@compiled
def update_progress(track, state, race):  # type: ignore[no-untyped-def]
    """Project both cars onto the race line and add what they drove; crossing the start line changes nothing."""
    half = 0.5 * track.length
    for car in range(2):
        before = state.frenet[race, car, 0]
        s, d = project(track, state.cars[race, car, _vehicle.X], state.cars[race, car, _vehicle.Y], before)
        driven = s - before
        if driven > half:
            driven -= track.length
        elif driven < -half:
            driven += track.length
        state.progress[race, car] += driven
        state.frenet[race, car, 0] = s
        state.frenet[race, car, 1] = d


@compiled
def _count_overtakes(state, race, length):  # type: ignore[no-untyped-def]
    lead = state.progress[race, 0] - state.progress[race, 1]
    if abs(lead) > length:
        ahead = np.int8(0) if lead > 0.0 else np.int8(1)
        if state.leader[race] == 1 - ahead:
            state.overtakes[race, ahead] += 1
        state.leader[race] = ahead


@compiled
def collide(track, state, race, vehicles):  # type: ignore[no-untyped-def]
    """Latch crashes and their faults; returns whether there is one."""
    crashed = False
    for car in range(2):
        own = state.cars[race, car]
        if car_hits_wall(
            track,
            own[_vehicle.X],
            own[_vehicle.Y],
            own[_vehicle.PSI],
            0.5 * vehicles[car, _vehicle.LENGTH],
            0.5 * vehicles[car, _vehicle.WIDTH],
            state.frenet[race, car, 0],
        ):
            state.crash[race, car] = _state.WALL_CRASH
            state.fault[race, car] = 1
            crashed = True
    if not crashed:
        a = state.cars[race, 0]
        b = state.cars[race, 1]
        half_length0 = 0.5 * vehicles[0, _vehicle.LENGTH]
        half_width0 = 0.5 * vehicles[0, _vehicle.WIDTH]
        half_length1 = 0.5 * vehicles[1, _vehicle.LENGTH]
        half_width1 = 0.5 * vehicles[1, _vehicle.WIDTH]
        if rectangles_overlap(
            a[_vehicle.X],
            a[_vehicle.Y],
            a[_vehicle.PSI],
            b[_vehicle.X],
            b[_vehicle.Y],
            b[_vehicle.PSI],
            half_length0,
            half_width0,
            half_length1,
            half_width1,
        ):
            fault0, fault1 = contact_fault(a, b, half_length0, half_width0, half_length1, half_width1)
            state.crash[race, 0] = _state.CAR_CRASH
            state.crash[race, 1] = _state.CAR_CRASH
            state.fault[race, 0] = 1 if fault0 else 0
            state.fault[race, 1] = 1 if fault1 else 0
            crashed = True
    return crashed


@compiled
def _measure_ittc(track, state, race, vehicles, horizon):  # type: ignore[no-untyped-def]
    for car in range(2):
        own = state.cars[race, car]
        opponent = state.cars[race, 1 - car]
        course = own[_vehicle.PSI] + own[_vehicle.BETA]
        other_course = opponent[_vehicle.PSI] + opponent[_vehicle.BETA]
        state.sums[race, car, _state.ITTC] += minimum_ittc(
            track,
            own[_vehicle.X],
            own[_vehicle.Y],
            own[_vehicle.V] * np.cos(course),
            own[_vehicle.V] * np.sin(course),
            state.frenet[race, car, 0],
            opponent[_vehicle.X],
            opponent[_vehicle.Y],
            opponent[_vehicle.PSI],
            0.5 * vehicles[1 - car, _vehicle.LENGTH],
            0.5 * vehicles[1 - car, _vehicle.WIDTH],
            opponent[_vehicle.V] * np.cos(other_course),
            opponent[_vehicle.V] * np.sin(other_course),
            True,
            horizon,
        )
        state.sums[race, car, _state.ITTC_SAMPLES] += 1.0


@compiled
def _measure_driving(state, race, vehicles, steering_before):  # type: ignore[no-untyped-def]
    """Add what one control period contributes to the running sums."""
    period = CONTROL_EVERY * DT
    lead = state.progress[race, 0] - state.progress[race, 1]
    beside = abs(state.frenet[race, 0, 1] - state.frenet[race, 1, 1])
    in_the_way = 0.5 * (vehicles[0, _vehicle.WIDTH] + vehicles[1, _vehicle.WIDTH])
    if beside < in_the_way and 0.0 < abs(lead) < BLOCKING_REACH:
        state.sums[race, 0 if lead > 0.0 else 1, _state.BLOCKING] += period
    for car in range(2):
        sideways = state.cars[race, car, _vehicle.V] * state.cars[race, car, _vehicle.PSI_DOT]
        state.sums[race, car, _state.STEERING] += abs(state.cars[race, car, _vehicle.DELTA] - steering_before[car])
        state.sums[race, car, _state.LATERAL] += sideways * sideways * period
        state.sums[race, car, _state.TIME] += period


@compiled
def advance_races(track, state, theta, vehicles, plan0, control0, plan1, control1, settings, ticks, first, last, scratch):  # type: ignore[no-untyped-def]
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
        The planners of car 0 and car 1 (:meth:`pcs_racing.planner.Planner.pointers`).
    settings : KernelSettings
    ticks : int
        Steps to drive.
    first, last : int
        The part of the batch to advance.
    scratch : ndarray
        At least as large as the larger of the two planners' scratch.
    """
    view = np.zeros(_planner.VIEW_SIZE)
    steering_before = np.zeros(2)
    noise_gain = settings.noise_sd * np.sqrt(1.0 - settings.noise_keep * settings.noise_keep)
    for race in range(first, last):
        end = min(state.tick[race] + ticks, settings.end_tick)
        crashed = state.crash[race, 0] != 0 or state.crash[race, 1] != 0
        cars = vehicles[race]
        while state.tick[race] < end and not crashed:
            tick = state.tick[race]
            if tick % CONTROL_EVERY == 0:
                for car in range(2):
                    fill_view(track, state, race, car, cars, settings, view)
                    path = state.path[race, car]
                    memory = state.memory[race, car]
                    command = state.command[race, car]
                    if car == 0:
                        if tick % PLAN_EVERY == 0:
                            plan0(track, theta[race, 0], view, memory, scratch, path)
                        control0(track, theta[race, 0], view, memory, scratch, path, command)
                    else:
                        if tick % PLAN_EVERY == 0:
                            plan1(track, theta[race, 1], view, memory, scratch, path)
                        control1(track, theta[race, 1], view, memory, scratch, path, command)
                    if settings.noise_sd > 0.0:
                        draw = steering_noise(state.seed[race], car, tick)
                        state.disturbance[race, car] = (
                            settings.noise_keep * state.disturbance[race, car] + noise_gain * draw
                        )
                        command[0] += state.disturbance[race, car]
                    steering_before[car] = state.cars[race, car, _vehicle.DELTA]
            for car in range(2):
                own = state.cars[race, car]
                rate, acceleration = _vehicle.target_inputs(
                    own, state.command[race, car, 0], state.command[race, car, 1], cars[car], DT
                )
                _vehicle.step(own, rate, acceleration, cars[car], DT)
            tick += 1
            state.tick[race] = tick
            if tick % CONTROL_EVERY == 0:
                update_progress(track, state, race)
                _measure_driving(state, race, cars, steering_before)
                crashed = collide(track, state, race, cars)
                _count_overtakes(state, race, cars[0, _vehicle.LENGTH])
            if tick % ITTC_EVERY == 0:
                _measure_ittc(track, state, race, cars, settings.ittc_horizon)


@compiled
def place_cars(track, state, vehicles):  # type: ignore[no-untyped-def]
    """Set the Frenet coordinates of freshly placed cars; marks as crashed those that stand in a wall or in each other."""
    for race in range(state.tick.shape[0]):
        for car in range(2):
            s, d = locate(track, state.cars[race, car, _vehicle.X], state.cars[race, car, _vehicle.Y])
            state.frenet[race, car, 0] = s
            state.frenet[race, car, 1] = d
        collide(track, state, race, vehicles[race])
