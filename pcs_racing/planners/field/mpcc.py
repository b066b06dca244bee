"""Model predictive contouring control [1]_: progress along the race line, by a quadratic program.

Ten times a second the planner computes the cheapest motion of the next 1.2 s: positions, headings,
yaw rates, slip angles, steering angles and speeds, and a place on the race line for each position.
The cost rewards progress of the place, and charges the distance from the race line (contouring
error), the distance between place and position along it (lag error), steering rates, and changes of
acceleration. The motion stays between the walls, within the grip of the tyres, below the speed
profile at the car's pace, and clear of the opponent: left of it, right of it, or behind it,
whichever is cheapest. The model is a single-track model with linear tyres, linearised around the
last plan, so each of these choices is one convex program. Clarabel [2]_ solves it from the same
start each time, and ends by accuracy and not by time: one program has one result.

Fifty times a second the car takes the plan's steering angle, corrected by pure pursuit of the plan
and by the steering error of the last commands, and the plan's acceleration.

Differences: the tyres are linear, with a limit of the lateral acceleration; the yaw inertia, which
a planner does not see, is a share of the mass; walls, grip and opponent are soft constraints; the
opponent is predicted at its share of the speed profile and its distance from the race line.

References
----------
.. [1] A. Liniger, A. Domahidi and M. Morari, "Optimization-based autonomous racing of 1:43 scale RC
   cars", Optimal Control Applications and Methods 36, 2015.
.. [2] P. Goulart and Y. Chen, "Clarabel: An interior-point solver for conic programs with quadratic
   objectives", 2024.
"""

from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.compilation import first_call, inner_kernel, kernel
from pcs_racing.base.elementary import sine_cosine
from pcs_racing.base.errors import require
from pcs_racing.planners import line_following as _line
from pcs_racing.planners import view as _view
from pcs_racing.planners.field.pure_pursuit import gap_ahead, line_index, side_air
from pcs_racing.planners.lattice import GRIP, LOST
from pcs_racing.planners.planner import Parameter, Planner
from pcs_racing.planners.pursuit import BRAKING, within_grip
from pcs_racing.track import frenet as _frenet
from pcs_racing.track.frenet import angle_between, project, shorter_way, to_cartesian, wrap_s
from pcs_racing.track.track import Track

PARAMETERS = (
    _line.PACE,
    Parameter(
        "contouring", 0.01, 50.0, 2.0, "cost of a squared distance from the race line, 1/m^2"
    ),
    Parameter("lag", 1.0, 1000.0, 100.0, "cost of a squared lag error, 1/m^2"),
    Parameter("progress", 0.1, 50.0, 10.0, "reward of progress along the race line, 1/m"),
    Parameter("steering_rate", -4.0, 2.0, -1.0, "log10 cost of a squared steering rate, s^2/rad^2"),
    Parameter("jerk", -6.0, -1.0, -4.0, "log10 cost of a squared rate of acceleration, s^6/m^2"),
    Parameter("wall_margin", 0.0, 0.4, 0.2, "air to keep beside a wall, m"),
    Parameter("opponent_margin", 0.0, 0.5, 0.15, "air to keep beside the opponent, m"),
    Parameter(
        "trailing_gap",
        0.7,
        4.0,
        0.9,
        "distance between the cars' middles to keep behind the opponent, m",
    ),
    Parameter(
        "attack",
        0.0,
        0.5,
        0.2,
        "share by which the speed may exceed the profile behind or beside the opponent, within the"
        " grip",
    ),
)
(
    _PACE,
    CONTOURING,
    LAG,
    PROGRESS,
    STEERING_RATE,
    JERK,
    WALL_MARGIN,
    OPPONENT_MARGIN,
    TRAILING_GAP,
    ATTACK,
) = range(len(PARAMETERS))

