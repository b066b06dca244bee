"""The compiled loop that advances a batch of two-car races: plan, control, drive, collide, measure.

Everything happens at fixed multiples of the simulation step of 0.01 s, so that stopping and going on changes nothing.
"""

from typing import NamedTuple

import numpy as np

from pcs_racing.base.compilation import inner_kernel, kernel
from pcs_racing.base.elementary import sine_cosine
from pcs_racing.car import vehicle as _vehicle
from pcs_racing.car.ittc import rectangle_ittc, walls_ittc
from pcs_racing.car.lanes import LANES, LANES_SIZE, load_car, set_target, step_lanes, step_slow_car, store_car
from pcs_racing.planners import view as _view
from pcs_racing.planners.calling import call_control, call_plan
from pcs_racing.race import state as _state
from pcs_racing.race.config import CONTROL_EVERY, DT, ITTC_EVERY, PLAN_EVERY
from pcs_racing.race.positions import collide, update_progress
from pcs_racing.race.steering import delayed, steering_noise, steering_sd
from pcs_racing.track.frenet import COS, SIN, SPEED, WALLS_BEGIN, WALLS_END, WallArrays

BLOCKING_REACH = 3.0  # m

GROUP = LANES // 2
"""Races that are driven in lockstep."""

# The loop's scratch memory: the cars in their lanes; whether each is slow, and its steering angle before a control
# period; the steps that each race has left; and the view of each car.
_SLOW = LANES_SIZE
_STEERING_BEFORE = _SLOW + LANES
_LEFT = _STEERING_BEFORE + LANES
_VIEWS = _LEFT + GROUP
WORK_SIZE = _VIEWS + LANES * _view.VIEW_SIZE


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


@inner_kernel
def _fill_fixed(own, opponent, settings, view):  # type: ignore[no-untyped-def]
    """Write what stays the same during a race into a view: the two cars' parameters and the range of speeds."""
    view[_view.OWN_LENGTH] = own[_vehicle.LENGTH]
    view[_view.OWN_WIDTH] = own[_vehicle.WIDTH]
    view[_view.WHEELBASE] = own[_vehicle.LF] + own[_vehicle.LR]
    view[_view.STEER_MAX] = own[_vehicle.STEER_MAX]
    grip = own[_vehicle.MU] * _vehicle.GRAVITY
    view[_view.UNDERSTEER] = (1.0 / own[_vehicle.C_SF] - 1.0 / own[_vehicle.C_SR]) / grip
    view[_view.UNDERSTEER_GAIN] = (
        own[_vehicle.H]
        / (grip * _vehicle.GRAVITY)
        * (1.0 / (own[_vehicle.C_SF] * own[_vehicle.LR]) + 1.0 / (own[_vehicle.C_SR] * own[_vehicle.LF]))
    )
    view[_view.REAR_SLIP] = 1.0 / (grip * own[_vehicle.C_SR])
    view[_view.REAR_AXLE] = own[_vehicle.LR]
    view[_view.OPP_LENGTH] = opponent[_vehicle.LENGTH]
    view[_view.OPP_WIDTH] = opponent[_vehicle.WIDTH]
    view[_view.SPEED_LOW] = settings.speed_low
    view[_view.SPEED_HIGH] = settings.speed_high


@inner_kernel(forceinline=True)
def _part_at(s, size, parts):  # type: ignore[no-untyped-def]
    """Index of the part of the line, all of one size, in which an arc length in [0, length) lies."""
    i = int(s / size)
    # Rounding can lead beyond the last, and a state from elsewhere anywhere; a remainder would take a division.
    return i if 0 <= i < parts else 0


@inner_kernel
def _fill_moving(line, ds, tick, cars, frenet, progress, race, car, view):  # type: ignore[no-untyped-def]
    """Write what changes from step to step into a view."""
    other = 1 - car
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
    view[_view.OPP_X] = cars[race, other, _vehicle.X]
    view[_view.OPP_Y] = cars[race, other, _vehicle.Y]
    view[_view.OPP_V] = cars[race, other, _vehicle.V]
    view[_view.OPP_PSI] = cars[race, other, _vehicle.PSI]
    view[_view.OPP_BETA] = cars[race, other, _vehicle.BETA]
    view[_view.OPP_S] = frenet[race, other, 0]
    view[_view.OPP_D] = frenet[race, other, 1]
    i = _part_at(frenet[race, other, 0], ds, line.shape[0])
    sine, cosine = sine_cosine(cars[race, other, _vehicle.PSI] + cars[race, other, _vehicle.BETA])
    view[_view.OPP_D_DOT] = cars[race, other, _vehicle.V] * (sine * line[i, COS] - cosine * line[i, SIN])
    view[_view.GAP] = progress[race, other] - progress[race, car]


