"""Compiled functions that turn a path, or an external command, into steering and speed.

They are parts of many planners.
"""

from typing import Any

import numpy as np

from pcs_racing.base.compilation import kernel
from pcs_racing.base.elementary import arctangent, exponential, sine_cosine
from pcs_racing.car.vehicle import COMMAND_PERIOD
from pcs_racing.planners import view as _view
from pcs_racing.planners.calling import control_address, plan_address

COMMAND_SLOTS = 2  # size of the memory of :func:`hold_command`: steering angle and speed

BRAKING = 5.5
"""Max braking of :func:`follow_path`, m/s^2."""


@kernel
def leave_path(track, theta, view, memory, scratch, path):
    """Plan nothing: for planners that decide everything in ``control``."""


@kernel
def hold_command(track, theta, view, memory, scratch, path, command):
    """Copy the command from the first two numbers of the memory, for external commands."""
    command[0] = memory[0]
    command[1] = memory[1]


@kernel(forceinline=True)
def write_point(path, j, x, y, speed, kappa):
    """Write the point ``j`` of a path: place (m), speed (m/s) and curvature (1/m)."""
    path[j, _view.PATH_X] = x
    path[j, _view.PATH_Y] = y
    path[j, _view.PATH_SPEED] = speed
    path[j, _view.PATH_KAPPA] = kappa


@kernel(forceinline=True)
def steady_course(view, kappa):
    """Return the direction of motion (rad) in a steady bend ``kappa`` (1/m): heading plus slip.

    The momentary slip says less, because it lags the steering. A planner that steers by it weaves,
    increasingly so above 6.5 m/s: there the linearised car and its pursuit have eigenvalues outside
    the unit circle (``dev/benchmarks/driving.py``).
    """
    v = view[_view.OWN_V]
    return view[_view.OWN_PSI] + kappa * (view[_view.REAR_AXLE] - view[_view.REAR_SLIP] * v * v)


@kernel(forceinline=True)
def pursuit_steering(view, course, dx, dy, kappa, acceleration):
    """Return the steering angle (rad) of pure pursuit towards a point.

    ``course`` (rad) is the direction of motion, and ``dx``, ``dy`` (m) the way to the point, where
    the path has the curvature ``kappa`` (1/m). The car's understeer makes up for the slip of the
    tyres in steady cornering. Under braking the load shifts to the front, and understeer turns into
    oversteer: ``acceleration`` (m/s^2) is the next acceleration to be commanded.
    """
    sine, cosine = sine_cosine(course)
    arc = 2.0 * (dy * cosine - dx * sine) / max(dx * dx + dy * dy, 1e-6)
    understeer = view[_view.UNDERSTEER] + view[_view.UNDERSTEER_GAIN] * acceleration
    steer = (
        arctangent(view[_view.WHEELBASE] * arc)
        + understeer * view[_view.OWN_V] * view[_view.OWN_V] * kappa
    )
    return limited_steering(view, steer)


@kernel(forceinline=True)
def limited_steering(view, steer):
    """Return the command (rad) for a steering angle, within the own limits.

    A servo with a lag covers a share of the missing angle until the next command; so it is sent
    farther by that share, and arrives then, as a servo without a lag would.
    """
    lag, delta = view[_view.STEER_LAG], view[_view.OWN_DELTA]
    if lag > 0.0:
        steer = delta + (steer - delta) / (1.0 - exponential(-COMMAND_PERIOD / lag))
    return min(max(steer, -view[_view.STEER_MAX]), view[_view.STEER_MAX])


@kernel(forceinline=True)
def within_grip(view, acceleration):
    """Return a lateral acceleration (m/s^2), limited to the usable grip of the own tyres."""
    return min(acceleration, 1.0 / max(view[_view.GRIP_USE], 1e-9))


@kernel(forceinline=True)
def calm_speed(view, speed):
    """Return the target speed, limited to stable braking, and the acceleration that it commands.

    The car brakes by its speed error over its time constant. Beyond about 6 m/s^2 the unloaded rear
    axle loses grip. A car with a handicap drives its share of the target speed.
    """
    v, share, lag = view[_view.OWN_V], 1.0 - view[_view.HANDICAP], view[_view.SPEED_LAG]
    speed = max(speed, (v - lag * BRAKING) / share)
    return speed, min(1.0 / lag * (share * speed - v), 9.5)


@kernel(forceinline=True)
def _share_of_gap(before, after, distance):
    """Return the share in [0, 1] of the way between two points at a distance from the car.

    ``before`` and ``after`` are the squares of the points' distances from the car.
    """
    before = np.sqrt(before)
    return min(max((distance - before) / max(np.sqrt(after) - before, 1e-9), 0.0), 1.0)


@kernel
def follow_path(track, theta, view, memory, scratch, path, command):
    """Follow the planned path by pure pursuit (the default ``control``).

    The look-ahead grows from 0.3 m by 0.1 m per m/s. The speed is the path's speed at the point
    reached within the time constant of the car's speed, 0.1 s unless it is another car.
    """
    x, y, v = view[_view.OWN_X], view[_view.OWN_Y], view[_view.OWN_V]
    turn, delay = 0.0, view[_view.STEER_DELAY]
    if delay > 0.0:  # the car gets the command later, at another place
        turn = view[_view.OWN_PSI_DOT] * delay
        sine, cosine = sine_cosine(view[_view.OWN_PSI] + view[_view.OWN_BETA] + 0.5 * turn)
        x, y = x + v * delay * cosine, y + v * delay * sine
    last = path.shape[0] - 1
    # The path starts at the car's position at planning time; skip the points behind the car.
    i = 0
    near = (path[0, _view.PATH_X] - x) ** 2 + (path[0, _view.PATH_Y] - y) ** 2
    while i < last:
        there = (path[i + 1, _view.PATH_X] - x) ** 2 + (path[i + 1, _view.PATH_Y] - y) ** 2
        if there > near:
            break
        near = there
        i += 1
    reach = 0.3 + 0.1 * v
    preview = view[_view.SPEED_LAG] * v
    goal_x = path[last, _view.PATH_X]
    goal_y = path[last, _view.PATH_Y]
    kappa = path[last, _view.PATH_KAPPA]
    speed = path[last, _view.PATH_SPEED]
    speed_found = False
    before = near
    for j in range(i, last):
        after = (path[j + 1, _view.PATH_X] - x) ** 2 + (path[j + 1, _view.PATH_Y] - y) ** 2
        if not speed_found and after >= preview * preview:
            w = _share_of_gap(before, after, preview)
            speed = path[j, _view.PATH_SPEED] + w * (
                path[j + 1, _view.PATH_SPEED] - path[j, _view.PATH_SPEED]
            )
            speed_found = True
        if after >= reach * reach:
            w = _share_of_gap(before, after, reach)
            goal_x = path[j, _view.PATH_X] + w * (path[j + 1, _view.PATH_X] - path[j, _view.PATH_X])
            goal_y = path[j, _view.PATH_Y] + w * (path[j + 1, _view.PATH_Y] - path[j, _view.PATH_Y])
            kappa = path[j, _view.PATH_KAPPA]
            break
        before = after
    speed, acceleration = calm_speed(view, speed)
    course = steady_course(view, kappa) + turn
    command[0] = pursuit_steering(view, course, goal_x - x, goal_y - y, kappa, acceleration)
    command[1] = speed


def held_command() -> tuple[Any, Any]:
    """Return the addresses of plan and control for a car whose memory begins with its command."""
    return plan_address(leave_path), control_address(hold_command)
