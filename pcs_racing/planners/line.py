"""Shared parts of planners with a map: the race line, lanes along it, paths onto them, trailing.

A *lane* is a planner's target: distances from the race line (m, positive to the left),
``lane_step`` apart, from the car on. `ease_onto` turns a lane into the path of the protocol, with
the speeds of the track's profile that the lane's bends allow. So planners of different papers
differ in their target, not in how well they follow a path.
"""

from typing import NamedTuple

import numpy as np

from pcs_racing.base.compilation import compiled, inner_kernel, kernel
from pcs_racing.base.elementary import tangent
from pcs_racing.planners import view as _view
from pcs_racing.planners.planner import Parameter
from pcs_racing.planners.pursuit import BRAKING, steady_course, within_grip, write_point
from pcs_racing.track import frenet as _frenet

FOLLOW_GAIN = 1.2  # closing speed per metre beyond the follow distance, 1/s
IN_THE_WAY = 0.1  # clearance below which the opponent is followed, m
WALL_MARGIN = 0.38  # distance of the car's middle to the wall next to an opponent, m
GRIP = 5.3  # m/s^2 allowed to a move up to speed scale 1; above, times the scale squared
LOST = 0.4  # m from the plan; beyond it a new plan begins at the car

PACE = Parameter(
    "pace",
    0.0,
    1.5,
    0.5,
    "speed scale between the slowest (0) and fastest (1) of the race's speed range",
)
TRAILING = (
    PACE,
    Parameter(
        "trailing_gap",
        0.8,
        4.0,
        1.5,
        "distance between the cars' middles to keep while trailing, m",
    ),
    Parameter("trailing_p", 0.1, 3.0, 0.5, "closing speed per metre beyond that distance, 1/s"),
    Parameter(
        "trailing_d",
        0.0,
        1.0,
        0.2,
        "share of the difference of speeds subtracted while trailing",
    ),
)
"""First parameters of planners that use `trailing_speed`; the values are from [1]_.

.. [1] N. Baumann et al., "ForzaETH Race Stack: Scaled autonomous head-to-head racing on fully
   commercial off-the-shelf hardware", Journal of Field Robotics, 2024, and its published
   configuration.
"""
_PACE, _GAP, _P, _D = range(len(TRAILING))

LANE_POINTS = 20
"""Number of points of a lane: the path's points, and enough more to brake for the bends beyond."""
ANCHORS = 8  # points of a curve that keeps the lane off the walls
LANE_SIZE = LANE_POINTS + ANCHORS
"""Size of a lane's array, with working memory for `ease_onto`."""

KEPT_LANE = 3 + LANE_POINTS
"""Size of a lane in the memory: 1 if there is a lane, its start, its step, and its points."""

ANCHOR_STEP = 2.0  # m
WALL_NEAR, WALL_PUSH = 0.60, 0.30  # m; a wall pushes a nearer lane away, by 0.145 m at 0.305 m

# Share and max of a deviation (m, or slope) that the path forgives: with a path that begins at the
# car itself, the car would weave.
FORGIVEN, MAX_FORGIVEN = 0.5, 0.1
OFF_LINE = 0.30  # m from the race line; walls do not push a lane beyond it
ON_LINE = 0.15  # m from the race line; a lane within it is as good as the line itself
BEND = 3  # points of the lane to either side that give its bend at a point
EASE_LATERAL = 6.0  # m/s^2, lateral acceleration allowed on the way to the lane
COMFORT = 4.5  # m/s^2, braking down to the speed of a bend


@compiled(forceinline=True)
def line_index(track, s):
    """Return the index of the last line sample at or before an arc length (any real number)."""
    return int(_frenet.wrap_s(track, s) / track.ds) % track.line.shape[0]


@inner_kernel(forceinline=True)
def sample_at(line, per_ds, s):
    """Return the index of the line's sample at an arc length above -length, or some laps on."""
    n = line.shape[0]
    i = int(s * per_ds + n) - n
    if i < 0:
        i += n
    while i >= n:
        i -= n
    return i


@compiled(forceinline=True)
def gap_ahead(track, view):
    """Return the distance to the opponent ahead, modulo laps, in [-length / 2, length / 2), m."""
    return _frenet.shorter_way(track.length, view[_view.GAP])


@compiled(forceinline=True)
def side_air(view):
    """Return the lateral clearance of both cars, m; negative if one would hit the other's rear."""
    return abs(view[_view.OPP_D] - view[_view.OWN_D]) - 0.5 * (
        view[_view.OWN_WIDTH] + view[_view.OPP_WIDTH]
    )


