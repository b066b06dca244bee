"""The lattice planner of the paper: spirals to a lattice of goals, each at several speeds, chosen by a weighted cost.

Ten times a second the planner lays a lattice of goals around the race line ahead (two distances, eight positions across
the track), joins each to the car by a cubic spiral, and drives each spiral at four speeds: 64 candidates. A candidate
that leaves the track or meets the predicted opponent is rejected; of the others the one with the smallest weighted sum
of costs wins. The weights, on a log scale, and a few traits (pace, late braking, side margin) are the parameters of the
policy. Of two cars side by side the one ahead has the right of way; the other one gives it room.

All steps of a plan stand in this file. They share the rows of the scratch, and are compiled without the wrappers for
calls from Python that functions of several files would need: half of the time of compiling them.
"""

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.compilation import inner_kernel, kernel
from pcs_racing.base.elementary import rough_sine_cosine, sine_cosine, tangent
from pcs_racing.planners import spiral
from pcs_racing.planners import view as _view
from pcs_racing.planners.planner import Parameter, Planner
from pcs_racing.planners.spiral import SEGMENTS, sample_spirals, solve_spirals, spiral_curvature
from pcs_racing.planners.view import PATH_POINTS
from pcs_racing.track import frenet as _frenet
from pcs_racing.track.frenet import angle_between, offset

__all__ = ["LATTICE"]

ACROSS = 8
DISTANCES = 2
GOALS = spiral.SPIRALS
assert GOALS == ACROSS * DISTANCES
SPEEDS = 4
CANDIDATES = GOALS * SPEEDS

HORIZON_STEPS = 10
HORIZON_STEP = 0.15  # s
ALONE_STEPS = 5  # enough to compare speeds when there is nobody to meet
REJECT_STEPS = 7  # overlaps within about a second reject a candidate, later ones cost
REJECTED = 1e6  # costs from here on mean that a candidate was rejected
FAR = 1.6
RETURN_TIME = 1.2  # s
BODY_AIR = 0.10  # m to keep from a wall at a goal, unless it lies on the race line
TIGHT = 0.06  # m; a spiral that comes closer to a wall is rejected
STRAIN_FROM = 8.0  # m/s^2 of lateral acceleration, from where on a spiral at speed is more than the car can do
STRAIN = 0.5  # cost per m/s^2 beyond
SPIN_FROM = 11.0  # m/s^2 of lateral acceleration, from where on the car would spin: as bad as an overlap
GRIP = 6.0  # m/s^2, lateral acceleration that a candidate may ask for at speed scale 1
SIGHT = 12.0  # m within which the opponent is predicted
CLOSE = 4.0  # m along the track within which a predicted opponent costs
LEVEL = 1.0  # m of lead from wholly ahead to wholly behind

_SPEED_FACTORS = (1.0, 0.94, 0.84, 0.65)

_WEIGHTS = (
    ("length", -1.0, "length of the spiral: 2.5 m over its length"),
    ("max_curvature", -1.0, "largest curvature, 1/m"),
    ("mean_curvature", -1.0, "mean curvature, 1/m"),
    ("curvature_rate", -1.5, "largest change of curvature in time, 1/(m s)"),
    ("lateral_acceleration", -1.0, "largest lateral acceleration, in 10 m/s^2"),
    ("braking", -1.5, "change of speed along the candidate, in 10 m/s^2"),
    ("similarity", 0.0, "squared distance to the previous plan, m^2"),
    ("progress", 0.5, "time per metre of progress, relative to the fastest profile"),
    ("deviation", 0.0, "mean distance from the race line, m"),
    ("walls", -0.5, "nearness to walls: mean of 0.1 / (air + 0.1 m)"),
    ("proximity", -0.5, "nearness to the predicted opponent: discounted mean of 0.3 / (distance^2 + 0.3 m^2)"),
    ("overtaking", 0.0, "how far behind the predicted opponent the candidate ends, in 5 m"),
    ("blocking", -0.5, "distance from the line of an opponent that closes from behind, m"),
)
(
    LENGTH,
    MAX_CURVATURE,
    MEAN_CURVATURE,
    CURVATURE_RATE,
    LATERAL,
    BRAKING,
    SIMILARITY,
    PROGRESS,
    DEVIATION,
    WALLS,
    PROXIMITY,
    OVERTAKING,
    BLOCKING,
) = range(len(_WEIGHTS))
PACE, LATE_BRAKING, SIDE_MARGIN, PACE_BEHIND = range(len(_WEIGHTS), len(_WEIGHTS) + 4)

