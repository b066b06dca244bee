"""The compiled step of the control-level environment: commands in, races driven on, observations and rewards out."""

import numpy as np

from pcs_racing.base.compilation import compiled, kernel
from pcs_racing.base.elementary import sine_cosine
from pcs_racing.car import vehicle as _vehicle
from pcs_racing.car.collision import car_hits_wall
from pcs_racing.car.lidar_kernel import scan_into
from pcs_racing.game.reward import step_reward
from pcs_racing.race import state as _state
from pcs_racing.race.kernel import CONTROL_EVERY, DT, advance_races, steering_noise
from pcs_racing.track.frenet import KAPPA, LEFT, PSI, RIGHT, SPEED, angle_between, project

__all__ = [
    "OWN_ELEMENTS",
    "STRETCH_ELEMENTS",
    "advance_alone",
    "observe_races",
    "restart",
    "set_commands",
    "step_races",
]

OWN_ELEMENTS = 8  # numbers about the own car
STRETCH_ELEMENTS = 4  # numbers about each look-ahead distance; those about the opponent follow

# Keeps the noise of the lidar apart from that of the steering, which has the same key.
_LIDAR_KEY = np.uint64(0x5851F42D4C957F2D)


@kernel
def advance_alone(track, state, vehicles, settings, ticks, first, last):  # type: ignore[no-untyped-def]
    """Advance car 0 of races ``first`` to ``last - 1`` by ``ticks`` steps, as if no other car were there.

    The same steps at the same times as in :func:`pcs_racing.race.kernel.advance_races`, for a car that drives as the
    first two numbers of its memory say. Car 1 stays where it is, and nothing is summed up for characteristics.
    """
    keep = settings.noise_keep
    gain = settings.noise_sd * np.sqrt(1.0 - keep * keep)
    half = 0.5 * track.length
    for race in range(first, last):
        end = min(state.tick[race] + ticks, settings.end_tick)
        own = state.cars[race, 0]
        p = vehicles[race, 0]
        while state.tick[race] < end and state.crash[race, 0] == 0:
            tick = state.tick[race]
            if tick % CONTROL_EVERY == 0:
                state.command[race, 0, 0] = state.memory[race, 0, 0]
                state.command[race, 0, 1] = state.memory[race, 0, 1]
                if settings.noise_sd > 0.0:
                    draw = steering_noise(state.seed[race], 0, tick)
                    state.disturbance[race, 0] = keep * state.disturbance[race, 0] + gain * draw
                    state.command[race, 0, 0] += state.disturbance[race, 0]
            _vehicle.step_to_target(own, state.command[race, 0, 0], state.command[race, 0, 1], p, DT)
            tick += 1
            state.tick[race] = tick
            if tick % CONTROL_EVERY == 0:
                before = state.frenet[race, 0, 0]
                s, d = project(track, own[_vehicle.X], own[_vehicle.Y], before)
                driven = s - before
                if driven > half:
                    driven -= track.length
                elif driven < -half:
                    driven += track.length
                state.progress[race, 0] += driven
                state.frenet[race, 0, 0] = s
                state.frenet[race, 0, 1] = d
                half_length = 0.5 * p[_vehicle.LENGTH]
                half_width = 0.5 * p[_vehicle.WIDTH]
                if car_hits_wall(
                    track, own[_vehicle.X], own[_vehicle.Y], own[_vehicle.PSI], half_length, half_width, s
                ):
                    state.crash[race, 0] = _state.WALL_CRASH
                    state.fault[race, 0] = 1