@compiled(forceinline=True)
def gives_way(view, gap):
    """Return whether the car gives way to the opponent.

    It does if the opponent is alongside and nearer to the race line: then the line belongs to the
    opponent.
    """
    bodies = 0.5 * (view[_view.OWN_LENGTH] + view[_view.OPP_LENGTH])
    alongside = -bodies < gap < 1.5 * bodies and side_air(view) > 0.0
    return alongside and abs(view[_view.OPP_D]) < abs(view[_view.OWN_D])


@compiled(forceinline=True)
def within_walls(track, s, d, keep):
    """Return the offset (m) nearest to ``d`` that leaves ``keep`` to walls where the line does."""
    line = track.line[line_index(track, s)]
    return min(max(d, min(keep - line[_frenet.RIGHT], 0.0)), max(line[_frenet.LEFT] - keep, 0.0))


@kernel(forceinline=True)
def speed_scale(view, pace):
    """Return the factor of the track's speed profile at a pace."""
    return view[_view.SPEED_LOW] + pace * (view[_view.SPEED_HIGH] - view[_view.SPEED_LOW])


@kernel(forceinline=True)
def trailing_speed(theta, view, gap):
    """Return the speed (m/s) that keeps the distance to a car ahead.

    ``theta`` begins with the parameters `TRAILING`.
    """
    closing = view[_view.OWN_V] - view[_view.OPP_V]
    return max(view[_view.OPP_V] + theta[_P] * (gap - theta[_GAP]) - theta[_D] * closing, 0.0)


@kernel(forceinline=True)
def room_to_brake(theta, view):
    """Return the distance (m) to a car ahead below which a pass is no longer aborted.

    ``theta`` begins with the parameters `TRAILING`.
    """
    closing = max(view[_view.OWN_V] - view[_view.OPP_V], 0.0)
    return theta[_GAP] + closing * closing / (2.0 * BRAKING)


@kernel(forceinline=True)
def easing_length(v):
    """Return the distance (m) for easing onto a plan at a speed, also the length of the path."""
    return 1.5 + 0.2 * v


@kernel(forceinline=True)
def lane_step(view):
    """Return the distance (m) along the race line between two points of a lane."""
    return easing_length(view[_view.OWN_V]) / (_view.PATH_POINTS - 1)


@kernel
def follow_line(track, theta, view, gap, sight, lane):
    """Lay the lane of a planner that does not overtake, and return the trailing speed (m/s).

    The lane is the race line. Next to a car that is nearer to the race line, and close behind such
    a car, the lane is the own lateral position. ``gap`` is the distance to the other car (m). The
    other car is trailed within ``sight`` if the own car would run into it.
    """
    beside = -0.5 * (view[_view.OWN_LENGTH] + view[_view.OPP_LENGTH]) < gap < theta[_GAP]
    waits = beside and side_air(view) > 0.0 and abs(view[_view.OPP_D]) < abs(view[_view.OWN_D])
    d = within_walls(track, view[_view.OWN_S], view[_view.OWN_D], WALL_MARGIN) if waits else 0.0
    lane[:LANE_POINTS] = d
    # Air at the car's position, and on the race line.
    air = min(
        side_air(view),
        abs(view[_view.OPP_D]) - 0.5 * (view[_view.OWN_WIDTH] + view[_view.OPP_WIDTH]),
    )
    ahead = 0.0 < gap < sight and air < IN_THE_WAY
    return trailing_speed(theta, view, gap) if waits or ahead else np.inf


@kernel
def sharpest_bend(track, s, reach, step):
    """Return the max curvature (1/m) of the race line within a reach after an arc length.

    The curvature is read at places a step apart; all distances are in m.
    """
    sharpest = 0.0
    for k in range(int(reach / step)):
        sharpest = max(sharpest, abs(track.line[line_index(track, s + step * k), _frenet.KAPPA]))
    return sharpest


@kernel
def lane_fits(track, view, keep, lane):
    """Return whether a lane leaves ``keep`` (m) to the walls everywhere off the race line."""
    step = lane_step(view)
    for j in range(LANE_POINTS):
        sample = track.line[line_index(track, view[_view.OWN_S] + j * step)]
        if abs(lane[j]) > ON_LINE and (
            lane[j] > sample[_frenet.LEFT] - keep or -lane[j] > sample[_frenet.RIGHT] - keep
        ):
            return False
    return True


