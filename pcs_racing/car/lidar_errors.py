"""Errors of a lidar: beams outside its field of view or lost, noise, bias and steps of the ranges.

A beam without a return reads the max range, as the drivers of most lidars report it. Noise and
losses are pure functions of a key, so a scan that is taken again is the same.
"""

import numpy as np

from pcs_racing.base.compilation import kernel
from pcs_racing.base.elementary import sine_cosine
from pcs_racing.base.seeds import normal_noise, uniform_noise
from pcs_racing.track.frenet import angle_between, project

# Numbers of a lidar's errors, in the order of the columns of a car and of a planner's view.
FOV, NOISE, LOST, BIAS, STEP = range(5)

EDGE = 1e-9  # rad: tolerance at the edge of the field of view

_LOST_KEY = np.uint64(0x9FB21C651E98DF25)  # separates lost beams from noise, which has the same key


@kernel
def lidar_place(track, x, y, psi, s, ahead, left):
    """Return x, y and arc length (m) of a lidar, ``ahead`` and to the ``left`` of its car, m."""
    if ahead == 0.0 and left == 0.0:
        return x, y, s
    sine, cosine = sine_cosine(psi)
    x, y = x + cosine * ahead - sine * left, y + sine * ahead + cosine * left
    s, _ = project(track, x, y, s)
    return x, y, s


@kernel
def disturb_scan(beams, turn, errors, seed, car, count, ranges):
    """Change exact ranges into the ranges that a lidar with some ``errors`` reports, in place, m.

    ``turn`` is the angle (rad) of the beams from the lidar's heading. Beam k takes the random
    numbers of the key ``seed``, the ``car`` and the number ``count + k``. Noise applies to all
    beams, bias and steps to those below the max range.
    """
    fov, noise, lost, bias, step = (
        errors[FOV],
        errors[NOISE],
        errors[LOST],
        errors[BIAS],
        errors[STEP],
    )
    most, whole = beams.max_range, fov >= 2.0 * np.pi
    if whole and noise == 0.0 and lost == 0.0 and bias == 0.0 and step == 0.0:
        return
    for k in range(ranges.shape[0]):
        angle = angle_between(beams.first + k * beams.step + turn, 0.0)
        if not whole and abs(angle) > 0.5 * fov + EDGE:
            ranges[k] = most
            continue
        if lost > 0.0 and uniform_noise(seed ^ _LOST_KEY, car, count + k) < lost:
            ranges[k] = most
            continue
        read = ranges[k]
        if read < most:
            read += bias
        if noise > 0.0:
            read += noise * normal_noise(seed, car, count + k)
        if step > 0.0 and read < most:
            read = step * np.floor(read / step + 0.5)
        ranges[k] = min(max(read, 0.0), most)