STEPS, STEP = 24, 0.05  # stages of a plan, and their distance in s
PLAN_EVERY = 10  # simulation steps of 0.01 s between two plans
SIGHT = 15.0  # m; an opponent farther ahead is ignored
BODY = 0.2  # m before and behind the opponent that belong to its place
SIDEWAYS = 3.0  # m/s, how fast a gap beside the opponent opens
STICK = 1.0  # cost of another side of the opponent than that of the last plan
STEERING = 3.0  # rad/s
LEARN = 0.15  # share by which the known steering error approaches the measured one in 0.02 s
YAW_INERTIA = 0.5  # share of mass times the axles' distances from the centre of gravity
ACCELERATION = 6.0  # m/s^2
SLOW = 0.5  # m/s; the model divides by the speed
# Costs of violating a soft constraint, linear and quadratic: walls and opponent per m, grip per
# m/s^2.
WALL_COST, OPPONENT_COST, GRIP_COST = 50.0, 100.0, 2.0
WALL_SQUARE, OPPONENT_SQUARE, GRIP_SQUARE = 500.0, 500.0, 5.0

FREE, LEFT, RIGHT, BEHIND = range(4)  # ways past the opponent

# Variables of a stage: x and y from the car (m), heading (rad), yaw rate (rad/s), slip angle (rad),
# steering angle (rad), speed (m/s), place on the race line from the car's own (m), violations of
# walls, opponent and grip.
_X, _Y, _PSI, _R, _BETA, _DELTA, _V, _S, _WALL, _OPP, _SLIP = range(11)
SIZE = 11
VARIABLES = STEPS * SIZE
EQUALITIES, INEQUALITIES = 5 * STEPS, 16 * STEPS

# Columns of a stage's row: linearisation point (as the variables); point, direction (cosine, sine)
# and curvature of the race line there; distance from it; free width; max speed; the opponent's
# place, and the own one without an opponent. Stage 0 is the car.
_KEPT = 7
(_LX, _LY, _LC, _LS, _LK, _D, _FREE_LEFT, _FREE_RIGHT, _MAX_V, _OPP_S, _FREE_S) = range(8, 19)
COLUMNS = 19

# Memory: time of the last plan + 1 s (0: none), its way, and the first variables of its stages.
_TIME, _WAY, _STAGES = 0, 1, 2
# Then the last commanded steering angle, and the error of such commands.
_SENT = _STAGES + _KEPT * (STEPS + 1)
_ERROR = _SENT + 1
MEMORY = _ERROR + 1


class Model(NamedTuple):
    """Coefficients of the car's single-track model with linear tyres, from the view."""

    lf: float  #: Distance of the front axle from the centre of gravity, m.
    lr: float  #: Distance of the rear axle, m.
    front: float  #: Lateral acceleration per slip angle of the front tyres, m/s^2.
    rear: float  #: Lateral acceleration per slip angle of the rear tyres, m/s^2.
    shift: float  #: Height of the centre of gravity divided by gravity, s^2.


@inner_kernel(forceinline=True)
def _relative(track, s, own):
    """Return an arc length from the own one, in [-length / 2, length / 2), m."""
    return shorter_way(track.length, s - own)


@inner_kernel(forceinline=True)
def _model(view):
    lr = view[_view.REAR_AXLE]
    lf = view[_view.WHEELBASE] - lr
    rear = 1.0 / view[_view.REAR_SLIP]
    front = 1.0 / (view[_view.UNDERSTEER] + view[_view.REAR_SLIP])
    shift = view[_view.UNDERSTEER_GAIN] / (1.0 / (front * lr) + 1.0 / (rear * lf))
    return Model(lf, lr, front, rear, shift)


@inner_kernel
def _top_speed(track, view, scale, s):
    """Return the profile's speed (m/s) at a place ``s`` m ahead of the car."""
    return scale * track.line[line_index(track, view[_view.OWN_S] + s), _frenet.SPEED]


@inner_kernel
def _on_line(track, view, s, d, v, row):
    """Write a stage that drives parallel to the race line."""
    at = view[_view.OWN_S] + s
    kappa = track.line[line_index(track, at), _frenet.KAPPA]
    kappa /= max(1.0 - kappa * d, 0.3)
    row[_X], row[_Y], course = to_cartesian(track, at, d)
    row[_R], row[_V], row[_S] = v * kappa, v, s
    row[_BETA] = kappa * (view[_view.REAR_AXLE] - view[_view.REAR_SLIP] * v * v)
    row[_PSI] = course - row[_BETA]
    steer = kappa * (view[_view.WHEELBASE] + view[_view.UNDERSTEER] * v * v)
    row[_DELTA] = min(max(steer, -view[_view.STEER_MAX]), view[_view.STEER_MAX])


