"""Candidates of a plan along the race line: moves across the track, each at several speeds.

Ten times a second a planner lays goals around the race line ahead (two distances, eight positions
across the track). A move is a cubic in the distance from the race line, as in [1]_ and [2]_. It
begins at the present point of the last plan and ends at a goal, along the line. So a plan continues
the last plan, and does not follow every deviation of the car: most of a deviation is led back
within a few metres, and the next plan forgives the rest.

Each move is considered at four speeds, 64 candidates in all:

- an attack, faster than the profile on straights, while a car is to be passed;
- the profile;
- a slower profile;
- the speed that keeps a distance behind the other car, even when the other car brakes.

A candidate is rejected if it comes too close to a wall, asks for more grip than there is, or meets
the predicted opponent within 1.75 s. The others have a weighted sum of costs. The weights, on a log
scale, and a few traits (pace, attack, side margin) are the parameters of a policy.

Of two cars, the car ahead has the right of way and keeps its line, while the other car follows.
Side by side, both keep their lanes.

The steps share the rows of the scratch (:mod:`pcs_racing.planners.candidate_rows`). They are
compiled without the wrappers for calls from Python, which take half of the compile time.

References
----------
.. [1] M. Werling, J. Ziegler, S. Kammel and S. Thrun, "Optimal trajectory generation for dynamic
   street scenarios in a Frenet frame", ICRA 2010.
.. [2] M. McNaughton, C. Urmson, J. M. Dolan and J.-W. Lee, "Motion planning for autonomous driving
   with a conformal spatiotemporal lattice", ICRA 2011.
"""

from typing import NamedTuple

import numpy as np

from pcs_racing.base.compilation import inner_kernel
from pcs_racing.base.elementary import tangent
from pcs_racing.planners import candidate_rows as rows, pursuit as _pursuit, view as _view
from pcs_racing.planners.candidate_rows import (
    ACROSS,
    GOALS,
    HORIZON_STEPS,
    METRES,
    OPPONENT,
    PROFILES,
    SEGMENTS,
    SPEEDS,
)
from pcs_racing.planners.line import GRIP, LOST, easing_length, sample_at
from pcs_racing.planners.planner import Parameter
from pcs_racing.track import frenet as _frenet

BEYOND = 4  # points beyond the end of a move, where bends are measured

HORIZON_STEP = 0.25  # s
ALONE_STEPS = 5  # steps without an opponent to meet, enough to compare speeds
REJECT_STEPS = 7  # overlaps within 1.75 s reject a candidate: time to fall back on a straight
WRONG_WAY = 10.0  # factor on overlaps: the car must give way but speeds on, or need not but brakes
RIGHT_STEPS = 3  # in place of `REJECT_STEPS`, for a car with the right of way
REJECTED = 1e6  # min cost of a rejected candidate
LATER = 30.0  # cost of a later overlap, per m of its depth

NEAR, NEAR_TIME, FAR = 1.2, 0.4, 1.7  # m, s: distance of the near goals; factor for the far goals
LED_BACK = 0.7  # share of a deviation from the plan to lead back; the next plan forgives the rest

BODY_AIR = 0.25  # m to keep from a wall at a goal, unless the goal lies on the race line
TOUCH = 0.06  # m; a move that comes closer to a wall is rejected
WALL_AIR = 0.3  # m to keep from a wall on the way, unless the race line itself comes closer
WALL_COST = 300.0  # cost per missing m of air

STRAIN = 0.5  # cost per m/s^2 beyond the grip
SPIN_BEYOND = 1.0  # m/s^2 beyond the grip; above it a move is rejected
BRAKING = 4.5  # m/s^2, braking down to the speed of a bend
OWN_BRAKING, OPPONENT_BRAKING, ACCELERATION = 4.4, 4.4, 5.0  # m/s^2, limits in predictions

SIGHT = 12.0  # m, max distance of a predicted opponent
CLOSE = 4.0  # m along the track, max distance of a predicted opponent that costs
BUMPER_AIR = 0.3  # m to keep ahead of a passed opponent, and behind an opponent
UNSURE = 0.04  # m of uncertainty added per step, unless the car follows and can correct
MOVE_TIME = 0.4  # s, duration of an opponent's sideways motion
FOLLOW_GAP = 0.8  # m between the cars' centres
LEVEL = 1.0  # m of lead from wholly ahead to wholly behind

BRAKES_EARLIER = 8.0  # m beyond the last prediction; a bend there may require braking

ATTACKS, FOLLOWS = 0, SPEEDS - 1  # speeds; without a car to pass, an attack is the profile
_SPEED_FACTORS = (1.0, 1.0, 0.85)
SLOWEST = 0.65  # factor in place of following, with no car to follow

