"""One step of the F1TENTH gym in compiled code, with the gym's order of operations and limits.

The number of cars is free. Vehicle, lidar and contacts come from :mod:`pcs_racing.car`. This module
holds the gym's own parts: its controllers, its test for walls by the scan, its finish line, and a
lidar for maps without a track.
"""

from typing import NamedTuple

import numpy as np

from pcs_racing.base.compilation import inner_kernel, kernel
from pcs_racing.base.elementary import sine_cosine, tangent
from pcs_racing.car.collision import Rectangle, inside_wall, rectangles_overlap
from pcs_racing.car.lidar_kernel import Beams, Pose, draw_rectangle, scan_into
from pcs_racing.car.vehicle import (
    BETA,
    DELTA,
    INERTIA,
    KINEMATIC_BELOW,
    LF,
    LR,
    PSI,
    PSI_DOT,
    STATE_SIZE,
    H,
    V,
    X,
    Y,
    derivative,
    handling_within,
    state_of,
)
from pcs_racing.track.frenet import TrackArrays, locate
from pcs_racing.track.grid import cast

# Columns of a car's parameters, in the gym's order; the first are `MU` to `INERTIA` of our cars.
(
    S_MIN,
    S_MAX,
    SV_MIN,
    SV_MAX,
    V_SWITCH,
    A_MAX,
    V_MIN,
    V_MAX,
    WIDTH,
    LENGTH,
) = range(INERTIA + 1, INERTIA + 11)

# Columns of a car: its state, its pose before a wall stopped it, the delayed steering, the index of
# the car in contact (-1 for none), laps, and its start.
(
    AT_X,
    AT_Y,
    AT_PSI,
    FIRST,
    SECOND,
    CRASHED,
    CONTACT,
    WALL,
    AWAY,
    TOGGLES,
    LAP_TIME,
    LAPS,
    START_X,
    START_Y,
    START_PSI,
    COLUMNS,
) = range(STATE_SIZE, STATE_SIZE + 16)

ORIGINAL = {
    "poses_x": X,
    "poses_y": Y,
    "poses_theta": PSI,
    "linear_vels_x": V,
    "ang_vels_z": PSI_DOT,
    "collisions": CRASHED,
}
"""Columns of the gym's observations, by name."""

KS, ST, OLD_ST = range(3)  # vehicle models; OLD_ST (generation A) differs below 0.5 m/s
RK4, EULER = range(2)
STOP_TIME = 0.005  # s; a shorter time to collision with a wall counts as a hit
NEAR = 3.0  # cells; walls nearer to a car's side are checked by the gym's own ray march
EPSILON = 1e-4  # m; the ray march ends at this distance
DIRECTIONS = 2000  # number of ray march directions in a full turn
BESIDE, AROUND = 2.0, 0.1  # box at the start: m to both sides, and m^2 beyond them


class MapGrid(NamedTuple):
    """Map as the gym reads it, framed by one ring of wall cells; grey levels above 128 are free."""

    free: np.ndarray  #: shape (H + 2, W + 2), bool: Free cells; row 0 is the bottom.
    #: shape (H + 2, W + 2): Distance from each cell's centre to the nearest wall cell's centre, m.
    distance: np.ndarray
    origin_x: float  #: x of the lower left corner of the map without the ring, m.
    origin_y: float  #: y of the same corner, m.
    cell: float  #: Side of a cell, m.
    open_outside: bool  #: True if beams that leave the map meet no wall.


class Setup(NamedTuple):
    """Constants of all steps."""

    model: int
    integrator: int
    acceleration: bool  #: Acceleration (m/s^2), not speed, in actions' column 1.
    steering_rate: bool  #: Steering rate (rad/s), not angle, in actions' column 0.
    dt: float  #: Length of a step, s.
    lidar_dist: float  #: Distance from the centre of gravity to the lidar, m.
    ego: int
    on_circuit: bool  #: True if the track belongs to the map.


