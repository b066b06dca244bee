"""Spliner of the ForzaETH race stack [1]_: a spline around the opponent, or trailing behind it.

An opponent ahead near the race line is passed on the side with more room. The lane is a cubic
spline through points on the race line before and after the opponent, and an apex next to it. The
lane moves on with the opponent until the opponent is behind. If the spline would come too near to a
wall, the car trails: it keeps a distance by a PD controller.

Differences: the opponent is propagated along the race line with its speed, the distance to the
track's bounds is measured from the side of the car, and the speed is limited by the bends of the
lane.

References
----------
.. [1] N. Baumann et al., "ForzaETH Race Stack: Scaled autonomous head-to-head racing on fully
   commercial off-the-shelf hardware", Journal of Field Robotics, 2024, arXiv:2403.11784.
"""

import numpy as np

from pcs_racing.base.compilation import inner_kernel, kernel
from pcs_racing.planners import line as _line, view as _view
from pcs_racing.planners.planner import Parameter, Planner, offsets
from pcs_racing.track import frenet as _frenet

PARAMETERS = (
    *_line.TRAILING,
    Parameter(
        "evasion_dist",
        0.4,
        1.25,
        0.65,
        "distance across the track from the opponent to the apex, m",
    ),
    Parameter(
        "obs_traj_thresh",
        0.1,
        1.5,
        0.3,
        "clearance to the race line below which the opponent is in the way, m",
    ),
    Parameter(
        "spline_bound_mindist",
        0.05,
        0.6,
        0.2,
        "min distance from the side of the car to a wall, m",
    ),
    Parameter("lookahead", 4.0, 15.0, 10.0, "distance within which an opponent is considered, m"),
    Parameter("pre_apex_0", 3.2, 8.0, 4.0, "first point before the apex, m"),
    Parameter("pre_apex_1", 2.1, 3.1, 3.0, "second point before the apex, m"),
    Parameter("pre_apex_2", 0.5, 2.0, 1.5, "third point before the apex, m"),
    Parameter("post_apex_0", 0.5, 2.4, 2.0, "first point after the apex, m"),
    Parameter("post_apex_1", 2.5, 3.9, 3.0, "second point after the apex, m"),
    Parameter("post_apex_2", 4.0, 12.0, 4.0, "third point after the apex, m"),
    Parameter(
        "sector_kappa",
        0.02,
        0.5,
        0.15,
        "max curvature of the race line at the beginning of a pass, 1/m",
    ),
    Parameter("fixed_pred_time", 0.0, 1.0, 0.15, "prediction time of the opponent, s"),
)
EVASION, IN_THE_WAY, BOUND, LOOKAHEAD, FIRST_POINT, *_, SECTOR, PREDICTION = range(
    len(_line.TRAILING), len(PARAMETERS)
)
TOP_SPEED = 8.0  # top speed of the profile, m/s; the speed scales point distances by 1 to 1.5
SECTOR_REACH = 10.0  # m
KEEPS_UP = 0.9  # max share of the own speed that the opponent is assumed to drive
CHECK_STEP = 0.4  # spacing of the spline points compared with the track's bounds, m

_SIDE = 0  # memory: the side of a pass (-1 right, 1 left), or 0
KNOTS = 7
# Scratch: the points, the spline's moments, work, the lane.
_AT, _MOMENT, _FACTOR, _LANE, SCRATCH = offsets(KNOTS, KNOTS, KNOTS, _line.LANE_SIZE)


@inner_kernel
def lay_spline(theta, stretch, scratch):
    """Write the natural cubic spline that is 1 at the apex and 0 at the other points.

    The output is its points and second derivatives.
    """
    for k in range(KNOTS):
        sign = -1.0 if k < 3 else 1.0
        scratch[_AT + k] = (
            0.0 if k == 3 else sign * stretch * theta[FIRST_POINT + (k if k < 3 else k - 1)]
        )
    scratch[_MOMENT] = scratch[_FACTOR] = scratch[_MOMENT + KNOTS - 1] = 0.0
    for k in range(1, KNOTS - 1):
        before = scratch[_AT + k] - scratch[_AT + k - 1]
        after = scratch[_AT + k + 1] - scratch[_AT + k]
        right = (1.0 if k == 2 else -1.0 if k == 3 else 0.0) / after - (
            1.0 if k == 3 else -1.0 if k == 4 else 0.0
        ) / before
        pivot = 2.0 * (before + after) - before * scratch[_FACTOR + k - 1]
        scratch[_FACTOR + k] = after / pivot
        scratch[_MOMENT + k] = (6.0 * right - before * scratch[_MOMENT + k - 1]) / pivot
    for k in range(KNOTS - 2, 0, -1):
        scratch[_MOMENT + k] -= scratch[_FACTOR + k] * scratch[_MOMENT + k + 1]