PARAMETERS = (
    *(Parameter(name, -2.0, 1.0, default, f"log10 weight of {what}") for name, default, what in _WEIGHTS),
    Parameter("pace", 0.0, 1.0, 0.5, "speed scale between the slowest (0) and fastest (1) of the race's speed range"),
    Parameter("late_braking", 0.0, 0.15, 0.03, "by how long the braking point is put off, s"),
    Parameter("side_margin", 0.05, 0.35, 0.15, "air to keep beside the opponent, m"),
    Parameter(
        "pace_behind", -0.5, 0.5, 0.0, "what is added to the pace while the opponent leads; the sum stays in [0, 1]"
    ),
)

# Memory: the previous plan as a cubic in d over arc length.
_M_VALID, _M_S, _M_D, _M_SLOPE, _M_LENGTH, _M_GOAL = range(6)
MEMORY = 6

# Rows of the scratch after the spirals' own block, each GOALS wide: position across the track, coefficients of the path
# there, nearness to walls, least air beside a wall, cost whatever the speed; trouble and proximity at the speed under
# study; then all costs, and the air at all points.
_GOAL_D, _SQUARE, _CUBE, _WALL_COST, _MIN_AIR, _BASE, _TROUBLE, _PROXIMITY, _COSTS = (
    spiral.BLOCK + GOALS * k for k in range(9)
)
_AIR = _COSTS + SPEEDS * GOALS
# Speed scales of the profiles, arc length and speed at present; predictions, a row for each step: own arc lengths and
# speeds at each speed profile and the room across the track; the opponent's arc length and position across the track.
_SCALE, _NOW_S, _NOW_V, _OWN_S = (_AIR + SEGMENTS * GOALS + SPEEDS * k for k in range(4))
_OWN_V = _OWN_S + SPEEDS * HORIZON_STEPS
_OWN_LOW = _OWN_V + SPEEDS * HORIZON_STEPS
_OWN_HIGH = _OWN_LOW + SPEEDS * HORIZON_STEPS
_OPP_S = _OWN_HIGH + SPEEDS * HORIZON_STEPS
_OPP_D = _OPP_S + HORIZON_STEPS
SCRATCH = _OPP_D + HORIZON_STEPS

_PATH_BASIS = np.array([spiral.heading_basis(j / (PATH_POINTS - 1)) for j in range(PATH_POINTS)])


@inner_kernel(forceinline=True)
def _near(v):  # type: ignore[no-untyped-def]
    """Distance of the near goals in m; the far ones are ``FAR`` times as far."""
    return 1.5 + 0.16 * v


@inner_kernel(forceinline=True)
def _sample_at(line, per_ds, s):  # type: ignore[no-untyped-def]
    """Index of the line's sample at an arc length above -length; a few laps more do no harm."""
    n = line.shape[0]
    i = int(s * per_ds + n) - n
    if i < 0:
        i += n
    while i >= n:
        i -= n
    return i


@inner_kernel(forceinline=True)
def _speed_at(line, per_ds, s):  # type: ignore[no-untyped-def]
    """Speed of the profile at an arc length above -length."""
    return line[_sample_at(line, per_ds, s), _frenet.SPEED]


