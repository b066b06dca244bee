"""Positions of the cars of a race: progress along the race line, laps, contacts and faults."""

import numpy as np

from pcs_racing.base.compilation import inner_kernel, kernel
from pcs_racing.car import vehicle as _vehicle
from pcs_racing.car.collision import (
    Rectangle,
    circle_overlaps,
    contact_fault,
    hits_wall,
    rectangles_overlap,
)
from pcs_racing.race import state as _state
from pcs_racing.race.config import CONTROL_EVERY, DT
from pcs_racing.track.frenet import WALLS_BEGIN, WALLS_END, WallArrays, foot, locate, shorter_way
from pcs_racing.track.moving import HALF_LENGTH, HALF_WIDTH, pose_at


@kernel
def end_lap(laps, race, car, time):
    """Count a lap that ended at a time, and record its duration."""
    lap = time - laps[race, car, _state.ENDED_AT]
    best = laps[race, car, _state.BEST_LAP]
    column = _state.LAP_COLUMNS + int(laps[race, car, _state.LAPS])
    if column < laps.shape[2]:
        laps[race, car, column] = lap
    laps[race, car, _state.LAPS] += 1.0
    laps[race, car, _state.ENDED_AT] = time
    laps[race, car, _state.LAP_TIME] = lap
    laps[race, car, _state.BEST_LAP] = lap if best == 0.0 else min(best, lap)


@inner_kernel(forceinline=True)
def laps_driven(laps, race):
    """Return whether a car has driven all laps of a race with laps."""
    wanted = laps.shape[2] - _state.LAP_COLUMNS
    if wanted > 0:
        for car in range(laps.shape[1]):
            if laps[race, car, _state.LAPS] >= wanted:
                return True
    return False


@kernel(forceinline=True)
def move_along(length, frenet, progress, laps, tick, race, car, s, d):
    """Move a car to arc length ``s`` and offset ``d``, and update its progress and laps."""
    # No car drives half a lap in a control period: a larger change of s is a crossing of s = 0.
    half = 0.5 * length
    driven = s - frenet[race, car, 0]
    if driven > half:
        driven -= length
    elif driven < -half:
        driven += length
    progress[race, car] += driven
    # A car that rolls back over the line and returns has ended that lap already.
    beyond = progress[race, car] - (laps[race, car, _state.LAPS] + 1.0) * length
    if beyond >= 0.0 and driven > 0.0:
        end_lap(laps, race, car, (tick - CONTROL_EVERY * beyond / driven) * DT)
    frenet[race, car, 0] = s
    frenet[race, car, 1] = d


@kernel(forceinline=True)
def update_progress(line, ds, length, cars, frenet, progress, laps, tick, race, car):
    """Project a car onto the race line and update its progress.

    The arguments are single arrays: the reference counts of whole named tuples cost more than the
    work of a small function.
    """
    s, d = foot(
        line,
        ds,
        length,
        cars[race, car, _vehicle.X],
        cars[race, car, _vehicle.Y],
        frenet[race, car, 0],
    )
    move_along(length, frenet, progress, laps, tick, race, car, s, d)


@inner_kernel(forceinline=True)
def gap_to(length, frenet, race, car, other):
    """Return the lead of ``other`` over ``car`` along the race line, the shorter way round, m."""
    return shorter_way(length, frenet[race, other, 0] - frenet[race, car, 0])


@inner_kernel
def nearest_car(length, frenet, race, car):
    """Return the nearest car along the track, the first of two equally near, or itself if alone."""
    nearest, least = car, np.inf
    for other in range(frenet.shape[1]):
        gap = abs(gap_to(length, frenet, race, car, other))
        if other != car and gap < least:
            nearest, least = other, gap
    return nearest


@inner_kernel(forceinline=True)
def body(state, vehicle):
    """Return the rectangle of a car."""
    half_length, half_width = 0.5 * vehicle[_vehicle.LENGTH], 0.5 * vehicle[_vehicle.WIDTH]
    return Rectangle(
        state[_vehicle.X], state[_vehicle.Y], state[_vehicle.PSI], half_length, half_width
    )


@inner_kernel
def _latch(cars, crash, fault, race, vehicles, walls):
    """Latch crashes and faults; a car in a wall (bit in ``walls``) hit the wall before any car."""
    for first in range(cars.shape[1]):
        if walls >> first & 1:
            crash[race, first] = _state.WALL_CRASH
            fault[race, first] = 1
            continue
        for second in range(first + 1, cars.shape[1]):
            one, two = (
                body(cars[race, first], vehicles[first]),
                body(cars[race, second], vehicles[second]),
            )
            if walls >> second & 1 or not rectangles_overlap(one, two):
                continue
            fault0, fault1 = contact_fault(cars[race, first], cars[race, second], one, two)
            crash[race, first] = _state.CAR_CRASH
            crash[race, second] = _state.CAR_CRASH
            if fault0:
                fault[race, first] = 1
            if fault1:
                fault[race, second] = 1


@inner_kernel
def overlap(cars, race, one, other, vehicles):
    """Return whether two cars of a race overlap."""
    return rectangles_overlap(
        body(cars[race, one], vehicles[one]), body(cars[race, other], vehicles[other])
    )


@inner_kernel
def touch_moving(moving, line, ds, length, tick, cars, race, vehicles):
    """Return the cars of a race that touch a moving obstacle, one bit for each car."""
    touched = 0
    for k in range(moving.shape[0]):
        x, y, psi = pose_at(moving, line, ds, length, k, tick * DT)
        half_length, half_width = moving[k, HALF_LENGTH], moving[k, HALF_WIDTH]
        for car in range(cars.shape[1]):
            own = body(cars[race, car], vehicles[car])
            if half_width > 0.0:
                hit = rectangles_overlap(own, Rectangle(x, y, psi, half_length, half_width))
            else:
                hit = circle_overlaps(own, x, y, half_length)
            if hit:
                touched |= 1 << car
    return touched


@inner_kernel(forceinline=True)
def collide(near, cars, frenet, crash, fault, race, vehicles, number, walls):
    """Latch crashes of ``number`` cars and their faults; return whether there is a crash.

    ``walls`` has a bit for each car that touches a moving obstacle, which counts as a wall.
    """
    for car in range(number):
        if hits_wall(near, frenet[race, car, 0], body(cars[race, car], vehicles[car])):
            walls |= 1 << car
    crashed = walls != 0
    for one in range(number):
        for other in range(one + 1, number):
            crashed = crashed or overlap(cars, race, one, other, vehicles)
    if crashed:
        _latch(cars, crash, fault, race, vehicles, walls)
    return crashed


@kernel
def place_cars(track, state, vehicles):
    """Set the Frenet coordinates of new cars; mark cars in a wall or in another car as crashed."""
    near = WallArrays(*track[WALLS_BEGIN:WALLS_END])
    for race in range(state.tick.shape[0]):
        number = state.cars.shape[1]
        for car in range(number):
            s, d = locate(
                track, state.cars[race, car, _vehicle.X], state.cars[race, car, _vehicle.Y]
            )
            state.frenet[race, car, 0] = s
            state.frenet[race, car, 1] = d
        touched = touch_moving(
            track.moving,
            track.line,
            track.ds,
            track.length,
            state.tick[race],
            state.cars,
            race,
            vehicles[race],
        )
        collide(
            near,
            state.cars,
            state.frenet,
            state.crash,
            state.fault,
            race,
            vehicles[race],
            number,
            touched,
        )
