"""Iterated best response [1]_, [2]_: both cars improve their plans alternately, without contact.

A plan is a position on the track for each of the next `STEPS` steps. The best response to the other
car's plan goes as far along the track as the speed profile allows, and to one side of the other car
where both would be level. Between passing and staying behind, the car takes the option that brings
it farther ahead. Across the track the plan is the minimum of a quadratic cost: acceleration,
distance from the race line, and missing clearance to the other car and the walls. The opponent is
assumed to plan in the same way, with its own share of the profile. The own plan is computed last.

The sensitivity term of [1]_ adds the push on the opponent by its constraint: a step where the
opponent has to give way pulls the own plan in front of it, with the multiplier of that constraint.
So a car defends.

Differences: the quadratic cost has penalties in place of constraints, and the multipliers are
multipliers of the penalties; plans are expressed along the race line, where the track is a
corridor.

References
----------
.. [1] R. Spica, E. Cristofalo, Z. Wang, E. Montijano and M. Schwager, "A real-time game theoretic
   planner for autonomous two-player drone racing", IEEE Transactions on Robotics, 2020,
   arXiv:1801.02302.
.. [2] M. Wang, Z. Wang, J. Talbot, J. C. Gerdes and M. Schwager, "Game-theoretic planning for
   self-driving cars in multivehicle competitive scenarios", IEEE Transactions on Robotics, 2021.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.compilation import inner_kernel, kernel
from pcs_racing.planners import line as _line, view as _view
from pcs_racing.planners.planner import Parameter, Planner, offsets
from pcs_racing.track import frenet as _frenet

PARAMETERS = (
    _line.PACE,
    Parameter("rounds", 1.0, 8.0, 3.0, "number of improvements of both cars' plans"),
    Parameter("sensitivity", 0.0, 2.0, 0.3, "weight of the push by the opponent's constraint"),
    Parameter(
        "line_weight", 0.02, 5.0, 0.3, "cost of a squared distance from the race line, 1/m^2"
    ),
    Parameter(
        "acceleration_weight",
        0.0005,
        0.1,
        0.005,
        "cost of a squared acceleration across the track, s^4/m^2",
    ),
    Parameter(
        "side_weight",
        0.1,
        5.0,
        0.5,
        "cost of a metre of mean distance from the line, m of progress",
    ),
    Parameter("wall_air", 0.05, 0.5, 0.15, "clearance to walls, m"),
    Parameter("opponent_air", 0.05, 0.6, 0.25, "clearance to the opponent, m"),
    Parameter(
        "follow_gap",
        0.7,
        3.0,
        1.1,
        "distance between the cars' middles to keep behind the opponent, m",
    ),
)
_PACE, ROUNDS, SENSITIVITY, LINE, ACCELERATION, SIDE, WALL_AIR, OPPONENT_AIR, FOLLOW = range(
    len(PARAMETERS)
)

STEPS, STEP = 15, 0.2  # number, length in s
STEEP = 20.0  # cost per squared metre of missing clearance to the other car or a wall
PASSES = 3  # iterations over the penalties of one response
MAX_ACCELERATION, MAX_BRAKING = 6.0, 4.5  # m/s^2 along the track
SIGHT = 25.0  # max distance of a considered opponent, m
IMPOSSIBLE = 1e3


# Memory: the last plan as a lane, and its passing side.
_, _PASSED, MEMORY = offsets(_line.KEPT_LANE, 1)
# Scratch: plans of both cars (arc length from the own car on, distance from the line, multiplier);
# a response under study; widths to both sides, the band matrix and its right side; the lane.
_PLAN = 3 * STEPS
_, _TRIAL, _RIGHT, _LEFT, _MAIN, _NEXT, _AFTER, _SIDE_OF, _LANE, SCRATCH = offsets(
    2 * _PLAN, _PLAN, *6 * [STEPS], _line.LANE_SIZE
)


class _Plans(NamedTuple):
    """A plan, and all that it responds to."""

    plan: NDArray[np.float64]  #: Plan to write or replace.
    other: NDArray[np.float64]  #: Plan of the other car.
    pull: NDArray[np.float64]  #: Multipliers that draw the plan towards the other car, 1/m.
    reach: float  #: Distance along the track below which the cars are level, m.
    clear: float  #: Distance across to keep, m.


@inner_kernel
def _go(track, s_from, car, plan, other, blocked, keep_back):
    """Write the arc lengths of a plan: as fast as the profile allows, and behind a blocking car.

    Returns the last arc length.
    """
    s, v = car.s, car.v
    for k in range(STEPS):
        profile = car.scale * track.line[_line.line_index(track, s_from + s), _frenet.SPEED]
        slowest = max(v - STEP * MAX_BRAKING, 0.0)
        v = max(min(v + STEP * MAX_ACCELERATION, profile), slowest)
        if blocked:
            # Stay behind at this step, and able to follow the other car's braking.
            v = max(min(v, (other[k] - keep_back - s) / STEP), slowest)
        s += STEP * v
        plan[k] = s
    return s


@inner_kernel
def _solve(main, following, after, right):
    """Solve a symmetric system with two bands next to the diagonal in place, by LDL' factors."""
    n = STEPS
    for k in range(n):
        if k > 0:
            main[k] -= following[k - 1] * following[k - 1] * main[k - 1]
        if k > 1:
            main[k] -= after[k - 2] * after[k - 2] * main[k - 2]
        if k < n - 1:
            if k > 0:
                following[k] -= following[k - 1] * after[k - 1] * main[k - 1]
            following[k] /= main[k]
        if k < n - 2:
            after[k] /= main[k]
        right[k] -= (following[k - 1] * right[k - 1] if k > 0 else 0.0) + (
            after[k - 2] * right[k - 2] if k > 1 else 0.0
        )
    for k in range(n):
        right[k] /= main[k]
    for k in range(n - 2, -1, -1):
        right[k] -= following[k] * right[k + 1] + (after[k] * right[k + 2] if k < n - 2 else 0.0)


