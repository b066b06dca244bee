"""Pure pursuit of the race line: the plainest driver, and the yardstick for the others.

Its path eases from the car back onto the race line, at the speed of the profile; the default ``control`` drives along
it by pure pursuit [1]_. Pursuing the line itself would not do: a look-ahead that is short enough not to cut corners
makes a fast car weave. It does not overtake: it follows an opponent ahead, and keeps its place until one beside it
that is nearer to the line has gone by.

References
----------
.. [1] R. C. Coulter, "Implementation of the pure pursuit path tracking algorithm", CMU-RI-TR-92-01, 1992.
"""

import numpy as np

from pcs_racing.base.compilation import compiled
from pcs_racing.base.elementary import tangent
from pcs_racing.planners import view as _view
from pcs_racing.planners.planner import Parameter, Planner
from pcs_racing.planners.view import PATH_POINTS
from pcs_racing.track import frenet as _frenet
from pcs_racing.track.frenet import angle_between, to_cartesian, wrap_s

PARAMETERS = (
    Parameter("pace", 0.0, 1.0, 0.2, "speed scale between the slowest (0) and fastest (1) of the race's speed range"),
    Parameter("lookahead", 1.0, 3.0, 1.5, "distance in which the path returns to the race line at standstill, m"),
    Parameter("lookahead_time", 0.1, 0.5, 0.2, "how that distance grows with the speed, s"),
    Parameter("follow_distance", 0.0, 4.0, 1.2, "distance to keep behind the opponent, m; 0 ignores it"),
)
PACE, LOOKAHEAD, LOOKAHEAD_TIME, FOLLOW_DISTANCE = range(len(PARAMETERS))

FOLLOW_GAIN = 1.2  # 1/s, closing speed per metre beyond the follow distance
IN_THE_WAY = 0.1  # m of air beside the opponent below which it is followed
WALL_MARGIN = 0.38  # m from the car's middle to the wall when it keeps its place beside an opponent


@compiled(forceinline=True)
def line_index(track, s):  # type: ignore[no-untyped-def]
    """Index of the last sample of the race line at or before an arc length (any real number)."""
    return int(wrap_s(track, s) / track.ds) % track.line.shape[0]


@compiled(forceinline=True)
def gap_ahead(track, view):  # type: ignore[no-untyped-def]
    """How far ahead the opponent is along the track, whatever the laps between, in [-length / 2, length / 2), m."""
    gap = view[_view.GAP]
    return gap - np.floor(gap / track.length + 0.5) * track.length


@compiled(forceinline=True)
def side_air(view):  # type: ignore[no-untyped-def]
    """Air between the two cars across the track in m; negative when one would hit the other from behind."""
    return abs(view[_view.OPP_D] - view[_view.OWN_D]) - 0.5 * (view[_view.OWN_WIDTH] + view[_view.OPP_WIDTH])


@compiled(forceinline=True)
def gives_way(view, gap):  # type: ignore[no-untyped-def]
    """Whether the opponent is beside the car and nearer to the race line, so that the line is its to take."""
    bodies = 0.5 * (view[_view.OWN_LENGTH] + view[_view.OPP_LENGTH])
    alongside = -bodies < gap < 1.5 * bodies and side_air(view) > 0.0
    return alongside and abs(view[_view.OPP_D]) < abs(view[_view.OWN_D])


@compiled(forceinline=True)
def within_walls(track, s, d, keep):  # type: ignore[no-untyped-def]
    """Distance from the race line nearest to ``d`` that leaves ``keep`` to the walls where the line does, m."""
    line = track.line[line_index(track, s)]
    return min(max(d, min(keep - line[_frenet.RIGHT], 0.0)), max(line[_frenet.LEFT] - keep, 0.0))


@compiled
def plan(track, theta, view, memory, scratch, path):  # type: ignore[no-untyped-def]
    """Write a path whose distance from the race line falls to 0 as a cubic that starts along the car's course."""
    s0 = view[_view.OWN_S]
    d0 = view[_view.OWN_D]
    course = view[_view.OWN_PSI] + view[_view.OWN_BETA]
    length = theta[LOOKAHEAD] + theta[LOOKAHEAD_TIME] * view[_view.OWN_V]
    line_psi = track.line[line_index(track, s0), _frenet.PSI]
    rise = length * tangent(min(max(angle_between(course, line_psi), -1.0), 1.0))
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
    for j in range(PATH_POINTS):
        u = j / (PATH_POINTS - 1)
        q = 1.0 - u
        s = s0 + u * length
        d = d1 + q * q * ((1.0 + 2.0 * u) * (d0 - d1) + u * rise)
        d_bend = ((12.0 * u - 6.0) * (d0 - d1) + (6.0 * u - 4.0) * rise) / (length * length)
        line = track.line[line_index(track, s)]
        x, y, _ = to_cartesian(track, s, d)
        path[j, _view.PATH_X] = x
        path[j, _view.PATH_Y] = y
        path[j, _view.PATH_SPEED] = min(scale * line[_frenet.SPEED], most)
        path[j, _view.PATH_KAPPA] = line[_frenet.KAPPA] / max(1.0 - line[_frenet.KAPPA] * d, 0.25) + d_bend


PURE_PURSUIT = Planner(name="pure-pursuit", parameters=PARAMETERS, plan=plan)
"""The race line, and nothing else."""
