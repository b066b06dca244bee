"""Lane switcher: race line or overtaking lane, after the winner of the F1TENTH race at ICRA 2022.

The planner drives on the race line, and on straights changes to a second lane when a slower
opponent blocks the race line. The second lane lies on the side of the race line with more room,
some way off the wall. The steering is proportional to the pursuit error of a look-ahead point, with
a derivative part on straights. ``plan`` chooses the lane ten times a second; ``control`` steers
fifty times a second. The planner's numbers are parameters; 20 variants, named "0" to "19", surround
the default.

Races against moving cars need some differences from the original:

- The speed from lane to lane is limited, and so is the closing speed during a lane change.
- A lane change needs 10 m of second lane ahead; where the second lane ends early, the car drops
  back behind the opponent.
- Next to an opponent that is nearer to the race line, the car keeps its lateral position.
- The pursuit error is measured from the car's course, and the understeer is added to the steering.
- The max look-ahead is 1.3 m instead of 2.0 m, and the second lane lies 0.38 m from the wall
  instead of 0.3 m: race lines with 0.15 m of air leave little room for cutting corners.
"""

from pcs_racing.base.compilation import compiled
from pcs_racing.base.elementary import sine_cosine
from pcs_racing.planners import view as _view
from pcs_racing.planners.line import (
    FOLLOW_GAIN,
    IN_THE_WAY,
    WALL_MARGIN,
    gap_ahead,
    gives_way,
    line_index,
    sharpest_bend,
    side_air,
    within_walls,
)
from pcs_racing.planners.planner import Parameter, Planner
from pcs_racing.planners.pursuit import calm_speed, limited_steering, pursuit_arc, write_point
from pcs_racing.track import frenet as _frenet

PARAMETERS = (
    Parameter(
        "speed", 0.65, 0.86, 0.82, "share of the profile's speed at the race's fastest scale"
    ),
    Parameter("lookahead_slow", 0.3, 1.0, 0.5, "look-ahead distance at standstill, m"),
    Parameter("lookahead_fast", 1.0, 1.7, 1.3, "look-ahead distance at 7 m/s, m"),
    Parameter("gain_slow", 0.4, 1.0, 0.7, "steering per pursuit error at standstill, rad m"),
    Parameter("gain_fast", 0.3, 0.6, 0.4, "steering per pursuit error at 7 m/s, rad m"),
    Parameter("gain_corner", 0.2, 0.6, 0.3, "steering per pursuit error in corners, rad m"),
    Parameter(
        "derivative",
        1.0,
        4.0,
        2.0,
        "steering per change of the error within 0.02 s, rad m; outside corners",
    ),
    Parameter(
        "blocking_distance",
        0.2,
        0.6,
        0.3,
        "distance of the opponent's box from a lane that blocks it, m",
    ),
    Parameter(
        "notice_time",
        0.5,
        2.0,
        1.0,
        "time within which the opponent could be reached, at 3 m/s or more, s",
    ),
    Parameter(
        "return_count",
        1.0,
        20.0,
        7.0,
        "decisions that the race line must be free before returning to it",
    ),
    Parameter("follow_factor", 0.6, 1.0, 0.8, "share of the opponent's speed while following it"),
    Parameter(
        "other_lane_factor", 0.5, 1.0, 0.6, "share of the race line's speed on the overtaking lane"
    ),
)
SPEED_SHARE, LOOKAHEAD_SLOW, LOOKAHEAD_FAST, GAIN_SLOW, GAIN_FAST, GAIN_CORNER = range(6)
DERIVATIVE, BLOCKING_DISTANCE, NOTICE_TIME, RETURN_COUNT, FOLLOW_FACTOR, OTHER_LANE_FACTOR = range(
    6, len(PARAMETERS)
)

VARIANTS = 20
VARIATION = 0.5  # share of the range from the default to the bounds, filled by the variants

FAST = 7.0  # m/s; at this speed the look-ahead and the gain reach their second value
NOTICE_SPEED = 3.0  # m/s
STEER_LIMIT = 0.3  # rad
CORNER = 0.3  # 1/m, min curvature of a corner
ZONE = 6  # m of race line without corners ahead, needed on the overtaking lane
ENTRY = 10  # m of race line without corners and with room for the lane, needed to change to it
FOLLOW_DISTANCE = 0.9  # m between the cars' centres while crossing behind the opponent
YIELD = 0.8  # share of the opponent's speed for dropping back behind it
MAX_OFFSET = 1.0  # max distance between the two lanes, m
MIN_OFFSET = 0.45  # min distance, m; without room for it there is no second lane
SMOOTHING = 1.5  # m to either side, averaged for the lane
SMOOTHING_POINTS = 7
CROSSING_SPEED = 1.2  # m/s, lateral speed from lane to lane
SPEED_PREVIEW = 0.1  # s

# Lanes: race line, overtaking lane, and the car's own lateral position (no lane).
RACE_LINE, OVERTAKING, OWN_PLACE = 0.0, 1.0, 2.0