@inner_kernel
def _across(theta, car, side, plans, scratch):
    """Write distances from the line and multipliers of a plan.

    The plan passes the other car on ``side`` (0: no pass). Returns the max missing clearance to the
    other car or a wall, m.
    """
    d, reach, clear = car.d, plans.reach, plans.clear
    plan, other = plans.plan, plans.other
    main, following, after = scratch[_MAIN:_NEXT], scratch[_NEXT:_AFTER], scratch[_AFTER:_SIDE_OF]
    out = plan[STEPS : 2 * STEPS]
    multiplier = plan[2 * STEPS : 3 * STEPS]
    bend = theta[ACCELERATION] / (STEP * STEP * STEP * STEP)
    out[:], multiplier[:] = d, 0.0
    missing = 0.0
    for turn in range(PASSES):
        previous = d - STEP * car.rate
        for k in range(STEPS):
            was = out[k]
            # Squares of d[k] - 2 d[k - 1] + d[k - 2], with the two positions before the plan given.
            main[k] = theta[LINE] + bend * (
                6.0 if k < STEPS - 2 else 5.0 if k == STEPS - 2 else 1.0
            )
            following[k] = bend * (-4.0 if k < STEPS - 2 else -2.0)
            after[k] = bend
            right = 0.0
            if k == 0:
                right = bend * (4.0 * d - previous)
            elif k == 1:
                right = -bend * d
            level = abs(plan[k] - other[k]) < reach
            if level and side != 0.0:
                wanted = other[STEPS + k] + side * clear
                if turn == 0 or side * (wanted - was) > 0.0:
                    main[k] += STEEP
                    right += STEEP * wanted
            inside = min(max(was, -scratch[_RIGHT + k]), scratch[_LEFT + k])
            if turn > 0 and was != inside:
                main[k] += 2.0 * STEEP
                right += 2.0 * STEEP * inside
            right += plans.pull[k] * min(max(other[STEPS + k] - was, -0.5), 0.5)
            multiplier[k] = right
        for k in range(STEPS):
            out[k] = multiplier[k]
        _solve(main, following, after, out)
    for k in range(STEPS):
        lack = 0.0
        if abs(plan[k] - other[k]) < reach:
            lack = max(clear - abs(out[k] - other[STEPS + k]), 0.0)
            missing = max(
                missing,
                max(clear - side * (out[k] - other[STEPS + k]), 0.0) if side != 0.0 else lack,
            )
        multiplier[k] = 2.0 * STEEP * lack
        missing = max(missing, max(out[k] - scratch[_LEFT + k], -scratch[_RIGHT + k] - out[k], 0.0))
    return missing