@kernel
def _observe(line, ds, length, cars, frenet, progress, memory, ahead, alone, race, row):  # type: ignore[no-untyped-def]
    """Write everything but the lidar, in the units of the elements; single arrays, for speed."""
    n = line.shape[0]
    v = cars[race, 0, _vehicle.V]
    psi = cars[race, 0, _vehicle.PSI]
    s = frenet[race, 0, 0]
    d = frenet[race, 0, 1]
    here = min(int(s / ds), n - 1)
    row[0] = v
    row[1] = cars[race, 0, _vehicle.DELTA]
    row[2] = cars[race, 0, _vehicle.PSI_DOT]
    row[3] = angle_between(cars[race, 0, _vehicle.BETA], 0.0)
    row[4] = memory[race, 0, 0]
    row[5] = memory[race, 0, 1]
    row[6] = d
    row[7] = angle_between(psi, line[here, PSI] + (s - here * ds) * line[here, KAPPA])
    k = OWN_ELEMENTS
    for i in range(ahead.shape[0]):
        j = here + ahead[i]
        if j >= n:
            j -= n
        row[k] = line[j, KAPPA]
        row[k + 1] = line[j, SPEED]
        row[k + 2] = line[j, LEFT]
        row[k + 3] = line[j, RIGHT]
        k += STRETCH_ELEMENTS
    if alone:
        for i in range(k, k + 9):
            row[i] = 0.0
        return
    sn, c = sine_cosine(psi)
    dx = cars[race, 1, _vehicle.X] - cars[race, 0, _vehicle.X]
    dy = cars[race, 1, _vehicle.Y] - cars[race, 0, _vehicle.Y]
    course = cars[race, 1, _vehicle.PSI] + cars[race, 1, _vehicle.BETA]
    own_course = psi + cars[race, 0, _vehicle.BETA]
    speed = cars[race, 1, _vehicle.V]
    sine, cosine = sine_cosine(course)
    own_sine, own_cosine = sine_cosine(own_course)
    vx = speed * cosine - v * own_cosine
    vy = speed * sine - v * own_sine
    gap = frenet[race, 1, 0] - s
    row[k] = 1.0
    row[k + 1] = gap - length * np.floor(gap / length + 0.5)
    row[k + 2] = frenet[race, 1, 1] - d
    row[k + 3] = dx * c + dy * sn
    row[k + 4] = dy * c - dx * sn
    row[k + 5] = angle_between(cars[race, 1, _vehicle.PSI], psi)
    row[k + 6] = vx * c + vy * sn
    row[k + 7] = vy * c - vx * sn
    row[k + 8] = progress[race, 0] - progress[race, 1]


@kernel
def _write(row, low, high, gain, shift, out, race):  # type: ignore[no-untyped-def]
    """Clip an observation to its bounds, scale it if asked, and round it to float32."""
    for k in range(row.shape[0]):
        out[race, k] = np.float32(min(max(row[k], low[k]), high[k]) * gain[k] + shift[k])


@kernel
def _noisy(scan, seed, tick, noise, most):  # type: ignore[no-untyped-def]
    """Add to each range noise that depends on the race's seed, the time and the beam alone."""
    beams = scan.shape[0]
    for k in range(beams):
        draw = steering_noise(seed ^ _LIDAR_KEY, 0, tick * beams + k)
        scan[k] = min(max(scan[k] + noise * draw, 0.0), most)


@kernel
def observe_races(track, state, vehicles, ahead, alone, beams, noise, low, high, gain, shift, rows, first, last, row, work, out):  # type: ignore[no-untyped-def]  # fmt: skip  # noqa: E501
    """Write the observations of the races ``rows[first:last]``.

    Parameters
    ----------
    track : TrackArrays
    state : RaceState
    vehicles : ndarray, shape (B, 2, 16)
    ahead : ndarray of int64
        Look-ahead distances in samples of the race line, each in [0, N).
    alone : bool
        Whether there is no opponent.
    beams : Beams
        Of the lidar; with no beams there is no scan.
    noise : float
        Standard deviation of its ranges, m.
    low, high, gain, shift : ndarray, shape (n,)
        Bounds of the elements, and what turns a clipped value into the one that is written.
    rows : ndarray of int64
        Which races to observe.
    first, last : int
        The part of ``rows`` to work off.
    row : ndarray, shape (n,)
        Scribbled on, as is ``work``, of shape ``WORK_SHAPE`` of the lidar.
    out : ndarray, shape (B, n), float32
        Receives the observations, each in its race's row.
    """
    count = low.shape[0]
    scanned = beams.cos.shape[0]
    scan = row[count - scanned :]
    for i in range(first, last):
        race = rows[i]
        _observe(
            track.line,
            track.ds,
            track.length,
            state.cars,
            state.frenet,
            state.progress,
            state.memory,
            ahead,
            alone,
            race,
            row,
        )
        if scanned > 0:
            scan_into(
                track,
                beams,
                state.cars[race, 0, _vehicle.X],
                state.cars[race, 0, _vehicle.Y],
                state.cars[race, 0, _vehicle.PSI],
                state.frenet[race, 0, 0],
                not alone,
                state.cars[race, 1, _vehicle.X],
                state.cars[race, 1, _vehicle.Y],
                state.cars[race, 1, _vehicle.PSI],
                0.5 * vehicles[race, 1, _vehicle.LENGTH],
                0.5 * vehicles[race, 1, _vehicle.WIDTH],
                work,
                scan,
            )
            if noise > 0.0:
                _noisy(scan, state.seed[race], state.tick[race], noise, beams.max_range)
        _write(row, low, high, gain, shift, out, race)


