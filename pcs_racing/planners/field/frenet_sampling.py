"""Frenet sampling [1]_: the cheapest feasible polynomial trajectory to a grid of end states.

Ten times a second a set of trajectories is made. Across the track each is the quintic polynomial in
time from the present state to a distance from the race line, along the track the quartic to a
speed. Its cost adds the integral of the squared jerk, the time and the deviation of the end state,
across and along. The trajectories are tried in the order of their costs. The car drives the first
feasible trajectory: off the walls and the predicted opponent, within the limits of acceleration.
The next set starts from the state on that trajectory.

Differences: the end speeds are shares of the track's profile there, and the speed of trailing;
along the track the set starts from the car's own speed; the opponent is predicted to keep its share
of the profile and its position across the track; without a feasible trajectory the car trails on
the race line.

References
----------
.. [1] M. Werling, J. Ziegler, S. Kammel and S. Thrun, "Optimal trajectory generation for dynamic
   street scenarios in a Frenet frame", ICRA 2010.
"""

import numpy as np

from pcs_racing.base.compilation import inner_kernel, kernel
from pcs_racing.base.elementary import tangent
from pcs_racing.planners import line_following as _line
from pcs_racing.planners import view as _view
from pcs_racing.planners.field.pure_pursuit import gap_ahead, line_index
from pcs_racing.planners.planner import Parameter, Planner
from pcs_racing.planners.pursuit import within_grip
from pcs_racing.planners.view import PATH_POINTS
from pcs_racing.track import frenet as _frenet

PARAMETERS = (
    *_line.TRAILING,
    Parameter(
        "k_jerk",
        0.0,
        0.1,
        0.002,
        "weight of the integral of the squared jerk across the track, s^5/m^2",
    ),
    Parameter("k_time", 0.0, 5.0, 0.3, "weight of the duration, 1/s"),
    Parameter(
        "k_deviation",
        0.1,
        20.0,
        2.0,
        "weight of the squared distance from the race line at the end, 1/m^2",
    ),
    Parameter("k_speed", 0.0, 5.0, 0.3, "weight of the squared lack of speed at the end, s^2/m^2"),
    Parameter(
        "k_lon_jerk",
        0.0,
        0.05,
        0.0005,
        "weight of the integral of the squared jerk along the track, s^5/m^2",
    ),
    Parameter("wall_air", 0.05, 0.5, 0.15, "least air beside a wall away from the race line, m"),
    Parameter("opponent_air", 0.05, 0.6, 0.25, "least air beside the opponent, m"),
    Parameter("bumper_air", 0.05, 1.5, 0.3, "least air before and behind the opponent, m"),
)
TRAILING_GAP = 1
JERK, TIME, DEVIATION, SPEED, LON_JERK, WALL_AIR, OPPONENT_AIR, BUMPER_AIR = range(
    len(_line.TRAILING), len(PARAMETERS)
)

OFFSETS, OFFSET_STEP = 9, 0.3  # lateral end states, and their spacing (m)
DURATIONS, SHORTEST, DURATION_STEP = 3, 1.0, 0.5  # s
SPEEDS = 4  # speed of the profile, shares of it, and the opponent's speed
SHARES = (1.0, 0.85, 0.65, 0.4)  # the last share is used if there is no car to follow
SETS = OFFSETS * DURATIONS * SPEEDS
CHECKS = 10  # checked points of a trajectory
SIGHT = 20.0  # max distance of a predicted opponent, m
SOON = 0.5  # initial time without full clearance to the opponent, s
MAX_ACCELERATION, MAX_BRAKING = 10.0, 7.0  # m/s^2 along the track

# Memory: flag of a plan, its race time, duration, quintic and quartic (powers of time 0 to 5).
_VALID, _BEGUN, _DURATION, _QUINTIC, _QUARTIC = 0, 1, 2, 3, 9
MEMORY = _QUARTIC + 6
# Scratch: costs, the quintic and the quartic of one trajectory, the predicted opponent, the lane.
_COST, _D, _S, _OPP = 0, SETS, SETS + 6, SETS + 12
_OPP_V = _OPP + CHECKS * DURATIONS
_ACROSS = _OPP_V + DURATIONS  # costs of the lateral end states
_LANE = _ACROSS + OFFSETS
SCRATCH = _LANE + _line.LANE_SIZE


@inner_kernel
def quintic(d, d_dot, d_bend, end, end_rate, duration, out):
    """Write the quintic from a state to a value and rate; return its integral of jerk^2."""
    per = 1.0 / duration
    rest = end - d - duration * (d_dot + 0.5 * duration * d_bend)
    slope = end_rate - d_dot - duration * d_bend
    bend = -d_bend
    out[0], out[1], out[2] = d, d_dot, 0.5 * d_bend
    out[3] = (10.0 * rest * per - 4.0 * slope + 0.5 * bend * duration) * per * per
    out[4] = (-15.0 * rest * per + 7.0 * slope - bend * duration) * per * per * per
    out[5] = (6.0 * rest * per - 3.0 * slope + 0.5 * bend * duration) * per * per * per * per
    a, b, c, t = 6.0 * out[3], 24.0 * out[4], 60.0 * out[5], duration
    return t * (
        a * a
        + t * (a * b + t * ((b * b + 2.0 * a * c) / 3.0 + t * (0.5 * b * c + t * c * c / 5.0)))
    )


