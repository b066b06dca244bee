"""Where the cars of a race are: progress along the race line, laps, contacts, and who is to blame for these."""

from pcs_racing.base.compilation import inner_kernel, kernel
from pcs_racing.car import vehicle as _vehicle
from pcs_racing.car.collision import Rectangle, contact_fault, hits_wall, rectangles_overlap
from pcs_racing.race import state as _state
from pcs_racing.race.config import CONTROL_EVERY, DT
from pcs_racing.track.frenet import WALLS_BEGIN, WALLS_END, WallArrays, foot, locate


@inner_kernel
def _cross_line(laps, race, car, time):  # type: ignore[no-untyped-def]
    """Count a forward crossing of s = 0; a lap ends, unless the car has only come back after rolling backwards."""
    laps[race, car, _state.CROSSINGS] += 1.0
    if laps[race, car, _state.CROSSINGS] <= laps[race, car, _state.MOST_CROSSINGS]:
        return
    laps[race, car, _state.MOST_CROSSINGS] = laps[race, car, _state.CROSSINGS]
    if laps[race, car, _state.MOST_CROSSINGS] > 1.0:
        lap = time - laps[race, car, _state.CROSSED_AT]
        best = laps[race, car, _state.BEST_LAP]
        laps[race, car, _state.LAP_TIME] = lap
        laps[race, car, _state.BEST_LAP] = lap if best == 0.0 else min(best, lap)
    laps[race, car, _state.CROSSED_AT] = time


@kernel
def count_crossing(length, before, driven, tick, laps, race, car):  # type: ignore[no-untyped-def]
    """Account for a control period in which a car crossed s = 0, forward or backward."""
    if driven > 0.0:
        share = (length - before) / driven
        _cross_line(laps, race, car, (tick - CONTROL_EVERY * (1.0 - share)) * DT)
    else:
        laps[race, car, _state.CROSSINGS] -= 1.0


@kernel(forceinline=True)
def update_progress(line, ds, length, cars, frenet, progress, laps, tick, race):  # type: ignore[no-untyped-def]
    """Project both cars onto the race line and add what they drove; crossing s = 0 only counts for the laps.

    Takes single arrays: handing whole named tuples to small functions costs more than their work, in reference counts.
    """
    # Nobody drives half a lap in a control period: a larger change of s is a crossing of the start line.
    half = 0.5 * length
    for car in range(2):
        before = frenet[race, car, 0]
        s, d = foot(line, ds, length, cars[race, car, _vehicle.X], cars[race, car, _vehicle.Y], before)
        driven = s - before
        if driven > half:
            driven -= length
            count_crossing(length, before, driven, tick, laps, race, car)
        elif driven < -half:
            driven += length
            count_crossing(length, before, driven, tick, laps, race, car)
        progress[race, car] += driven
        frenet[race, car, 0] = s
        frenet[race, car, 1] = d


@inner_kernel(forceinline=True)
def _body(state, vehicle):  # type: ignore[no-untyped-def]
    """The rectangle of a car."""
    half_length, half_width = 0.5 * vehicle[_vehicle.LENGTH], 0.5 * vehicle[_vehicle.WIDTH]
    return Rectangle(state[_vehicle.X], state[_vehicle.Y], state[_vehicle.PSI], half_length, half_width)


@inner_kernel
def _latch(cars, crash, fault, race, vehicles, wall0, wall1):  # type: ignore[no-untyped-def]
    """Keep a crash and who is to blame for it; who is in a wall hit it before the other car."""
    if wall0 or wall1:
        if wall0:
            crash[race, 0] = _state.WALL_CRASH
            fault[race, 0] = 1
        if wall1:
            crash[race, 1] = _state.WALL_CRASH
            fault[race, 1] = 1
        return
    first, second = cars[race, 0], cars[race, 1]
    fault0, fault1 = contact_fault(first, second, _body(first, vehicles[0]), _body(second, vehicles[1]))
    crash[race, 0] = _state.CAR_CRASH
    crash[race, 1] = _state.CAR_CRASH
    fault[race, 0] = 1 if fault0 else 0
    fault[race, 1] = 1 if fault1 else 0


@inner_kernel
def _touch(cars, race, vehicles):  # type: ignore[no-untyped-def]
    """Whether the two cars of a race overlap."""
    return rectangles_overlap(_body(cars[race, 0], vehicles[0]), _body(cars[race, 1], vehicles[1]))


@inner_kernel(forceinline=True)
def collide(near, cars, frenet, crash, fault, race, vehicles):  # type: ignore[no-untyped-def]
    """Latch crashes and their faults; returns whether there is one."""
    # False, but no constant, for which numba would compile `_latch` once more.
    wall0 = wall1 = crash[race, 0] != 0
    for car in range(2):
        hit = hits_wall(near, frenet[race, car, 0], _body(cars[race, car], vehicles[car]))
        wall0 = hit if car == 0 else wall0
        wall1 = hit if car == 1 else wall1
    crashed = wall0 or wall1 or _touch(cars, race, vehicles)
    if crashed:
        _latch(cars, crash, fault, race, vehicles, wall0, wall1)
    return crashed


@kernel
def place_cars(track, state, vehicles):  # type: ignore[no-untyped-def]
    """Set the Frenet coordinates of freshly placed cars; a car in a wall or in the other one is marked as crashed."""
    near = WallArrays(*track[WALLS_BEGIN:WALLS_END])
    for race in range(state.tick.shape[0]):
        for car in range(2):
            s, d = locate(track, state.cars[race, car, _vehicle.X], state.cars[race, car, _vehicle.Y])
            state.frenet[race, car, 0] = s
            state.frenet[race, car, 1] = d
        collide(near, state.cars, state.frenet, state.crash, state.fault, race, vehicles[race])