@inner_kernel(forceinline=True)
def _target_speed(line, per_ds, s, v, late_braking):  # type: ignore[no-untyped-def]
    """Speed of the profile, the braking point put off, the acceleration out of corners not."""
    return max(_speed_at(line, per_ds, s), _speed_at(line, per_ds, s - v * late_braking))


@inner_kernel(forceinline=True)
def _power_of_ten(x):  # type: ignore[no-untyped-def]
    """10**x for x in [-2, 1] to a relative 1e-9, cheaper than the library's power."""
    t = x * (2.302585092994046 / 16.0)
    t = 1.0 + t * (1.0 + t * (1 / 2 + t * (1 / 6 + t * (1 / 24 + t * (1 / 120 + t * (1 / 720 + t / 5040))))))
    t *= t
    t *= t
    t *= t
    return t * t


@inner_kernel(forceinline=True)
def _hermite(u, d0, slope0, d1):  # type: ignore[no-untyped-def]
    """Cubic from d0 with slope0 (per unit of u) to d1 with slope 0; constant from u = 1 on."""
    u = min(max(u, 0.0), 1.0)
    q = 1.0 - u
    return d1 + q * q * ((1.0 + 2.0 * u) * (d0 - d1) + u * slope0)


@inner_kernel(forceinline=True)
def _pace_now(pace, pace_behind, gap):  # type: ignore[no-untyped-def]
    """The pace at a gap: ``pace`` in front, ``pace + pace_behind`` behind.

    Level cars take the mean of the two, and the ramp reaches half a metre to either side, about a car's length. With a
    step instead, two such cars side by side would change their speeds at every plan.
    """
    behind = min(max(0.5 + gap / LEVEL, 0.0), 1.0)
    return min(max(pace + behind * pace_behind, 0.0), 1.0)


@inner_kernel
def _lay_goals(line, ds, length, view, distance, first, course, scratch):  # type: ignore[no-untyped-def]
    """Put one row of goals across the track, ``distance`` ahead, in the frame of the car's velocity."""
    s = view[_view.OWN_S] + distance
    i = _sample_at(line, 1.0 / ds, s)
    kappa = line[i, _frenet.KAPPA]
    keep = 0.5 * view[_view.OWN_WIDTH] + BODY_AIR
    right = -max(line[i, _frenet.RIGHT] - keep, 0.0)
    left = max(line[i, _frenet.LEFT] - keep, 0.0)
    step = (left - right) / (ACROSS - 1)
    on_line = int(-right / step + 0.5) if step > 1e-9 else 0
    sn, c = sine_cosine(course)
    # The same for the whole row: where the line is, and which way across the track.
    x, y, psi = offset(line, ds, length, s, 0.0)
    heading = angle_between(psi, course)
    dx = x - view[_view.OWN_X]
    dy = y - view[_view.OWN_Y]
    line_x = dx * c + dy * sn
    line_y = -dx * sn + dy * c
    sine, across_y = sine_cosine(heading)
    across_x = -sine
    for k in range(ACROSS):
        g = first + k
        d = 0.0 if k == on_line else right + k * step
        scratch[spiral.GOAL_X + g] = line_x + d * across_x
        scratch[spiral.GOAL_Y + g] = line_y + d * across_y
        scratch[spiral.GOAL_HEADING + g] = heading
        scratch[spiral.GOAL_KAPPA + g] = kappa / max(1.0 - kappa * d, 0.25)
        scratch[_GOAL_D + g] = d