_WEIGHTS = (
    ("length", -2.0, 0.0, -0.2979, "length of the move: 2.5 m over its length"),
    ("max_curvature", -2.0, 0.0, -0.1836, "max curvature, 1/m"),
    ("mean_curvature", -2.0, 0.0, -1.744, "mean curvature, 1/m"),
    ("curvature_rate", -2.0, 0.0, -2.0, "max change of curvature in time, 1/(m s)"),
    ("lateral_acceleration", -2.0, 0.0, -0.8748, "max lateral acceleration, in 10 m/s^2"),
    ("braking", -2.0, 0.5, -0.5202, "change of speed along the candidate, in 10 m/s^2"),
    ("similarity", -2.0, 1.0, 0.4275, "squared distance to the previous plan, m^2"),
    ("progress", -1.0, 2.0, 0.1675, "time per metre of progress, relative to the fastest profile"),
    ("deviation", -1.5, 1.0, -0.2211, "mean distance from the race line, m"),
    ("walls", -1.5, 2.0, 1.471, "nearness to walls: mean of 0.1 / (air + 0.1 m)"),
    (
        "proximity",
        -2.5,
        1.0,
        -1.717,
        "nearness to the predicted opponent: discounted mean of 0.3 / (distance^2 + 0.3 m^2)",
    ),
    (
        "overtaking",
        -1.0,
        3.0,
        0.6541,
        "distance from the end of the candidate to the predicted opponent ahead, in 5 m",
    ),
    (
        "blocking",
        -2.0,
        1.0,
        0.4467,
        "distance from the line of an opponent that closes from behind, m",
    ),
)
LENGTH, MAX_CURVATURE, MEAN_CURVATURE, CURVATURE_RATE, LATERAL, BRAKE, SIMILARITY = range(7)
PROGRESS, DEVIATION, WALLS, PROXIMITY, OVERTAKING, BLOCKING = range(7, len(_WEIGHTS))
PACE, ATTACK, SIDE_MARGIN, PACE_BEHIND = range(len(_WEIGHTS), len(_WEIGHTS) + 4)

PARAMETERS = (
    *(
        Parameter(name, low, high, default, f"log10 weight of {what}")
        for name, low, high, default, what in _WEIGHTS
    ),
    Parameter(
        "pace",
        0.0,
        1.5,
        1.293,
        "speed scale between the slowest (0) and fastest (1) of the race's speed range",
    ),
    Parameter(
        "attack",
        0.0,
        0.5,
        0.2286,
        "share added to the profile on straights by a car that wants to pass",
    ),
    Parameter("side_margin", 0.1, 0.45, 0.3148, "clearance to the opponent, m"),
    Parameter(
        "pace_behind",
        -0.5,
        0.5,
        0.3471,
        "addition to the pace while the opponent leads; the sum is at least 0, and at most 1 or"
        " the pace",
    ),
)

# Memory: the chosen move, and 1 if the car attacks. The move is stored as 1 if there is a move, its
# start (m of arc length), its length (m), its end (m from the race line), and two coefficients of
# its cubic, see `lateral`.
_M_VALID, _M_S, _M_LENGTH, _M_GOAL, _M_A, _M_B, _M_ATTACKS = range(7)
MEMORY = 7


class Situation(NamedTuple):
    """Own car and opponent at the moment of a plan, and the rules between them."""

    s: float  #: Own arc length, m.
    d: float  #: Own distance from the race line, m.
    slope: float  #: Change of this distance along the line.
    v: float  #: Own speed, at least 0.5 m/s.
    width: float  #: Own width, m.
    scale: float  #: Speed scale of the policy's pace, less the own handicap.
    grip: float  #: Lateral acceleration that a move may ask for, m/s^2.
    gap: float  #: Distance to the opponent along the track, positive ahead, without laps, m.
    opponent_d: float  #: Opponent's distance from the race line, m.
    opponent_v: float  #: Opponent's speed, m/s.
    reach: float  #: Gap below which the cars are level, m.
    body: float  #: Distance across between touching cars, m.
    meets: bool  #: The opponent is near enough for a prediction.
    gives_way: bool  #: The opponent has the right of way.
    follows: bool  #: The own car keeps a distance behind the opponent.
    beside: bool  #: The cars are side by side.
    attacks: bool  #: The own car tries to pass.


class Start(NamedTuple):
    """Start place of the moves: the last plan's point at the own car."""

    d: float  #: Distance from the race line, m.
    slope: float  #: Change of the distance along the line.
    bend: float  #: Change of the slope, 1/m.
    since: float  #: Distance driven since the last plan, m.
    remembered: bool  #: There is a last plan.


class Return(NamedTuple):
    """Way of the car back onto its plan."""

    aside: float  #: Part of the deviation from the plan to lead back, m.
    slope: float  #: Change of this part along the way, m.
    length: float  #: Length of the way, m.


class Laid(NamedTuple):
    """Place of laid candidates; their numbers are in the scratch."""

    now: Situation  #: Cars at the moment of the plan.
    start: Start  #: Beginning of the moves.
    way: Return  #: Way of the car back onto them.


@inner_kernel
def _lay_profiles(line, per_ds, s0, metres, attack, scratch):
    """Lay the profiles of all predictions: squared speeds at all scales, and the track's edges.

    Rows are a metre apart, laid from far to near: a car brakes for each bend as hard as it may, and
    no harder, while above speed scale 1 the race line's profile brakes harder. An attack exceeds
    the profile by the share ``attack`` where bends allow.
    """
    scale = scratch[rows.SCALE + ATTACKS]
    lateral = _frenet.LATERAL_OF_PROFILE * scale * scale
    top = (1.0 + attack) * scale
    for f in range(PROFILES):
        scratch[rows.SQUARE + (metres - 1) * PROFILES + f] = 1e9
    for j in range(metres):
        k = metres - 1 - j
        row = rows.SQUARE + k * PROFILES
        beyond = row + (PROFILES if j > 0 else 0)
        i = sample_at(line, per_ds, s0 + (k - 1.0))
        square = line[i, _frenet.SPEED] * line[i, _frenet.SPEED]
        for f in range(1, PROFILES):
            own = scratch[rows.SCALE + f] * scratch[rows.SCALE + f] * square
            scratch[row + f] = min(own, scratch[beyond + f] + 2.0 * _pursuit.BRAKING)
        fast = min(top * top * square, lateral / max(abs(line[i, _frenet.KAPPA]), 1e-6))
        # Bends between these metres count by the profile, which never exceeds an attack.
        scratch[row] = (
            max(min(fast, scratch[beyond] + 2.0 * BRAKING), scratch[row + 1])
            if attack > 0.0
            else scratch[row + 1]
        )
        scratch[rows.RIGHT + k] = line[i, _frenet.RIGHT]
        scratch[rows.LEFT + k] = line[i, _frenet.LEFT]


