"""Compiled functions that turn a path, or a command from outside, into steering and speed: parts of many planners."""

import numpy as np

from pcs_racing.base.compilation import kernel
from pcs_racing.base.elementary import arctangent, sine_cosine
from pcs_racing.planners import view as _view

COMMAND_SLOTS = 2  # memory that :func:`hold_command` reads: steering angle and speed

BRAKING = 5.5
"""Braking that :func:`follow_path` asks for at most, m/s^2."""


@kernel
def leave_path(track, theta, view, memory, scratch, path):  # type: ignore[no-untyped-def]
    """Plan nothing: for drivers that decide everything in ``control``."""


@kernel
def hold_command(track, theta, view, memory, scratch, path, command):  # type: ignore[no-untyped-def]
    """Drive as the first two numbers of the memory say: how commands from outside reach a car."""
    command[0] = memory[0]
    command[1] = memory[1]


@kernel(forceinline=True)
def steady_course(view, kappa):  # type: ignore[no-untyped-def]
    """Direction (rad) in which the car would move in a steady bend ``kappa`` (1/m): its heading plus the slip there.

    The slip of the moment says less: it lags the steering. A driver that steers by it weaves, above 6.5 m/s ever more:
    the linearised car and its pursuit have eigenvalues outside the unit circle there (``dev/benchmarks/driving.py``).
    """
    v = view[_view.OWN_V]
    return view[_view.OWN_PSI] + kappa * (view[_view.REAR_AXLE] - view[_view.REAR_SLIP] * v * v)


@kernel(forceinline=True)
def pursuit_arc(view, x, y, kappa):  # type: ignore[no-untyped-def]
    """Curvature (1/m) of the arc to a point (m) that starts along `steady_course` in a bend ``kappa`` (1/m)."""
    dx = x - view[_view.OWN_X]
    dy = y - view[_view.OWN_Y]
    sine, cosine = sine_cosine(steady_course(view, kappa))
    return 2.0 * (dy * cosine - dx * sine) / max(dx * dx + dy * dy, 1e-6)


@kernel(forceinline=True)
def pursuit_steering(view, x, y, kappa, acceleration):  # type: ignore[no-untyped-def]
    """Steering angle (rad) of pure pursuit towards a point (m) where the path has the curvature ``kappa`` (1/m).

    The car's understeer makes up for the slip of the tyres in steady cornering; under braking the load shifts to the
    front and it turns into oversteer: ``acceleration`` (m/s^2) is what the driver is about to ask for.
    """
    arc = pursuit_arc(view, x, y, kappa)
    understeer = view[_view.UNDERSTEER] + view[_view.UNDERSTEER_GAIN] * acceleration
    steer = arctangent(view[_view.WHEELBASE] * arc) + understeer * view[_view.OWN_V] * view[_view.OWN_V] * kappa
    return min(max(steer, -view[_view.STEER_MAX]), view[_view.STEER_MAX])


@kernel(forceinline=True)
def calm_speed(v, speed):  # type: ignore[no-untyped-def]
    """Target speed that asks for no more braking than the car stays stable under, and the acceleration it stands for.

    The controller brakes by 10 times the speed error; beyond about 6 m/s^2 the unloaded rear axle lets go.
    """
    speed = max(speed, v - 0.1 * BRAKING)
    return speed, min(10.0 * (speed - v), 9.5)


@kernel(forceinline=True)
def _share_of_gap(before, after, distance):  # type: ignore[no-untyped-def]
    """How far between two points a distance from the car is reached, in [0, 1], from the squares of their distances."""
    before = np.sqrt(before)
    return min(max((distance - before) / max(np.sqrt(after) - before, 1e-9), 0.0), 1.0)


@kernel
def follow_path(track, theta, view, memory, scratch, path, command):  # type: ignore[no-untyped-def]
    """Follow the planned path by pure pursuit (the default ``control``).

    The look-ahead grows from 0.3 m by 0.1 m per m/s; the speed is the path's at the point reached in a tenth of a
    second.
    """
    x = view[_view.OWN_X]
    y = view[_view.OWN_Y]
    v = view[_view.OWN_V]
    last = path.shape[0] - 1
    # The path starts where the car was when it planned; skip what lies behind by now.
    i = 0
    near = (path[0, _view.PATH_X] - x) ** 2 + (path[0, _view.PATH_Y] - y) ** 2
    while i < last:
        there = (path[i + 1, _view.PATH_X] - x) ** 2 + (path[i + 1, _view.PATH_Y] - y) ** 2
        if there > near:
            break
        near = there
        i += 1
    reach = 0.3 + 0.1 * v
    preview = 0.1 * v
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
            speed = path[j, _view.PATH_SPEED] + w * (path[j + 1, _view.PATH_SPEED] - path[j, _view.PATH_SPEED])
            speed_found = True
        if after >= reach * reach:
            w = _share_of_gap(before, after, reach)
            goal_x = path[j, _view.PATH_X] + w * (path[j + 1, _view.PATH_X] - path[j, _view.PATH_X])
            goal_y = path[j, _view.PATH_Y] + w * (path[j + 1, _view.PATH_Y] - path[j, _view.PATH_Y])
            kappa = path[j, _view.PATH_KAPPA]
            break
        before = after
    speed, acceleration = calm_speed(v, speed)
    command[0] = pursuit_steering(view, goal_x, goal_y, kappa, acceleration)
    command[1] = speed