class World(NamedTuple):
    """Input data of a step."""

    grid: MapGrid
    track: TrackArrays
    setup: Setup
    beams: Beams
    tables: np.ndarray  #: shape (2, DIRECTIONS): Sine and cosine of the ray march's directions.
    #: shape (beams,): Distance from the lidar to the car's side along each beam, as in the gym, m.
    sides: np.ndarray
    params: np.ndarray  #: shape (N, 18): Parameters of each car.


@inner_kernel
def write_rates(state, rate, acceleration, p, car, model, out):
    """Write the time derivative of a car's state."""
    delta, v, psi = state[DELTA], state[V], state[PSI]
    least = p[SV_MIN] if delta > p[S_MIN] else 0.0
    rate = min(max(rate, least), p[SV_MAX] if delta < p[S_MAX] else 0.0)
    if model == ST or (model == OLD_ST and abs(v) >= 0.5):
        rolls_below = KINEMATIC_BELOW if model == ST else -np.inf
        found = derivative(state_of(state), rate, acceleration, car, None, rolls_below)
        for k in range(len(found)):
            out[k] = found[k]
        return
    least = -car.a_max if v > car.v_min else 0.0
    most = car.a_max * (car.v_switch / v if v > car.v_switch else 1.0) if v < car.v_max else 0.0
    a = min(max(acceleration, least), most)
    wheelbase = p[LF] + p[LR]
    slope = tangent(delta)
    sine, cosine = sine_cosine(psi)
    out[X], out[Y], out[DELTA], out[V], out[PSI] = (
        v * cosine,
        v * sine,
        rate,
        a,
        v / wheelbase * slope,
    )
    out[PSI_DOT] = (
        (a * slope + v * (1.0 + slope * slope) * rate) / wheelbase if model == OLD_ST else 0.0
    )
    out[BETA] = 0.0


@inner_kernel
def handling(p):
    """Return the handling of a car with these parameters.

    Steering is limited elsewhere: its limits may differ by side.
    """
    ends = np.inf, np.inf, p[V_MIN], p[V_MAX], p[A_MAX], p[V_SWITCH]
    return handling_within(p, *ends, p[H], np.inf)


@kernel
def pid_steer(steer, current_steer, max_sv):
    """Return the steering rate towards a steering angle, rad/s."""
    error = steer - current_steer
    return np.sign(error) * max_sv if abs(error) > 1e-4 else 0.0


@kernel
def pid_accl(speed, current_speed, max_a, max_v, min_v):
    """Return the acceleration towards a speed, m/s^2."""
    difference = speed - current_speed
    return (
        (10.0 if current_speed > 0.0 else 2.0)
        * max_a
        / (max_v if difference > 0.0 else -min_v)
        * difference
    )


@inner_kernel
def _drive(state, steer, longitudinal, p, setup, work):
    """Advance one car in place by the gym's controllers and one step of its integrator."""
    rate = steer if setup.steering_rate else pid_steer(steer, state[DELTA], p[SV_MAX])
    a = (
        longitudinal
        if setup.acceleration
        else pid_accl(longitudinal, state[V], p[A_MAX], p[V_MAX], p[V_MIN])
    )
    car = handling(p)
    k, total, probe = work[0], work[1], work[2]
    write_rates(state, rate, a, p, car, setup.model, k)
    last = 0 if setup.integrator == EULER else 3
    for j in range(STATE_SIZE):
        total[j] = k[j] / (6.0 if last else 1.0)
    for stage in range(1, last + 1):
        for j in range(STATE_SIZE):
            probe[j] = state[j] + setup.dt * (0.5 if stage < last else 1.0) * k[j]
        write_rates(probe, rate, a, p, car, setup.model, k)
        for j in range(STATE_SIZE):
            total[j] += k[j] / (3.0 if stage < last else 6.0)
    for j in range(STATE_SIZE):
        state[j] += setup.dt * total[j]
    turn = 2.0 * np.pi
    if setup.model != OLD_ST:
        state[PSI] -= turn * np.floor(state[PSI] / turn)
    elif state[PSI] > turn:
        state[PSI] -= turn
    elif state[PSI] < 0.0:
        state[PSI] += turn