@inner_kernel
def _recall(track, view, memory, stages):
    """Write the stages of the last plan that are still ahead; return their number.

    The number is 0 without a plan, or if the car lost it.
    """
    age = view[_view.TIME] + 1.0 - memory[_TIME]
    if memory[_TIME] == 0.0 or age > 0.5 * STEP * STEPS:
        return 0
    shift = int(age / STEP + 0.5)
    x, y = memory[_STAGES + _KEPT * shift], memory[_STAGES + _KEPT * shift + 1]
    if (x - view[_view.OWN_X]) ** 2 + (y - view[_view.OWN_Y]) ** 2 > LOST * LOST:
        return 0
    for k in range(1, STEPS - shift + 1):
        for i in range(_KEPT):
            stages[k, i] = memory[_STAGES + _KEPT * (k + shift) + i]
    return STEPS - shift


@inner_kernel
def _place(track, view, stages):
    """Write the stages' places on the race line and distances from it; unwrap their headings."""
    own_s, along = view[_view.OWN_S], 0.0
    for k in range(STEPS + 1):
        row = stages[k]
        s, row[_D] = project(track, row[_X], row[_Y], own_s + along)
        along = _relative(track, s, own_s)
        row[_S] = along
        if k > 0:
            turned = angle_between(row[_PSI], stages[k - 1, _PSI])
            row[_PSI] = stages[k - 1, _PSI] + turned


@inner_kernel
def _extend(track, view, scale, first, stages):
    """Write the stages from ``first`` on: parallel to the race line, and back to it."""
    s, d = project(track, stages[first - 1, _X], stages[first - 1, _Y], view[_view.OWN_S])
    s = _relative(track, s, view[_view.OWN_S])
    for k in range(first, STEPS + 1):
        before = stages[k - 1, _V]
        v = min(before + STEP * ACCELERATION, _top_speed(track, view, scale, s))
        s, d = s + STEP * 0.5 * (before + v), 0.9 * d
        _on_line(track, view, s, d, v, stages[k])


@inner_kernel(forceinline=True)
def _place_length(view):
    """Return the distance (m) along the line of two cars' middles from which a car is clear."""
    return 0.5 * (view[_view.OWN_LENGTH] + view[_view.OPP_LENGTH]) + BODY


@inner_kernel(forceinline=True)
def _in_sight(track, view):
    """Return whether the opponent is beside the car, or ahead of it and near."""
    return -_place_length(view) < gap_ahead(track, view) < SIGHT


@inner_kernel
def _measure(track, view, theta, scale, stages):
    """Write the race line, the free width, the speed limit and the opponent at each stage."""
    keep = 0.5 * view[_view.OWN_WIDTH] + theta[WALL_MARGIN]
    opp_s, free_s = gap_ahead(track, view), 0.0
    free_v = stages[0, _V]
    here = track.line[line_index(track, wrap_s(track, view[_view.OPP_S]))]
    share = view[_view.OPP_V] / here[_frenet.SPEED]
    fast = scale * (1.0 + theta[ATTACK]) if _in_sight(track, view) else scale
    for k in range(STEPS + 1):
        row = stages[k]
        if k > 0:
            opp_s += STEP * share * _top_speed(track, view, 1.0, opp_s)
            free_v = min(free_v + STEP * ACCELERATION, _top_speed(track, view, fast, free_s))
            free_s += STEP * free_v
        line = track.line[line_index(track, view[_view.OWN_S] + row[_S])]
        row[_LX], row[_LY], course = to_cartesian(track, view[_view.OWN_S] + row[_S], 0.0)
        row[_LS], row[_LC] = sine_cosine(course)
        row[_LK] = line[_frenet.KAPPA]
        row[_FREE_LEFT] = line[_frenet.LEFT] - keep
        row[_FREE_RIGHT] = line[_frenet.RIGHT] - keep
        # The last stage is at the profile: beyond it there may be a bend.
        top = (fast if k < STEPS else scale) * line[_frenet.SPEED]
        row[_MAX_V] = max(top, stages[0, _V] - 0.95 * BRAKING * STEP * k)
        row[_OPP_S], row[_FREE_S] = opp_s, free_s