@inner_kernel
def spline_at(x, scratch):
    """Return the spline of `lay_spline` at a distance (m) from its apex.

    The value is clipped to [0, 1], because a spline must not change sides.
    """
    if x <= scratch[_AT] or x >= scratch[_AT + KNOTS - 1]:
        return 0.0
    k = 0
    while x > scratch[_AT + k + 1]:
        k += 1
    width = scratch[_AT + k + 1] - scratch[_AT + k]
    a = (scratch[_AT + k + 1] - x) / width
    b = 1.0 - a
    value = (a if k == 3 else 0.0) + (b if k == 2 else 0.0)
    bent = (a * a * a - a) * scratch[_MOMENT + k] + (b * b * b - b) * scratch[_MOMENT + k + 1]
    return min(max(value + bent * width * width / 6.0, 0.0), 1.0)


@inner_kernel
def fits(track, view, keep, s, apex, gap, scratch):
    """Return whether the rest of a spline, apex at ``s + gap``, leaves ``keep`` (m) to walls."""
    x = max(scratch[_AT], -gap)
    while x < scratch[_AT + KNOTS - 1]:
        sample = track.line[_line.line_index(track, s + gap + x)]
        d = apex * spline_at(x, scratch)
        if abs(d) > 0.1 and (d > sample[_frenet.LEFT] - keep or -d > sample[_frenet.RIGHT] - keep):
            return False
        x += CHECK_STEP
    return True


@kernel
def plan(track, theta, view, memory, scratch, path):
    """Follow the race line, pass, or trail."""
    s0 = view[_view.OWN_S]
    opp_d = view[_view.OPP_D]
    gap = _line.gap_ahead(track, view) + theta[PREDICTION] * (view[_view.OPP_V] - view[_view.OWN_V])
    stretch = min(1.0 + view[_view.OWN_V] / TOP_SPEED, 1.5)
    lay_spline(theta, stretch, scratch)
    now = _line.gap_ahead(track, view)
    blocks = (
        abs(opp_d) - 0.5 * view[_view.OPP_WIDTH] < theta[IN_THE_WAY] + 0.5 * view[_view.OWN_WIDTH]
    )
    passing = memory[_SIDE] != 0.0 and gap > -scratch[_AT + KNOTS - 1]
    lane = scratch[_LANE:SCRATCH]
    side = 0.0
    cap = np.inf
    if blocks and (
        passing
        or (
            0.0 < now < theta[LOOKAHEAD]
            and _line.sharpest_bend(track, s0, SECTOR_REACH, 0.5) < theta[SECTOR]
        )
    ):
        here = track.line[_line.line_index(track, s0 + gap)]
        roomier = 1.0 if here[_frenet.LEFT] - opp_d > here[_frenet.RIGHT] + opp_d else -1.0
        side = memory[_SIDE] if passing else roomier
        apex = opp_d + side * theta[EVASION]
        # The opponent moves on while the car does.
        closes = 1.0 - min(view[_view.OPP_V] / max(view[_view.OWN_V], 1.0), KEEPS_UP)
        for j in range(_line.LANE_POINTS):
            lane[j] = apex * spline_at(j * _line.lane_step(view) * closes - gap, scratch)
        keep = theta[BOUND] + 0.5 * view[_view.OWN_WIDTH]
        if not (
            _line.lane_fits(track, view, keep, lane)
            and fits(track, view, keep, s0, apex, gap, scratch)
        ):
            # A pass is aborted only with room to brake.
            if now > _line.room_to_brake(theta, view) or not passing:
                side = 0.0
            else:
                _line.hold_off(track, view, keep, lane)
                cap = _line.trailing_speed(theta, view, now) if now > 0.0 else np.inf
    memory[_SIDE] = side
    if side == 0.0:
        cap = _line.follow_line(track, theta, view, now, theta[LOOKAHEAD], lane)
    _line.ease_onto(track, view, _line.speed_scale(view, theta[0]), cap, lane, path)


SPLINER = Planner(
    name="spliner",
    parameters=PARAMETERS,
    plan=plan,
    memory_size=1,
    scratch_size=SCRATCH,
    variants={
        "published": {
            "obs_traj_thresh": 1.0,
            "evasion_dist": 0.6,
            "spline_bound_mindist": 0.3,
            "pre_apex_2": 2.0,
        },
        "close": {"evasion_dist": 0.5},
        "wide": {"evasion_dist": 0.8},
    },
)
"""The spliner: evasion by a spline, or trailing."""