@inner_kernel
def _march(grid, x, y, sine, cosine, reach):
    """Return a beam's range by the gym's ray march, m; outside the map it reads the last cell."""
    rows, columns = grid.distance.shape
    near = total = 0.0
    while True:
        x += near * cosine
        y += near * sine
        u, v = x - grid.origin_x, y - grid.origin_y
        i, j = rows - 2, columns - 2
        if 0.0 <= u < (columns - 2) * grid.cell and 0.0 <= v < (rows - 2) * grid.cell:
            i, j = min(int(v / grid.cell) + 1, i), min(int(u / grid.cell) + 1, j)
        near = grid.distance[i, j]
        total += near
        if near <= EPSILON or total > reach:
            return min(total, reach)


@kernel
def scan_map(grid, track, on_circuit, beams, x, y, psi, work, out):
    """Write the exact ranges to the walls, m, shape (beams,)."""
    reach = beams.max_range
    if on_circuit and not inside_wall(track, x, y):
        s, _ = locate(track, x, y)
        nobody = Rectangle(0.0, 0.0, 0.0, 0.1, 0.1)
        scan_into(track, beams, Pose(x, y, psi), s, False, nobody, work, out)
        return
    sine, cosine = sine_cosine(psi)
    rows, columns = grid.free.shape
    u, v = (x - grid.origin_x) / grid.cell + 1.0, (y - grid.origin_y) / grid.cell + 1.0
    inside = 1.0 <= u < columns - 1.0 and 1.0 <= v < rows - 1.0
    out[:] = reach if grid.open_outside else 0.0
    for k in range(out.shape[0] if inside else 0):
        s, c = (
            sine * beams.cos[k] + cosine * beams.sin[k],
            cosine * beams.cos[k] - sine * beams.sin[k],
        )
        cells, i, j, side = cast(grid.free, u, v, c, s, reach / grid.cell)
        i, j = i + (side == 2) - (side == 0), j + (side == 1) - (side == 3)
        framed = side >= 0 and (i == 0 or j == 0 or i == rows - 1 or j == columns - 1)
        out[k] = reach if framed and grid.open_outside else min(cells * grid.cell, reach)


@inner_kernel
def _stops(world, x, y, psi, v, noise, scan):
    """Return whether the gym detects a wall hit: time to collision of a beam below STOP_TIME.

    The time is measured from the car's side. Only walls near the car matter, so only their beams
    are marched as in the gym, with the same decisions.
    """
    grid, beams, sides = world.grid, world.beams, world.sides
    if v == 0.0:
        return False
    near = STOP_TIME * abs(v) + NEAR * grid.cell
    count = 0
    for k in range(np.uint64(scan.shape[0])):
        count += abs(scan[k] + noise[k] - sides[k]) < near
    if count == 0:
        return False
    index = np.fmod(DIRECTIONS * (psi + beams.first) / (2.0 * np.pi), DIRECTIONS)
    while index < 0.0:
        index += DIRECTIONS
    for k in range(scan.shape[0]):
        if abs(scan[k] + noise[k] - sides[k]) < near:
            i = int(index)
            found = (
                _march(grid, x, y, world.tables[0, i], world.tables[1, i], beams.max_range)
                + noise[k]
            )
            time = (found - sides[k]) / (v * beams.cos[k])
            if 0.0 <= time < STOP_TIME:
                return True
        index += DIRECTIONS * beams.step / (2.0 * np.pi)
        while index >= DIRECTIONS:
            index -= DIRECTIONS
    return False


@inner_kernel
def _body(cars, params, i):
    """Return the outline of a car at its pose before a wall stopped it."""
    return Rectangle(
        cars[i, AT_X],
        cars[i, AT_Y],
        cars[i, AT_PSI],
        0.5 * params[i, LENGTH],
        0.5 * params[i, WIDTH],
    )