@kernel
def prepare(track, theta, view, memory, stages):
    """Write the stages to linearise around; return whether they continue the last plan."""
    scale = _line.speed_scale(view, theta[_PACE])
    car = stages[0]
    car[_X], car[_Y], car[_PSI] = view[_view.OWN_X], view[_view.OWN_Y], view[_view.OWN_PSI]
    car[_R], car[_BETA] = view[_view.OWN_PSI_DOT], view[_view.OWN_BETA]
    car[_DELTA], car[_V] = view[_view.OWN_DELTA], max(view[_view.OWN_V], 0.0)
    last = _recall(track, view, memory, stages)
    _extend(track, view, scale, last + 1, stages)
    _place(track, view, stages)
    _measure(track, view, theta, scale, stages)
    return last > 0


@kernel
def may_pass(track, view, way):
    """Return whether a way past the opponent is to be considered."""
    if way == FREE or not _in_sight(track, view):
        return (way == FREE) != _in_sight(track, view)
    gap = gap_ahead(track, view)
    if way == BEHIND:
        return gap > 0.0
    if gap < _place_length(view) and side_air(view) > 0.0:  # side by side
        return (view[_view.OWN_D] > view[_view.OPP_D]) == (way == LEFT)
    return True


@inner_kernel(forceinline=True)
def _put(entries, count, row, column, value):
    """Append an entry to a matrix of rows, columns and values; return the number of entries."""
    entries[0, count], entries[1, count], entries[2, count] = row, column, value
    return count + 1


@inner_kernel
def _fill_cost(theta, stages, costs, q):
    """Write the upper triangle of the cost's matrix, and its vector."""
    n, x0, y0 = 0, stages[0, _X], stages[0, _Y]
    contouring, lag = 2.0 * theta[CONTOURING], 2.0 * theta[LAG]
    turn = 2.0 * 10.0 ** theta[STEERING_RATE] / (STEP * STEP)
    jerk = 2.0 * 10.0 ** theta[JERK] / STEP**4
    q[:] = 0.0
    for k in range(1, STEPS + 1):
        row, at = stages[k], (k - 1) * SIZE
        c, s, w = row[_LC], row[_LS], 1.0 - row[_LK] * row[_D]
        lx, ly = row[_LX] - x0, row[_LY] - y0
        # Contouring error n (p - l), n = (-s, c); lag error t (p - l) - w (S - S'), t = (c, s).
        n = _put(costs, n, at + _X, at + _X, contouring * s * s + lag * c * c)
        n = _put(costs, n, at + _X, at + _Y, (lag - contouring) * c * s)
        n = _put(costs, n, at + _Y, at + _Y, contouring * c * c + lag * s * s)
        n = _put(costs, n, at + _X, at + _S, -lag * c * w)
        n = _put(costs, n, at + _Y, at + _S, -lag * s * w)
        n = _put(costs, n, at + _S, at + _S, lag * w * w)
        aside, ahead = c * ly - s * lx, c * lx + s * ly - w * row[_S]
        q[at + _X] += contouring * s * aside - lag * c * ahead
        q[at + _Y] += -contouring * c * aside - lag * s * ahead
        q[at + _S] += lag * w * ahead
        for slack, cost, square in (
            (_WALL, WALL_COST, WALL_SQUARE),
            (_OPP, OPPONENT_COST, OPPONENT_SQUARE),
            (_SLIP, GRIP_COST, GRIP_SQUARE),
        ):
            n = _put(costs, n, at + slack, at + slack, 2.0 * square)
            q[at + slack] = cost
        # Steering rate (DELTA_k - DELTA_k-1)^2.
        n = _put(costs, n, at + _DELTA, at + _DELTA, turn)
        if k == 1:
            q[at + _DELTA] -= turn * stages[0, _DELTA]
        else:
            n = _put(costs, n, at - SIZE + _DELTA, at - SIZE + _DELTA, turn)
            n = _put(costs, n, at - SIZE + _DELTA, at + _DELTA, -turn)
        # Rate of acceleration (V_k - 2 V_k-1 + V_k-2)^2, from the second step on.
        if k >= 2:
            n = _put(costs, n, at + _V, at + _V, jerk)
            n = _put(costs, n, at - SIZE + _V, at - SIZE + _V, 4.0 * jerk)
            n = _put(costs, n, at - SIZE + _V, at + _V, -2.0 * jerk)
            if k == 2:
                q[at + _V] += jerk * stages[0, _V]
                q[at - SIZE + _V] -= 2.0 * jerk * stages[0, _V]
            else:
                n = _put(costs, n, at - 2 * SIZE + _V, at - 2 * SIZE + _V, jerk)
                n = _put(costs, n, at - 2 * SIZE + _V, at + _V, jerk)
                n = _put(costs, n, at - 2 * SIZE + _V, at - SIZE + _V, -2.0 * jerk)
    q[VARIABLES - SIZE + _S] -= theta[PROGRESS]
    return n


