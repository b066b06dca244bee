"""Alpha-RACER [1]_: both cars' driving parameters, five each, maximise a potential of their game.

The parameters of a car are a factor of its speed, a look-ahead (how soon it reaches its target
position across the track), the passing distance to the other car, the distance where a pass begins,
and how much it moves in front of a car behind. Ten times a second both cars get a few samples of
them, and every pair of samples is simulated. The payoff of a pair to a car is its progress minus
the other car's progress and the costs of collisions, of walls and of leaving the race line. In a
potential game, one function of both choices, the potential, changes as much as the payoff of the
car that changes its choice. The equilibria are at the maximum of the potential. So the car drives
its part of the pair with the max potential.

Differences: the potential is not learned offline by a network. It is the potential of the potential
game nearest to the sampled game, in closed form by a least-squares projection [2]_. Cars are
simulated for 3 s along the race line instead of being valued over a whole race; each approaches its
position across the track like a damped spring. The opponent is assumed to keep its own share of the
profile, and not to make way for a car behind. There are two cars instead of three.

References
----------
.. [1] D. Kalaria, C. Maheshwari and S. Sastry, "alpha-RACER: Real-time algorithm for game-theoretic
   motion planning and control in autonomous racing using near-potential function", L4DC, 2025,
   arXiv:2412.08855.
.. [2] O. Candogan, I. Menache, A. Ozdaglar and P. Parrilo, "Flows and decompositions of games:
   harmonic and potential games", Mathematics of Operations Research 36(3), 2011.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.compilation import inner_kernel, kernel
from pcs_racing.base.elementary import exponential
from pcs_racing.planners import line as _line, view as _view
from pcs_racing.planners.planner import Parameter, Planner, offsets
from pcs_racing.planners.pursuit import within_grip
from pcs_racing.track import frenet as _frenet

_PACE, _GAP, _P, _D = range(len(_line.TRAILING))
PARAMETERS = (
    _line.PACE,
    replace(_line.TRAILING[_GAP], default=1.1),
    replace(_line.TRAILING[_P], default=1.0),
    _line.TRAILING[_D],
    Parameter("speed_factor", 0.7, 1.0, 0.95, "min factor of the speed among the samples"),
    Parameter(
        "look_ahead",
        1.0,
        4.0,
        2.2,
        "max time among the samples to reach a place across the track, s",
    ),
    Parameter("shift", 0.1, 1.0, 0.25, "max clearance to the opponent among the samples, m"),
    Parameter(
        "shift_range",
        3.0,
        12.0,
        6.0,
        "max distance at the beginning of a pass among the samples, m",
    ),
    Parameter(
        "blocking",
        0.0,
        1.0,
        0.5,
        "max share among the samples of the way in front of a car behind",
    ),
    Parameter("rivalry", 0.0, 1.0, 0.8, "cost of a metre of the opponent's progress, m"),
    Parameter(
        "side_weight",
        0.1,
        5.0,
        0.8,
        "cost of a metre of mean distance from the line, m of progress",
    ),
    Parameter("wall_air", 0.05, 0.5, 0.15, "clearance to walls off the race line, m"),
    Parameter("opponent_air", 0.05, 0.6, 0.25, "clearance to the opponent, m"),
)
SPEED, LOOK, SHIFT, RANGE, BLOCKING, RIVALRY, SIDE, WALL_AIR, OPPONENT_AIR = range(
    _D + 1, len(PARAMETERS)
)

SAMPLES = 12  # per car: a third pass right, a third stay, a third pass left
NUMBERS = 5
_ROOT = 1.1347241384015194  # root of x^6 = x + 1: its powers are a 5-D low-discrepancy sequence
_POINTS = (0.5 + np.arange(SAMPLES)[:, None] / np.cumprod(np.full(NUMBERS, _ROOT))) % 1.0
_F, _T, _SHIFT, _RANGE, _BLOCK = range(NUMBERS)

STEPS, STEP, FINE = 12, 0.25, 0.08  # number, length in the game and in the driven plan (s)
MAX_ACCELERATION, MAX_BRAKING = 6.0, 4.5  # m/s^2
COLLISION, WALL, KEPT = 15.0, 4.0, 0.3  # m: costs, and the bonus of the last choice
BEHIND = 6.0  # max distance of a blocked car behind, m
SIGHT = 12.0  # max distance of the opponent in the game, m
PLACES, SPACE, BACK = 120, 0.5, 14.0  # rows of the table, spacing (m), reach behind the car (m)
EASE = 0.1  # max change of the free widths, m per m
_SPEED, _KAPPA, _RIGHT, _LEFT = range(4)

# Memory: the lane, and the last chosen sample, counted from 1.
_, _CHOSEN, MEMORY = offsets(_line.KEPT_LANE, 1)
# Scratch: the samples of both cars; arc lengths and distances from the line of the own plan;
# payoffs of every pair to both cars; their means over each car's own samples; the table of the
# track; the lane.
_PAIRS = SAMPLES * SAMPLES
_, _PLAN, _VALUES, _MEANS, _TABLE, _LANE, SCRATCH = offsets(
    2 * SAMPLES * NUMBERS, 2 * STEPS, 2 * _PAIRS, 4 * SAMPLES, 4 * PLACES, _line.LANE_SIZE
)


@inner_kernel
def _draw(theta, clear, passes, samples):
    """Write the five parameters of all samples of a car.

    ``clear`` is the min passing distance, m. A car that is passed does not make way: it goes on,
    faster or slower, and may block.
    """
    for k in range(SAMPLES):
        own, point = samples[k * NUMBERS :], _POINTS[k]
        own[_F] = 1.0 - (1.0 - theta[SPEED]) * (point[_F] if k > 2 else 0.0)
        # Time constant: a quarter of the look-ahead, after which a tenth of the way is left.
        own[_T] = 0.125 * theta[LOOK] * (1.0 + point[_T])
        own[_SHIFT] = (k % 3 - 1.0) * (clear + theta[SHIFT] * point[_SHIFT]) if passes else 0.0
        own[_RANGE] = 0.5 * theta[RANGE] * (1.0 + point[_RANGE])
        own[_BLOCK] = theta[BLOCKING] * point[_BLOCK]


@inner_kernel(forceinline=True)
def _near(distance, reach):
    """Return 1 at distance 0, falling smoothly to 0 at the reach."""
    q = max(1.0 - (distance / reach) ** 2, 0.0)
    return q * q


@inner_kernel
def _lay_table(track, view, keep, table):
    """Write speed, curvature and eased free widths (m), from `BACK` m behind the car on."""
    for k in range(PLACES):
        sample, row = (
            track.line[_line.line_index(track, view[_view.OWN_S] + k * SPACE - BACK)],
            table[4 * k :],
        )
        row[_SPEED], row[_KAPPA] = sample[_frenet.SPEED], sample[_frenet.KAPPA]
        row[_RIGHT], row[_LEFT] = (
            min(keep - sample[_frenet.RIGHT], 0.0),
            max(sample[_frenet.LEFT] - keep, 0.0),
        )
    for k in range(PLACES - 1):
        for here, there in ((PLACES - 2 - k, PLACES - 1 - k), (k + 1, k)):
            for side, sign in ((_RIGHT, -1.0), (_LEFT, 1.0)):
                eased = sign * table[4 * there + side] + EASE * SPACE
                table[4 * here + side] = sign * min(sign * table[4 * here + side], eased)


@inner_kernel(forceinline=True)
def _row(table, s):
    """Return the index of the table row for an arc length (m) from the car on."""
    return 4 * min(max(int((s + BACK) / SPACE), 0), PLACES - 1)


class _Choice(NamedTuple):
    """A car with one of its samples."""

    five: NDArray[np.float64]  #: Parameters of the sample.
    decay: float  #: Share of a deviation that a step leaves.
    home: float  #: Distance from the race line that the car prefers, m.


class _Limits(NamedTuple):
    """Numbers of the game that hold for both cars."""

    dt: float  #: Length of a step, s.
    grip: float  #: Max lateral acceleration, m/s^2.
    long: float  #: Distance along the track below which the cars are level, m.
    wide: float  #: Distance across below which a car follows, m.


@inner_kernel(forceinline=True)
def _step(theta, table, limits, choice, car, other):
    """Return a car after a step, and the cost of the step."""
    five, dt = choice.five, limits.dt
    here, time, gap = table[_row(table, car.s) :], five[_T], other.s - car.s
    soon = table[_row(table, car.s + 2.0 * car.v * time) :]  # the spring lags
    place = choice.home
    if gap < -limits.long:
        place += five[_BLOCK] * _near(gap, BEHIND) * (other.d - choice.home)
    elif five[_SHIFT] != 0.0:
        place += _near(gap, five[_RANGE]) * (other.d + five[_SHIFT] - choice.home)
    place = min(max(place, here[_RIGHT], soon[_RIGHT]), here[_LEFT], soon[_LEFT])
    # The exact step of a critically damped spring.
    stray = car.d - place
    pull = car.rate + stray / time
    d = place + (stray + pull * dt) * choice.decay
    rate = (car.rate - pull * dt / time) * choice.decay
    stretch = max(1.0 - here[_KAPPA] * d, 0.25)
    wanted = min(
        five[_F] * car.scale * here[_SPEED],
        np.sqrt(limits.grip * stretch / max(abs(here[_KAPPA]), 1e-6)),
    )
    if gap > 0.0 and abs(other.d - d) < limits.wide:
        wanted = min(wanted, max(other.v + theta[_P] * (gap - theta[_GAP]), 0.0))
    v = max(min(wanted, car.v + dt * MAX_ACCELERATION), car.v - dt * MAX_BRAKING, 0.0)
    off = d < here[_RIGHT] - 0.05 or d > here[_LEFT] + 0.05
    cost = theta[SIDE] * abs(d - choice.home) / STEPS + (WALL / STEPS if off else 0.0)
    return _line.Car(car.s + dt * v / stretch, v, d, rate, car.scale), cost


@inner_kernel
def _play(theta, view, dt, cars, i, j, scratch):
    """Simulate both cars with one sample each; write the own plan, return both payoffs (m)."""
    car, opp = cars
    grip = within_grip(view, 1.3 * _line.GRIP * max(car.scale * car.scale, 1.0))
    table = scratch[_TABLE:_LANE]
    long = 0.5 * (view[_view.OWN_LENGTH] + view[_view.OPP_LENGTH]) + 0.1
    wide = 0.5 * (view[_view.OWN_WIDTH] + view[_view.OPP_WIDTH])
    limits = _Limits(dt, grip, long, wide + 0.1)
    own_five, opp_five = scratch[i * NUMBERS :], scratch[(SAMPLES + j) * NUMBERS :]
    own = _Choice(own_five, exponential(-dt / own_five[_T]), 0.0)
    other = _Choice(opp_five, exponential(-dt / opp_five[_T]), opp.d)
    value, opp_value = 0.0, 0.0
    for k in range(STEPS):
        was = car
        car, cost = _step(theta, table, limits, own, car, opp)
        opp, opp_cost = _step(theta, table, limits, other, opp, was)
        value, opp_value = value - cost, opp_value - opp_cost
        scratch[_PLAN + k], scratch[_PLAN + STEPS + k] = car.s, car.d
        # Missing clearance costs while the cars are level; in the first 0.5 s only an overlap does.
        if abs(opp.s - car.s) < long:
            lack = max(wide + (theta[OPPONENT_AIR] if k > 1 else 0.0) - abs(opp.d - car.d), 0.0)
            cost = COLLISION * lack / wide * (1.5 - k / STEPS)
            value, opp_value = value - cost, opp_value - cost
    gained, lost = car.s, opp.s - cars[1].s
    return value + gained - theta[RIVALRY] * lost, opp_value + lost - theta[RIVALRY] * gained


@kernel
def best_of_potential(own, opponent, means, last):
    """Return the pair of samples with the max potential of the nearest potential game.

    Parameters
    ----------
    own, opponent : ndarray, shape (SAMPLES * SAMPLES,)
        Payoffs of the pairs to each car; own samples are rows.
    means : ndarray, shape (4 * SAMPLES,)
        Working memory.
    last : int
        Own sample with a bonus of `KEPT`.
    """
    n = SAMPLES
    means[:] = 0.0
    for i in range(n):
        for j in range(n):
            means[j] += own[i * n + j] / n
            means[n + i] += opponent[i * n + j] / n
            means[2 * n + i] += own[i * n + j] / n
            means[3 * n + j] += opponent[i * n + j] / n
    row, column, best = 0, 0, -np.inf
    for i in range(n):
        for j in range(n):
            # Potential of a choice: its mean gain over the other car's samples, plus half of the
            # rest.
            gains = own[i * n + j] - means[j] + opponent[i * n + j] - means[n + i]
            value = 0.5 * (gains + means[2 * n + i] + means[3 * n + j]) + (
                KEPT if i == last else 0.0
            )
            if value > best:
                row, column, best = i, j, value
    return row, column


@kernel
def plan(track, theta, view, memory, scratch, path):
    """Play the game if the opponent is near, and drive the own part of the best pair."""
    gap, scale, lane = (
        _line.gap_ahead(track, view),
        _line.speed_scale(view, theta[_PACE]),
        scratch[_LANE:SCRATCH],
    )
    if abs(gap) > SIGHT:
        memory[0] = memory[_CHOSEN] = 0.0
        cap = _line.follow_line(track, theta, view, gap, SIGHT, lane)
        _line.ease_onto(track, view, scale, cap, lane, path)
        return
    cars = _line.both_cars(track, view, memory, scale)
    clear = 0.5 * (view[_view.OWN_WIDTH] + view[_view.OPP_WIDTH]) + theta[OPPONENT_AIR]
    keep = 0.5 * view[_view.OWN_WIDTH] + theta[WALL_AIR]
    _lay_table(track, view, keep, scratch[_TABLE:_LANE])
    _draw(theta, clear, True, scratch)
    _draw(theta, clear, gap < 0.0, scratch[SAMPLES * NUMBERS :])
    own, opponent = scratch[_VALUES : _VALUES + _PAIRS], scratch[_VALUES + _PAIRS : _MEANS]
    for i in range(SAMPLES):
        for j in range(SAMPLES):
            own[i * SAMPLES + j], opponent[i * SAMPLES + j] = _play(
                theta, view, STEP, cars, i, j, scratch
            )
    i, j = best_of_potential(own, opponent, scratch[_MEANS:_TABLE], int(memory[_CHOSEN]) - 1)
    _play(theta, view, FINE, cars, i, j, scratch)
    memory[_CHOSEN] = i + 1.0
    along, factor = scratch[_PLAN : _PLAN + STEPS], scratch[i * NUMBERS + _F]
    _line.lay_lane(view, cars[0].d, along, scratch[_PLAN + STEPS : _VALUES], lane)
    _line.hold_off(track, view, keep, lane)
    _line.keep_lane(view, lane, memory)
    _line.ease_onto(track, view, factor * scale, np.inf, lane, path)
    _line.hold_back(track, view, factor * scale, along, FINE, path)


ALPHA_RACER = Planner(
    name="alpha-racer",
    parameters=PARAMETERS,
    plan=plan,
    memory_size=MEMORY,
    scratch_size=SCRATCH,
    variants={
        "blocks": {"blocking": 1.0, "rivalry": 1.0},
        "lets-by": {"blocking": 0.0, "rivalry": 0.0},
    },
)
"""The near-potential game of two cars."""