@inner_kernel
def _measure(world, cars, i, noise, inverse, work, scan):
    """Write the ranges of a car's lidar, and stop the car if it has hit a wall."""
    setup, car = world.setup, cars[i]
    body = _body(cars, world.params, i)
    sine, cosine = sine_cosine(body.psi)
    x, y = body.x + setup.lidar_dist * cosine, body.y + setup.lidar_dist * sine
    scan_map(world.grid, world.track, setup.on_circuit, world.beams, x, y, body.psi, work, scan)
    car[WALL] = _stops(world, x, y, body.psi, car[V], noise, scan)
    # The gym detects other cars from the centre of gravity, with the heading after a wall hit.
    x, y = body.x, body.y
    if car[WALL] > 0.0:
        car[V] = car[PSI_DOT] = car[BETA] = car[PSI] = 0.0
        sine, cosine = 0.0, 1.0
    inverse[:] = 0.0
    for j in range(cars.shape[0]):
        if j != i:
            other = _body(cars, world.params, j)
            length, width = other.half_length, other.half_width
            seen = Rectangle(other.x - x, other.y - y, other.psi, length, width)
            draw_rectangle(world.beams, seen, cosine, sine, work, inverse)
    for k in range(np.uint64(scan.shape[0])):
        scan[k] += noise[k]
        scan[k] = 1.0 / inverse[k] if inverse[k] * scan[k] > 1.0 else scan[k]


@inner_kernel
def _count_lap(world, cars, i):
    """Count laps as the gym does: one lap for every two crossings of the box around a car's start.

    The box lies across the heading of the ego's start.
    """
    car = cars[i]
    sine, cosine = sine_cosine(-cars[world.setup.ego, START_PSI])
    dx, dy = car[AT_X] - car[START_X], car[AT_Y] - car[START_Y]
    along, across = cosine * dx - sine * dy, abs(sine * dx + cosine * dy)
    beyond = max(across - BESIDE, 0.0)
    away = 1.0 if along * along + beyond * beyond > AROUND else 0.0
    if away != car[AWAY]:
        car[AWAY] = away
        car[TOGGLES] += 1.0
    car[LAPS] = car[TOGGLES] // 2.0


@kernel
def advance(world, cars, actions, noise, now, scans, inverse, work):
    """Advance all cars in place by one step, and write their scans.

    Return whether the episode ends.

    Shapes: ``cars`` (N, COLUMNS); ``actions`` (N, 2): steering, then speed or acceleration;
    ``noise`` (beams,), m, shared by all cars; ``scans`` (N, beams), written, m; ``inverse``
    (beams,) and ``work`` (the lidar's WORK_SHAPE): scratch. ``now`` is the time after the step, s.
    A car's lap time stops after two laps.
    """
    count, setup = cars.shape[0], world.setup
    for i in range(count):
        car = cars[i]
        steer = car[FIRST]
        car[FIRST], car[SECOND] = car[SECOND], actions[i, 0]
        _drive(car, steer, actions[i, 1], world.params[i], setup, work)
        car[AT_X], car[AT_Y], car[AT_PSI] = car[X], car[Y], car[PSI]
        car[CONTACT] = -1.0
    crashed, finished = False, True
    for i in range(count):
        a = _body(cars, world.params, i)
        for j in range(i + 1, count):
            b = _body(cars, world.params, j)
            if rectangles_overlap(a, b):
                cars[i, CONTACT], cars[j, CONTACT] = j, i
        _measure(world, cars, i, noise, inverse, work, scans[i])
        car = cars[i]
        car[CRASHED] = 1.0 if car[WALL] > 0.0 or car[CONTACT] >= 0.0 else 0.0
        # In the gym only a crash of the ego ends the episode.
        crashed |= car[CRASHED] > 0.0 and i == setup.ego
        _count_lap(world, cars, i)
        if car[TOGGLES] < 4.0:
            car[LAP_TIME] = now
            finished = False
    return crashed or finished