@kernel
def set_commands(actions, steer_max, top_speed, memory, first, last):  # type: ignore[no-untyped-def]
    """Turn actions in [-1, 1] into target steering angles and speeds, where the driver of car 0 reads them."""
    for race in range(first, last):
        memory[race, 0, 0] = steer_max * min(max(actions[race, 0], -1.0), 1.0)
        memory[race, 0, 1] = 0.5 * top_speed * (1.0 + min(max(actions[race, 1], -1.0), 1.0))


@compiled
def restart(state, grid, rows, places, seeds):  # type: ignore[no-untyped-def]
    """Put races ``rows`` back on the grid: at the places that ``grid``, a batch of fresh races, has them start from."""
    for i in range(rows.shape[0]):
        race = rows[i]
        place = places[i]
        state.tick[race] = 0
        state.seed[race] = seeds[i]
        state.cars[race] = grid.cars[place]
        state.frenet[race] = grid.frenet[place]
        state.progress[race] = grid.progress[place]
        state.command[race] = 0.0
        state.disturbance[race] = 0.0
        state.path[race] = 0.0
        state.memory[race] = 0.0
        state.sums[race] = 0.0
        state.crash[race] = 0
        state.fault[race] = 0
        state.leader[race] = -1
        state.overtakes[race] = 0


@kernel
def _end_step(  # type: ignore[no-untyped-def]
    progress, crash, fault, tick, end_tick, weights, alone, before, reward, terminated, truncated, first, last
):
    """Rewards and ends after a step, from the progress before it and the state after it."""
    for race in range(first, last):
        own = progress[race, 0] - before[race, 0]
        other = 0.0 if alone else progress[race, 1] - before[race, 1]
        ended = crash[race, 0] != 0 or crash[race, 1] != 0
        reward[race] = step_reward(own, other, fault[race, 0], weights)
        terminated[race] = ended
        truncated[race] = not ended and tick[race] >= end_tick


@kernel
def step_races(track, state, theta, vehicles, plan0, control0, plan1, control1, settings, ticks, actions, limits, weights, sight, low, high, gain, shift, rows, first, last, buffers, before, reward, terminated, truncated, out):  # type: ignore[no-untyped-def]  # fmt: skip  # noqa: E501
    """One step of races ``first`` to ``last - 1``: drive ``ticks`` steps on, pay, and observe.

    Parameters
    ----------
    track, state, theta, vehicles, plan0, control0, plan1, control1, settings, ticks
        As in :func:`pcs_racing.race.kernel.advance_races`.
    actions : ndarray, shape (B, 2)
        Steering and speed, clipped to [-1, 1].
    limits : tuple of float
        Largest steering angle (rad) and top speed (m/s).
    weights : tuple of float
        As :func:`pcs_racing.game.reward.step_reward` takes them.
    sight : tuple
        ``ahead, alone, beams, noise`` of :func:`observe_races`.
    low, high, gain, shift, rows, out
        As in :func:`observe_races`; ``rows`` counts from 0 to B - 1.
    first, last : int
        The part of the batch to step.
    buffers : tuple of ndarray
        ``scratch`` and ``work`` of the races, ``row`` and ``work`` of the observations: all scribbled on.
    before : ndarray, shape (B, 2)
        Progress from which the reward counts, m.
    reward, terminated, truncated : ndarray, shape (B,)
        Overwritten.
    """
    ahead, alone, beams, noise = sight
    scratch, work, row, scan_work = buffers
    set_commands(actions, limits[0], limits[1], state.memory, first, last)
    if alone:
        advance_alone(track, state, vehicles, settings, ticks, first, last)
    else:
        advance_races(
            track, state, theta, vehicles, plan0, control0, plan1, control1, settings, ticks, first, last, scratch, work
        )
    _end_step(
        state.progress,
        state.crash,
        state.fault,
        state.tick,
        settings.end_tick,
        weights,
        alone,
        before,
        reward,
        terminated,
        truncated,
        first,
        last,
    )
    observe_races(
        track,
        state,
        vehicles,
        ahead,
        alone,
        beams,
        noise,
        low,
        high,
        gain,
        shift,
        rows,
        first,
        last,
        row,
        scan_work,
        out,
    )