@inner_kernel
def _measure_track(track, scratch, half_width):  # type: ignore[no-untyped-def]
    """Air beside each spiral's points, from the distance field."""
    distance = track.distance
    height, width = distance.shape
    cells = distance.reshape(height * width)
    per_cell = 1.0 / track.cell
    first_x = -track.origin_x * per_cell
    first_y = -track.origin_y * per_cell
    for k in range(GOALS, GOALS * (SEGMENTS + 1)):
        # The outermost cells of the field are wall, like everything beyond them.
        col = min(max(int(scratch[spiral.POINT_X + k] * per_cell + first_x), 0), width - 1)
        row = min(max(int(scratch[spiral.POINT_Y + k] * per_cell + first_y), 0), height - 1)
        scratch[_AIR - GOALS + k] = row * width + col
    # In a loop of its own, which is so short that the processor waits for many cells of the field at the same time.
    for k in range(GOALS, GOALS * (SEGMENTS + 1)):
        scratch[_AIR - GOALS + k] = cells[np.uint64(int(scratch[_AIR - GOALS + k]))]
    for g in range(GOALS):
        nearest = 1e9
        total = 0.0
        for j in range(SEGMENTS):
            air = scratch[_AIR + j * GOALS + g] - half_width
            nearest = min(nearest, air)
            total += 1.0 / (max(air, 0.0) + 0.1)
        scratch[_WALL_COST + g] = total * (0.1 / SEGMENTS)
        scratch[_MIN_AIR + g] = nearest


@inner_kernel
def _predict(line, per_ds, s, v, late_braking, keep, steps, scratch):  # type: ignore[no-untyped-def]
    """Drive along the race line from (s, v) towards the profile, at every scale in the scratch.

    Keeps arc lengths (unwrapped), speeds, and how far right and left the track lets the car be by then.
    """
    for f in range(SPEEDS):
        scratch[_NOW_S + f] = s
        scratch[_NOW_V + f] = v
    for k in range(steps):
        # The speeds do not wait for each other, but each waits for its own last step: so they take turns.
        for f in range(SPEEDS):
            own_s = scratch[_NOW_S + f]
            own_v = scratch[_NOW_V + f]
            target = scratch[_SCALE + f] * _target_speed(line, per_ds, own_s, own_v, late_braking)
            own_v += min(max(target - own_v, -6.0 * HORIZON_STEP), 3.5 * HORIZON_STEP)
            own_s += own_v * HORIZON_STEP
            i = _sample_at(line, per_ds, own_s)
            scratch[_NOW_S + f] = own_s
            scratch[_NOW_V + f] = own_v
            scratch[_OWN_S + k * SPEEDS + f] = own_s
            scratch[_OWN_V + k * SPEEDS + f] = own_v
            scratch[_OWN_LOW + k * SPEEDS + f] = min(keep - line[i, _frenet.RIGHT], 0.0)
            scratch[_OWN_HIGH + k * SPEEDS + f] = max(line[i, _frenet.LEFT] - keep, 0.0)


@inner_kernel
def _predict_opponent(line, per_ds, view, s, gives_way, scratch):  # type: ignore[no-untyped-def]
    """The opponent carries on along the track from ``s`` with its share of the profile: arc lengths and positions."""
    v = view[_view.OPP_V]
    carried = v / max(_speed_at(line, per_ds, view[_view.OPP_S]), 0.5)
    # The track pushes the other car sideways where it narrows; who has the right of way leaves it air there.
    room = 0.5 * view[_view.OPP_WIDTH] + (0.0 if gives_way else BODY_AIR)
    for k in range(HORIZON_STEPS):
        wanted = carried * _speed_at(line, per_ds, s)
        s += min(max(wanted, v - 6.0 * HORIZON_STEP * (k + 1)), v + 3.0) * HORIZON_STEP
        t = (k + 1) * HORIZON_STEP
        d = view[_view.OPP_D]
        if gives_way:
            # A driver with the right of way finishes its move and then comes back to the race line.
            d = (d + min(t, 0.25) * view[_view.OPP_D_DOT]) * max(1.0 - t / RETURN_TIME, 0.0)
        row = _sample_at(line, per_ds, s)
        low = min(room - line[row, _frenet.RIGHT], 0.0)
        high = max(line[row, _frenet.LEFT] - room, 0.0)
        scratch[_OPP_S + k] = s
        scratch[_OPP_D + k] = min(max(d, low), high)