@inner_kernel
def _fill_motion(k, stages, rows, n, b):
    """Write a step of position and heading, by the mean of both stages' directions."""
    before, row = stages[k - 1], stages[k]
    at, r, h = (k - 1) * SIZE, 5 * (k - 1), 0.5 * STEP
    length = h * (before[_V] + row[_V])
    course = 0.5 * (before[_PSI] + row[_PSI] + before[_BETA] + row[_BETA])
    s, c = sine_cosine(course)
    b[r], b[r + 1], b[r + 2] = length * s * course, -length * c * course, 0.0
    for i, own, along, across in (
        (0, _X, h * c, -0.5 * length * s),
        (1, _Y, h * s, 0.5 * length * c),
    ):
        n = _put(rows, n, r + i, at + own, 1.0)
        n = _put(rows, n, r + i, at + _V, -along)
        n = _put(rows, n, r + i, at + _PSI, -across)
        n = _put(rows, n, r + i, at + _BETA, -across)
        if k > 1:
            n = _put(rows, n, r + i, at - SIZE + own, -1.0)
            n = _put(rows, n, r + i, at - SIZE + _V, -along)
            n = _put(rows, n, r + i, at - SIZE + _PSI, -across)
            n = _put(rows, n, r + i, at - SIZE + _BETA, -across)
        else:  # positions count from the car
            b[r + i] += along * before[_V] + across * (before[_PSI] + before[_BETA])
    n = _put(rows, n, r + 2, at + _PSI, 1.0)
    n = _put(rows, n, r + 2, at + _R, -h)
    if k > 1:
        n = _put(rows, n, r + 2, at - SIZE + _PSI, -1.0)
        n = _put(rows, n, r + 2, at - SIZE + _R, -h)
    else:
        b[r + 2] = before[_PSI] + h * before[_R]
    return n


@inner_kernel
def _fill_tyres(car, k, stages, rows, n, b):
    """Write a step of yaw rate and slip angle, at the speed of the linearisation."""
    before, row = stages[k - 1], stages[k]
    at, r, h = (k - 1) * SIZE, 5 * (k - 1) + 3, 0.5 * STEP
    v = max(0.5 * (before[_V] + row[_V]), SLOW)
    a = min(max((row[_V] - before[_V]) / STEP, -BRAKING), ACCELERATION)
    base, yaw = car.lf + car.lr, 1.0 / (YAW_INERTIA * car.lf * car.lr)
    front = car.front * max(car.lr - a * car.shift, 0.0) / base
    rear = car.rear * max(car.lf + a * car.shift, 0.0) / base
    # Rates of yaw rate and slip angle by yaw rate, slip angle and steering angle.
    for i, own, by_r, by_beta, by_delta in (
        (
            0,
            _R,
            -yaw * (car.lf * car.lf * front + car.lr * car.lr * rear) / v,
            yaw * (car.lr * rear - car.lf * front),
            yaw * car.lf * front,
        ),
        (
            1,
            _BETA,
            (car.lr * rear - car.lf * front) / (v * v) - 1.0,
            -(front + rear) / v,
            front / v,
        ),
    ):
        b[r + i] = 0.0
        for j, by in ((_R, by_r), (_BETA, by_beta), (_DELTA, by_delta)):
            one = 1.0 if j == own else 0.0
            n = _put(rows, n, r + i, at + j, one - h * by)
            if k > 1:
                n = _put(rows, n, r + i, at - SIZE + j, -one - h * by)
            else:
                b[r + i] += (one + h * by) * before[j]
    return n


