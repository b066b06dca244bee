"""Contacts that do not end a race: the car at fault stops, or is put back on the race line."""

import numpy as np

from pcs_racing.base.compilation import inner_kernel
from pcs_racing.car import vehicle as _vehicle
from pcs_racing.car.collision import Rectangle, contact_fault, hits_wall, rectangles_overlap
from pcs_racing.planners.view import (
    OWN_LENGTH,
    OWN_WIDTH,
    TRUE_D,
    TRUE_PSI,
    TRUE_S,
    TRUE_X,
    TRUE_Y,
    VIEW_SIZE,
)
from pcs_racing.race import state as _state
from pcs_racing.race.positions import body, gap_to, move_along, overlap, touch_moving
from pcs_racing.track import frenet as _frenet

END, STOP, RESTART = range(3)  # as in `pcs_racing.race.config.CONTACTS`

BEHIND = 2.0  # m: distance behind the other car or an obstacle, and between two tried places
TRIES = 20
DRIVES_AGAIN = 1.0  # m/s: below it the last contact continues, so that pushing a wall is one fault
MAX_FAULTS = 127


@inner_kernel
def _overlapped(before, car, other):
    """Return whether two cars already overlapped before the control period."""
    a, b = before[VIEW_SIZE * car :], before[VIEW_SIZE * other :]
    return rectangles_overlap(
        Rectangle(a[TRUE_X], a[TRUE_Y], a[TRUE_PSI], 0.5 * a[OWN_LENGTH], 0.5 * a[OWN_WIDTH]),
        Rectangle(b[TRUE_X], b[TRUE_Y], b[TRUE_PSI], 0.5 * b[OWN_LENGTH], 0.5 * b[OWN_WIDTH]),
    )


@inner_kernel
def _stand_on_line(near, track, tick, cars, race, car, s, vehicles):
    """Put a car at rest on the race line, at s or in free space behind s; return its arc length."""
    line, ds = track.line, track.ds
    for _ in range(TRIES):
        i = int(np.floor(s / ds)) % line.shape[0]
        cars[race, car, :] = 0.0
        cars[race, car, _vehicle.X] = line[i, _frenet.X]
        cars[race, car, _vehicle.Y] = line[i, _frenet.Y]
        cars[race, car, _vehicle.PSI] = line[i, _frenet.PSI]
        taken = hits_wall(near, i * ds, body(cars[race, car], vehicles[car]))
        obstructed = touch_moving(track, tick, cars, race, vehicles)
        taken = taken or obstructed >> car & 1 == 1
        for other in range(cars.shape[1]):
            taken = taken or (other != car and overlap(cars, race, car, other, vehicles))
        if not taken:
            break
        s -= BEHIND
    return i * ds


@inner_kernel
def _set_back(near, track, state, race, car, s, vehicles, mode, before):
    """Stop a car at its pose before the control period, or put it on the race line at s."""
    cars, view, d = state.cars, before[VIEW_SIZE * car :], 0.0
    if mode == STOP:
        cars[race, car, _vehicle.X], cars[race, car, _vehicle.Y] = view[TRUE_X], view[TRUE_Y]
        cars[race, car, _vehicle.PSI] = view[TRUE_PSI]
        cars[race, car, _vehicle.V] = cars[race, car, _vehicle.PSI_DOT] = cars[
            race, car, _vehicle.BETA
        ] = 0.0
        s, d = view[TRUE_S], view[TRUE_D]
    else:
        s = _stand_on_line(near, track, state.tick[race], cars, race, car, s, vehicles)
    move_along(
        track.length, state.frenet, state.progress, state.laps, state.tick[race], race, car, s, d
    )


@inner_kernel
def _note(fault, contact, race, car, kind, blamed):
    """Record the kind of a car's contact; count its fault unless the last contact continues."""
    if blamed and contact[race, car] == _state.NO_CRASH:
        fault[race, car] = min(fault[race, car] + 1, MAX_FAULTS)
    contact[race, car] = kind


@inner_kernel
def settle_contacts(track, state, vehicles, settings, race, car, before):
    """Set back cars that hit a wall or, by their own fault, a car.

    ``before`` holds the views of the cars before the control period, one after the other. If both
    cars are at fault and are put on the line, the car ahead keeps its place. Cars that already
    overlapped are left alone, so that they can part. A car with too many faults ends the race.
    """
    near = _frenet.WallArrays(*track[_frenet.WALLS_BEGIN : _frenet.WALLS_END])
    cars, frenet, fault, contact = state.cars, state.frenet, state.fault, state.contact
    mode, touched = settings.contact, 0
    obstructed = touch_moving(track, state.tick[race], cars, race, vehicles)
    for car in range(cars.shape[1]):
        in_wall = hits_wall(near, frenet[race, car, 0], body(cars[race, car], vehicles[car]))
        meets = obstructed >> car & 1
        if in_wall or meets:
            s = frenet[race, car, 0] - meets * BEHIND
            _note(fault, contact, race, car, _state.WALL_CRASH, True)
            _set_back(near, track, state, race, car, s, vehicles, mode, before)
            touched |= 1 << car
    for one in range(cars.shape[1]):
        for two in range(one + 1, cars.shape[1]):
            if not overlap(cars, race, one, two, vehicles):
                continue
            touched |= 1 << one | 1 << two
            if _overlapped(before, one, two):
                continue
            bodies = body(cars[race, one], vehicles[one]), body(cars[race, two], vehicles[two])
            fault1, fault2 = contact_fault(cars[race, one], cars[race, two], bodies[0], bodies[1])
            _note(fault, contact, race, one, _state.CAR_CRASH, fault1)
            _note(fault, contact, race, two, _state.CAR_CRASH, fault2)
            ahead = gap_to(track.length, frenet, race, one, two) < 0.0  # True if car `one` is ahead
            for turn in range(2):
                # The car behind comes first: it makes room for the car ahead.
                car, other = (one, two) if ahead == (turn == 1) else (two, one)
                if fault1 if car == one else fault2:
                    both = fault1 and fault2 and turn == 1
                    s = frenet[race, car, 0] if both else frenet[race, other, 0] - BEHIND
                    _set_back(near, track, state, race, car, s, vehicles, mode, before)
    for car in range(cars.shape[1]):
        if touched >> car & 1 == 0 and abs(cars[race, car, _vehicle.V]) > DRIVES_AGAIN:
            contact[race, car] = _state.NO_CRASH
        if 0 < settings.most_faults <= fault[race, car]:
            state.crash[race, car] = contact[race, car]