@kernel
def fill_view(track, state, race, car, vehicles, settings, view):  # type: ignore[no-untyped-def]
    """Write what the driver of ``car`` sees (:data:`pcs_racing.planners.view.VIEW`) into ``view``."""
    _fill_fixed(vehicles[car], vehicles[1 - car], settings, view)
    _fill_moving(track.line, track.ds, state.tick[race], state.cars, state.frenet, state.progress, race, car, view)


@inner_kernel
def _count_overtakes(progress, leader, overtakes, race, length):  # type: ignore[no-untyped-def]
    """Count a pass once the car that was behind leads by more than a car's length."""
    # By more than a length, so that two cars side by side don't pass each other at every step.
    lead = progress[race, 0] - progress[race, 1]
    if abs(lead) > length:
        ahead = 0 if lead > 0.0 else 1
        if leader[race] == 1 - ahead:
            overtakes[race, ahead] += 1
        leader[race] = ahead


@kernel(forceinline=True)
def measure_ittc(near, cars, frenet, sums, race, vehicles, horizon):  # type: ignore[no-untyped-def]
    """Sample the minimum time to collision of both cars."""
    sine0, cosine0 = sine_cosine(cars[race, 0, _vehicle.PSI] + cars[race, 0, _vehicle.BETA])
    sine1, cosine1 = sine_cosine(cars[race, 1, _vehicle.PSI] + cars[race, 1, _vehicle.BETA])
    v0x = cars[race, 0, _vehicle.V] * cosine0
    v0y = cars[race, 0, _vehicle.V] * sine0
    v1x = cars[race, 1, _vehicle.V] * cosine1
    v1y = cars[race, 1, _vehicle.V] * sine1
    # The velocities of both are worked out once, before the loop: each car needs that of the other, too.
    for car in range(2):
        other = 1 - car
        x = cars[race, car, _vehicle.X]
        y = cars[race, car, _vehicle.Y]
        vx = v0x if car == 0 else v1x
        vy = v0y if car == 0 else v1y
        stretch = _part_at(frenet[race, car, 0], near.seen_stretch, near.seen_middle.shape[0])
        time = walls_ittc(near, stretch, x, y, vx, vy, horizon)
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


@inner_kernel
def _measure_speed(line, ds, speed_high, frenet, progress, sums, race, before0, before1):  # type: ignore[no-untyped-def]
    """Add the time that the profile of pace 1 takes for what a control period drove, from the progress before it."""
    for car in range(2):
        driven = progress[race, car] - (before0 if car == 0 else before1)
        i = _part_at(frenet[race, car, 0], ds, line.shape[0])
        sums[race, car, _state.PROFILE] += driven / (speed_high * line[i, SPEED])


@inner_kernel
def _measure_driving(cars, frenet, progress, sums, race, vehicles, before0, before1):  # type: ignore[no-untyped-def]
    """Add what one control period contributes to the running sums."""
    period = CONTROL_EVERY * DT
    lead = progress[race, 0] - progress[race, 1]
    beside = abs(frenet[race, 0, 1] - frenet[race, 1, 1])
    in_the_way = 0.5 * (vehicles[0, _vehicle.WIDTH] + vehicles[1, _vehicle.WIDTH])
    if beside < in_the_way and 0.0 < abs(lead) < BLOCKING_REACH:
        sums[race, 0 if lead > 0.0 else 1, _state.BLOCKING] += period
    for car in range(2):
        sideways = cars[race, car, _vehicle.V] * cars[race, car, _vehicle.PSI_DOT]
        before = before0 if car == 0 else before1
        sums[race, car, _state.STEERING] += abs(cars[race, car, _vehicle.DELTA] - before)
        sums[race, car, _state.LATERAL] += sideways * sideways * period
        sums[race, car, _state.TIME] += period