@inner_kernel
def _beside(theta, view, way, gap, k, row):
    """Return direction and limit (m) of the opponent's half-plane, from the race line's point.

    ``gap`` is the present distance to the opponent, m. A direction of 0 leaves the stage free.
    """
    if way == BEHIND:
        wanted = theta[TRAILING_GAP]
        # A car that is too near falls back within the plan.
        wanted = min(wanted, gap + (wanted - gap) * k / STEPS)
        return row[_LC], row[_LS], row[_OPP_S] - wanted - row[_S]
    place = _place_length(view)
    meets = row[_FREE_S] > row[_OPP_S] - place and row[_S] < row[_OPP_S] + place
    if way == FREE or not meets:
        return 0.0, 0.0, 1.0
    side = 1.0 if way == LEFT else -1.0
    air = side * (view[_view.OWN_D] - view[_view.OPP_D])
    keep = 0.5 * (view[_view.OWN_WIDTH] + view[_view.OPP_WIDTH]) + theta[OPPONENT_MARGIN]
    keep = min(keep, max(air, 0.0) + SIDEWAYS * STEP * k)
    return side * row[_LS], -side * row[_LC], -side * view[_view.OPP_D] - keep


@inner_kernel
def _fill_limits(theta, view, way, stages, rows, n, b):
    """Write all inequalities, after the ``n`` entries of the model."""
    x0, y0 = stages[0, _X], stages[0, _Y]
    scale = _line.speed_scale(view, theta[_PACE])
    grip, most = within_grip(view, GRIP * max(scale * scale, 1.0)), view[_view.STEER_MAX]
    for k in range(1, STEPS + 1):
        row, at, r = stages[k], (k - 1) * SIZE, EQUALITIES + 16 * (k - 1)
        for i, own, rise, fall in (
            (0, _V, STEP * ACCELERATION, STEP * BRAKING),
            (2, _DELTA, STEP * STEERING, STEP * STEERING),
        ):
            fixed = stages[0, own] if k == 1 else 0.0
            n = _put(rows, n, r + i, at + own, 1.0)
            n = _put(rows, n, r + i + 1, at + own, -1.0)
            if k > 1:
                n = _put(rows, n, r + i, at - SIZE + own, -1.0)
                n = _put(rows, n, r + i + 1, at - SIZE + own, 1.0)
            b[r + i], b[r + i + 1] = rise + fixed, fall - fixed
        for i, own, high, low in ((4, _V, row[_MAX_V], 0.0), (6, _DELTA, most, most)):
            n = _put(rows, n, r + i, at + own, 1.0)
            n = _put(rows, n, r + i + 1, at + own, -1.0)
            b[r + i], b[r + i + 1] = high, low
        # Lateral acceleration V R.
        for i, sign in ((8, 1.0), (9, -1.0)):
            n = _put(rows, n, r + i, at + _R, sign * row[_V])
            n = _put(rows, n, r + i, at + _V, sign * row[_R])
            n = _put(rows, n, r + i, at + _SLIP, -1.0)
            b[r + i] = grip + sign * row[_V] * row[_R]
        # Walls.
        c, s = row[_LC], row[_LS]
        lx, ly = row[_LX] - x0, row[_LY] - y0
        for i, sign, free in ((10, 1.0, row[_FREE_LEFT]), (11, -1.0, row[_FREE_RIGHT])):
            n = _put(rows, n, r + i, at + _X, -sign * s)
            n = _put(rows, n, r + i, at + _Y, sign * c)
            n = _put(rows, n, r + i, at + _WALL, -1.0)
            b[r + i] = free + sign * (c * ly - s * lx)
        # Opponent.
        gx, gy, limit = _beside(theta, view, way, stages[0, _OPP_S], k, row)
        n = _put(rows, n, r + 12, at + _X, gx)
        n = _put(rows, n, r + 12, at + _Y, gy)
        n = _put(rows, n, r + 12, at + _OPP, -1.0)
        b[r + 12] = limit + gx * lx + gy * ly
        for i in range(3):
            n = _put(rows, n, r + 13 + i, at + _WALL + i, -1.0)
            b[r + 13 + i] = 0.0
    return n