@inner_kernel
def _shape_paths(scratch, d0, slope):  # type: ignore[no-untyped-def]
    """Coefficients of each spiral's distance from the race line, as the cubic of `_hermite` in the distance driven."""
    for g in range(GOALS):
        per_length = 1.0 / scratch[spiral.LENGTH + g]
        aside = (scratch[_GOAL_D + g] - d0) * per_length
        scratch[_SQUARE + g] = (3.0 * aside - 2.0 * slope) * per_length
        scratch[_CUBE + g] = (slope - 2.0 * aside) * per_length * per_length


@inner_kernel
def _meet_opponent(scratch, f, d0, slope, s0, long_reach, side_reach, soft_side, gives_way, followed):  # type: ignore[no-untyped-def]
    """Trouble (overlap within a second) and proximity of all spirals at one speed with the predicted opponent."""
    for g in range(GOALS):
        scratch[_TROUBLE + g] = 0.0
        scratch[_PROXIMITY + g] = 0.0
    fade = 1.0
    for k in range(HORIZON_STEPS):
        driven = scratch[_OWN_S + k * SPEEDS + f] - s0
        # Who is followed does not brake to let the other car through: that ends in its back. Moving aside may help.
        at_speed = 0 if followed else f
        gap = abs(scratch[_OWN_S + k * SPEEDS + at_speed] - scratch[_OPP_S + k])
        opp_d = scratch[_OPP_D + k]
        # A driver who must give way foresees where the track will push it sideways.
        low = scratch[_OWN_LOW + k * SPEEDS + f] if gives_way else -100.0
        high = scratch[_OWN_HIGH + k * SPEEDS + f] if gives_way else 100.0
        long_air = max(gap - long_reach, 0.0)
        long_square = long_air * long_air + 0.3
        hard = fade * (REJECTED if k < REJECT_STEPS and not followed else 10.0)
        if gap >= long_reach:
            hard = 0.0
        soft = fade * 0.3
        fade *= 0.85
        if gap > CLOSE:
            continue
        for g in range(GOALS):
            along = min(driven, scratch[spiral.LENGTH + g])
            d = d0 + along * (slope + along * (scratch[_SQUARE + g] + along * scratch[_CUBE + g]))
            across = abs(min(max(d, low), high) - opp_d)
            deep = max(side_reach - across, 0.0)
            scratch[_TROUBLE + g] += hard * deep * (1.0 + deep)
            side_air = max(across - soft_side, 0.0)
            scratch[_PROXIMITY + g] += soft / (long_square + side_air * side_air)


@inner_kernel
def _weigh_spirals(theta, memory, scratch, remembered, since, d0, slope, defend, opponent_d):  # type: ignore[no-untyped-def]
    """Sum up what a spiral costs whatever the speed, rejections by walls included, into the base row."""
    w_length = 2.5 * _power_of_ten(theta[LENGTH])
    w_max = _power_of_ten(theta[MAX_CURVATURE])
    w_mean = _power_of_ten(theta[MEAN_CURVATURE])
    w_similarity = _power_of_ten(theta[SIMILARITY]) if remembered else 0.0
    w_deviation = 0.5 * _power_of_ten(theta[DEVIATION])
    w_walls = _power_of_ten(theta[WALLS])
    before = max(memory[_M_LENGTH], 0.1)
    per_before = 1.0 / before
    before_d = memory[_M_D]
    before_slope = memory[_M_SLOPE] * before
    before_goal = memory[_M_GOAL]
    for g in range(GOALS):
        length = scratch[spiral.LENGTH + g]
        goal = scratch[_GOAL_D + g]
        middle = _hermite(0.5, d0, slope * length, goal)
        change = goal - _hermite((since + length) * per_before, before_d, before_slope, before_goal)
        middle_change = middle - _hermite((since + 0.5 * length) * per_before, before_d, before_slope, before_goal)
        tight = max(TIGHT - scratch[_MIN_AIR + g], 0.0)
        scratch[_BASE + g] = (
            w_length / length
            + w_max * scratch[spiral.MAX_KAPPA + g]
            + w_mean * scratch[spiral.MEAN_KAPPA + g]
            + w_walls * scratch[_WALL_COST + g]
            + w_deviation * (abs(middle) + abs(goal))
            + w_similarity * (change * change + middle_change * middle_change)
            + defend * abs(goal - opponent_d)
            + REJECTED * (1.0 + 3.0 * tight) * (1.0 if tight > 0.0 else 0.0)
            + 100.0 * REJECTED * scratch[spiral.BROKEN + g]
        )