@inner_kernel
def _quartic(v, a, end, duration, out):
    """Write the quartic from speed and acceleration to a speed; return its integral of jerk^2."""
    third = ((end - v) / duration - 2.0 / 3.0 * a) / duration
    fourth = -(a + 6.0 * third * duration) / (12.0 * duration * duration)
    out[0], out[1], out[2], out[3], out[4], out[5] = 0.0, v, 0.5 * a, third, fourth, 0.0
    p, q = 6.0 * third, 24.0 * fourth * duration
    return duration * (p * p + p * q + q * q / 3.0)


@inner_kernel(forceinline=True)
def _at(c, t):
    """Return the value of a quintic."""
    return c[0] + t * (c[1] + t * (c[2] + t * (c[3] + t * (c[4] + t * c[5]))))


@inner_kernel(forceinline=True)
def _rate(c, t):
    """Return the first derivative of a quintic."""
    return c[1] + t * (2.0 * c[2] + t * (3.0 * c[3] + t * (4.0 * c[4] + t * 5.0 * c[5])))


@inner_kernel(forceinline=True)
def _bend(c, t):
    """Return the second derivative of a quintic."""
    return 2.0 * c[2] + t * (6.0 * c[3] + t * (12.0 * c[4] + t * 20.0 * c[5]))


@inner_kernel
def _present(track, view, memory):
    """Return the lateral start state of the plan: distance, first and second derivative."""
    t = view[_view.TIME] - memory[_BEGUN]
    if memory[_VALID] > 0.0 and t < 0.5:
        c = memory[_QUINTIC:]
        t = min(t, memory[_DURATION])
        d = _at(c, t)
        if abs(d - view[_view.OWN_D]) < _line.LOST:
            return d, _rate(c, t), _bend(c, t)
    course = _line.course_off_line(track, view)
    return view[_view.OWN_D], view[_view.OWN_V] * tangent(min(max(course, -1.0), 1.0)), 0.0


@inner_kernel
def _along(theta, v, a, profile, duration, k, opp_s, opp_v, out):
    """Write the polynomial along the track to the k-th kind of end state.

    The end state has a share of the profile's speed, or is behind the opponent. Returns the
    integral of the squared jerk, and the speed at the end.
    """
    if k == SPEEDS - 1 and opp_s > 0.0:
        return quintic(0.0, v, a, opp_s - theta[TRAILING_GAP], opp_v, duration, out), opp_v
    end = SHARES[k] * profile
    return _quartic(v, a, end, duration, out), end


@inner_kernel
def _possible(track, theta, view, duration, number, seen, scratch):
    """Return whether a trajectory keeps off walls and opponent, and within acceleration limits."""
    c, along = scratch[_D:_S], scratch[_S:_OPP]
    keep = 0.5 * view[_view.OWN_WIDTH] + theta[WALL_AIR]
    side = 0.5 * (view[_view.OWN_WIDTH] + view[_view.OPP_WIDTH]) + theta[OPPONENT_AIR]
    reach = 0.5 * (view[_view.OWN_LENGTH] + view[_view.OPP_LENGTH]) + theta[BUMPER_AIR]
    scale = _line.speed_scale(view, theta[0])
    grip = within_grip(view, 1.3 * _line.GRIP * max(scale * scale, 1.0))
    for k in range(1, CHECKS + 1):
        t = duration * k / CHECKS
        d = _at(c, t)
        s, v, a = _at(along, t), _rate(along, t), _bend(along, t)
        if a > MAX_ACCELERATION or a < -MAX_BRAKING or v < 0.0:
            return False
        sample = track.line[line_index(track, view[_view.OWN_S] + s)]
        if abs(d) > _line.ON_LINE and (
            d > sample[_frenet.LEFT] - keep or -d > sample[_frenet.RIGHT] - keep
        ):
            return False
        kappa = sample[_frenet.KAPPA] / max(1.0 - sample[_frenet.KAPPA] * d, 0.25)
        if abs(kappa * v * v + _bend(c, t)) > grip:
            return False
        # Up to `SOON` clearance may still be missing.
        soon = t < SOON
        near = abs(scratch[_OPP + number * CHECKS + k - 1] - s) < reach - (
            theta[BUMPER_AIR] if soon else 0.0
        )
        if (
            seen
            and near
            and abs(view[_view.OPP_D] - d) < side - (theta[OPPONENT_AIR] if soon else 0.0)
        ):
            return False
    return True