@inner_kernel(forceinline=True)
def _metre_at(driven):
    """Return the profiles' row ``driven`` m from the car, and the share of the way to the next."""
    at = min(max(driven + 1.0, 0.0), METRES - 1.001)
    k = int(at)
    return k, at - k


@inner_kernel(forceinline=True)
def _speed_ahead(scratch, f, k, share):
    """Return the speed of the profile ``f`` at a row and share: linear in its square."""
    square = scratch[rows.SQUARE + k * PROFILES + f]
    return np.sqrt(square + share * (scratch[rows.SQUARE + (k + 1) * PROFILES + f] - square))


@inner_kernel(forceinline=True)
def power_of_ten(x):
    """Return 10**x for x in [-2, 2] to a relative 1e-7, cheaper than the library's power."""
    t = x * (2.302585092994046 / 16.0)
    t = 1.0 + t * (
        1.0 + t * (1 / 2 + t * (1 / 6 + t * (1 / 24 + t * (1 / 120 + t * (1 / 720 + t / 5040)))))
    )
    t *= t
    t *= t
    t *= t
    return t * t


@inner_kernel(forceinline=True)
def lateral(u, goal, a, b):
    """Return a move's distance from the race line at the share ``u`` of the move.

    From u = 1 on it is the goal.
    """
    u = min(max(u, 0.0), 1.0)
    q = 1.0 - u
    return goal + q * q * (a + u * b)


@inner_kernel(forceinline=True)
def _lateral_slope(u, a, b):
    """Return the derivative of `lateral` by ``u``."""
    u = min(max(u, 0.0), 1.0)
    q = 1.0 - u
    return q * (q * b - 2.0 * (a + u * b))


@inner_kernel(forceinline=True)
def _lateral_bend(u, a, b):
    """Return the second derivative of `lateral` by ``u``; 0 from u = 1 on."""
    return 2.0 * (a + u * b) - 4.0 * (1.0 - u) * b if u < 1.0 else 0.0


@inner_kernel(forceinline=True)
def _fade_out(u, d, slope):
    """Return a cubic from d, with a slope (per unit of u), to 0 at u = 1; 0 from there on."""
    u = min(max(u, 0.0), 1.0)
    q = 1.0 - u
    return q * q * (d + u * (slope + 2.0 * d))


@inner_kernel(forceinline=True)
def _pace_now(pace, pace_behind, gap):
    """Return the pace at a gap: ``pace`` in front, ``pace + pace_behind`` behind.

    Level cars take the mean of the two. The ramp reaches half a metre to either side, about a car's
    length. With a step instead, two such cars side by side would change their speeds at every plan.
    """
    behind = min(max(0.5 + gap / LEVEL, 0.0), 1.0)
    return min(max(pace + behind * pace_behind, 0.0), max(pace, 1.0))


@inner_kernel
def _following_speed(scratch, s, first):
    """Return the max speed at ``s`` with room to brake uniformly `FOLLOW_GAP` behind the opponent.

    The predicted opponent counts from step ``first`` on. So a car begins to fall back before the
    car ahead brakes: at half of the speed, the same time between two cars is half of the distance.
    """
    speed = 1e9
    for k in range(first, HORIZON_STEPS):
        room = scratch[rows.OPP_S + k] - FOLLOW_GAP - s
        speed = min(speed, 2.0 * room / ((k + 1 - first) * HORIZON_STEP) - scratch[rows.OPP_V + k])
    return max(speed, 0.0)


@inner_kernel(forceinline=True)
def situation(track, theta, view, memory):
    """Return the :class:`Situation` of a view."""
    line, per_ds = track.line, 1.0 / track.ds
    s, d, opponent_d = view[_view.OWN_S], view[_view.OWN_D], view[_view.OPP_D]
    here = sample_at(line, per_ds, s)
    course = view[_view.OWN_PSI] + view[_view.OWN_BETA]
    slope = tangent(min(max(_frenet.angle_between(course, line[here, _frenet.PSI]), -1.2), 1.2))
    slope *= max(1.0 - line[here, _frenet.KAPPA] * d, 0.25)
    gap = view[_view.GAP]
    pace = _pace_now(theta[PACE], theta[PACE_BEHIND], gap)
    scale = view[_view.SPEED_LOW] + pace * (view[_view.SPEED_HIGH] - view[_view.SPEED_LOW])
    scale *= 1.0 - view[_view.HANDICAP]
    laps = np.floor((gap + 0.5 * track.length) / track.length)
    gap -= laps * track.length  # the position of the other car counts, not its laps
    reach = 0.5 * (view[_view.OWN_LENGTH] + view[_view.OPP_LENGTH]) + BUMPER_AIR
    body = 0.5 * (view[_view.OWN_WIDTH] + view[_view.OPP_WIDTH])
    # The following car must avoid contact; the leading car keeps its line.
    in_line = abs(d - opponent_d) < body
    meets = -(reach - (BUMPER_AIR if in_line else 0.0)) < gap < SIGHT
    # Right of way: the car ahead; if level, the car nearer to the race line; if as near, the car
    # on the right.
    claim = gap + 0.5 * (abs(d) - abs(opponent_d))
    gives_way = claim > 0.0 or (claim == 0.0 and d > opponent_d)
    return Situation(
        s,
        d,
        slope,
        max(view[_view.OWN_V], 0.5),
        view[_view.OWN_WIDTH],
        scale,
        # The car has the grip that the line needs at this pace, and more at slow paces.
        _pursuit.within_grip(view, GRIP * max(scale * scale, 1.0)),
        gap,
        opponent_d,
        view[_view.OPP_V],
        reach,
        body,
        meets,
        gives_way,
        meets and (gap > 0.0 or (gives_way and gap > -reach)),
        # Side by side, each car keeps its lane.
        abs(gap) < reach and abs(d - opponent_d) > 0.8 * body,
        # An attack begins wholly behind and ends wholly ahead. If level cars changed roles (the
        # passing car stops, the passed car attacks), both would stay side by side into the next
        # bend.
        meets and (gap > LEVEL or memory[_M_ATTACKS] > 0.5),
    )


