"""Bimatrix game of racing [1]_: both cars choose from a few trajectories and anticipate each other.

Ten times a second each car has trajectories to several positions across the track at several
speeds, including the speed of following. The payoff of a pair of trajectories is the progress of a
car, minus a cost of leaving the race line. A collision costs the car behind, whose duty it is to
avoid it, and, as far as the game is cooperative, the car ahead too. In the blocking game the car
ahead is paid for staying ahead. The game is solved for its Stackelberg equilibrium with the car
ahead as the leader, and played again at the next plan.

Differences: trajectories are cubics along the race line instead of trajectories of a viability
kernel; the opponent is assumed to keep its own share of the profile, or to be slower, and to prefer
its current position across the track; Nash equilibria are left out, because the leader's favourite
Nash equilibrium drove the same races.

References
----------
.. [1] A. Liniger and J. Lygeros, "A noncooperative game approach to autonomous racing", IEEE
   Transactions on Control Systems Technology 28(3), 2020, arXiv:1712.03913.
"""

from typing import NamedTuple

import numpy as np

from pcs_racing.base.compilation import inner_kernel, kernel
from pcs_racing.planners import line as _line, view as _view
from pcs_racing.planners.planner import Parameter, Planner, offsets
from pcs_racing.planners.pursuit import within_grip
from pcs_racing.track import frenet as _frenet

PARAMETERS = (
    *_line.TRAILING,
    Parameter(
        "cooperation", 0.0, 1.0, 0.3, "share of the cost of a collision that the car ahead bears"
    ),
    Parameter("blocking", 0.0, 10.0, 0.0, "payoff of staying ahead for the car ahead, m"),
    Parameter(
        "side_weight",
        0.1,
        5.0,
        1.0,
        "cost of a metre of mean distance from the line, m of progress",
    ),
    Parameter("wall_air", 0.05, 0.5, 0.15, "clearance to walls off the race line, m"),
    Parameter("opponent_air", 0.05, 0.6, 0.25, "clearance to the opponent, m"),
)
COOPERATION, BLOCKING, SIDE, WALL_AIR, OPPONENT_AIR = range(len(_line.TRAILING), len(PARAMETERS))

PLACES, PLACE_STEP = 5, 0.62  # lateral end positions and spacing, m; the middle one is preferred
SPEEDS = 2  # speed of the profile, and speed of following
PART = 0.8  # factor of the speed for a car that follows though it is ahead
MOVES = PLACES * SPEEDS
STEPS, STEP = 8, 0.25  # number, length in s
MAX_ACCELERATION, MAX_BRAKING = 6.0, 4.5  # m/s^2
GRIP = 1.3 * _line.GRIP  # m/s^2 across the track
COLLISION, IMPOSSIBLE, KEPT = 20.0, 1e3, 0.3  # m: costs, and the bonus of the last choice
SIGHT = 12.0  # max distance of the opponent in the game, m
AIR_LATER = 2  # first steps without full clearance to the opponent

# Memory: the lane, and the last chosen position, counted from 1.
_, _CHOSEN, MEMORY = offsets(_line.KEPT_LANE, 1)
# Scratch: arc lengths and distances from the line of each trajectory of both cars at the steps, and
# its value alone; the payoffs of both cars; the lane.
_S, _D, _VALUE, _OWN, _OPP, _LANE, SCRATCH = offsets(
    2 * MOVES * STEPS,
    2 * MOVES * STEPS,
    2 * MOVES,
    MOVES * MOVES,
    MOVES * MOVES,
    _line.LANE_SIZE,
)


class _Car(NamedTuple):
    """A car at the begin of its trajectories."""

    number: int  #: 0 for the own car, 1 for the opponent.
    begin: float  #: Arc length from the own car on, m.
    v: float  #: Speed, m/s.
    d: float  #: Distance from the race line, m.
    home: float  #: Preferred distance from the race line, m.
    slope: float  #: Change of the distance along the line.
    scale: float  #: Factor of the speed profile.
    follow: float  #: Max speed of the moves that follow, m/s.


