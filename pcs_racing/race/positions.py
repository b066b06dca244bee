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
from pcs_racing.track.frenet import WALLS_BEGIN, WALLS_END, WallArrays, locate, shorter_way
from pcs_racing.track.moving import HALF_LENGTH, HALF_WIDTH, pose_at


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
        time, own = (tick - CONTROL_EVERY * beyond / driven) * DT, laps[race, car]
        lap, best = time - own[_state.ENDED_AT], own[_state.BEST_LAP]
        column = _state.LAP_COLUMNS + int(own[_state.LAPS])
        if column < own.shape[0]:
            own[column] = lap
        own[_state.LAPS] += 1.0
        own[_state.ENDED_AT], own[_state.LAP_TIME] = time, lap
        own[_state.BEST_LAP] = lap if best == 0.0 or lap < best else best
    frenet[race, car, 0] = s
    frenet[race, car, 1] = d


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
def touch_moving(track, tick, cars, race, vehicles):
    """Return the cars of a race that touch a moving obstacle, one bit for each car."""
    moving, touched = track.moving, 0
    for k in range(moving.shape[0]):
        x, y, psi = pose_at(moving, track.line, track.ds, track.length, k, tick * DT)
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
def collide(drivers, near, state, race, vehicles, walls):
    """Latch crashes of cars and their faults; return whether there is a crash.

    ``drivers`` has an item for each car, and ``walls`` a bit for each car that touches a moving
    obstacle, which counts as a wall.
    """
    number = len(drivers)
    for car in range(number):
        own = body(state.cars[race, car], vehicles[car])
        if hits_wall(near, state.frenet[race, car, 0], own):
            walls |= 1 << car
    crashed = walls != 0
    if len(drivers) == 1:
        if crashed:
            state.crash[race, 0] = _state.WALL_CRASH
            state.fault[race, 0] = 1
        return crashed
    for one in range(number):
        for other in range(one + 1, number):
            crashed = crashed or overlap(state.cars, race, one, other, vehicles)
    if crashed:
        _latch(state.cars, state.crash, state.fault, race, vehicles, walls)
    return crashed


@kernel
def place_cars(track, cars, frenet, crash, vehicles):
    """Write the Frenet coordinates of new cars; mark cars in a wall as crashed."""
    near = WallArrays(*track[WALLS_BEGIN:WALLS_END])
    for race in range(cars.shape[0]):
        for car in range(cars.shape[1]):
            own = body(cars[race, car], vehicles[race, car])
            frenet[race, car, 0], frenet[race, car, 1] = locate(track, own.x, own.y)
            if hits_wall(near, frenet[race, car, 0], own):
                crash[race, car] = _state.WALL_CRASH


@kernel
def mark_contacts(track, cars, crash, vehicles, tick):
    """Mark cars in another car or in a moving obstacle as crashed."""
    for race in range(cars.shape[0]):
        touched = touch_moving(track, tick[race], cars, race, vehicles[race])
        for car in range(cars.shape[1]):
            if touched >> car & 1:
                crash[race, car] = _state.WALL_CRASH
            for other in range(car):
                if overlap(cars, race, car, other, vehicles[race]):
                    crash[race, car] = crash[race, other] = _state.CAR_CRASH
