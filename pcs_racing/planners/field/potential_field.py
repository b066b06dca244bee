"""Artificial potential field over the lidar [1]_, the base planner of residual learning in [2]_.

Free space pulls and near obstacles push. Each beam in front pulls the car along its direction with
a power of its range. Within a reach, each beam pushes it away with the inverse square of its range,
minus the inverse square of the reach. The car steers for the direction of the sum, at a speed that
allows it to brake within the free distance of that side.

Differences: free space pulls instead of the goal of [1]_, and a bend's lateral acceleration limits
the speed.

References
----------
.. [1] O. Khatib, "Real-Time Obstacle Avoidance for Manipulators and Mobile Robots", International
   Journal of Robotics Research 5(1), 1986.
.. [2] R. Trumpp, E. Javanmardi, J. Nakazato, M. Tsukada and M. Caccamo, "RaceMOP: Mapless Online
   Path Planning for Multi-Agent Autonomous Racing using Residual Policy Learning", 2024,
   arXiv:2403.07129.
"""

import numpy as np

from pcs_racing.base.compilation import compiled
from pcs_racing.base.elementary import arctangent2, tangent
from pcs_racing.planners import view as _view
from pcs_racing.planners.planner import Parameter, Planner
from pcs_racing.planners.scanning import (
    BEAMS,
    COS,
    SCAN_SIZE,
    SIN,
    beam_at,
    follow_scan,
    scan,
    steer_for,
)

PARAMETERS = (
    Parameter("power", 1.0, 6.0, 3.0, "power of the range with which free space pulls"),
    Parameter("repulsion", 0.0, 5.0, 0.5, "strength of what pushes, against the pull"),
    Parameter("reach", 0.3, 3.0, 1.0, "range within which something pushes, m"),
    Parameter("steering_gain", 0.3, 2.0, 0.8, "steering angle per angle of the sum"),
    Parameter(
        "braking",
        1.0,
        8.0,
        3.0,
        "deceleration with which it would stop within the free distance, m/s^2",
    ),
    Parameter("top_speed", 2.0, 12.0, 7.0, "top speed, m/s"),
    Parameter(
        "lateral", 1.0, 8.0, 5.0, "lateral acceleration that limits the speed in a bend, m/s^2"
    ),
)
POWER, REPULSION, REACH, GAIN, BRAKING, TOP_SPEED, LATERAL = range(len(PARAMETERS))

LONGEST = 10.0  # max range that pulls, m
STOP = 0.5  # distance left to an obstacle after a stop, m
SLOWEST = 1.0  # m/s
NO_LIMIT = 1e6  # lateral acceleration, m/s^2: the command has its own limit


@compiled
def field_command(theta, view, ranges):
    """Return the steering angle (rad) and speed (m/s) requested by the field of the ranges (m)."""
    first, last = beam_at(-0.5 * np.pi), beam_at(0.5 * np.pi)
    pull_x = pull_y = push_x = push_y = 0.0
    for k in range(first, last + 1):
        near = max(ranges[k], 0.05)
        pull = (min(near, LONGEST) / LONGEST) ** theta[POWER]
        push = max(1.0 / near**2 - 1.0 / theta[REACH] ** 2, 0.0)
        pull_x, pull_y = pull_x + pull * COS[k], pull_y + pull * SIN[k]
        push_x, push_y = push_x + push * COS[k], push_y + push * SIN[k]
    size = np.sqrt(pull_x**2 + pull_y**2) + 1e-9
    share = theta[REPULSION] / (last + 1 - first)
    # Obstacles ahead push only to the side; the speed accounts for their distance.
    angle = arctangent2(pull_y / size - share * push_y, max(pull_x / size, 0.1))
    steering = min(max(theta[GAIN] * angle, -view[_view.STEER_MAX]), view[_view.STEER_MAX])
    free = ranges[beam_at(0.5 * angle)]
    stopping = np.sqrt(2.0 * theta[BRAKING] * max(free - STOP, 0.0))
    bend = np.sqrt(theta[LATERAL] * view[_view.WHEELBASE] / max(abs(tangent(steering)), 1e-6))
    return steering, max(min(stopping, bend, theta[TOP_SPEED]), SLOWEST)


@compiled
def plan(track, theta, view, memory, scratch, path):
    """Scan, and steer along the field."""
    scan(track, view, scratch)
    steering, speed = field_command(theta, view, scratch[SCAN_SIZE - BEAMS : SCAN_SIZE])
    steer_for(view, steering, speed, NO_LIMIT, path)


VARIANTS = {"calm": {"top_speed": 5.0, "lateral": 4.0}, "bold": {"braking": 4.0, "lateral": 6.0}}
POTENTIAL_FIELD = Planner(
    name="potential-field",
    parameters=PARAMETERS,
    plan=plan,
    control=follow_scan,
    scratch_size=SCAN_SIZE,
    variants=VARIANTS,
)
"""Planner that drives along the field of the ranges."""