@inner_kernel
def _trajectories(track, theta, view, car, scratch):
    """Write the trajectories of a car."""
    s0, reach = view[_view.OWN_S], max(3.0, 1.2 * car.v)
    begin, d, home, scale = car.begin, car.d, car.home, car.scale
    grip = within_grip(view, GRIP * max(scale * scale, 1.0))
    keep = 0.5 * view[_view.OWN_WIDTH] + theta[WALL_AIR]
    for move in range(MOVES):
        first, speed, aside, fits = (car.number * MOVES + move) * STEPS, car.v, 0.0, True
        end = home + (move % PLACES - PLACES // 2) * PLACE_STEP
        along, sample = begin, track.line[_line.line_index(track, s0 + begin)]
        for k in range(STEPS):
            wanted = min(scale * sample[_frenet.SPEED], car.follow if move >= PLACES else np.inf)
            speed = max(
                min(wanted, speed + STEP * MAX_ACCELERATION), speed - STEP * MAX_BRAKING, 0.0
            )
            along += STEP * speed
            u = min((along - begin) / reach, 1.0)
            q = 1.0 - u
            across = end + q * q * ((1.0 + 2.0 * u) * (d - end) + u * reach * car.slope)
            bend = (6.0 - 12.0 * u) * (end - d) / (reach * reach) if u < 1.0 else 0.0
            sample = track.line[_line.line_index(track, s0 + along)]
            off = abs(across) > _line.ON_LINE
            wall = across > sample[_frenet.LEFT] - keep or -across > sample[_frenet.RIGHT] - keep
            slips = abs(sample[_frenet.KAPPA] + bend) * speed * speed > grip
            fits = fits and not (off and (wall or (slips and k > 0)))
            scratch[_S + first + k], scratch[_D + first + k] = along, across
            aside += abs(across - home) / STEPS
        value = along - begin - theta[SIDE] * aside - (0.0 if fits else IMPOSSIBLE)
        scratch[_VALUE + car.number * MOVES + move] = value


@inner_kernel
def _collision(view, air, own, opponent, scratch):
    """Return the cost (m) of a collision of two trajectories: higher if sooner, 0 if none."""
    long = 0.5 * (view[_view.OWN_LENGTH] + view[_view.OPP_LENGTH]) + 0.1
    wide = 0.5 * (view[_view.OWN_WIDTH] + view[_view.OPP_WIDTH])
    a, b = own * STEPS, (MOVES + opponent) * STEPS
    for k in range(STEPS):
        room = wide + (air if k >= AIR_LATER else 0.0)
        across = abs(scratch[_D + a + k] - scratch[_D + b + k])
        if across < room and abs(scratch[_S + a + k] - scratch[_S + b + k]) < long:
            return COLLISION * (1.5 - k / STEPS)
    return 0.0


@inner_kernel
def _payoffs(theta, view, leads, last, scratch):
    """Write the payoffs of both cars for every pair of trajectories."""
    for i in range(MOVES):
        for j in range(MOVES):
            own = scratch[_VALUE + i] + (KEPT if i % PLACES + 1 == last else 0.0)
            opponent = scratch[_VALUE + MOVES + j]
            if own > -0.5 * IMPOSSIBLE and opponent > -0.5 * IMPOSSIBLE:
                cost = _collision(view, theta[OPPONENT_AIR], i, j, scratch)
                own -= cost * (theta[COOPERATION] if leads else 1.0)
                opponent -= cost * (1.0 if leads else theta[COOPERATION])
            ahead = scratch[_S + (i + 1) * STEPS - 1] > scratch[_S + (MOVES + j + 1) * STEPS - 1]
            own += theta[BLOCKING] if leads and ahead else 0.0
            opponent += theta[BLOCKING] if not leads and not ahead else 0.0
            scratch[_OWN + i * MOVES + j], scratch[_OPP + i * MOVES + j] = own, opponent


@kernel
def solve(own, opponent, leads):
    """Return the own move in the Stackelberg equilibrium.

    Payoffs have shape (MOVES * MOVES,); own moves are rows.
    """
    chosen, best = 0, -np.inf
    for move in range(MOVES):
        # The follower's best column against the leader's row, or best row against its column.
        reply = int(np.argmax(opponent[move * MOVES :][:MOVES] if leads else own[move::MOVES]))
        value = own[move * MOVES + reply] if leads else opponent[reply * MOVES + move]
        if value > best:
            best, chosen = value, move if leads else reply
    return chosen


@kernel
def plan(track, theta, view, memory, scratch, path):
    """Play the game if the opponent is near, and drive the own trajectory."""
    gap, scale, lane = (
        _line.gap_ahead(track, view),
        _line.speed_scale(view, theta[0]),
        scratch[_LANE:SCRATCH],
    )
    if abs(gap) > SIGHT:
        memory[0] = memory[_CHOSEN] = 0.0
        cap = _line.follow_line(track, theta, view, gap, SIGHT, lane)
        _line.ease_onto(track, view, scale, cap, lane, path)
        return
    d, slope, goes_on = _line.last_lane(track, view, memory)
    if not goes_on:
        d, slope = view[_view.OWN_D], 0.0
    opp_v = view[_view.OPP_V]
    follow = _line.trailing_speed(theta, view, gap) if gap > 0.0 else PART * view[_view.OWN_V]
    opp_scale = opp_v / track.line[_line.line_index(track, view[_view.OWN_S] + gap), _frenet.SPEED]
    opp_slope = view[_view.OPP_D_DOT] / max(opp_v, 1.0)
    own = _Car(0, 0.0, view[_view.OWN_V], d, 0.0, slope, scale, follow)
    _trajectories(track, theta, view, own, scratch)
    behind = view[_view.OWN_V] if gap < 0.0 else PART * opp_v
    opp_d = view[_view.OPP_D]
    opponent = _Car(1, gap, opp_v, opp_d, opp_d, opp_slope, opp_scale, behind)
    _trajectories(track, theta, view, opponent, scratch)
    leads = gap < 0.0
    _payoffs(theta, view, leads, memory[_CHOSEN], scratch)
    move = solve(scratch[_OWN:_OPP], scratch[_OPP:_LANE], leads)
    memory[_CHOSEN] = move % PLACES + 1.0
    along, across = scratch[_S + move * STEPS :][:STEPS], scratch[_D + move * STEPS :][:STEPS]
    cap = follow if move >= PLACES else np.inf
    _line.follow_plan(track, view, d, along, across, scale, cap, lane, memory, path)


BIMATRIX = Planner(
    name="bimatrix-game",
    parameters=PARAMETERS,
    plan=plan,
    memory_size=MEMORY,
    scratch_size=SCRATCH,
    variants={"blocks": {"blocking": 3.0}, "sequential": {"cooperation": 0.0}},
)
"""The bimatrix game of two cars."""
