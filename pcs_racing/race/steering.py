"""Changes to a command on its way to a car: noise of the race and of the car, delays of the car."""

import numpy as np

from pcs_racing.base.compilation import inner_kernel, kernel
from pcs_racing.base.seeds import GOLDEN, scramble_one
from pcs_racing.car import vehicle as _vehicle
from pcs_racing.race.config import CONTROL_EVERY

_SPEED_KEY = np.uint64(0x5851F42D4C957F2D)  # makes the noise of the speed another sequence


@kernel
def steering_noise(seed, car, tick):
    """Draw nearly normal noise, mean 0 and variance 1, as a pure function of the arguments.

    It is the sum of four 16-bit uniform numbers: bounded by 3.5 standard deviations, excess
    kurtosis -0.3.
    """
    # Neighbouring ticks and cars differ in few bits: after two rounds of scrambling no trace of
    # that is left. Every two cars have their own sequence: in a shared sequence car 2 would get at
    # a tick the noise that car 0 gets at the next tick.
    pair = seed + np.uint64(0xA0761D6478BD642F) * np.uint64(car >> 1)
    key = scramble_one(pair + GOLDEN * np.uint64(2 * tick + (car & 1) + 1))
    key = scramble_one(key + np.uint64(0xD1B54A32D192ED03))
    mask = np.uint64(0xFFFF)
    total = (
        float(key & mask)
        + float((key >> np.uint64(16)) & mask)
        + float((key >> np.uint64(32)) & mask)
        + float((key >> np.uint64(48)) & mask)
    )
    return (total / 65535.0 - 2.0) * 1.7320508075688772


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
    return speed + noise * steering_noise(seed ^ _SPEED_KEY, car, tick - tick % CONTROL_EVERY)


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
