"""Model predictive path integral control [1]_: a cost-weighted mean of hundreds of disturbed plans.

The plan is a sequence of curvatures, relative to the race line, and accelerations. Ten times a
second it is shifted by one step, and `SAMPLES` copies of it are disturbed by normal noise and
driven in a kinematic model along the race line. A copy's cost adds the squares of its distance from
the speed profile and from the race line, nearness to walls and to the predicted opponent, lateral
acceleration beyond the grip, and the cost of its disturbance. The new plan is the mean of all
copies with the weights ``exp(-cost / temperature)``.

Differences: the model is kinematic; the plan begins at the last plan's present position; the car
follows the path of the plan, which compensates the slip of the tyres, instead of its first control;
the noise comes from a table that is drawn once, read at places that depend on the race time, so
that one race has one result, and is held for some steps.

References
----------
.. [1] G. Williams et al., "Information theoretic MPC for model-based reinforcement learning", ICRA
   2017.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.compilation import inner_kernel, kernel
from pcs_racing.base.elementary import exponential
from pcs_racing.base.seeds import GOLDEN, scramble, scramble_one
from pcs_racing.planners import line as _line, view as _view
from pcs_racing.planners.planner import Parameter, Planner, offsets
from pcs_racing.planners.pursuit import within_grip
from pcs_racing.track import frenet as _frenet

PARAMETERS = (
    _line.PACE,
    Parameter("temperature", 0.1, 50.0, 5.0, "cost that divides the weight of a copy by e"),
    Parameter(
        "lateral_noise",
        0.2,
        6.0,
        2.0,
        "standard deviation of the disturbance of the curvature, in m/s^2",
    ),
    Parameter(
        "acceleration_noise",
        0.2,
        6.0,
        1.0,
        "standard deviation of the disturbance of the acceleration, m/s^2",
    ),
    Parameter(
        "speed_weight",
        0.1,
        10.0,
        1.0,
        "cost of a squared difference from the speed profile, s^2/m^2",
    ),
    Parameter(
        "line_weight", 0.1, 100.0, 20.0, "cost of a squared distance from the race line, 1/m^2"
    ),
    Parameter(
        "wall_weight", 50.0, 2000.0, 400.0, "cost of a squared lack of clearance to a wall, 1/m^2"
    ),
    Parameter("opponent_weight", 5.0, 500.0, 60.0, "cost of the opponent's place"),
    Parameter(
        "smoothness",
        0.0,
        50.0,
        10.0,
        "cost of a squared change of the curvature from step to step, m^2",
    ),
    Parameter("opponent_length", 0.6, 4.0, 1.4, "half of the opponent's place along the track, m"),
    Parameter(
        "opponent_width", 0.35, 1.0, 0.55, "half of the opponent's place across the track, m"
    ),
)
(
    _PACE,
    TEMPERATURE,
    LATERAL_NOISE,
    ACCELERATION_NOISE,
    SPEED_WEIGHT,
    LINE_WEIGHT,
    WALL_WEIGHT,
    OPPONENT_WEIGHT,
    SMOOTHNESS,
    OPPONENT_LENGTH,
    OPPONENT_WIDTH,
) = range(len(PARAMETERS))

SAMPLES, STEPS, STEP = 256, 15, 0.1  # copies, steps, step length in s
HELD = 3  # steps per disturbance: fewer numbers to sample, and smooth plans
CONTROL = 0.1  # cost of leaving the line's curvature, as a share of the temperature
GRIP = 6.0  # free lateral acceleration up to speed scale 1, above it by its square, m/s^2
GRIP_WEIGHT = 4.0
WALL_AIR = 0.30  # clearance below which a wall costs, m
CRASH = 300.0
MAX_KAPPA, MAX_NOISE, MAX_BRAKING, MAX_ACCELERATION = 1.2, 0.3, 5.5, 6.0
CELL, CELLS = 0.25, 128  # length (m) and number of the copied cells of the race line ahead

_TABLE = 4096


def normal_table(size: int) -> NDArray[np.float64]:
    """Return nearly normal numbers, mean 0 and variance 1.

    Each is a sum of four uniform numbers of 16 bits, from a counter.
    """
    key = scramble(np.arange(1, size + 1, dtype=np.uint64) * GOLDEN)
    total = sum(
        ((key >> np.uint64(shift)) & np.uint64(0xFFFF)).astype(np.float64)
        for shift in (0, 16, 32, 48)
    )
    drawn = (np.asarray(total) / 65535.0 - 2.0) * np.sqrt(3.0)
    return np.ascontiguousarray(drawn - drawn.mean())


NOISE = normal_table(_TABLE)

# Memory: the plan's curvatures relative to the race line (1/m) and accelerations (m/s^2); its path
# as a lane.
_KAPPAS, _ACCELERATIONS, _KEPT, MEMORY = offsets(STEPS, STEPS, _line.KEPT_LANE)
# Scratch: the copies' arc length from the car on, distance from the line, course relative to it,
# speed, curvature relative to the line and cost; the race line ahead: curvature, speed, free
# widths; the plan's path; the lane.
(
    _S,
    _D,
    _E,
    _V,
    _K,
    _COST,
    _LINE_KAPPA,
    _LINE_SPEED,
    _LINE_RIGHT,
    _LINE_LEFT,
    _ALONG,
    _ACROSS,
    _SPEEDS,
    _LANE,
    SCRATCH,
) = offsets(*6 * [SAMPLES], *4 * [CELLS], *3 * [STEPS], _line.LANE_SIZE)


@inner_kernel(forceinline=True)
def _place(time, step, which):
    """Return the table index of the noise of a plan step at a race time in s (splitmix64)."""
    key = scramble_one(np.uint64(int(time * 100.0 + 0.5) * 64 + 2 * step + which + 1) * GOLDEN)
    return np.int64((key >> np.uint64(33)) % np.uint64(_TABLE - SAMPLES))


@inner_kernel(forceinline=True)
def _advance(s, d, e, v, kappa, a, line_kappa):
    """Return arc length, distance from the line, course and speed one step of the model later."""
    e2 = e * e
    sine = e * (1.0 - e2 / 6.0)
    cosine = 1.0 - 0.5 * e2
    along = STEP * v * cosine / max(1.0 - line_kappa * d, 0.3)
    turned = e + STEP * v * kappa - along * line_kappa
    return s + along, d + STEP * v * sine, min(max(turned, -1.0), 1.0), max(v + STEP * a, 0.1)


class _Limits(NamedTuple):
    """Numbers that hold for all steps of a plan."""

    sd_kappa: float  #: Standard deviation of the curvatures, 1/m.
    grip: float  #: Free lateral acceleration, m/s^2.
    scale: float  #: Factor of the speed profile.


class _Step(NamedTuple):
    """A step of the plan."""

    k: int  #: Number of the step.
    opp_s: float  #: Opponent's arc length from the car on, m.
    opp_d: float  #: Opponent's distance from the race line, m.
    kappa: float  #: Curvature of the plan relative to the race line, 1/m.
    a: float  #: Acceleration of the plan, m/s^2.


@inner_kernel
def _drive_copies(theta, view, limits, step, scratch):
    """Drive all copies by one step of the plan, and add its cost (code for vectorisation)."""
    sd_kappa, grip, scale = limits
    k, opp_s, opp_d, kappa0, a0 = step
    kappas, accelerations = (
        NOISE[_place(view[0], k // HELD, 0) :],
        NOISE[_place(view[0], k // HELD, 1) :],
    )
    s_, d_, e_, v_ = scratch[_S:_D], scratch[_D:_E], scratch[_E:_V], scratch[_V:_K]
    k_, cost = scratch[_K:_COST], scratch[_COST:_LINE_KAPPA]
    line_kappa, line_speed = scratch[_LINE_KAPPA:_LINE_SPEED], scratch[_LINE_SPEED:_LINE_RIGHT]
    line_right, line_left = scratch[_LINE_RIGHT:_LINE_LEFT], scratch[_LINE_LEFT:_ALONG]
    sd_a = theta[ACCELERATION_NOISE]
    per_length, per_width = 1.0 / theta[OPPONENT_LENGTH], 1.0 / theta[OPPONENT_WIDTH]
    keep = 0.5 * view[_view.OWN_WIDTH]
    strain = CONTROL * theta[TEMPERATURE]
    mix_kappa, mix_a = strain * kappa0 / sd_kappa, strain * a0 / sd_a
    for i in range(np.uint64(SAMPLES)):
        drawn_kappa, drawn_a = kappas[i], accelerations[i]
        extra = kappa0 + sd_kappa * drawn_kappa
        a = min(max(a0 + sd_a * drawn_a, -MAX_BRAKING), MAX_ACCELERATION)
        cell = np.uint64(min(s_[i] * (1.0 / CELL), CELLS - 1.0))
        kappa = min(max(line_kappa[cell] + extra, -MAX_KAPPA), MAX_KAPPA)
        change = extra - k_[i]
        s, d, e, v = _advance(s_[i], d_[i], e_[i], v_[i], kappa, a, line_kappa[cell])
        s_[i], d_[i], e_[i], v_[i], k_[i] = s, d, e, v, extra
        cell = np.uint64(min(s * (1.0 / CELL), CELLS - 1.0))
        too_fast = v - scale * line_speed[cell]
        air = min(line_left[cell] - d, line_right[cell] + d) - keep
        lack = max(WALL_AIR - air, 0.0)
        beyond = max(abs(kappa) * v * v - grip, 0.0)
        x, y = (s - opp_s) * per_length, (d - opp_d) * per_width
        place = max(1.0 - x * x * x * x - y * y, 0.0)
        cost[i] += (
            theta[SPEED_WEIGHT] * too_fast * too_fast
            + theta[LINE_WEIGHT] * d * d
            + theta[WALL_WEIGHT] * lack * lack
            + (CRASH if air < 0.0 else 0.0)
            + theta[OPPONENT_WEIGHT] * place
            + theta[SMOOTHNESS] * change * change
            + GRIP_WEIGHT * beyond * beyond
            + mix_kappa * drawn_kappa
            + mix_a * drawn_a
        )


@inner_kernel
def _average(theta, time, sd_kappa, memory, scratch):
    """Replace the plan by the weighted mean of the copies."""
    cost = scratch[_COST:_LINE_KAPPA]
    least = np.inf
    for i in range(SAMPLES):
        least = min(least, cost[i])
    total = 0.0
    for i in range(SAMPLES):
        cost[i] = exponential((least - cost[i]) / theta[TEMPERATURE])
        total += cost[i]
    for k in range(STEPS):
        at_kappa, at_a = _place(time, k // HELD, 0), _place(time, k // HELD, 1)
        kappa = a = 0.0
        for i in range(SAMPLES):
            kappa += cost[i] * NOISE[at_kappa + i]
            a += cost[i] * NOISE[at_a + i]
        memory[_KAPPAS + k] += sd_kappa * kappa / total
        memory[_ACCELERATIONS + k] += theta[ACCELERATION_NOISE] * a / total


@inner_kernel
def _drive_plan(track, view, d, e, memory, along, across, speeds):
    """Simulate the plan; write arc length, distance from the line and speed after each step."""
    s, v = 0.0, max(view[_view.OWN_V], 0.1)
    for k in range(STEPS):
        line_kappa = track.line[_line.line_index(track, view[_view.OWN_S] + s), _frenet.KAPPA]
        kappa = min(max(line_kappa + memory[_KAPPAS + k], -MAX_KAPPA), MAX_KAPPA)
        a = min(max(memory[_ACCELERATIONS + k], -MAX_BRAKING), MAX_ACCELERATION)
        s, d, e, v = _advance(s, d, e, v, kappa, a, line_kappa)
        along[k], across[k], speeds[k] = s, d, v


@kernel
def plan(track, theta, view, memory, scratch, path):
    """Shift the plan, disturb it, and average the copies."""
    s0, v0 = view[_view.OWN_S], max(view[_view.OWN_V], 0.1)
    scale = _line.speed_scale(view, theta[_PACE])
    grip = within_grip(view, GRIP * max(scale * scale, 1.0))
    kept = memory[_KEPT:]
    # Start at the last plan's present position; `ease_onto` removes the car's deviation from it.
    d0, e0, goes_on = _line.last_lane(track, view, kept)
    if not goes_on:
        d0, e0 = view[_view.OWN_D], _line.course_off_line(track, view)
    e0 = min(max(e0, -1.0), 1.0)
    for k in range(CELLS):
        sample = track.line[_line.line_index(track, s0 + (k + 0.5) * CELL)]
        scratch[_LINE_KAPPA + k] = sample[_frenet.KAPPA]
        scratch[_LINE_SPEED + k] = sample[_frenet.SPEED]
        scratch[_LINE_RIGHT + k] = sample[_frenet.RIGHT]
        scratch[_LINE_LEFT + k] = sample[_frenet.LEFT]
    before = memory[_KAPPAS]
    for k in range(STEPS):
        memory[_KAPPAS + k] = memory[_KAPPAS + k + 1] if k < STEPS - 1 else 0.0
        memory[_ACCELERATIONS + k] = memory[_ACCELERATIONS + k + 1] if k < STEPS - 1 else 0.0
    sd_kappa = min(theta[LATERAL_NOISE] / (v0 * v0), MAX_NOISE)
    for i in range(SAMPLES):
        scratch[_S + i], scratch[_D + i], scratch[_E + i], scratch[_V + i] = 0.0, d0, e0, v0
        scratch[_K + i], scratch[_COST + i] = before, 0.0
    # The opponent keeps its share of the profile and its position across the track.
    opp_s = _line.gap_ahead(track, view)
    behind = opp_s <= -0.5 * view[_view.OWN_LENGTH]
    line_s = _frenet.wrap_s(track, view[_view.OPP_S])
    share = view[_view.OPP_V] / track.line[_line.line_index(track, line_s), _frenet.SPEED]
    for k in range(STEPS):
        opp_s += STEP * share * track.line[_line.line_index(track, s0 + opp_s), _frenet.SPEED]
        # A car that is entirely behind is responsible for itself.
        seen = -1e3 if behind else opp_s
        kappa, a = memory[_KAPPAS + k], memory[_ACCELERATIONS + k]
        step = _Step(k, seen, view[_view.OPP_D], kappa, a)
        _drive_copies(theta, view, _Limits(sd_kappa, grip, scale), step, scratch)
    _average(theta, view[_view.TIME], sd_kappa, memory, scratch)
    along, across, speeds = (
        scratch[_ALONG:_ACROSS],
        scratch[_ACROSS:_SPEEDS],
        scratch[_SPEEDS:_LANE],
    )
    lane = scratch[_LANE:SCRATCH]
    _drive_plan(track, view, d0, e0, memory, along, across, speeds)
    _line.follow_plan(track, view, d0, along, across, scale, np.inf, lane, kept, path)
    k = 0
    for j in range(_view.PATH_POINTS):
        while k < STEPS - 1 and along[k] < j * _line.lane_step(view):
            k += 1
        before_s, before_v = (along[k - 1], speeds[k - 1]) if k > 0 else (0.0, v0)
        share = min((j * _line.lane_step(view) - before_s) / max(along[k] - before_s, 1e-3), 1.0)
        path[j, _view.PATH_SPEED] = min(
            path[j, _view.PATH_SPEED], before_v + share * (speeds[k] - before_v)
        )


MPPI = Planner(
    name="mppi",
    parameters=PARAMETERS,
    plan=plan,
    memory_size=MEMORY,
    scratch_size=SCRATCH,
    variants={
        "sharp": {"temperature": 2.0},
        "close": {"opponent_width": 0.45, "opponent_length": 1.0},
    },
)
"""Model predictive path integral control."""
