"""Follow-the-gap method of the F1TENTH course [2]_, a simplification of [1]_.

The ranges are capped at a max range and smoothed. Around the nearest point a bubble as large as the
car is set to zero; the longest remaining run of beams is the gap. The car steers for the farthest
point of the gap, in ranges averaged once more, and chooses one of three speeds by the steering
angle. `pcs_racing.planners.field.gap_follower` is our own planner after the same idea.

Differences: only beams within a quarter turn of straight ahead count, and the speeds are higher
than in the exercise of the course.

References
----------
.. [1] V. Sezer and M. Gokasan, "A novel obstacle avoidance algorithm: Follow the Gap Method",
   Robotics and Autonomous Systems 60(9), 2012.
.. [2] University of Pennsylvania, F1TENTH course, laboratory "Follow the Gap", 2020.
"""

from pcs_racing.base.compilation import compiled
from pcs_racing.base.elementary import arctangent
from pcs_racing.planners.planner import Parameter, Planner, offsets
from pcs_racing.planners.scanning import (
    ANGLES,
    BEAMS,
    LEFT_BEAM,
    RIGHT_BEAM,
    SCAN_SIZE,
    STEP,
    farthest,
    follow_scan,
    scan,
    steer_for,
)

PARAMETERS = (
    Parameter("bubble", 0.15, 0.8, 0.3, "radius of the bubble around the nearest point, m"),
    Parameter("longest", 2.0, 15.0, 10.0, "cap of the ranges, m"),
    Parameter(
        "smoothing", 0.0, 0.2, 0.03, "angle to either side over which ranges are averaged, rad"
    ),
    Parameter(
        "best_smoothing", 0.0, 0.4, 0.17, "the same for the choice of the farthest point, rad"
    ),
    Parameter("steering_gain", 0.1, 1.0, 0.5, "steering angle per angle of the chosen direction"),
    Parameter("straight_angle", 0.02, 0.2, 0.17, "max steering angle on a straight, rad"),
    Parameter("corner_angle", 0.2, 0.4, 0.35, "max steering angle in a bend, rad"),
    Parameter("straight_speed", 1.0, 10.0, 5.0, "speed up to the first angle, m/s"),
    Parameter("bend_speed", 1.0, 8.0, 3.5, "speed up to the second angle, m/s"),
    Parameter("corner_speed", 0.5, 6.0, 2.0, "speed beyond it, m/s"),
)
BUBBLE, LONGEST, SMOOTHING, BEST, GAIN, STRAIGHT_ANGLE, CORNER_ANGLE, STRAIGHT, BEND, CORNER = (
    range(len(PARAMETERS))
)

NO_LIMIT = 1e6  # lateral acceleration, m/s^2: only the angles limit the speed
_, _SMOOTH, _CHOICE, SCRATCH = offsets(SCAN_SIZE, BEAMS, BEAMS)


@compiled
def smooth(ranges, longest, angle, out):
    """Write means of the ranges (m), capped at ``longest``, over +-``angle`` (rad) into ``out``."""
    reach = int(angle / STEP)
    total = 0.0
    first, last = 0, -1
    for k in range(BEAMS):
        while last < min(k + reach, BEAMS - 1):
            last += 1
            total += min(ranges[last], longest)
        while first < k - reach:
            total -= min(ranges[first], longest)
            first += 1
        out[k] = total / (last - first + 1)


@compiled
def longest_gap(ranges):
    """Return the first beam of the longest run of ranges above 0, and the beam after its last."""
    best, best_end, begin = 0, 0, 0
    for k in range(BEAMS + 1):
        if k == BEAMS or ranges[k] <= 0.0:
            if k - begin > best_end - best:
                best, best_end = begin, k
            begin = k + 1
    return best, best_end


@compiled
def plan(track, theta, view, memory, scratch, path):
    """Scan, clear the bubble, and steer for the farthest point of the longest gap."""
    ranges, choice = scratch[_SMOOTH:_CHOICE], scratch[_CHOICE:SCRATCH]
    smooth(scan(track, view, scratch), theta[LONGEST], theta[SMOOTHING], ranges)
    smooth(ranges, theta[LONGEST], theta[BEST], choice)
    nearest = RIGHT_BEAM
    for k in range(RIGHT_BEAM, LEFT_BEAM + 1):
        nearest = k if ranges[k] < ranges[nearest] else nearest
    spread = int(arctangent(theta[BUBBLE] / max(ranges[nearest], 1e-3)) / STEP)
    for k in range(BEAMS):
        if k < RIGHT_BEAM or k > LEFT_BEAM or abs(k - nearest) <= spread:
            ranges[k] = 0.0
    begin, end = longest_gap(ranges)
    steering = theta[GAIN] * ANGLES[farthest(choice, ANGLES, begin, end)]
    speed = theta[CORNER]
    if abs(steering) < theta[STRAIGHT_ANGLE]:
        speed = theta[STRAIGHT]
    elif abs(steering) < theta[CORNER_ANGLE]:
        speed = theta[BEND]
    steer_for(view, steering, speed, NO_LIMIT, path)


FOLLOW_THE_GAP = Planner(
    name="follow-the-gap",
    parameters=PARAMETERS,
    plan=plan,
    control=follow_scan,
    scratch_size=SCRATCH,
    variants={
        "calm": {"straight_speed": 3.5, "bend_speed": 2.5, "corner_speed": 1.5},
        "nearest": {"longest": 4.0},
    },
)
"""The course's version of follow the gap."""