@kernel
def hold_off(track, view, keep, lane):
    """Move a lane so that it leaves ``keep`` (m) to the walls, or as much as the race line does."""
    step = lane_step(view)
    for j in range(LANE_POINTS):
        lane[j] = within_walls(track, view[_view.OWN_S] + j * step, lane[j], keep)


@kernel
def lay_lane(view, d, along, across, lane):
    """Lay a lane of cubics from the distance ``d`` (m) through all places of a plan.

    ``along`` holds the places' distances from the car along the race line, increasing; ``across``
    holds their distances from the race line; both in m.
    """
    last = along.shape[0] - 1
    k = 0
    before_s, before_d = 0.0, d
    slope = (across[0] - d) / max(along[0], 0.1)
    for j in range(LANE_POINTS):
        x = j * lane_step(view)
        while k < last and x > along[k]:
            slope = (across[k + 1] - before_d) / max(along[k + 1] - before_s, 0.1)
            before_s, before_d = along[k], across[k]
            k += 1
        width = max(along[k] - before_s, 0.1)
        after = min(k + 1, last)
        next_slope = (across[after] - before_d) / max(along[after] - before_s, 0.1)
        u = min((x - before_s) / width, 1.0)
        rise = across[k] - before_d
        lane[j] = (
            before_d
            + u * rise
            + u * (1.0 - u) * ((slope * width - rise) * (1.0 - u) + (rise - next_slope * width) * u)
        )


@kernel
def keep_lane(view, lane, memory):
    """Save a lane in the first `KEPT_LANE` numbers of the memory."""
    memory[0], memory[1], memory[2] = 1.0, view[_view.OWN_S], lane_step(view)
    for j in range(LANE_POINTS):
        memory[3 + j] = lane[j]


@kernel
def kept_lane(track, memory, s):
    """Return the distance from the race line (m) and slope of the saved lane at an arc length.

    Both are 0 without a saved lane.
    """
    if memory[0] == 0.0:
        return 0.0, 0.0
    driven = s - memory[1]
    driven = driven + track.length if driven < -0.5 * track.length else driven
    u = min(max(driven / memory[2], 0.0), LANE_POINTS - 1.001)
    j = int(u)
    slope = (memory[4 + j] - memory[3 + j]) / memory[2]
    return memory[3 + j] + (u - j) * memory[2] * slope, slope


@kernel
def last_lane(track, view, memory):
    """Return `kept_lane` at the own car, and whether the lane may go on.

    It may not if there is no saved lane, or if the car lost it.
    """
    d, slope = kept_lane(track, memory, view[_view.OWN_S])
    return d, slope, memory[0] != 0.0 and abs(d - view[_view.OWN_D]) <= LOST


@kernel
def course_off_line(track, view):
    """Return the angle (rad) of the own course to the race line at the car."""
    here = track.line[line_index(track, view[_view.OWN_S])]
    return _frenet.angle_between(steady_course(view, here[_frenet.KAPPA]), here[_frenet.PSI])


class Car(NamedTuple):
    """A car at the begin of a plan."""

    s: float  #: Arc length from the own car on, m.
    v: float  #: Speed, m/s.
    d: float  #: Distance from the race line, m.
    rate: float  #: Change of this distance, m/s.
    scale: float  #: Factor of the speed profile.


@inner_kernel
def both_cars(track, view, memory, scale):
    """Return the own car at the present point of the saved lane, and the opponent.

    Without a lane that may go on, the own car is at its own position. The opponent keeps its share
    of the profile. ``scale`` is the own factor.
    """
    v, gap = view[_view.OWN_V], gap_ahead(track, view)
    d, slope, goes_on = last_lane(track, view, memory)
    if not goes_on:
        d, slope = (
            view[_view.OWN_D],
            tangent(min(max(course_off_line(track, view), -1.0), 1.0)),
        )
    profile = track.line[line_index(track, view[_view.OWN_S] + gap), _frenet.SPEED]
    opp_v = view[_view.OPP_V]
    other = Car(gap, opp_v, view[_view.OPP_D], view[_view.OPP_D_DOT], opp_v / profile)
    return Car(0.0, v, d, v * slope, scale), other


@kernel(forceinline=True)
def _stray(x):
    """Return a deviation from the lane, less the part that the path forgives."""
    return x - min(max(FORGIVEN * x, -MAX_FORGIVEN), MAX_FORGIVEN)


