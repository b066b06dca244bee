"""Changes to a command on its way to a car: noise of the race and of the car, delays of the car."""

import numpy as np

from pcs_racing.base.compilation import inner_kernel, kernel
from pcs_racing.base.seeds import normal_noise
from pcs_racing.car import vehicle as _vehicle
from pcs_racing.planners.pursuit import BRAKING
from pcs_racing.race.config import CONTROL_EVERY

_SPEED_KEY = np.uint64(0xDA942042E4DD58B5)  # makes the noise of the speed another sequence


@kernel(forceinline=True)
def slowed(speed, handicap, v, vehicle):
    """Return the speed command (m/s) that a slower car at a speed ``v`` gets, by its handicap.

    A command of calm braking (:func:`pcs_racing.planners.pursuit.calm_speed`) stays one.
    """
    return min(speed, max((1.0 - handicap) * speed, v - vehicle[_vehicle.SPEED_LAG] * BRAKING))


@kernel(forceinline=True)
def disturbed_speed(speed, vehicle, seed, car, tick):
    """Return a speed command (m/s) with the car's noise, the same until the next command."""
    noise = vehicle[_vehicle.SPEED_NOISE]
    if noise == 0.0:
        return speed
    return speed + noise * normal_noise(seed ^ _SPEED_KEY, car, tick - tick % CONTROL_EVERY)


@inner_kernel
def send_late(track, state, vehicles, settings, race, car, command):
    """Change a command by the noise and the delays of its car."""
    own, memory, tick = vehicles[car], state.memory[race, car], state.tick[race]
    delay, late = own[_vehicle.STEER_DELAY], own[_vehicle.SPEED_DELAY]
    if delay > 0.0:
        command[0] = delayed(memory, delay, tick, command[0], 0.0)
    command[1] = disturbed_speed(command[1], own, state.seed[race], car, tick)
    if late > 0.0:
        command[1] = delayed(memory, late, tick, command[1], delay)
        if tick < late * CONTROL_EVERY:  # before the first command arrives
            command[1] = state.cars[race, car, _vehicle.V]


@inner_kernel
def delayed(memory, delay, tick, command, behind):
    """Queue a command at the end of a car's memory; return the command that is due.

    ``behind`` is the length of another queue, behind this one.
    """
    length = int(delay)
    place = memory.shape[0] - int(behind) - length + (tick // CONTROL_EVERY) % length
    due = memory[place]
    memory[place] = command
    return due
