"""The opponent's planner of the overtaking protocol [1]_: a lattice along its own scaled line.

Ten times a second it compares `GOALS` places across half of the track, each at `SPEEDS` shares of
the line's speed. The cost of a candidate consists of its distance from the line, its lack of speed,
and curvature times speed. A candidate is rejected if it leads into a wall or the other car, or if
its time to collision with a car ahead is below `MIN_TTC`.

Difference from [1]_: this package's pursuit follows the chosen lane, with smaller deviations.

References
----------
.. [1] End2Race, arXiv:2509.16894.
"""

import numpy as np

from pcs_racing.base.compilation import inner_kernel, kernel
from pcs_racing.planners import line as _line, view as _view
from pcs_racing.planners.line import gap_ahead, line_index
from pcs_racing.planners.planner import Parameter, Planner
from pcs_racing.planners.view import PATH_POINTS
from pcs_racing.track import frenet as _frenet
from pcs_racing.track.frenet import wrap_s

GOALS, SPEEDS = 15, 19
SLOWEST = 0.1  # min share of the line's speed; the max is 1
LINE, SPEED, BEND = 1.0, 1.0, 0.02  # costs: m from the line, lost share of speed, m/s times 1/m
MIN_TTC = 2.0  # s
CHECKS, CHECK_STEP = 8, 0.2  # number and spacing (s) of the checks against the other car
NEAR = 12.0  # m: range of the checks against the other car
WALL_AIR, CAR_AIR = 0.05, 0.1  # m: margins to walls and to the other car
NO_LIMIT = 3.0  # speed scale, so large that only the line's speeds limit

# Parameters: speed factor, number of line samples, their distances from the race line and speeds.
FACTOR, SAMPLES, FIRST = 0, 1, 2


@inner_kernel
def _sample(track, theta, s, column):
    """Return the own line's distance from the race line (column 0, m) or speed (1, m/s) at s."""
    number = int(theta[SAMPLES])
    u = wrap_s(track, s) / track.length * number
    k = int(u)
    first = FIRST + column * number
    here, after = theta[first + k % number], theta[first + (k + 1) % number]
    return here + (u - k) * (after - here)


@inner_kernel
def _clear(view, gap, v, d, reach):
    """Return whether a candidate avoids the other car, assumed to hold its speed and place."""
    long = 0.5 * (view[_view.OWN_LENGTH] + view[_view.OPP_LENGTH]) + CAR_AIR
    wide = 0.5 * (view[_view.OWN_WIDTH] + view[_view.OPP_WIDTH]) + CAR_AIR
    closing = v - view[_view.OPP_V]
    if (
        gap > 0.0
        and abs(view[_view.OPP_D] - d) < wide
        and closing > 0.0
        and gap - long < MIN_TTC * closing
    ):
        return False
    for k in range(1, CHECKS + 1):
        t = CHECK_STEP * k
        share = min(v * t / reach, 1.0)
        across = view[_view.OWN_D] + share * share * (3.0 - 2.0 * share) * (d - view[_view.OWN_D])
        if abs(gap - closing * t) < long and abs(view[_view.OPP_D] - across) < wide:
            return False
    return True


@kernel
def plan(track, theta, view, memory, scratch, path):
    """Choose a place across the track and a share of the speed, and follow the shifted line."""
    s0, gap, step = view[_view.OWN_S], gap_ahead(track, view), _line.lane_step(view)
    reach = (PATH_POINTS - 1) * step
    ends = track.line[line_index(track, s0 + reach)]
    quarter = 0.25 * (ends[_frenet.LEFT] + ends[_frenet.RIGHT])
    keep = 0.5 * view[_view.OWN_WIDTH] + WALL_AIR
    line_d, full = (
        _sample(track, theta, s0 + reach, 0),
        theta[FACTOR] * _sample(track, theta, s0 + reach, 1),
    )
    aside, share, best = 0.0, SLOWEST, np.inf
    for g in range(GOALS):
        goal = (2.0 * g / (GOALS - 1) - 1.0) * quarter
        d = line_d + goal
        if goal != 0.0 and (d > ends[_frenet.LEFT] - keep or -d > ends[_frenet.RIGHT] - keep):
            continue
        bend = abs(ends[_frenet.KAPPA] + 6.0 * (d - view[_view.OWN_D]) / (reach * reach))
        for f in range(SPEEDS):
            part = SLOWEST + (1.0 - SLOWEST) * f / (SPEEDS - 1)
            cost = LINE * abs(goal) + SPEED * (1.0 - part) + BEND * bend * part * full
            if cost < best and (abs(gap) > NEAR or _clear(view, gap, part * full, d, reach)):
                aside, share, best = goal, part, cost
    for j in range(_line.LANE_POINTS):
        scratch[j] = _sample(track, theta, s0 + j * step, 0) + aside
    _line.hold_off(track, view, keep, scratch)
    _line.ease_onto(track, view, NO_LIMIT, np.inf, scratch, path)
    for j in range(PATH_POINTS):
        path[j, _view.PATH_SPEED] = share * theta[FACTOR] * _sample(track, theta, s0 + j * step, 1)


def overtaken(samples: int) -> Planner:
    """Return the planner for lines of a number of samples, evenly spaced along the race line."""
    numbers = [
        Parameter(f"d{i}", -10.0, 10.0, 0.0, "distance from the race line, m")
        for i in range(samples)
    ]
    speeds = [Parameter(f"v{i}", 0.0, 30.0, 1.0, "speed, m/s") for i in range(samples)]
    factor = Parameter("factor", 0.0, 1.0, 0.5, "factor of the line's speeds")
    count = Parameter("samples", 1.0, 1e6, float(samples), "samples of the line")
    return Planner(
        "overtaken", (factor, count, *numbers, *speeds), plan=plan, scratch_size=_line.LANE_SIZE
    )
