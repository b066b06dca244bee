"""Stanley controller [1]_: steering by heading error and distance of the front axle from the path.

The steering angle is the heading error of the front axle and the arctangent of the gain times its
distance from the path over the speed. It has the terms of [2]_ for a car with slipping tyres: the
steady yaw in a bend, and damping by the yaw rate and by the last change of the steering. The
controller follows the race line, and trails a car ahead; it does not overtake.

Differences: the gain for the steady yaw is not tuned; it follows from the car's front tyres.

References
----------
.. [1] S. Thrun et al., "Stanley: The robot that won the DARPA Grand Challenge", Journal of Field
   Robotics 23(9), 2006.
.. [2] G. M. Hoffmann, C. J. Tomlin, M. Montemerlo and S. Thrun, "Autonomous automobile trajectory
   tracking for off-road driving: Controller design, experimental validation and racing", ACC 2007.
"""

import numpy as np

from pcs_racing.base.compilation import kernel
from pcs_racing.base.elementary import arctangent
from pcs_racing.planners import line as _line, view as _view
from pcs_racing.planners.planner import Parameter, Planner, offsets
from pcs_racing.planners.pursuit import calm_speed, limited_steering
from pcs_racing.track import frenet as _frenet

PARAMETERS = (
    *_line.TRAILING,
    Parameter("k", 0.5, 6.0, 4.0, "gain of the distance of the front axle from the path, 1/s"),
    Parameter("k_soft", 0.1, 5.0, 1.0, "addition to the car's speed, m/s"),
    Parameter("k_d_yaw", 0.0, 0.3, 0.02, "damping by the yaw rate of the car minus the path's, s"),
    Parameter("k_d_steer", 0.0, 1.0, 0.1, "damping by the last change of the steering angle"),
)
K, K_SOFT, YAW_DAMPING, STEER_DAMPING = range(len(_line.TRAILING), len(PARAMETERS))

SIGHT = 10.0  # max distance of a trailed car, m
PLAN_PERIOD = 0.1  # time between plans, s
PREVIEW = 0.1  # time ahead of the speed read off the path, s
# Memory: the lane, and the previous steering angle.
_, _BEFORE, MEMORY = offsets(_line.KEPT_LANE, 1)


@kernel
def plan(track, theta, view, memory, scratch, path):
    """Write the lane: the race line, or the own position across the track next to another car."""
    cap = _line.follow_line(track, theta, view, _line.gap_ahead(track, view), SIGHT, scratch)
    _line.ease_onto(track, view, _line.speed_scale(view, theta[0]), cap, scratch, path)
    _line.keep_lane(view, scratch, memory)


@kernel
def control(track, theta, view, memory, scratch, path, command):
    """Steer by the errors of the front axle."""
    v = view[_view.OWN_V]
    s = view[_view.OWN_S] + view[_view.WHEELBASE] - view[_view.REAR_AXLE]
    lane, slope = _line.kept_lane(track, memory, s)
    sample = track.line[_line.line_index(track, s)]
    kappa = sample[_frenet.KAPPA] / max(1.0 - sample[_frenet.KAPPA] * lane, 0.25)
    # Errors of the front axle: heading, and distance from the path.
    turns = _frenet.angle_between(sample[_frenet.PSI] + slope, view[_view.OWN_PSI])
    here = track.line[_line.line_index(track, view[_view.OWN_S]), _frenet.PSI]
    axle = (view[_view.WHEELBASE] - view[_view.REAR_AXLE]) * _frenet.angle_between(
        view[_view.OWN_PSI], here
    )
    error = view[_view.OWN_D] + axle - lane
    since = view[_view.TIME] - PLAN_PERIOD * np.floor(view[_view.TIME] / PLAN_PERIOD + 0.01)
    ahead = int(min(v * (since + PREVIEW) / memory[2], _view.PATH_POINTS - 1.0))
    speed, acceleration = calm_speed(view, path[ahead, _view.PATH_SPEED])
    slip = (
        view[_view.REAR_SLIP] + view[_view.UNDERSTEER] + view[_view.UNDERSTEER_GAIN] * acceleration
    )
    steer = turns + slip * v * v * kappa - arctangent(theta[K] * error / (theta[K_SOFT] + v))
    steer -= theta[YAW_DAMPING] * (view[_view.OWN_PSI_DOT] - v * kappa)
    steer += theta[STEER_DAMPING] * (memory[_BEFORE] - view[_view.OWN_DELTA])
    memory[_BEFORE] = view[_view.OWN_DELTA]
    command[0] = limited_steering(view, steer)
    command[1] = speed


STANLEY = Planner(
    name="stanley",
    parameters=PARAMETERS,
    plan=plan,
    control=control,
    memory_size=MEMORY,
    scratch_size=_line.LANE_SIZE,
    variants={"soft": {"k_soft": 3.0}, "damped": {"k_d_yaw": 0.05}},
)
"""The Stanley controller on the race line."""