@inner_kernel(forceinline=True)
def plan_by_now(memory, now, length):
    """Return the :class:`Start` of the moves.

    A car that lost its plan, or has no plan, begins a new plan at its position.
    """
    driven = now.s - memory[_M_S]
    if driven < -0.5 * length:
        driven += length
    per = 1.0 / max(memory[_M_LENGTH], 0.1)
    u = driven * per
    d = lateral(u, memory[_M_GOAL], memory[_M_A], memory[_M_B])
    if memory[_M_VALID] < 0.5 or driven < -0.5 or driven > 5.0 or abs(d - now.d) > LOST:
        return Start(now.d, now.slope, 0.0, 0.0, False)
    slope = _lateral_slope(u, memory[_M_A], memory[_M_B]) * per
    bend = _lateral_bend(u, memory[_M_A], memory[_M_B]) * per * per
    return Start(d, slope, bend, driven, True)


@inner_kernel(forceinline=True)
def way_back(now, start):
    """Return the :class:`Return` of a car onto its plan."""
    length = easing_length(now.v)
    return Return(
        LED_BACK * (now.d - start.d), LED_BACK * (now.slope - start.slope) * length, length
    )


@inner_kernel
def _lay_moves(line, ds, now, start, back, scratch):
    """Lay the goals, join each goal to the plan by a move, and measure the moves.

    The points lie on the driven path: on the move, and on the way back onto it.
    """
    v, width = now.v, now.width
    per_ds = 1.0 / ds
    count = line.shape[0]
    keep = 0.5 * width + BODY_AIR
    per_return = 1.0 / back.length
    here = line[sample_at(line, per_ds, now.s), _frenet.KAPPA]
    scratch[rows.MEAN_KAPPA : rows.LINE_AIR] = 0.0
    scratch[rows.LINE_AIR : rows.AWAY] = WALL_AIR
    kappa0 = here / max(1.0 - here * start.d, 0.25) + start.bend
    for first in range(0, GOALS, ACROSS):
        length = (NEAR + NEAR_TIME * v) * (FAR if first > 0 else 1.0)
        per_length = 1.0 / length
        i = sample_at(line, per_ds, now.s + length)
        right = -max(line[i, _frenet.RIGHT] - keep, 0.0)
        left = max(line[i, _frenet.LEFT] - keep, 0.0)
        step = (left - right) / (ACROSS - 1)
        on_line = int(-right / step + 0.5) if step > 1e-9 else 0
        for k in range(ACROSS):
            g = first + k
            goal = 0.0 if k == on_line else right + k * step
            a = start.d - goal
            scratch[rows.GOAL_D + g] = goal
            scratch[rows.LENGTH + g] = length
            scratch[rows.A + g] = a
            scratch[rows.B + g] = length * start.slope + 2.0 * a
            scratch[rows.KAPPA + g] = kappa0
            scratch[rows.MAX_KAPPA + g] = abs(kappa0)
        for j in range(SEGMENTS):
            u = (j + 1) / SEGMENTS
            driven = u * length
            at = now.s + driven
            i = sample_at(line, per_ds, at)
            # Between two samples the line is taken as straight: a millimetre.
            beyond = at - np.floor(at * per_ds) * ds
            x = line[i, _frenet.X] + beyond * line[i, _frenet.COS]
            y = line[i, _frenet.Y] + beyond * line[i, _frenet.SIN]
            sine = line[i, _frenet.SIN]
            cosine = line[i, _frenet.COS]
            kappa = line[i, _frenet.KAPPA]
            fastest = now.scale * line[i, _frenet.SPEED]
            square = min(fastest * fastest, v * v + 8.0 * driven)
            aside = _fade_out(driven * per_return, back.aside, back.slope)
            # A narrow place may lie between two points: the min room around this point counts.
            around = int(0.5 * length / SEGMENTS * per_ds) + 1
            right = line[i, _frenet.RIGHT] - 0.5 * width
            left = line[i, _frenet.LEFT] - 0.5 * width
            least_right = right
            least_left = left
            for k in range(i - around, i + around + 1):
                sample = k - count if k >= count else k
                least_right = min(least_right, line[sample, _frenet.RIGHT] - 0.5 * width)
                least_left = min(least_left, line[sample, _frenet.LEFT] - 0.5 * width)
            for g in range(first, first + ACROSS):
                a = scratch[rows.A + g]
                b = scratch[rows.B + g]
                at_d = lateral(u, scratch[rows.GOAL_D + g], a, b)
                stretch = max(1.0 - kappa * at_d, 0.25)
                bent = kappa / stretch + _lateral_bend(u, a, b) * per_length * per_length
                scratch[rows.STRETCH + g] += stretch * (1.0 / SEGMENTS)
                scratch[rows.SLOWED + g] += min(
                    np.sqrt(now.grip / max(abs(bent) * square, 1e-3)), 1.0
                ) * (1.0 / SEGMENTS)
                scratch[rows.LINE_AIR + g] = min(scratch[rows.LINE_AIR + g], right, left)
                scratch[rows.MOVE_AIR + g] = min(
                    scratch[rows.MOVE_AIR + g], right + at_d + aside, left - at_d - aside
                )
                least = min(least_right + at_d + aside, least_left - at_d - aside)
                scratch[rows.MIN_AIR + g] = min(scratch[rows.MIN_AIR + g], least)
                scratch[rows.POINT_X + j * GOALS + g] = x - (at_d + aside) * sine
                scratch[rows.POINT_Y + j * GOALS + g] = y + (at_d + aside) * cosine
                scratch[rows.MAX_KAPPA + g] = max(scratch[rows.MAX_KAPPA + g], abs(bent))
                scratch[rows.MEAN_KAPPA + g] += abs(bent) * (1.0 / SEGMENTS)
                rate = abs(bent - scratch[rows.KAPPA + g]) * (SEGMENTS * per_length)
                scratch[rows.KAPPA_RATE + g] = max(scratch[rows.KAPPA_RATE + g], rate)
                scratch[rows.SIDEWAYS + g] = max(scratch[rows.SIDEWAYS + g], abs(bent) * square)
                scratch[rows.KAPPA + g] = bent
        # A near move must not end before a bend that cannot be driven: bends count up to the end
        # of the far moves.
        for j in range(BEYOND if first == 0 else 0):
            driven = length * (1.0 + (j + 1) / BEYOND * (FAR - 1.0))
            i = sample_at(line, per_ds, now.s + driven)
            kappa = line[i, _frenet.KAPPA]
            fastest = now.scale * line[i, _frenet.SPEED]
            square = min(fastest * fastest, v * v + 8.0 * driven)
            for g in range(first, first + ACROSS):
                bent = kappa / max(1.0 - kappa * scratch[rows.GOAL_D + g], 0.25)
                scratch[rows.SIDEWAYS + g] = max(scratch[rows.SIDEWAYS + g], abs(bent) * square)


