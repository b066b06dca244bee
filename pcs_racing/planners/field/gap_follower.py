"""Follow-the-gap planner without a map: its only input is the lidar [1]_.

Every point that the lidar hits grows into a bubble that the middle of the car must not enter. That
gives each direction a free distance. The car heads for the middle of the directions with a free
distance close to the longest one, leans away from obstacles next to it, and drives no faster than
it can stop within the free distance. The race line and the opponent's state are unused: the
opponent is one more obstacle in the scan, and the planner does not know that it moves.

References
----------
.. [1] V. Sezer and M. Gokasan, "A novel obstacle avoidance algorithm: Follow the Gap Method",
   Robotics and Autonomous Systems 60(9), 2012.
"""

import numpy as np

from pcs_racing.base.compilation import compiled
from pcs_racing.base.elementary import arcsine, sine_cosine, tangent
from pcs_racing.car.lidar import Beams
from pcs_racing.planners import view as _view
from pcs_racing.planners.planner import Parameter, Planner, offsets
from pcs_racing.planners.scanning import (
    WORK,
    farthest,
    follow_scan,
    scan_beams,
    sine_tables,
    use_odometry,
    write_arc,
)

BEAMS = 108
FIELD_OF_VIEW = np.pi
MAX_RANGE = 12.0  # m
STEP = FIELD_OF_VIEW / (BEAMS - 1)

PARAMETERS = (
    Parameter("bubble", 0.20, 0.45, 0.26, "radius of the bubble around every point hit, m"),
    Parameter(
        "depth",
        0.5,
        0.95,
        0.8,
        "min free distance within the gap, as a share of the max free distance",
    ),
    Parameter(
        "side_air",
        0.2,
        1.2,
        1.0,
        "clearance below which it steers away, m",
    ),
    Parameter("reach", 0.7, 2.0, 1.4, "length of the path's turn into the chosen direction, m"),
    Parameter("top_speed", 2.0, 10.0, 8.0, "speed never exceeded, m/s"),
    Parameter(
        "braking",
        1.0,
        6.0,
        4.5,
        "braking that would stop the car within the free distance, m/s^2",
    ),
    Parameter(
        "lateral", 1.0, 6.0, 5.0, "lateral acceleration that limits the speed in a bend, m/s^2"
    ),
)
BUBBLE, DEPTH, SIDE_AIR, REACH, TOP_SPEED, BRAKING, LATERAL = range(len(PARAMETERS))

SLOWEST = 1.0  # m/s, to creep out of a dead end
SIDE_BEAMS = BEAMS // 6  # the outer 30 degrees on each side
LEAN = 0.4  # turn per missing metre to a side, rad/m
_ANGLES = np.linspace(-0.5 * FIELD_OF_VIEW, 0.5 * FIELD_OF_VIEW, BEAMS)
_SIN, _COS = sine_tables(_ANGLES)
_APART_SIN, _APART_COS = sine_tables(STEP * np.arange(BEAMS))  # by index difference of two beams

# Scratch: the lidar's own working memory, the ranges, and the free distances.
_, _RANGES, _FREE, SCRATCH = offsets(WORK, BEAMS, BEAMS)


@compiled
def free_distances(ranges, bubble, free):
    """Write the free distance (m) of the car's middle along each beam, up to the first bubble."""
    for k in range(BEAMS):
        free[k] = ranges[k]
    for j in range(BEAMS):
        near = ranges[j]
        # Within the bubble every forward direction is blocked at once.
        spread = arcsine(bubble / near) if near > bubble else 0.5 * np.pi
        reach = int(spread / STEP)
        for k in range(max(j - reach, 0), min(j + reach + 1, BEAMS)):
            # Entry of a beam into a circle around a point `near` away, some beams aside.
            across = near * _APART_SIN[abs(k - j)]
            ahead = near * _APART_COS[abs(k - j)] - np.sqrt(
                max(bubble * bubble - across * across, 0.0)
            )
            free[k] = min(free[k], max(ahead, 0.0))


@compiled
def widest_gap(free, depth):
    """Return the middle (rad) of the gap around the longest free distance, and this distance, m."""
    best = farthest(free, _ANGLES, 0, BEAMS)
    enough = depth * free[best]
    right = best
    while right > 0 and free[right - 1] >= enough:
        right -= 1
    left = best
    while left < BEAMS - 1 and free[left + 1] >= enough:
        left += 1
    return 0.5 * (_ANGLES[right] + _ANGLES[left]), free[best]


@compiled
def lean(ranges, side_air):
    """Return the turn (rad, positive to the left) away from obstacles next to the car."""
    right = side_air
    left = side_air
    for k in range(SIDE_BEAMS):
        right = min(right, ranges[k])
        left = min(left, ranges[BEAMS - 1 - k])
    return LEAN * (left - right)


@compiled
def plan(track, theta, view, memory, scratch, path):
    """Scan, choose a direction and write the arc that turns into it."""
    use_odometry(view)
    slip = view[_view.OWN_BETA]
    course = view[_view.OWN_PSI] + slip
    ranges = scratch[_RANGES:_FREE]
    free = scratch[_FREE:SCRATCH]
    scan_beams(
        track, Beams(_ANGLES[0], STEP, MAX_RANGE, _COS, _SIN), view, slip, scratch[:WORK], ranges
    )
    free_distances(ranges, theta[BUBBLE], free)
    angle, longest = widest_gap(free, theta[DEPTH])
    angle += lean(ranges, theta[SIDE_AIR])
    reach = theta[REACH]
    tightest = tangent(view[_view.STEER_MAX]) / view[_view.WHEELBASE]
    sine, _ = sine_cosine(angle)
    kappa = min(max(2.0 * sine / reach, -tightest), tightest)
    ahead = free[BEAMS // 2]
    speed = np.sqrt(2.0 * theta[BRAKING] * min(ahead, longest))
    speed = min(speed, np.sqrt(theta[LATERAL] / max(abs(kappa), 1e-6)), theta[TOP_SPEED])
    write_arc(view, course, kappa, 1.5 * reach, max(speed, SLOWEST), path)


GAP_FOLLOWER = Planner(
    name="gap-follower",
    parameters=PARAMETERS,
    plan=plan,
    control=follow_scan,
    scratch_size=SCRATCH,
)
"""Planner that drives by its lidar alone."""