@kernel
def fill(theta, view, way, stages, costs, rows, q, b):
    """Write the quadratic program of a way past the opponent; return the numbers of entries."""
    car, n = _model(view), 0
    for k in range(1, STEPS + 1):
        n = _fill_motion(k, stages, rows, n, b)
        n = _fill_tyres(car, k, stages, rows, n, b)
    return _fill_cost(theta, stages, costs, q), _fill_limits(theta, view, way, stages, rows, n, b)


@kernel
def gather(entries, places, values):
    """Add a matrix's entries to its stored values."""
    values[:] = 0.0
    for i in range(places.shape[0]):
        values[places[i]] += entries[2, i]


@kernel
def keep(view, way, stages, solution, solved, memory):
    """Save a plan: the solution, or the stages to linearise around where no solution was found."""
    memory[_TIME], memory[_WAY] = view[_view.TIME] + 1.0, way
    for k in range(STEPS + 1):
        for i in range(_KEPT):
            value = stages[k, i]
            if solved and k > 0:
                origin = stages[0, i] if i <= _Y else 0.0
                value = origin + solution[(k - 1) * SIZE + i]
            memory[_STAGES + k * _KEPT + i] = value


@inner_kernel
def _planned(memory, time, which):
    """Return a variable of the plan at a time since the plan, s."""
    u = min(max(time / STEP, 0.0), STEPS - 1e-6)
    k = int(u)
    at = _STAGES + k * _KEPT + which
    return memory[at] + (u - k) * (memory[at + _KEPT] - memory[at])


@kernel
def control(view, memory, command):
    """Follow the plan: its steering angle, corrected by pure pursuit of its path, and its speed.

    The car's speed approaches a command by the difference in 0.1 s.
    """
    age = view[_view.TIME] + 1.0 - memory[_TIME]
    v = view[_view.OWN_V]
    turned = angle_between(view[_view.OWN_PSI], _planned(memory, age, _PSI))
    s, c = sine_cosine(view[_view.OWN_PSI] + view[_view.OWN_BETA])
    x, y = (
        _planned(memory, age, _X) - view[_view.OWN_X],
        _planned(memory, age, _Y) - view[_view.OWN_Y],
    )
    reach = 0.3 + 0.1 * v
    aside = c * y - s * x - reach * turned
    steer = _planned(memory, age + 0.02, _DELTA)
    steer += view[_view.WHEELBASE] * 2.0 * aside / (reach * reach)
    if memory[_SENT] != 0.0:
        memory[_ERROR] += LEARN * (view[_view.OWN_DELTA] - memory[_SENT] - memory[_ERROR])
    steer -= memory[_ERROR]
    command[0] = min(max(steer, -view[_view.STEER_MAX]), view[_view.STEER_MAX])
    memory[_SENT] = command[0]
    a = (_planned(memory, age + STEP, _V) - _planned(memory, age, _V)) / STEP
    command[1] = max(v + 0.1 * min(max(a, -BRAKING), ACCELERATION), 0.0)


class _Pattern(NamedTuple):
    """Places of a sparse matrix's entries."""

    places: NDArray[np.int64]  #: Index of each entry in the stored values.
    indices: NDArray[np.int64]  #: Row of each stored value.
    starts: NDArray[np.int64]  #: First stored value of each column.


def _pattern(entries: NDArray[np.float64], rows: int) -> _Pattern:
    key = entries[1].astype(np.int64) * rows + entries[0].astype(np.int64)
    stored, places = np.unique(key, return_inverse=True)
    starts = np.searchsorted(stored, np.arange(VARIABLES + 1) * rows)
    return _Pattern(places, stored % rows, starts)


_MAX_ENTRIES = 64 * STEPS