@inner_kernel
def _measure_track(track, scratch, half_width):
    """Measure the air around each move's points, from the distance field."""
    distance = track.distance
    height, width = distance.shape
    cells = distance.reshape(height * width)
    per_cell = 1.0 / track.cell
    first_x = -track.origin_x * per_cell
    first_y = -track.origin_y * per_cell
    for k in range(GOALS * SEGMENTS):
        # The outermost cells of the field are wall, like everything beyond them.
        col = min(max(int(scratch[rows.POINT_X + k] * per_cell + first_x), 0), width - 1)
        row = min(max(int(scratch[rows.POINT_Y + k] * per_cell + first_y), 0), height - 1)
        scratch[rows.AIR + k] = row * width + col
    # A separate loop, short enough for the processor to wait for many cells of the field at once.
    for k in range(GOALS * SEGMENTS):
        scratch[rows.AIR + k] = cells[np.uint64(int(scratch[rows.AIR + k]))]
    for g in range(GOALS):
        nearest = scratch[rows.MIN_AIR + g]
        total = 0.0
        for j in range(SEGMENTS):
            air = scratch[rows.AIR + j * GOALS + g] - half_width
            nearest = min(nearest, air)
            total += 1.0 / (max(air, 0.0) + 0.1)
        scratch[rows.WALL_COST + g] = total * (0.1 / SEGMENTS)
        scratch[rows.MIN_AIR + g] = nearest


@inner_kernel
def _predict(now, steps, scratch):
    """Drive along the race line towards the profiles, at every speed.

    The results are arc lengths (unwrapped), speeds, and the car's limits on the track to the right
    and left.
    """
    s, keep = now.s, 0.5 * now.width + BODY_AIR
    for f in range(SPEEDS):
        scratch[rows.NOW_S + f] = s
        scratch[rows.NOW_V + f] = now.v
    for k in range(steps):
        # Steps of different speeds are interleaved: each waits only for its own last step.
        for f in range(SPEEDS):
            own_s = scratch[rows.NOW_S + f]
            own_v = scratch[rows.NOW_V + f]
            row, share = _metre_at(own_s - s)
            target = _speed_ahead(scratch, f, row, share)
            if f == FOLLOWS and now.follows:
                target = min(target, _following_speed(scratch, own_s, k))
            own_v += min(
                max(target - own_v, -OWN_BRAKING * HORIZON_STEP), ACCELERATION * HORIZON_STEP
            )
            own_s += own_v * HORIZON_STEP
            row, share = _metre_at(own_s - s)
            scratch[rows.NOW_S + f] = own_s
            scratch[rows.NOW_V + f] = own_v
            scratch[rows.OWN_S + k * SPEEDS + f] = own_s
            scratch[rows.OWN_V + k * SPEEDS + f] = own_v
            scratch[rows.OWN_LOW + k * SPEEDS + f] = min(keep - scratch[rows.RIGHT + row], 0.0)
            scratch[rows.OWN_HIGH + k * SPEEDS + f] = max(scratch[rows.LEFT + row] - keep, 0.0)


