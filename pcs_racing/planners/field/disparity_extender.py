"""Disparity extender of UNC Chapel Hill [1]_: drive straight for the farthest point within reach.

A large difference between the ranges of two neighbouring beams is an edge, and next to an edge the
car needs half of its width. So the nearer range is extended over as many beams of the farther side
as half a car covers at that distance. The car steers for the longest remaining range in front of
it, and goes straight on if something is next to it on the side of the turn. Its speed grows with
the distance straight ahead.

Differences: the speed is also limited by the lateral acceleration of the bend.

References
----------
.. [1] N. Otterness, "The 'Disparity Extender' Algorithm, and F1/Tenth", 2019.
"""

import numpy as np

from pcs_racing.base.compilation import compiled
from pcs_racing.base.elementary import arctangent
from pcs_racing.planners import view as _view
from pcs_racing.planners.planner import Parameter, Planner
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
    Parameter(
        "disparity",
        0.05,
        1.0,
        0.3,
        "difference of the ranges of two neighbouring beams that is an edge, m",
    ),
    Parameter("tolerance", 0.0, 0.4, 0.15, "margin added to half of the car's width, m"),
    Parameter("steering_gain", 0.3, 1.5, 1.0, "steering angle per angle of the chosen direction"),
    Parameter(
        "side_distance",
        0.1,
        0.6,
        0.3,
        "clearance at its side below which the car does not turn, m",
    ),
    Parameter("safe_distance", 0.2, 3.0, 0.8, "max distance straight ahead for creeping, m"),
    Parameter(
        "full_distance",
        4.0,
        15.0,
        8.0,
        "min distance straight ahead for the top speed, m",
    ),
    Parameter("top_speed", 2.0, 12.0, 7.0, "top speed, m/s"),
    Parameter(
        "lateral", 1.0, 8.0, 5.0, "lateral acceleration that limits the speed in a bend, m/s^2"
    ),
)
DISPARITY, TOLERANCE, GAIN, SIDE, SAFE, FULL, TOP_SPEED, LATERAL = range(len(PARAMETERS))

SLOWEST = 1.0  # m/s
SCRATCH = SCAN_SIZE + BEAMS


@compiled
def extend_disparities(ranges, disparity, half_width, extended):
    """Write the ranges (m), with every edge extended by half a car, into ``extended``."""
    for k in range(BEAMS):
        extended[k] = ranges[k]
    for k in range(BEAMS - 1):
        right, left = ranges[k], ranges[k + 1]
        if abs(left - right) < disparity:
            continue
        near = min(left, right)
        beams = min(int(np.ceil(arctangent(half_width / max(near, 1e-3)) / STEP)), BEAMS)
        first, last = (
            (k + 1, min(k + 1 + beams, BEAMS)) if right < left else (max(k - beams, 0), k + 1)
        )
        for i in range(first, last):
            extended[i] = min(extended[i], near)


@compiled
def plan(track, theta, view, memory, scratch, path):
    """Scan, extend the disparities, and steer for the farthest point."""
    ranges, extended = scan(track, view, scratch), scratch[SCAN_SIZE:SCRATCH]
    extend_disparities(
        ranges, theta[DISPARITY], 0.5 * view[_view.OWN_WIDTH] + theta[TOLERANCE], extended
    )
    steering = theta[GAIN] * ANGLES[farthest(extended, ANGLES, RIGHT_BEAM, LEFT_BEAM + 1)]
    # Beams to the side of the turn, next to or behind the car.
    begin, end = (LEFT_BEAM, BEAMS) if steering > 0.0 else (0, RIGHT_BEAM + 1)
    for k in range(begin, end):
        if ranges[k] < theta[SIDE]:
            steering = 0.0
    share = (extended[BEAMS // 2] - theta[SAFE]) / (theta[FULL] - theta[SAFE])
    speed = SLOWEST + (theta[TOP_SPEED] - SLOWEST) * min(max(share, 0.0), 1.0)
    steer_for(view, steering, speed, theta[LATERAL], path)


DISPARITY_EXTENDER = Planner(
    name="disparity-extender",
    parameters=PARAMETERS,
    plan=plan,
    control=follow_scan,
    scratch_size=SCRATCH,
    variants={
        "calm": {"top_speed": 5.0, "lateral": 4.0},
        "fast": {"full_distance": 7.0, "lateral": 6.0},
    },
)
"""Planner that drives straight for the farthest point."""