# Memory: the lane; the side of the overtaking lane (-1 right, 1 left); the lateral position of the
# steering target on its way from lane to lane, m from the race line; consecutive decisions with a
# free race line; max speed while following (below 0: none); the previous error; 1 once the race has
# begun.
_LANE, _SIDE, _PLACE, _FREE_COUNT, _MAX_SPEED, _ERROR, _BEGUN = range(7)
MEMORY = 7


@compiled
def lane_offset(track, s, side):
    """Return the distance (m) of the overtaking lane from the race line at an arc length.

    The lane lies on one ``side`` (-1 right, 1 left). Where there is room, the lane keeps
    ``WALL_MARGIN`` to the wall and lies at most ``MAX_OFFSET`` from the race line, averaged over
    3 m of track. Without room, the lane runs into the race line.
    """
    column = _frenet.LEFT if side > 0.0 else _frenet.RIGHT
    total = 0.0
    for k in range(SMOOTHING_POINTS):
        at = s + SMOOTHING * (2.0 * k / (SMOOTHING_POINTS - 1) - 1.0)
        total += min(max(track.line[line_index(track, at), column] - WALL_MARGIN, 0.0), MAX_OFFSET)
    # The average of a narrowing passage must not reach into its wall.
    room = max(track.line[line_index(track, s), column] - WALL_MARGIN, 0.0)
    return min(total / SMOOTHING_POINTS, room)


@compiled
def _room(track, s, side, reach):
    """Return the min offset (m) of the overtaking lane within ``reach`` metres ahead."""
    least = MAX_OFFSET
    for k in range(reach + 1):
        least = min(least, lane_offset(track, s + k, side))
    return least


@compiled
def _in_zone(track, s, reach):
    """Return whether the race line is free of corners for ``reach`` metres."""
    return sharpest_bend(track, s, reach, 0.25) <= CORNER


@compiled
def _lane_d(track, memory, lane, s):
    """Return the distance (m) of a lane from the race line at an arc length."""
    if lane == OVERTAKING:
        return memory[_SIDE] * lane_offset(track, s, memory[_SIDE])
    return memory[_PLACE] if lane == OWN_PLACE else 0.0


@compiled
def _blocked(track, theta, view, memory, lane):
    """Return whether a corner of the opponent's box lies near a lane."""
    n, c = sine_cosine(view[_view.OPP_PSI])
    for k in range(4):
        u = 0.5 * view[_view.OPP_LENGTH] if k in (0, 3) else -0.5 * view[_view.OPP_LENGTH]
        w = 0.5 * view[_view.OPP_WIDTH] if k < 2 else -0.5 * view[_view.OPP_WIDTH]
        x = view[_view.OPP_X] + u * c - w * n
        y = view[_view.OPP_Y] + u * n + w * c
        s, d = _frenet.project(track, x, y, view[_view.OPP_S])
        if abs(d - _lane_d(track, memory, lane, s)) < theta[BLOCKING_DISTANCE]:
            return True
    return False


@compiled
def _choose_lane(track, theta, view, memory):
    """Return the lane to drive on, and update the count, the side and the speed limit in the
    memory.
    """
    s = view[_view.OWN_S]
    gap = gap_ahead(track, view)
    ahead = 0.0 < gap < theta[NOTICE_TIME] * max(view[_view.OWN_V], NOTICE_SPEED)
    beside = abs(gap) < view[_view.OWN_LENGTH] + view[_view.OPP_LENGTH]
    line_blocked = (ahead or beside) and _blocked(track, theta, view, memory, RACE_LINE)
    memory[_FREE_COUNT] = 0.0 if line_blocked else memory[_FREE_COUNT] + 1.0
    memory[_MAX_SPEED] = -1.0
    lane = memory[_LANE]
    if lane == OVERTAKING:
        narrow = gap > 0.0 and _room(track, s, memory[_SIDE], ZONE) < MIN_OFFSET
        if narrow or (ahead and _blocked(track, theta, view, memory, OVERTAKING)):
            memory[_MAX_SPEED] = min(theta[FOLLOW_FACTOR], YIELD) * view[_view.OPP_V]
        elif ahead and side_air(view) < IN_THE_WAY:
            # Still crossing: a speed that leaves the time for it.
            memory[_MAX_SPEED] = max(view[_view.OPP_V] + FOLLOW_GAIN * (gap - FOLLOW_DISTANCE), 0.0)
        if beside and line_blocked:
            return OVERTAKING
        free = memory[_FREE_COUNT] >= theta[RETURN_COUNT]
        return RACE_LINE if free or narrow or not _in_zone(track, s, ZONE) else OVERTAKING
    if gives_way(view, gap):
        memory[_MAX_SPEED] = min(theta[FOLLOW_FACTOR], YIELD) * view[_view.OPP_V]
        return OWN_PLACE
    if ahead and line_blocked:
        if _in_zone(track, s, ENTRY):
            right, left = _room(track, s, -1.0, ENTRY), _room(track, s, 1.0, ENTRY)
            memory[_SIDE] = 1.0 if left + view[_view.OWN_D] > right - view[_view.OWN_D] else -1.0
            room = left if memory[_SIDE] > 0.0 else right
            if room > MIN_OFFSET and not _blocked(track, theta, view, memory, OVERTAKING):
                return OVERTAKING
        memory[_MAX_SPEED] = theta[FOLLOW_FACTOR] * view[_view.OPP_V]
    return RACE_LINE