@inner_kernel
def _write_path(line, per_ds, view, scratch, g, kappa0, course, at_scale, scale, late, path):  # type: ignore[no-untyped-def]
    """Sample the chosen spiral, with a speed at each point that its curvature allows."""
    s0, c0 = sine_cosine(course)
    length = scratch[spiral.LENGTH + g]
    w = scratch[spiral.W + g]
    end = scratch[spiral.GOAL_HEADING + g]
    kappa1 = scratch[spiral.GOAL_KAPPA + g]
    h = length / (PATH_POINTS - 1)
    correction = h * h / 12.0
    a1, a2, a3 = spiral_curvature(length, w, end, kappa0, kappa1)
    sum_c = -0.5
    sum_s = 0.0
    distance = _near(max(view[_view.OWN_V], 0.5))
    if g >= ACROSS:
        distance *= FAR
    grip = GRIP * scale * scale
    for j in range(PATH_POINTS):
        a, b0, b3, d = _PATH_BASIS[j, 0], _PATH_BASIS[j, 1], _PATH_BASIS[j, 2], _PATH_BASIS[j, 3]
        u = j / (PATH_POINTS - 1)
        kappa = kappa0 + u * (a1 + u * (a2 + u * a3))
        s, c = rough_sine_cosine(a * end + length * (b0 * kappa0 + b3 * kappa1) + d * w)
        # As sample_spirals does.
        sum_c += c
        sum_s += s
        x = h * (sum_c - 0.5 * c) + correction * s * kappa
        y = h * (sum_s - 0.5 * s) + correction * (kappa0 - c * kappa)
        at = view[_view.OWN_S] + distance * u
        speed = at_scale * _target_speed(line, per_ds, at, view[_view.OWN_V], late)
        path[j, _view.PATH_X] = view[_view.OWN_X] + x * c0 - y * s0
        path[j, _view.PATH_Y] = view[_view.OWN_Y] + x * s0 + y * c0
        path[j, _view.PATH_SPEED] = min(speed, np.sqrt(grip / max(abs(kappa), 1e-6)))
        path[j, _view.PATH_KAPPA] = kappa