@inner_kernel
def _keep_off_walls(track, s0, step, lane):
    """Move a lane off walls near the race line, by a quadratic B-spline along the track."""
    first = np.floor(s0 / ANCHOR_STEP - 1.0)
    for k in range(ANCHORS):
        left = right = 0.0
        for i in range(4):
            sample = track.line[line_index(track, (first + k + 0.25 * i) * ANCHOR_STEP)]
            right += max(WALL_NEAR - sample[_frenet.RIGHT], 0.0) ** 2
            left += max(WALL_NEAR - sample[_frenet.LEFT], 0.0) ** 2
        lane[LANE_POINTS + k] = (right - left) / (4.0 * 2.0 * WALL_PUSH)
    for j in range(LANE_POINTS):
        u = (s0 + j * step) / ANCHOR_STEP - first
        k = min(max(int(u), 1), ANCHORS - 2)
        u -= k
        before, here, after = (
            lane[LANE_POINTS + k - 1],
            lane[LANE_POINTS + k],
            lane[LANE_POINTS + k + 1],
        )
        push = 0.5 * (
            (1.0 - u) * (1.0 - u) * before + (1.0 + 2.0 * u * (1.0 - u)) * here + u * u * after
        )
        lane[j] += push * max(1.0 - abs(lane[j]) / OFF_LINE, 0.0)


@kernel
def ease_onto(track, view, scale, cap, lane, path):
    """Write a path that eases from the car onto a lane.

    ``scale`` is a factor of the speed profile; ``cap`` is the max speed (m/s). The lane, shape
    (LANE_SIZE,), is moved off walls.
    """
    line, ds, length = track.line, track.ds, track.length
    s0 = view[_view.OWN_S]
    d0 = view[_view.OWN_D]
    reach = easing_length(view[_view.OWN_V])
    step = lane_step(view)
    _keep_off_walls(track, s0, step, lane)
    here = line[line_index(track, s0)]
    slope = tangent(min(max(course_off_line(track, view), -1.2), 1.2))
    slope *= max(1.0 - here[_frenet.KAPPA] * d0, 0.25)
    aside = _stray(d0 - lane[0])
    ease = max(reach, view[_view.OWN_V] * np.sqrt(6.0 * abs(aside) / EASE_LATERAL))
    rise = ease * _stray(slope - (lane[1] - lane[0]) / step)
    # The car has the grip that the line needs at this scale, and more at slow scales.
    grip = within_grip(view, GRIP * max(scale * scale, 1.0))
    braking = 2.0 * step * min(COMFORT * grip / GRIP, BRAKING)
    square = 1e9
    for i in range(LANE_POINTS):
        j = LANE_POINTS - 1 - i
        sample = line[line_index(track, s0 + j * step)]
        inner = min(max(j, BEND), LANE_POINTS - 1 - BEND)
        d_bend = (lane[inner + BEND] - 2.0 * lane[inner] + lane[inner - BEND]) / (
            BEND * BEND * step * step
        )
        kappa = sample[_frenet.KAPPA] / max(1.0 - sample[_frenet.KAPPA] * lane[j], 0.25) + d_bend
        square = min(square + braking, grip / max(abs(kappa), 1e-6))
        if j < _view.PATH_POINTS:
            u = j * step / ease
            q = 1.0 - u
            d = lane[j] + q * q * ((1.0 + 2.0 * u) * aside + u * rise)
            back = ((12.0 * u - 6.0) * aside + (6.0 * u - 4.0) * rise) / (ease * ease)
            x, y, _ = _frenet.offset(line, ds, length, s0 + j * step, d)
            speed = min(scale * sample[_frenet.SPEED], np.sqrt(square), cap)
            write_point(path, j, x, y, speed, kappa + back)


@kernel
def follow_plan(track, view, d, along, across, scale, cap, lane, memory, path):
    """Lay and save the lane of a plan, and write the path onto it.

    The arguments are as for `lay_lane`, `keep_lane` and `ease_onto`.
    """
    lay_lane(view, d, along, across, lane)
    keep_lane(view, lane, memory)
    ease_onto(track, view, scale, cap, lane, path)


@kernel
def hold_back(track, view, scale, along, step, path):
    """Take a path's speeds from a plan where the plan is held up.

    ``along`` (m) holds the plan's places, every ``step`` s.
    """
    last, k = along.shape[0] - 1, 0
    for j in range(_view.PATH_POINTS):
        while k < last and along[k] < j * lane_step(view):
            k += 1
        v = (along[k] - (along[k - 1] if k > 0 else 0.0)) / step
        profile = scale * track.line[line_index(track, view[_view.OWN_S] + along[k]), _frenet.SPEED]
        if v < 0.97 * profile and v < view[_view.OWN_V]:
            path[j, _view.PATH_SPEED] = min(path[j, _view.PATH_SPEED], v)