@compiled(forceinline=True)
def _lookahead(theta, v):
    share = min(max(v / FAST, 0.0), 1.0)
    return theta[LOOKAHEAD_SLOW] + share * (theta[LOOKAHEAD_FAST] - theta[LOOKAHEAD_SLOW])


@compiled(forceinline=True)
def _speed(track, theta, view, memory, s):
    factor = theta[OTHER_LANE_FACTOR] if memory[_LANE] == OVERTAKING else 1.0
    speed = (
        factor
        * theta[SPEED_SHARE]
        * view[_view.SPEED_HIGH]
        * track.line[line_index(track, s), _frenet.SPEED]
    )
    return min(speed, memory[_MAX_SPEED]) if memory[_MAX_SPEED] >= 0.0 else speed


@compiled
def plan(track, theta, view, memory, scratch, path):
    """Choose the lane, and write its next piece for replays."""
    s0 = view[_view.OWN_S]
    if memory[_BEGUN] == 0.0:
        memory[_BEGUN] = 1.0
        memory[_PLACE] = view[_view.OWN_D]
    memory[_LANE] = _choose_lane(track, theta, view, memory)
    step = 1.5 * _lookahead(theta, view[_view.OWN_V]) / (_view.PATH_POINTS - 1)
    for j in range(_view.PATH_POINTS):
        s = s0 + j * step
        x, y, _ = _frenet.to_cartesian(
            track, s, within_walls(track, s, memory[_PLACE], WALL_MARGIN)
        )
        kappa = track.line[line_index(track, s), _frenet.KAPPA]
        write_point(path, j, x, y, _speed(track, theta, view, memory, s), kappa)


@compiled
def control(track, theta, view, memory, scratch, path, command):
    """Steer for a point on the lane, and remember the error for the derivative part."""
    v = view[_view.OWN_V]
    s0 = view[_view.OWN_S]
    s = s0 + _lookahead(theta, v)
    crossed = 0.02 * CROSSING_SPEED
    memory[_PLACE] += min(
        max(_lane_d(track, memory, memory[_LANE], s) - memory[_PLACE], -crossed), crossed
    )
    x, y, _ = _frenet.to_cartesian(track, s, within_walls(track, s, memory[_PLACE], WALL_MARGIN))
    ahead = track.line[line_index(track, s), _frenet.KAPPA]
    error = pursuit_arc(view, x, y, ahead)
    kappa = track.line[line_index(track, s0), _frenet.KAPPA]
    if max(abs(kappa), abs(ahead)) > CORNER:
        steer = theta[GAIN_CORNER] * error
    else:
        share = min(max(v / FAST, 0.0), 1.0)
        steer = (theta[GAIN_SLOW] + share * (theta[GAIN_FAST] - theta[GAIN_SLOW])) * error
        if view[_view.TIME] > 0.0:
            steer += theta[DERIVATIVE] * (error - memory[_ERROR])
    memory[_ERROR] = error
    speed = _speed(track, theta, view, memory, s0 + SPEED_PREVIEW * v)
    command[1], acceleration = calm_speed(view, speed)
    steer += (view[_view.UNDERSTEER] + view[_view.UNDERSTEER_GAIN] * acceleration) * v * v * kappa
    command[0] = limited_steering(view, min(max(steer, -STEER_LIMIT), STEER_LIMIT))


def _variants() -> dict[str, tuple[float, ...]]:
    """Return parameter vectors spread evenly around the default, by name.

    The vectors are points of the additive sequence of the generalised golden ratio. They need no
    random numbers, and so never change.
    """
    size = len(PARAMETERS)
    ratio = 2.0
    for _ in range(64):
        ratio = (1.0 + ratio) ** (1.0 / (size + 1))
    variants = {}
    for i in range(VARIANTS):
        values = []
        for j, parameter in enumerate(PARAMETERS):
            place = 2.0 * ((0.5 + (i + 1) * ratio ** -(j + 1.0)) % 1.0) - 1.0
            bound = parameter.high if place > 0.0 else parameter.low
            values.append(
                round(parameter.default + VARIATION * abs(place) * (bound - parameter.default), 3)
            )
        values[RETURN_COUNT] = round(values[RETURN_COUNT])
        variants[str(i)] = tuple(values)
    return variants


LANE_SWITCHER = Planner(
    name="lane-switcher",
    parameters=PARAMETERS,
    plan=plan,
    control=control,
    memory_size=MEMORY,
    variants=_variants(),
)
"""Planner with two lanes, after the winner of ICRA 2022."""