@kernel
def advance_races(  # type: ignore[no-untyped-def]
    track, state, theta, vehicles, drivers, settings, ticks, first, last, scratch, work
):
    """Advance races ``first`` to ``last - 1`` of a batch by ``ticks`` steps each, in place.

    A race that crashed or reached ``settings.end_tick`` stands still. Races are driven in groups whose cars share the
    processor's vectors; no race depends on the others in its group.

    ``theta``, shape (B, 2, P), are parameters of the two policies of each race, and ``vehicles``, shape (B, 2, 18), its
    cars' parameter rows. ``drivers`` are the addresses of plan and control of car 0 and of car 1
    (:meth:`pcs_racing.planners.planner.Planner.pointers`). ``scratch``, as large as that of either planner, and
    ``work``, of ``WORK_SIZE``, hold nothing afterwards.
    """
    plan0, control0, plan1, control1 = drivers
    # Arrays are taken out of their tuples once: handing whole tuples to functions costs more than many of these do.
    near = WallArrays(*track[WALLS_BEGIN:WALLS_END])
    line, ds, length = track.line, track.ds, track.length
    cars, frenet, progress, sums = state.cars, state.frenet, state.progress, state.sums
    crash, fault, leader, overtakes, laps = state.crash, state.fault, state.leader, state.overtakes, state.laps
    commands, disturbances, paths, memories = state.command, state.disturbance, state.path, state.memory
    noise_share = np.sqrt(1.0 - settings.noise_keep * settings.noise_keep)
    # Numbers left over from elsewhere may be so small that arithmetic with them is slow.
    work[:LANES_SIZE] = 0.0
    for start in range(first, last, GROUP):
        stop = min(start + GROUP, last)
        lanes = 2 * (stop - start)
        for race in range(start, stop):
            crashed = crash[race, 0] != 0 or crash[race, 1] != 0
            work[_LEFT + race - start] = 0.0 if crashed else min(ticks, settings.end_tick - state.tick[race])
            for car in range(2):
                lane = 2 * (race - start) + car
                load_car(work, lane, cars[race, car], vehicles[race, car])
                view = work[_VIEWS + lane * _view.VIEW_SIZE : _VIEWS + (lane + 1) * _view.VIEW_SIZE]
                _fill_fixed(vehicles[race, car], vehicles[race, 1 - car], settings, view)
        # One turn is one step of all races of the group that still drive.
        driving = True
        while driving:
            driving = False
            for race in range(start, stop):
                if work[_LEFT + race - start] <= 0.0:
                    continue
                driving = True
                tick = state.tick[race]
                if tick % CONTROL_EVERY == 0:
                    for car in range(2):
                        lane = 2 * (race - start) + car
                        view = work[_VIEWS + lane * _view.VIEW_SIZE : _VIEWS + (lane + 1) * _view.VIEW_SIZE]
                        path, memory, command = paths[race, car], memories[race, car], commands[race, car]
                        _fill_moving(line, ds, tick, cars, frenet, progress, race, car, view)
                        if car == 0:
                            if tick % PLAN_EVERY == 0:
                                call_plan(plan0, track, theta[race, 0], view, memory, scratch, path)
                            call_control(control0, track, theta[race, 0], view, memory, scratch, path, command)
                        else:
                            if tick % PLAN_EVERY == 0:
                                call_plan(plan1, track, theta[race, 1], view, memory, scratch, path)
                            call_control(control1, track, theta[race, 1], view, memory, scratch, path, command)
                        # First the disturbance, then the delay: the car gets late what was disturbed when it was sent.
                        noise_sd = steering_sd(settings, vehicles[race, car])
                        if noise_sd > 0.0:
                            draw = noise_sd * noise_share * steering_noise(state.seed[race], car, tick)
                            disturbances[race, car] = settings.noise_keep * disturbances[race, car] + draw
                            command[0] += disturbances[race, car]
                        delay = vehicles[race, car, _vehicle.STEER_DELAY]
                        if delay > 0.0:
                            command[0] = delayed(memory, delay, tick, command[0])
                        set_target(work, lane, command[0], command[1])
                        work[_STEERING_BEFORE + lane] = cars[race, car, _vehicle.DELTA]
                # Slow cars are driven alone; their lanes are computed as well, and overwritten below.
                for car in range(2):
                    lane = 2 * (race - start) + car
                    slow = step_slow_car(work, lane, cars[race, car], vehicles[race, car], DT)
                    work[_SLOW + lane] = 1.0 if slow else 0.0
            step_lanes(work, lanes, DT)
            for race in range(start, stop):
                if work[_LEFT + race - start] <= 0.0:
                    continue
                work[_LEFT + race - start] -= 1.0
                params = vehicles[race]
                for car in range(2):
                    lane = 2 * (race - start) + car
                    if work[_SLOW + lane] != 0.0:
                        load_car(work, lane, cars[race, car], params[car])
                    else:
                        store_car(work, lane, cars[race, car])
                tick = state.tick[race] + 1
                state.tick[race] = tick
                # Measured before contacts are looked for: a race that ends now has driven this period.
                if tick % CONTROL_EVERY == 0:
                    before = _STEERING_BEFORE + 2 * (race - start)
                    progress0, progress1 = progress[race, 0], progress[race, 1]
                    update_progress(line, ds, length, cars, frenet, progress, laps, tick, race)
                    _measure_speed(line, ds, settings.speed_high, frenet, progress, sums, race, progress0, progress1)
                    _measure_driving(cars, frenet, progress, sums, race, params, work[before], work[before + 1])
                    if collide(near, cars, frenet, crash, fault, race, params):
                        work[_LEFT + race - start] = 0.0
                    _count_overtakes(progress, leader, overtakes, race, params[0, _vehicle.LENGTH])
                if tick % ITTC_EVERY == 0 and settings.ittc_horizon > 0.0:
                    measure_ittc(near, cars, frenet, sums, race, params, settings.ittc_horizon)