@inner_kernel
def _search(track, theta, view, memory, scratch, path, slack):  # type: ignore[no-untyped-def]
    """Choose a candidate and write its path.

    What meeting the opponent costs is added at those speeds only where the rest, which is less, leaves a candidate
    within ``slack`` of the best one so far.
    """
    v = max(view[_view.OWN_V], 0.5)
    s0 = view[_view.OWN_S]
    d0 = view[_view.OWN_D]
    course = view[_view.OWN_PSI] + view[_view.OWN_BETA]
    line = track.line
    per_ds = 1.0 / track.ds
    line_psi = line[_sample_at(line, per_ds, s0), _frenet.PSI]
    slope = tangent(min(max(angle_between(course, line_psi), -1.2), 1.2))
    pace = _pace_now(theta[PACE], theta[PACE_BEHIND], view[_view.GAP])
    scale = view[_view.SPEED_LOW] + pace * (view[_view.SPEED_HIGH] - view[_view.SPEED_LOW])
    # The yaw rate lags the steering; half of each is where the car is about to be.
    kappa0 = 0.5 * (view[_view.OWN_PSI_DOT] / v + tangent(view[_view.OWN_DELTA]) / view[_view.WHEELBASE])
    kappa0 = min(max(kappa0, -1.2), 1.2)
    late = theta[LATE_BRAKING]

    distance = _near(v)
    for first in range(0, GOALS, ACROSS):
        _lay_goals(line, track.ds, track.length, view, distance, first, course, scratch)
        distance *= FAR
    solve_spirals(scratch, kappa0)
    sample_spirals(scratch, kappa0, view[_view.OWN_X], view[_view.OWN_Y], course)
    _measure_track(track, scratch, 0.5 * view[_view.OWN_WIDTH])

    gap = view[_view.GAP]
    laps = np.floor((gap + 0.5 * track.length) / track.length)
    gap -= laps * track.length  # what matters to a driver is where the other car stands, not how often it came round
    meets = abs(gap) < SIGHT
    follow = 0.65
    # Right of way: the car ahead; level, the one nearer to the race line; as near, the one on the right.
    claim = gap + 0.5 * (abs(d0) - abs(view[_view.OPP_D]))
    gives_way = claim > 0.0 or (claim == 0.0 and d0 > view[_view.OPP_D])
    if meets:
        _predict_opponent(line, per_ds, view, s0 + gap, gives_way, scratch)
        if gap > 0.0:
            wanted = view[_view.OPP_V] + 1.2 * (gap - 1.1)
            follow = min(max(wanted / max(scale * _speed_at(line, per_ds, s0), 0.5), 0.0), 0.65)
    for f in range(SPEEDS):
        scratch[_SCALE + f] = scale * (_SPEED_FACTORS[f] if f < SPEEDS - 1 else follow)
    steps = HORIZON_STEPS if meets else ALONE_STEPS
    _predict(line, per_ds, s0, v, late, 0.5 * view[_view.OWN_WIDTH] + BODY_AIR, steps, scratch)
    long_reach = 0.5 * (view[_view.OWN_LENGTH] + view[_view.OPP_LENGTH]) + 0.12
    body = 0.5 * (view[_view.OWN_WIDTH] + view[_view.OPP_WIDTH])
    margin = theta[SIDE_MARGIN] if gives_way else 0.5 * theta[SIDE_MARGIN]
    followed = -CLOSE < gap < -long_reach
    defend = 0.0
    if meets and -4.0 < gap < 0.0:
        closing = view[_view.OPP_V] - view[_view.OWN_V]
        if closing > -0.5:
            defend = _power_of_ten(theta[BLOCKING]) * (1.0 + gap / 4.0) * min(closing + 0.5, 2.0)
    remembered = memory[_M_VALID] > 0.5
    since = 0.0
    if remembered:
        since = s0 - memory[_M_S]
        if since < -0.5 * track.length:
            since += track.length

    _weigh_spirals(theta, memory, scratch, remembered, since, d0, slope, defend, view[_view.OPP_D])
    _shape_paths(scratch, d0, slope)
    best_goal = np.int64(0)  # the type is stated, or a second copy of _write_path is compiled for the constant
    best_speed = np.int64(0)
    best = 1e30
    w_progress = _power_of_ten(theta[PROGRESS]) * (scratch[_OWN_S + (steps - 1) * SPEEDS] - s0)
    w_braking = _power_of_ten(theta[BRAKING]) / (3.0 * HORIZON_STEP * 10.0)
    w_overtaking = _power_of_ten(theta[OVERTAKING]) / 5.0
    w_lateral = 0.1 * _power_of_ten(theta[LATERAL])
    w_rate = 0.1 * _power_of_ten(theta[CURVATURE_RATE])
    w_proximity = _power_of_ten(theta[PROXIMITY]) / 6.0
    # The path's speed falls with its curvature: a sharp turn aside is braking, too.
    turns_from = min(SPIN_FROM, 1.2 * GRIP * scale * scale) if followed else SPIN_FROM
    for f in range(SPEEDS):
        driven = max(scratch[_OWN_S + (steps - 1) * SPEEDS + f] - s0, 0.1)
        fast = max(v, scratch[_OWN_V + 4 * SPEEDS + f])
        soon = scratch[_OWN_V + 2 * SPEEDS + f]
        speed_cost = w_progress / driven + w_braking * abs(soon - v)
        if meets:
            behind = min(max(scratch[_OPP_S + HORIZON_STEPS - 1] - s0 - driven, 0.0), 10.0)
            speed_cost += w_overtaking * behind
        at_speed = w_lateral * fast * fast
        in_time = w_rate * fast
        costs = _COSTS + f * GOALS
        hopeful = 0
        for g in range(GOALS):
            sideways = soon * soon * scratch[spiral.MAX_KAPPA + g]
            cost = (
                speed_cost
                + scratch[_BASE + g]
                + at_speed * scratch[spiral.MAX_KAPPA + g]
                + in_time * scratch[spiral.KAPPA_RATE + g]
                + STRAIN * max(sideways - STRAIN_FROM, 0.0)
                + 0.03 * REJECTED * max(sideways - turns_from, 0.0)
            )
            scratch[costs + g] = cost
            hopeful += 1 if cost < best + slack else 0
        if hopeful == 0:
            continue
        if meets:
            _meet_opponent(scratch, f, d0, slope, s0, long_reach, body + margin, body, gives_way, followed)
            for g in range(GOALS):
                scratch[costs + g] += w_proximity * scratch[_PROXIMITY + g] + scratch[_TROUBLE + g]
        for g in range(GOALS):
            if scratch[costs + g] < best:
                best = scratch[costs + g]
                best_goal = np.int64(g)
                best_speed = np.int64(f)
    memory[_M_VALID] = 1.0
    memory[_M_S] = s0
    memory[_M_D] = d0
    memory[_M_SLOPE] = slope
    memory[_M_LENGTH] = scratch[spiral.LENGTH + best_goal]
    memory[_M_GOAL] = scratch[_GOAL_D + best_goal]
    _write_path(line, per_ds, view, scratch, best_goal, kappa0, course, scratch[_SCALE + best_speed], scale, late, path)


