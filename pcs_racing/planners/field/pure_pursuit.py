"""Pure pursuit of the race line: the simplest planner, and the baseline of the others.

Its path eases from the car back onto the race line, at the speed of the profile; the default
``control`` drives along it by pure pursuit [1]_. Direct pursuit of the line fails: a look-ahead
short enough not to cut corners makes a fast car weave. The planner does not overtake: it follows an
opponent ahead. Next to an opponent that is nearer to the line, it keeps its position across the
track until the opponent has gone by.

References
----------
.. [1] R. C. Coulter, "Implementation of the pure pursuit path tracking algorithm", CMU-RI-TR-92-01,
   1992.
"""

import numpy as np

from pcs_racing.base.compilation import compiled
from pcs_racing.base.elementary import tangent
from pcs_racing.planners import view as _view
from pcs_racing.planners.line import (
    FOLLOW_GAIN,
    IN_THE_WAY,
    WALL_MARGIN,
    gap_ahead,
    gives_way,
    line_index,
    side_air,
    within_walls,
)
from pcs_racing.planners.planner import Parameter, Planner
from pcs_racing.planners.pursuit import write_point
from pcs_racing.track import frenet as _frenet

PARAMETERS = (
    Parameter(
        "pace",
        0.0,
        1.5,
        0.2,
        "speed scale between the slowest (0) and fastest (1) of the race's speed range",
    ),
    Parameter(
        "lookahead",
        1.0,
        3.0,
        1.5,
        "length of the path's return to the race line at standstill, m",
    ),
    Parameter("lookahead_time", 0.1, 0.5, 0.2, "growth of that length with the speed, s"),
    Parameter(
        "follow_distance", 0.0, 4.0, 1.2, "distance to keep behind the opponent, m; 0 ignores it"
    ),
)
PACE, LOOKAHEAD, LOOKAHEAD_TIME, FOLLOW_DISTANCE = range(len(PARAMETERS))


@compiled
def plan(track, theta, view, memory, scratch, path):
    """Write a path back to the race line: a cubic that starts along the car's course."""
    s0 = view[_view.OWN_S]
    d0 = view[_view.OWN_D]
    course = view[_view.OWN_PSI] + view[_view.OWN_BETA]
    length = theta[LOOKAHEAD] + theta[LOOKAHEAD_TIME] * view[_view.OWN_V]
    line_psi = track.line[line_index(track, s0), _frenet.PSI]
    rise = length * tangent(min(max(_frenet.angle_between(course, line_psi), -1.0), 1.0))
    scale = view[_view.SPEED_LOW] + theta[PACE] * (view[_view.SPEED_HIGH] - view[_view.SPEED_LOW])
    d1 = 0.0
    most = np.inf
    if theta[FOLLOW_DISTANCE] > 0.0:
        gap = gap_ahead(track, view)
        waits = gives_way(view, gap)
        if waits:
            d1 = within_walls(track, s0 + length, d0, WALL_MARGIN)
        if waits or (gap > 0.0 and side_air(view) < IN_THE_WAY):
            most = max(view[_view.OPP_V] + FOLLOW_GAIN * (gap - theta[FOLLOW_DISTANCE]), 0.0)
    for j in range(_view.PATH_POINTS):
        u = j / (_view.PATH_POINTS - 1)
        q = 1.0 - u
        s = s0 + u * length
        d = d1 + q * q * ((1.0 + 2.0 * u) * (d0 - d1) + u * rise)
        d_bend = ((12.0 * u - 6.0) * (d0 - d1) + (6.0 * u - 4.0) * rise) / (length * length)
        line = track.line[line_index(track, s)]
        x, y, _ = _frenet.to_cartesian(track, s, d)
        kappa = line[_frenet.KAPPA] / max(1.0 - line[_frenet.KAPPA] * d, 0.25) + d_bend
        write_point(path, j, x, y, min(scale * line[_frenet.SPEED], most), kappa)


PURE_PURSUIT = Planner(name="pure-pursuit", parameters=PARAMETERS, plan=plan)
"""Pure pursuit of the race line alone."""
