"""Measurements of a car: its pose with errors of the localisation, and other cars late, lost or
out of sight.

Every error is a pure function of the race's seed, the car and the time, like the noise of commands.
Late cars come from a history in the memory of the car that sees them late. While an opponent is
lost, a planner has the view of a car alone: trackers drop an object without measurements.
"""

from collections.abc import Iterable

import numpy as np

from pcs_racing.base.compilation import inner_kernel
from pcs_racing.base.elementary import sine_cosine
from pcs_racing.base.seeds import normal_noise, uniform_noise
from pcs_racing.car import vehicle as _vehicle
from pcs_racing.car.vehicle import COMMAND_PERIOD, VehicleParams
from pcs_racing.planners import view as _view
from pcs_racing.race.config import CONTROL_EVERY, DT, FULL_SIGHT
from pcs_racing.race.positions import body, gap_to
from pcs_racing.track.frenet import COS, SIN, foot, shorter_way

_KEY = np.uint64(0x2545F4914F6CDD1D)  # separates these errors from the noise of the steering
_SCAN_KEY = np.uint64(0xD6E8FEB86659FD93)
DRIFT_TICKS = 400  # steps of 0.01 s between two independent draws of a drift

# Counts of the draws, so that no two share one: a multiple of 16, the kind, and the coordinate.
_NOISE, _DRIFT, _BIAS, _LOST, _DRAWS = 0, 4, 8, 12, 16
_AXIS_X, _AXIS_Y, _AXIS_PSI = range(3)

UNSEEN = 1e9  # m: x of a car that is lost or out of sight

# Numbers of a car in the history.
_X, _Y, _V, _PSI, _BETA, _S, _D, _PROGRESS = range(8)
REMEMBERED = 8


def history_size(vehicles: Iterable[VehicleParams], cars: int) -> int:
    """Return the size of the longest history of cars in a race of so many cars, in numbers."""
    longest = max(round(vehicle.opponent_delay / COMMAND_PERIOD) for vehicle in vehicles)
    return REMEMBERED * cars * (longest + 1) if longest else 0


@inner_kernel(forceinline=True)
def senses_exactly(own):
    """Return whether a car with a row of parameters sees itself and others as they are."""
    errors = 0.0
    for k in range(_vehicle.POSE_NOISE, _vehicle.OPPONENT_LOST + 1):
        errors += own[k]  # none is below 0
    return errors == 0.0


@inner_kernel(forceinline=True)
def scan_key(own, seed, car, tick):
    """Return the key of the noise of a car's scan, in [0, 1); 0 for a lidar without noise."""
    if own[_vehicle.LIDAR_NOISE] == 0.0 and own[_vehicle.LIDAR_LOST] == 0.0:
        return 0.0
    return uniform_noise(seed ^ _SCAN_KEY, car, tick)


@inner_kernel
def _error(own, first, seed, car, tick, axis):
    """Return the error of a coordinate.

    ``own[first]`` and the two numbers after it are the standard deviations of noise, drift and
    bias.
    """
    noise, drift, bias, error = own[first], own[first + 1], own[first + 2], 0.0
    if noise > 0.0:
        error += noise * normal_noise(seed, car, _DRAWS * tick + _NOISE + axis)
    if drift > 0.0:
        part = tick // DRIFT_TICKS
        # The squares of sine and cosine add up to 1: the variance is the same at all times.
        sine, cosine = sine_cosine(0.5 * np.pi * (tick - part * DRIFT_TICKS) / DRIFT_TICKS)
        before = normal_noise(seed, car, _DRAWS * part + _DRIFT + axis)
        after = normal_noise(seed, car, _DRAWS * (part + 1) + _DRIFT + axis)
        error += drift * (cosine * before + sine * after)
    if bias > 0.0:
        error += bias * normal_noise(seed, car, _BIAS + axis)
    return error


@inner_kernel(forceinline=True)
def _has_error(own, first):
    return own[first] + own[first + 1] + own[first + 2] > 0.0


@inner_kernel
def measured_pose(line, ds, length, own, seed, car, tick, x, y, psi, s, d):
    """Return x, y, heading, arc length and offset of a car as its localisation reports them."""
    key = seed ^ _KEY
    if _has_error(own, _vehicle.POSE_NOISE):
        x += _error(own, _vehicle.POSE_NOISE, key, car, tick, _AXIS_X)
        y += _error(own, _vehicle.POSE_NOISE, key, car, tick, _AXIS_Y)
        s, d = foot(line, ds, length, x, y, s)
    if _has_error(own, _vehicle.HEADING_NOISE):
        psi += _error(own, _vehicle.HEADING_NOISE, key, car, tick, _AXIS_PSI)
        psi -= 2.0 * np.pi * np.floor(psi * (0.5 / np.pi))
    return x, y, psi, s, d