@kernel
def plan(track, theta, view, memory, scratch, path):  # type: ignore[no-untyped-def]
    """Choose a candidate and write its path."""
    _search(track, theta, view, memory, scratch, path, 0.0)


@kernel
def _weigh_all(track, theta, view, memory, scratch, path):  # type: ignore[no-untyped-def]
    """Do as ``plan``, and leave the whole cost of every candidate in the scratch."""
    _search(track, theta, view, memory, scratch, path, np.inf)


def candidates(
    track: _frenet.TrackArrays, theta: NDArray[np.float64], view: NDArray[np.float64], memory: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """All candidates that ``plan`` would choose from, for pictures.

    Returns
    -------
    points : ndarray, shape (64, 9, 2)
        Points of each candidate in m (the four speeds of one spiral share them).
    costs : ndarray, shape (64,)
        Weighted cost; infinite where the candidate is rejected.
    """
    scratch = np.zeros(SCRATCH)
    _weigh_all(track, theta, view, memory.copy(), scratch, np.zeros((PATH_POINTS, 4)))
    shape = (SEGMENTS + 1, GOALS)
    x = scratch[spiral.POINT_X : spiral.POINT_X + shape[0] * GOALS].reshape(shape)
    y = scratch[spiral.POINT_Y : spiral.POINT_Y + shape[0] * GOALS].reshape(shape)
    points = np.stack([x.T, y.T], axis=-1)
    costs = scratch[_COSTS : _COSTS + CANDIDATES].copy()
    costs[costs >= 0.02 * REJECTED] = np.inf
    return np.tile(points, (SPEEDS, 1, 1)), costs


LATTICE = Planner(
    name="lattice",
    parameters=PARAMETERS,
    plan=plan,
    memory_size=MEMORY,
    scratch_size=SCRATCH,
    candidates=candidates,
    sight=SIGHT,
)
"""The lattice planner of the paper."""
