"""Lane switcher: race line or overtaking lane, after the winner of the F1TENTH race at ICRA 2022.

The planner drives on the race line, and on straights changes to a second lane when a slower
opponent blocks the race line. The second lane lies on the side of the race line with more room. It
returns when the race line was free for some decisions, and where the second lane ends. The
planner's numbers are parameters; 20 variants, named "0" to "19", surround the default.

The original steers by the pursuit error of a point on the lane, with a gain for straights and one
for corners. That leaves the road at the speeds of other planners here, and hits the car in front.
So lanes are costs: the car drives the cheapest candidate of the lattice
(:mod:`pcs_racing.planners.candidates`), which grows dearer with the square of its end's distance
from the lane. Walls, grip and the other car are the lattice's costs; the lane is the planner's own.
"""

from pcs_racing.base.compilation import inner_kernel, kernel
from pcs_racing.base.elementary import sine_cosine
from pcs_racing.planners import candidate_rows as rows, candidates as _candidates, view as _view
from pcs_racing.planners.candidate_rows import CANDIDATES, GOALS, SCRATCH
from pcs_racing.planners.lattice import LATTICE, choose
from pcs_racing.planners.line import WALL_MARGIN, gap_ahead, line_index, sharpest_bend
from pcs_racing.planners.planner import Parameter, Planner, offsets
from pcs_racing.track import frenet as _frenet

PARAMETERS = (
    Parameter(
        "pace",
        0.6,
        1.0,
        0.98,
        "speed scale between the slowest (0) and fastest (1) of the race's speed range",
    ),
    Parameter("lane_weight", -1.0, 1.5, 1.2, "log10 weight of the squared distance from the lane"),
    Parameter("side_margin", 0.1, 0.4, 0.11, "clearance to the opponent, m"),
    Parameter(
        "blocking_distance",
        0.2,
        0.6,
        0.33,
        "distance of the opponent's box from a lane that blocks it, m",
    ),
    Parameter(
        "notice_time",
        0.5,
        2.0,
        0.95,
        "time within which the opponent could be reached, at 3 m/s or more, s",
    ),
    Parameter(
        "return_count",
        1.0,
        20.0,
        3.0,
        "decisions that the race line must be free before returning to it",
    ),
)
PACE, LANE_WEIGHT, SIDE_MARGIN, BLOCKING_DISTANCE, NOTICE_TIME, RETURN_COUNT = range(
    len(PARAMETERS)
)

VARIANTS = 20
VARIATION = 0.5  # share of the range from the default to the bounds, filled by the variants

NOTICE_SPEED = 3.0  # m/s
CORNER = 0.3  # 1/m, min curvature of a corner
ZONE = 6  # m of race line without corners ahead, needed on the overtaking lane
ENTRY = 10  # m of race line without corners and with room for the lane, needed to change to it
MAX_OFFSET = 1.0  # max distance between the two lanes, m
MIN_OFFSET = 0.45  # min distance, m; without room for it there is no second lane
SMOOTHING = 1.5  # m to either side, averaged for the lane
SMOOTHING_POINTS = 7

RACE_LINE, OVERTAKING = 0.0, 1.0  # lanes

# Memory, after the lattice's: the lane; the side of the overtaking lane (-1 right, 1 left);
# consecutive decisions with a free race line.
_, _LANE, _SIDE, _FREE_COUNT, MEMORY = offsets(_candidates.MEMORY, 1, 1, 1)
_, _THETA, TOTAL = offsets(SCRATCH, len(LATTICE.parameters))  # parameters of the lattice
WEIGHTS = tuple(LATTICE.policy({"deviation": -1.5, "pace_behind": 0.0}).parameters.tolist())


@kernel
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


@kernel
def _room(track, s, side, reach):
    """Return the min offset (m) of the overtaking lane within ``reach`` metres ahead."""
    least = MAX_OFFSET
    for k in range(reach + 1):
        least = min(least, lane_offset(track, s + k, side))
    return least


@kernel
def _in_zone(track, s, reach):
    """Return whether the race line is free of corners for ``reach`` metres."""
    return sharpest_bend(track, s, reach, 0.25) <= CORNER


@kernel
def _lane_d(track, memory, lane, s):
    """Return the distance (m) of a lane from the race line at an arc length."""
    return memory[_SIDE] * lane_offset(track, s, memory[_SIDE]) if lane == OVERTAKING else 0.0


@kernel
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


@kernel
def choose_lane(track, theta, view, memory):
    """Choose the lane to drive on, and write it with its side and the count into the memory."""
    s, gap = view[_view.OWN_S], gap_ahead(track, view)
    ahead = 0.0 < gap < theta[NOTICE_TIME] * max(view[_view.OWN_V], NOTICE_SPEED)
    near = ahead or abs(gap) < view[_view.OWN_LENGTH] + view[_view.OPP_LENGTH]
    line_blocked = near and _blocked(track, theta, view, memory, RACE_LINE)
    memory[_FREE_COUNT] = 0.0 if line_blocked else memory[_FREE_COUNT] + 1.0
    if memory[_LANE] == OVERTAKING:
        narrow = gap > 0.0 and _room(track, s, memory[_SIDE], ZONE) < MIN_OFFSET
        free = memory[_FREE_COUNT] >= theta[RETURN_COUNT]
        if free or narrow or not _in_zone(track, s, ZONE):
            memory[_LANE] = RACE_LINE
    elif ahead and line_blocked and _in_zone(track, s, ENTRY):
        right, left = _room(track, s, -1.0, ENTRY), _room(track, s, 1.0, ENTRY)
        memory[_SIDE] = 1.0 if left + view[_view.OWN_D] > right - view[_view.OWN_D] else -1.0
        room = left if memory[_SIDE] > 0.0 else right
        if room > MIN_OFFSET and not _blocked(track, theta, view, memory, OVERTAKING):
            memory[_LANE] = OVERTAKING


@inner_kernel
def _prefer_lane(track, weight, view, memory, scratch):
    """Add the cost of the lane to every candidate."""
    for g in range(GOALS):
        end = view[_view.OWN_S] + scratch[rows.LENGTH + g]
        away = scratch[rows.GOAL_D + g] - _lane_d(track, memory, memory[_LANE], end)
        for c in range(g, CANDIDATES, GOALS):
            scratch[rows.MIN_COST + c] += weight * away * away


@kernel
def plan(track, theta, view, memory, scratch, path):
    """Choose the lane, and write the path of the cheapest candidate."""
    choose_lane(track, theta, view, memory)
    lattice = scratch[_THETA:TOTAL]
    for k in range(len(WEIGHTS)):
        lattice[k] = WEIGHTS[k]
    lattice[_candidates.PACE] = theta[PACE]
    lattice[_candidates.SIDE_MARGIN] = theta[SIDE_MARGIN]
    now = _candidates.situation(track, lattice, view, memory)
    laid = _candidates.lay_candidates(track, lattice, view, memory, now, scratch)
    weight = _candidates.power_of_ten(theta[LANE_WEIGHT])
    _prefer_lane(track, weight, view, memory, scratch)
    chosen = choose(lattice, laid, 0.0, scratch)
    _candidates.take(track, view, memory, laid, now.attacks, scratch, chosen, path)


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
    memory_size=MEMORY,
    scratch_size=TOTAL,
    variants=_variants(),
    sight=_candidates.SIGHT,
)
"""Planner with two lanes, after the winner of ICRA 2022."""