@inner_kernel
def opponent_lost(own, seed, car, tick):
    """Return whether a car sees no other car now."""
    if own[_vehicle.OPPONENT_LOST] == 0.0:
        return False
    # Multiples of 0.01 s are rarely exact in floating point; 1e-9 is a tolerance.
    interval = int(tick * DT / own[_vehicle.OPPONENT_LOST_TIME] + 1e-9)
    return uniform_noise(seed ^ _KEY, car, _DRAWS * interval + _LOST) < own[_vehicle.OPPONENT_LOST]


@inner_kernel
def _place(own, number, count, other, memory):
    """Return the place of a car in the history of the command ``count``.

    The history lies before the queues of late commands. It holds one command more than the delay,
    so that it can be read before and after it is written.
    """
    kept = int(own[_vehicle.OPPONENT_DELAY]) + 1
    queues = int(own[_vehicle.STEER_DELAY] + own[_vehicle.SPEED_DELAY])
    begin = memory.shape[0] - queues - REMEMBERED * number * kept
    return begin + REMEMBERED * (number * (count % kept) + other)


@inner_kernel
def out_of_sight(row, own, seen, sight):
    """Return whether all corners of a rectangle lie outside of the sight of a car's lidar.

    ``row`` and ``own`` are the state and the parameters of the car.
    """
    if sight >= FULL_SIGHT:
        return False
    sine, cosine = sine_cosine(row[_vehicle.PSI])
    x = row[_vehicle.X] + own[_vehicle.LIDAR_X] * cosine - own[_vehicle.LIDAR_Y] * sine
    y = row[_vehicle.Y] + own[_vehicle.LIDAR_X] * sine + own[_vehicle.LIDAR_Y] * cosine
    ahead_y, ahead_x = sine_cosine(row[_vehicle.PSI] + own[_vehicle.LIDAR_YAW])
    limit = sine_cosine(0.5 * sight)[1]
    sine, cosine = sine_cosine(seen.psi)
    for corner in range(4):
        along = seen.half_length if corner < 2 else -seen.half_length
        across = seen.half_width if corner % 2 == 0 else -seen.half_width
        dx = seen.x + along * cosine - across * sine - x
        dy = seen.y + along * sine + across * cosine - y
        if dx * ahead_x + dy * ahead_y >= limit * np.sqrt(dx * dx + dy * dy):
            return False
    return True


@inner_kernel
def _hidden(state, race, car, other, vehicles, sight):
    """Return whether a car is out of the sight of ``car`` now."""
    seen = body(state.cars[race, other], vehicles[other])
    return out_of_sight(state.cars[race, car], vehicles[car], seen, sight)