@inner_kernel
def _reply(track, theta, view, car, last, plans, scratch):
    """Replace a plan by the best response to the other plan; return its passing side."""
    plan, other, pull, reach, clear = plans
    s0 = view[_view.OWN_S]
    trial = scratch[_TRIAL : _TRIAL + _PLAN]
    keep = 0.5 * view[_view.OWN_WIDTH] + theta[WALL_AIR]
    nothing = scratch[_SIDE_OF : _SIDE_OF + STEPS]
    chosen, best = 0.0, -np.inf
    for way in (1.0, -1.0, 0.0):
        side, blocked = way, way == 0.0
        end = _go(track, s0, car, trial, other, blocked, theta[FOLLOW])
        meets = False
        for k in range(STEPS):
            sample = track.line[_line.line_index(track, s0 + trial[k])]
            # The race line itself is always allowed, however near a wall.
            scratch[_RIGHT + k] = max(sample[_frenet.RIGHT] - keep, 0.0)
            scratch[_LEFT + k] = max(sample[_frenet.LEFT] - keep, 0.0)
            meets = meets or abs(trial[k] - other[k]) < reach
        if blocked and not meets:
            pull = nothing
        tried = _Plans(trial, other, pull, reach, clear)
        missing = _across(theta, car, side, tried, scratch)
        aside = 0.0
        for k in range(STEPS):
            aside += abs(trial[STEPS + k]) / STEPS
        value = (
            end
            - theta[SIDE] * aside
            - (20.0 * missing if not blocked else 0.0)
            + (0.3 if side == last else 0.0)
        )
        if not blocked and (missing > 0.12 and meets):
            value -= IMPOSSIBLE
        if not meets and not blocked:
            # No car is met: the line is free.
            _across(theta, car, 0.0, tried, scratch)
            side, value = 0.0, IMPOSSIBLE
        if value > best:
            best, chosen = value, side
            for k in range(_PLAN):
                plan[k] = trial[k]
        if value == IMPOSSIBLE:
            break
    return chosen


@kernel
def plan(track, theta, view, memory, scratch, path):
    """Improve both plans alternately, and drive the own plan."""
    s0 = view[_view.OWN_S]
    scale = _line.speed_scale(view, theta[_PACE])
    gap = _line.gap_ahead(track, view)
    own, opponent = scratch[:_PLAN], scratch[_PLAN:_TRIAL]
    lane = scratch[_LANE:SCRATCH]
    car, other = _line.both_cars(track, view, memory, scale)
    far = not -SIGHT < gap < SIGHT
    # The opponent's first plan keeps its position across the track.
    _go(track, s0, other, opponent, own, False, 0.0)
    for k in range(STEPS):
        opponent[k] += 1e6 if far else 0.0
        opponent[STEPS + k] = view[_view.OPP_D]
        opponent[2 * STEPS + k] = own[2 * STEPS + k] = scratch[_SIDE_OF + k] = 0.0
    pull, none = opponent[2 * STEPS :], scratch[_SIDE_OF : _SIDE_OF + STEPS]
    reach = 0.5 * (view[_view.OWN_LENGTH] + view[_view.OPP_LENGTH]) + 0.3
    clear = 0.5 * (view[_view.OWN_WIDTH] + view[_view.OPP_WIDTH]) + theta[OPPONENT_AIR]
    own_plans = _Plans(own, opponent, pull, reach, clear)
    other_plans = _Plans(opponent, own, none, reach, clear)
    side = memory[_PASSED]
    for turn in range(int(theta[ROUNDS])):
        if turn > 0 and not far:
            _reply(track, theta, view, other, 0.0, other_plans, scratch)
            for k in range(STEPS):
                # Only a car behind is blocked.
                pull[k] = theta[SENSITIVITY] * pull[k] if gap < 0.0 else 0.0
        side = _reply(track, theta, view, car, memory[_PASSED], own_plans, scratch)
    memory[_PASSED] = side
    along, across = own[:STEPS], own[STEPS : 2 * STEPS]
    _line.follow_plan(track, view, car.d, along, across, scale, np.inf, lane, memory, path)
    _line.hold_back(track, view, scale, along, STEP, path)


BEST_RESPONSE = Planner(
    name="iterated-best-response",
    parameters=PARAMETERS,
    plan=plan,
    memory_size=MEMORY,
    scratch_size=SCRATCH,
    variants={"plain": {"sensitivity": 0.0}, "defends": {"sensitivity": 1.0}},
)
"""Iterated best response of two cars."""