@cache
def _patterns() -> tuple[_Pattern, _Pattern]:
    """Return the patterns of the cost's and of the constraints' matrix; all programs share them."""
    rows = EQUALITIES + INEQUALITIES
    costs, limits = np.zeros((2, 3, _MAX_ENTRIES))
    theta, view, stages = (
        np.ones(len(PARAMETERS)),
        np.ones(_view.VIEW_SIZE),
        np.zeros((STEPS + 1, COLUMNS)),
    )
    n, m = fill(theta, view, FREE, stages, costs, limits, np.zeros(VARIABLES), np.zeros(rows))
    return _pattern(costs[:, :n], VARIABLES), _pattern(limits[:, :m], rows)


@cache
def _settings() -> Any:
    import clarabel

    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_threads = 1
    settings.direct_solve_method = "qdldl"  # SSE2 at most on every processor
    settings.max_iter = 50
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-6
    return settings


def _solve(
    theta: NDArray[np.float64], view: NDArray[np.float64], way: int, stages: NDArray[np.float64]
) -> tuple[float, NDArray[np.float64]]:
    """Return cost and solution of a way past the opponent; an infinite cost without a solution."""
    import clarabel
    from scipy.sparse import csc_matrix

    of_cost, of_limits = _patterns()
    costs, limits = np.empty((2, 3, _MAX_ENTRIES))
    q, b = np.empty(VARIABLES), np.empty(EQUALITIES + INEQUALITIES)
    fill(theta, view, way, stages, costs, limits, q, b)
    p, a = np.empty(len(of_cost.indices)), np.empty(len(of_limits.indices))
    gather(costs, of_cost.places, p)
    gather(limits, of_limits.places, a)
    solution = clarabel.DefaultSolver(
        csc_matrix((p, of_cost.indices, of_cost.starts), (VARIABLES, VARIABLES)),
        q,
        csc_matrix((a, of_limits.indices, of_limits.starts), (len(b), VARIABLES)),
        b,
        [clarabel.ZeroConeT(EQUALITIES), clarabel.NonnegativeConeT(INEQUALITIES)],
        _settings(),
    ).solve()
    solved = solution.status in (clarabel.SolverStatus.Solved, clarabel.SolverStatus.AlmostSolved)
    return solution.obj_val if solved else np.inf, np.asarray(solution.x)


def _plan(
    track: Track,
    theta: NDArray[np.float64],
    view: NDArray[np.float64],
    memory: NDArray[np.float64],
) -> bool:
    """Save a new plan in the memory; return whether it continues the last one."""
    stages = np.zeros((STEPS + 1, COLUMNS))
    with first_call(fill, "the planner mpcc", 10):
        goes_on = prepare(track.arrays, theta, view, memory, stages)
        _patterns()
    best = np.inf, np.zeros(VARIABLES), FREE
    for way in (FREE, LEFT, RIGHT, BEHIND):
        if may_pass(track.arrays, view, way):
            cost, solution = _solve(theta, view, way, stages)
            cost += STICK * (way != memory[_WAY])
            best = min(best, (cost, solution, way), key=lambda found: found[0])
    cost, solution, way = best
    keep(view, way, stages, solution, cost < np.inf, memory)
    return bool(goes_on)


def drive(
    track: Track,
    theta: NDArray[np.float64],
    view: NDArray[np.float64],
    memory: NDArray[np.float64],
) -> tuple[float, float]:
    """Plan ten times a second, and follow the plan."""
    due = int(100.0 * view[_view.TIME] + 0.5) % PLAN_EVERY == 0
    if memory[_TIME] == 0.0:
        require("clarabel")
    # A first plan is linearised around the race line: a second program corrects it.
    if (due or memory[_TIME] == 0.0) and not _plan(track, theta, view, memory):
        _plan(track, theta, view, memory)
    command = np.empty(2)
    control(view, memory, command)
    return float(command[0]), float(command[1])


VARIANTS = {
    "close": {"opponent_margin": 0.05, "trailing_gap": 0.75},
    "smooth": {"steering_rate": 0.0, "contouring": 1.0},
}
MPCC = Planner(
    name="mpcc",
    parameters=PARAMETERS,
    drive=drive,
    memory_size=MEMORY,
    variants=VARIANTS,
    sight=SIGHT,
)
"""Model predictive contouring control."""