@inner_kernel
def _predict_opponent(view, now, scratch):
    """Predict the opponent along the track, with its share of the profile."""
    v, driven = now.opponent_v, now.gap
    # A narrowing track pushes the other car sideways; a car with the right of way leaves it air.
    room = 0.5 * view[_view.OPP_WIDTH] + (0.0 if now.gives_way else BODY_AIR)
    row, share = _metre_at(driven)
    for k in range(HORIZON_STEPS):
        wanted = _speed_ahead(scratch, OPPONENT, row, share)
        v += min(max(wanted - v, -OPPONENT_BRAKING * HORIZON_STEP), ACCELERATION * HORIZON_STEP)
        driven += v * HORIZON_STEP
        t = (k + 1) * HORIZON_STEP
        d = now.opponent_d
        if not now.beside:
            # Sideways motion continues for a while; a policy may have reasons for a position.
            d += view[_view.OPP_D_DOT] * t / (1.0 + t / MOVE_TIME)
        row, share = _metre_at(driven)
        low = min(room - scratch[rows.RIGHT + row], 0.0)
        high = max(scratch[rows.LEFT + row] - room, 0.0)
        scratch[rows.OPP_S + k] = now.s + driven
        scratch[rows.OPP_V + k] = v
        scratch[rows.OPP_D + k] = min(max(d, low), high)


@inner_kernel(forceinline=True)
def _predict_all(line, per_ds, theta, view, now, steps, scratch):
    """Lay the profiles, and predict both cars."""
    for f in range(FOLLOWS):
        scratch[rows.SCALE + f] = now.scale * _SPEED_FACTORS[f]
    scratch[rows.SCALE + FOLLOWS] = now.scale * (1.0 if now.follows else SLOWEST)
    carried = now.opponent_v / max(
        line[sample_at(line, per_ds, view[_view.OPP_S]), _frenet.SPEED], 0.5
    )
    if now.beside:
        # The opponent speeds up as the own car will.
        carried = max(carried, now.scale * min(now.opponent_v / now.v, 1.0))
    scratch[rows.SCALE + OPPONENT] = max(carried, 0.0)
    time = steps * HORIZON_STEP
    far = time * (now.v + 0.5 * time * ACCELERATION)
    if now.meets:
        far = max(far, now.gap + time * (now.opponent_v + 0.5 * time * ACCELERATION))
    metres = int(min(far + BRAKES_EARLIER, METRES - 1.0)) + 1
    _lay_profiles(line, per_ds, now.s, metres, theta[ATTACK] if now.attacks else 0.0, scratch)
    if now.meets:
        _predict_opponent(view, now, scratch)
    _predict(now, steps, scratch)


@inner_kernel(forceinline=True)
def meet_opponent(scratch, now, start, f, g, side_reach, w_near, most):
    """Return the cost of the predicted opponent for the move ``g`` at the speed ``f``.

    Overlaps cost, and nearness costs ``w_near``. The cars are level within a reach that grows at
    each step. The sum stops above ``most``. The nearness itself is returned as well.
    """
    s0, reach, body = now.s, now.reach, now.body
    falls_back = f == FOLLOWS
    unsure = 0.0 if falls_back else UNSURE
    wrong = WRONG_WAY if now.gives_way != falls_back else 1.0  # one car falls back, one drives on
    # A car with the right of way drives on, and avoids only imminent contact: if both held back,
    # they would stay side by side into the next bend.
    rejects = REJECT_STEPS if now.gives_way else RIGHT_STEPS
    later = LATER if now.gives_way and not falls_back else 0.0
    goal, a, b = scratch[rows.GOAL_D + g], scratch[rows.A + g], scratch[rows.B + g]
    length = scratch[rows.LENGTH + g]
    per_length = 1.0 / length
    gains = scratch[rows.SLOWED + g] / scratch[rows.STRETCH + g] - 1.0
    before = -now.gap
    side_before = start.d - now.opponent_d
    deepest = 0.0
    cost = 0.0
    nearness = 0.0
    fade = 1.0
    for k in range(HORIZON_STEPS):
        driven = scratch[rows.OWN_S + k * SPEEDS + f] - s0
        ahead = scratch[rows.OPP_S + k] - s0
        hard = fade * (REJECTED * wrong if k < rejects else later)
        near = fade * 0.3
        soft = near * w_near
        fade *= 0.85
        reach += unsure
        if abs(driven - ahead) > CLOSE + 2.0:
            continue
        if cost > most:
            break
        along = driven + gains * min(driven, length) - ahead
        # A narrowing track pushes the car sideways.
        low = scratch[rows.OWN_LOW + k * SPEEDS + f]
        high = scratch[rows.OWN_HIGH + k * SPEEDS + f]
        d = lateral((along + ahead) * per_length, goal, a, b)
        side = min(max(d, low), high) - scratch[rows.OPP_D + k]
        across = abs(side)
        # Min distance across while the cars are level, at this step or since the last step.
        nearest = across if abs(along) < reach else side_reach
        if along * before < 0.0:
            # A car passes between two steps: the positions at that time count.
            aside = side_before + (side - side_before) * before / (before - along)
            nearest = min(nearest, abs(aside))
        elif side * side_before < 0.0 and abs(before) < reach:
            nearest = 0.0  # a change of sides next to the other car
        before = along
        side_before = side
        # A move cannot lead through the other car: an overlap counts on the other side as well.
        deepest = max(deepest, side_reach - nearest)
        cost += hard * deepest * (1.0 + deepest)
        if abs(along) < CLOSE:
            long_air = max(abs(along) - reach, 0.0)
            side_air = max(across - body, 0.0)
            cost += soft / (long_air * long_air + 0.3 + side_air * side_air)
            nearness += near / (long_air * long_air + 0.3 + side_air * side_air)
    return cost, nearness