@kernel
def plan(track, theta, view, memory, scratch, path):
    """Sample the trajectories, and drive the cheapest feasible trajectory."""
    s0, v0 = view[_view.OWN_S], max(view[_view.OWN_V], 1.0)
    scale = _line.speed_scale(view, theta[0])
    gap = gap_ahead(track, view)
    seen = -0.5 * (view[_view.OWN_LENGTH] + view[_view.OPP_LENGTH]) < gap < SIGHT
    d0, rate0, bend0 = _present(track, view, memory)
    a0 = 0.0
    if memory[_VALID] > 0.0:
        a0 = _bend(memory[_QUARTIC:], min(view[_view.TIME] - memory[_BEGUN], memory[_DURATION]))
        a0 = min(max(a0, -MAX_BRAKING), MAX_ACCELERATION)
    c, along, lane = scratch[_D:_S], scratch[_S:_OPP], scratch[_LANE:SCRATCH]
    opp_share = view[_view.OPP_V] / track.line[line_index(track, s0 + gap), _frenet.SPEED]
    for n in range(DURATIONS):
        duration = SHORTEST + n * DURATION_STEP
        opp_s, opp_v = gap, view[_view.OPP_V]
        for k in range(CHECKS):
            opp_v = opp_share * track.line[line_index(track, s0 + opp_s), _frenet.SPEED]
            opp_s += duration / CHECKS * opp_v
            scratch[_OPP + n * CHECKS + k] = opp_s
        scratch[_OPP_V + n] = opp_v
        profile = scale * track.line[line_index(track, s0 + v0 * duration), _frenet.SPEED]
        for f in range(SPEEDS):
            follow_s = opp_s if seen and gap > 0.0 else -1.0
            lon_jerk, end_speed = _along(
                theta, v0, a0, profile, duration, f, follow_s, opp_v, along
            )
            lack = profile - end_speed
            lon = theta[LON_JERK] * lon_jerk + theta[SPEED] * lack * lack + theta[TIME] * duration
            for o in range(OFFSETS):
                end = (o - OFFSETS // 2) * OFFSET_STEP
                if f == 0:
                    jerk = quintic(d0, rate0, bend0, end, 0.0, duration, c)
                    scratch[_ACROSS + o] = theta[JERK] * jerk + theta[DEVIATION] * end * end
                scratch[_COST + (n * SPEEDS + f) * OFFSETS + o] = lon + scratch[_ACROSS + o]
    found = False
    duration, kind = SHORTEST, 0
    for _ in range(SETS):
        best = int(np.argmin(scratch[_COST : _COST + SETS]))
        scratch[_COST + best] = np.inf
        number, kind = best // (SPEEDS * OFFSETS), best // OFFSETS % SPEEDS
        duration = SHORTEST + number * DURATION_STEP
        profile = scale * track.line[line_index(track, s0 + v0 * duration), _frenet.SPEED]
        follow_s = scratch[_OPP + number * CHECKS + CHECKS - 1] if seen and gap > 0.0 else -1.0
        _along(theta, v0, a0, profile, duration, kind, follow_s, scratch[_OPP_V + number], along)
        quintic(d0, rate0, bend0, (best % OFFSETS - OFFSETS // 2) * OFFSET_STEP, 0.0, duration, c)
        if _possible(track, theta, view, duration, number, seen, scratch):
            found = True
            break
    memory[_VALID] = 1.0 if found else 0.0
    if not found:
        cap = _line.follow_line(track, theta, view, gap, SIGHT, lane)
        _line.ease_onto(track, view, scale, cap, lane, path)
        return
    memory[_BEGUN], memory[_DURATION] = view[_view.TIME], duration
    for k in range(12):
        memory[_QUINTIC + k] = scratch[_D + k]
    # Sample the lane by arc length: the time of a point follows from the previous one.
    t = 0.0
    for j in range(_line.LANE_POINTS):
        lane[j] = _at(c, min(t, duration))
        t += _line.lane_step(view) / max(_rate(along, min(t, duration)), 0.5)
    _line.ease_onto(track, view, scale, np.inf, lane, path)
    if kind > 0 or seen:
        t = 0.0
        for j in range(PATH_POINTS):
            v = max(_rate(along, t), 0.0)
            path[j, _view.PATH_SPEED] = min(path[j, _view.PATH_SPEED], v)
            t = min(t + _line.lane_step(view) / max(v, 0.5), duration)


VARIANTS = {
    "calm": {"k_jerk": 0.01, "opponent_air": 0.4},
    "close": {"opponent_air": 0.15, "trailing_gap": 1.1},
}
FRENET_SAMPLING = Planner(
    name="frenet-sampling",
    parameters=PARAMETERS,
    plan=plan,
    memory_size=MEMORY,
    scratch_size=SCRATCH,
    variants=VARIANTS,
)
"""Sampled polynomials in Frenet coordinates."""