@inner_kernel
def remember_cars(state, race, car, vehicles, sight):
    """Write the cars of a race, at a command, to the history of a car that sees them late.

    A car out of sight is remembered at x = `UNSEEN`.
    """
    own, memory = vehicles[car], state.memory[race, car]
    if own[_vehicle.OPPONENT_DELAY] == 0.0:
        return
    number = state.cars.shape[1]
    for other in range(number):
        at = _place(own, number, state.tick[race] // CONTROL_EVERY, other, memory)
        row = state.cars[race, other]
        hidden = other != car and _hidden(state, race, car, other, vehicles, sight)
        memory[at + _X] = UNSEEN if hidden else row[_vehicle.X]
        memory[at + _Y] = row[_vehicle.Y]
        memory[at + _V] = row[_vehicle.V]
        memory[at + _PSI] = row[_vehicle.PSI]
        memory[at + _BETA] = row[_vehicle.BETA]
        memory[at + _S] = state.frenet[race, other, 0]
        memory[at + _D] = state.frenet[race, other, 1]
        memory[at + _PROGRESS] = state.progress[race, other]


@inner_kernel
def _remembered(own, number, tick, other, memory):
    """Return the place of a car in the history, as it is seen now; -1 for the present."""
    late = int(own[_vehicle.OPPONENT_DELAY])
    if late == 0 or tick == 0:
        return -1
    return _place(own, number, max(tick // CONTROL_EVERY - late, 0), other, memory)


@inner_kernel
def seen_car(length, state, race, car, vehicles, sight):
    """Return the nearest car in sight along the track; -1 for none."""
    nearest, least = -1, np.inf
    number, memory = state.cars.shape[1], state.memory[race, car]
    for other in range(number):
        gap = abs(gap_to(length, state.frenet, race, car, other))
        if other == car or gap >= least:
            continue
        at = _remembered(vehicles[car], number, state.tick[race], other, memory)
        if at < 0:
            hidden = _hidden(state, race, car, other, vehicles, sight)
        else:
            hidden = memory[at + _X] == UNSEEN
        if not hidden:
            nearest, least = other, gap
    return nearest


@inner_kernel
def blur_view(line, ds, length, own, number, other, seed, car, tick, progress, memory, view):
    """Change an exact view into a car's measurements; ``progress`` is the own progress, m.

    ``other`` is the visible opponent, -1 for none.
    """
    exact = view[_view.OWN_S]
    (
        view[_view.OWN_X],
        view[_view.OWN_Y],
        view[_view.OWN_PSI],
        view[_view.OWN_S],
        view[_view.OWN_D],
    ) = measured_pose(
        line,
        ds,
        length,
        own,
        seed,
        car,
        tick,
        view[_view.OWN_X],
        view[_view.OWN_Y],
        view[_view.OWN_PSI],
        view[_view.OWN_S],
        view[_view.OWN_D],
    )
    if other < 0:
        return
    at = _remembered(own, number, tick, other, memory)
    if at >= 0:
        view[_view.OPP_X], view[_view.OPP_Y] = memory[at + _X], memory[at + _Y]
        view[_view.OPP_V], view[_view.OPP_PSI] = memory[at + _V], memory[at + _PSI]
        view[_view.OPP_BETA] = memory[at + _BETA]
        view[_view.OPP_S], view[_view.OPP_D] = memory[at + _S], memory[at + _D]
        i = min(int(memory[at + _S] / ds), line.shape[0] - 1)
        sine, cosine = sine_cosine(memory[at + _PSI] + memory[at + _BETA])
        view[_view.OPP_D_DOT] = memory[at + _V] * (sine * line[i, COS] - cosine * line[i, SIN])
        view[_view.GAP] = memory[at + _PROGRESS] - progress
    view[_view.GAP] -= shorter_way(length, view[_view.OWN_S] - exact)


@inner_kernel
def sense_cars(track, state, race, car, vehicles, sight, seen):
    """Write the cars of a race, as one of them measures them, into the arrays of ``seen``.

    These are states, Frenet coordinates and progress of a single race. A car that is lost or out of
    sight is at x = `UNSEEN`.
    """
    seen_cars, seen_frenet, seen_progress = seen
    cars, frenet, progress, memory = (
        state.cars,
        state.frenet,
        state.progress,
        state.memory[race, car],
    )
    number, own, seed, tick = cars.shape[1], vehicles[car], state.seed[race], state.tick[race]
    lost = opponent_lost(own, seed, car, tick)
    for other in range(number):
        for k in range(_vehicle.STATE_SIZE):
            seen_cars[0, other, k] = cars[race, other, k]
        seen_frenet[0, other, 0] = frenet[race, other, 0]
        seen_frenet[0, other, 1] = frenet[race, other, 1]
        seen_progress[0, other] = progress[race, other]
        at = -1 if other == car else _remembered(own, number, tick, other, memory)
        if at >= 0:
            seen_cars[0, other, _vehicle.X] = memory[at + _X]
            seen_cars[0, other, _vehicle.Y] = memory[at + _Y]
            seen_cars[0, other, _vehicle.V] = memory[at + _V]
            seen_cars[0, other, _vehicle.PSI] = memory[at + _PSI]
            seen_cars[0, other, _vehicle.BETA] = memory[at + _BETA]
            seen_frenet[0, other, 0] = memory[at + _S]
            seen_frenet[0, other, 1] = memory[at + _D]
            seen_progress[0, other] = memory[at + _PROGRESS]
        unseen = lost or (at < 0 and _hidden(state, race, car, other, vehicles, sight))
        if unseen and other != car:
            seen_cars[0, other, _vehicle.X] = UNSEEN
    x, y, psi, s, d = measured_pose(
        track.line,
        track.ds,
        track.length,
        own,
        seed,
        car,
        tick,
        cars[race, car, _vehicle.X],
        cars[race, car, _vehicle.Y],
        cars[race, car, _vehicle.PSI],
        frenet[race, car, 0],
        frenet[race, car, 1],
    )
    seen_progress[0, car] += shorter_way(track.length, s - frenet[race, car, 0])
    seen_cars[0, car, _vehicle.X], seen_cars[0, car, _vehicle.Y] = x, y
    seen_cars[0, car, _vehicle.PSI] = psi
    seen_frenet[0, car, 0], seen_frenet[0, car, 1] = s, d