@inner_kernel(forceinline=True)
def defence(theta, view, now):
    """Return the weight of the distance from the line of an opponent that closes from behind."""
    closing = view[_view.OPP_V] - view[_view.OWN_V]
    if not -4.0 < now.gap < 0.0 or closing <= -0.5:
        return 0.0
    return power_of_ten(theta[BLOCKING]) * (1.0 + now.gap / 4.0) * min(closing + 0.5, 2.0)


@inner_kernel(forceinline=True)
def _compare_moves(memory, now, start, scratch):
    """Compare each move with the last plan, the race line and the opponent's line."""
    since = start.since
    per_before = 1.0 / max(memory[_M_LENGTH], 0.1)
    for first in range(0, GOALS, ACROSS):
        length = scratch[rows.LENGTH + first]
        then = (since + length) * per_before
        before = lateral(then, memory[_M_GOAL], memory[_M_A], memory[_M_B])
        then = (since + 0.5 * length) * per_before
        middle_before = lateral(then, memory[_M_GOAL], memory[_M_A], memory[_M_B])
        for g in range(first, first + ACROSS):
            goal = scratch[rows.GOAL_D + g]
            middle = lateral(0.5, goal, scratch[rows.A + g], scratch[rows.B + g])
            change = goal - before
            middle_change = middle - middle_before
            scratch[rows.AWAY + g] = abs(middle) + abs(goal)
            scratch[rows.CHANGE + g] = change * change + middle_change * middle_change
            scratch[rows.ABREAST + g] = abs(goal - now.opponent_d)
            scratch[rows.CLOSE + g] = max(
                scratch[rows.LINE_AIR + g] - scratch[rows.MOVE_AIR + g], 0.0
            )


@inner_kernel(forceinline=True)
def _weigh_moves(theta, view, now, start, scratch):
    """Sum up each move's speed-independent costs, with rejections by walls, in the base row."""
    defend = defence(theta, view, now)
    w_length = 2.5 * power_of_ten(theta[LENGTH])
    w_max = power_of_ten(theta[MAX_CURVATURE])
    w_mean = power_of_ten(theta[MEAN_CURVATURE])
    w_similarity = power_of_ten(theta[SIMILARITY]) if start.remembered else 0.0
    w_deviation = 0.5 * power_of_ten(theta[DEVIATION])
    w_walls = power_of_ten(theta[WALLS])
    for g in range(GOALS):
        tight = max(TOUCH - scratch[rows.MIN_AIR + g], 0.0)
        scratch[rows.BASE + g] = (
            w_length / scratch[rows.LENGTH + g]
            + w_max * scratch[rows.MAX_KAPPA + g]
            + w_mean * scratch[rows.MEAN_KAPPA + g]
            + w_walls * scratch[rows.WALL_COST + g]
            + WALL_COST * scratch[rows.CLOSE + g]
            + w_deviation * scratch[rows.AWAY + g]
            + w_similarity * scratch[rows.CHANGE + g]
            + defend * scratch[rows.ABREAST + g]
            + REJECTED * (1.0 + 3.0 * tight) * (1.0 if tight > 0.0 else 0.0)
        )


@inner_kernel(forceinline=True)
def _measure_candidates(now, steps, scratch):
    """Measure each speed, and each candidate without the opponent's nearness."""
    s0, v = now.s, now.v
    ahead = scratch[rows.OPP_S + HORIZON_STEPS - 1] - s0 if now.meets else -100.0
    for f in range(SPEEDS):
        driven = max(scratch[rows.OWN_S + (steps - 1) * SPEEDS + f] - s0, 0.1)
        soon = scratch[rows.OWN_V + 2 * SPEEDS + f]
        scratch[rows.DRIVEN + f] = driven
        scratch[rows.FAST + f] = max(v, scratch[rows.OWN_V + 4 * SPEEDS + f])
        scratch[rows.BRAKED + f] = abs(soon - v)
        share = (
            soon / scratch[rows.OWN_V + 2 * SPEEDS + ATTACKS + 1]
        )  # of the measured bends' speed
        share *= share
        for g in range(GOALS):
            gained = (scratch[rows.SLOWED + g] / scratch[rows.STRETCH + g] - 1.0) * min(
                driven, scratch[rows.LENGTH + g]
            )
            behind = ahead - driven - gained
            scratch[rows.ASIDE + f * GOALS + g] = share * scratch[rows.SIDEWAYS + g]
            scratch[rows.BEHIND + f * GOALS + g] = min(max(behind, 0.0), 10.0)


