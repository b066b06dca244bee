"""Contacts of the cars of a race, with walls and with each other, and who is to blame for them."""

from pcs_racing.base.compilation import inner_kernel, kernel
from pcs_racing.car import vehicle as _vehicle
from pcs_racing.car.collision import contact_fault, hits_wall, rectangles_overlap
from pcs_racing.race import state as _state
from pcs_racing.track.frenet import locate


@inner_kernel
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


@inner_kernel
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


@inner_kernel(forceinline=True)
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
    wall0 = wall1 = crash[race, 0] != 0  # False, but no constant, for which numba would compile _latch once more
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
