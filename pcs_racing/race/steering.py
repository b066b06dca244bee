"""Changes to a command on its way to a car: noise of the race and of the car, delays of the car."""

import numpy as np

from pcs_racing.base.compilation import inner_kernel, kernel
from pcs_racing.base.seeds import normal_noise
from pcs_racing.car import vehicle as _vehicle
from pcs_racing.race.config import CONTROL_EVERY

_SPEED_KEY = np.uint64(0xDA942042E4DD58B5)  # makes the noise of the speed another sequence


@inner_kernel(forceinline=True)
def steering_sd(settings, vehicle):
    """Return the standard deviation of a car's steering disturbance: its own, else the rules'."""
    own = vehicle[_vehicle.STEER_NOISE]
    return settings.noise_sd if own < 0.0 else own


@kernel(forceinline=True)
def disturbed_speed(speed, vehicle, seed, car, tick):
    """Return a speed command (m/s) with the car's noise, the same until the next command."""
    noise = vehicle[_vehicle.SPEED_NOISE]
    if noise == 0.0:
        return speed
    return speed + noise * normal_noise(seed ^ _SPEED_KEY, car, tick - tick % CONTROL_EVERY)


@inner_kernel
def delayed(memory, delay, tick, command, behind=0.0):
    """Queue a command at the end of a car's memory; return the command that is due.

    ``behind`` is the length of another queue, behind this one.
    """
    length = int(delay)
    place = memory.shape[0] - int(behind) - length + (tick // CONTROL_EVERY) % length
    due = memory[place]
    memory[place] = command
    return due