@inner_kernel(forceinline=True)
def _weigh_candidates(theta, now, steps, scratch):
    """Sum up the costs of all candidates without the opponent's nearness."""
    grip = now.grip
    w_progress = power_of_ten(theta[PROGRESS]) * (
        scratch[rows.OWN_S + (steps - 1) * SPEEDS] - now.s
    )
    w_braking = power_of_ten(theta[BRAKE]) / (3.0 * HORIZON_STEP * 10.0)
    w_overtaking = power_of_ten(theta[OVERTAKING]) / 5.0
    w_lateral = 0.1 * power_of_ten(theta[LATERAL])
    w_rate = 0.1 * power_of_ten(theta[CURVATURE_RATE])
    for f in range(SPEEDS):
        speed_cost = w_progress / scratch[rows.DRIVEN + f] + w_braking * scratch[rows.BRAKED + f]
        in_time = w_rate * scratch[rows.FAST + f]
        for g in range(GOALS):
            sideways = scratch[rows.ASIDE + f * GOALS + g]
            scratch[rows.MIN_COST + f * GOALS + g] = (
                speed_cost
                + w_overtaking * scratch[rows.BEHIND + f * GOALS + g]
                + scratch[rows.BASE + g]
                + w_lateral * sideways
                + in_time * scratch[rows.KAPPA_RATE + g]
                + STRAIN * max(sideways - grip, 0.0)
                + 0.03 * REJECTED * max(sideways - grip - SPIN_BEYOND, 0.0)
            )


@inner_kernel
def _write_path(track, view, laid, scratch, g, f, path):
    """Write the beginning of the move ``g`` and the way back onto it, at the speed ``f``.

    Bends limit the speed.
    """
    line, now, way = track.line, laid.now, laid.way
    s0, grip, reach, per_ds = now.s, now.grip, way.length, 1.0 / track.ds
    commanded = 1.0 / (1.0 - view[_view.HANDICAP])  # per driven speed
    at_scale = commanded * scratch[rows.SCALE + f]
    most = _following_speed(scratch, s0, 0) if now.follows and f == FOLLOWS else np.inf
    # As in the profile at this scale, limited.
    braking = min(BRAKING * grip / GRIP, _pursuit.BRAKING)
    goal, a, b = scratch[rows.GOAL_D + g], scratch[rows.A + g], scratch[rows.B + g]
    per_length = 1.0 / scratch[rows.LENGTH + g]
    # Bends beyond the written path: max speeds by braking, from the end of the move backwards.
    square = 1e9
    step = 0.25 * max(scratch[rows.LENGTH + g] - reach, 0.0)
    for j in range(4):
        driven = reach + (4 - j) * step
        kappa = line[sample_at(line, per_ds, s0 + driven), _frenet.KAPPA]
        u = driven * per_length
        d = lateral(u, goal, a, b)
        bent = kappa / max(1.0 - kappa * d, 0.25) + _lateral_bend(u, a, b) * per_length * per_length
        square = min(square + 2.0 * braking * step, grip / max(abs(bent), 1e-6))
    square += 2.0 * braking * step
    step = reach / (_view.PATH_POINTS - 1)
    for j in range(_view.PATH_POINTS - 1, -1, -1):
        driven = j * step
        at = s0 + driven
        i = sample_at(line, per_ds, at)
        kappa = line[i, _frenet.KAPPA]
        u = driven * per_length
        d = lateral(u, goal, a, b)
        bent = kappa / max(1.0 - kappa * d, 0.25) + _lateral_bend(u, a, b) * per_length * per_length
        square = min(square, grip / max(abs(bent), 1e-6))
        w = driven / reach
        back = ((12.0 * w - 6.0) * way.aside + (6.0 * w - 4.0) * way.slope) / (reach * reach)
        aside = d + _fade_out(w, way.aside, way.slope)
        x, y, _ = _frenet.offset(line, track.ds, track.length, at, aside)
        if now.attacks and f == ATTACKS:
            row, share = _metre_at(driven)
            speed = commanded * _speed_ahead(scratch, ATTACKS, row, share)
        else:
            speed = at_scale * line[i, _frenet.SPEED]
        _pursuit.write_point(path, j, x, y, min(speed, np.sqrt(square), most), bent + back)
        square += 2.0 * braking * step


@inner_kernel(forceinline=True)
def lay_candidates(track, theta, view, memory, now, scratch):
    """Lay, predict, measure and weigh all candidates; return their :class:`Laid`."""
    start = plan_by_now(memory, now, track.length)
    way = way_back(now, start)
    _lay_moves(track.line, track.ds, now, start, way, scratch)
    _measure_track(track, scratch, 0.5 * now.width)
    steps = HORIZON_STEPS if now.meets else ALONE_STEPS
    _predict_all(track.line, 1.0 / track.ds, theta, view, now, steps, scratch)
    _compare_moves(memory, now, start, scratch)
    _weigh_moves(theta, view, now, start, scratch)
    _measure_candidates(now, steps, scratch)
    _weigh_candidates(theta, now, steps, scratch)
    return Laid(now, start, way)


@inner_kernel(forceinline=True)
def take(track, view, memory, laid, attacks, scratch, chosen, path):
    """Remember a candidate, and whether the car attacks, and write the candidate's path."""
    g, f = chosen % GOALS, chosen // GOALS
    memory[_M_VALID] = 1.0
    memory[_M_S] = laid.now.s
    memory[_M_LENGTH] = scratch[rows.LENGTH + g]
    memory[_M_GOAL] = scratch[rows.GOAL_D + g]
    memory[_M_A] = scratch[rows.A + g]
    memory[_M_B] = scratch[rows.B + g]
    memory[_M_ATTACKS] = 1.0 if attacks else 0.0
    _write_path(track, view, laid, scratch, g, f, path)
