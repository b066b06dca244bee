"""Predictive spliner [1]_: a learned model of the opponent, and a pass where both cars will meet.

The opponent's driving is recorded along the track: its distance from the race line, and its speed
as a share of the profile. A Gaussian process over arc length smooths both and fills the gaps. With
it both cars are simulated, until the car is level with the opponent (the beginning of the region of
collision) and entirely past it (its end). If the track has room for an evasion all along that
region, the lane is a spline around it; otherwise, or if the car does not get past in time, it
trails like `pcs_racing.planners.field.spliner`.

Differences: the process has an exponential kernel, on bins of the track, so that its mean follows
exactly from a tridiagonal system, ten times a second; the spline is made of cubics through the
region's ends instead of found by an optimiser; speeds are learned as shares of the profile.

References
----------
.. [1] N. Baumann et al., "Predictive Spliner: Data-driven overtaking in autonomous racing using
   opponent trajectory prediction", IEEE Robotics and Automation Letters, 2025, arXiv:2410.04868.
"""

from typing import NamedTuple

import numpy as np

from pcs_racing.base.compilation import inner_kernel, kernel
from pcs_racing.base.elementary import exponential
from pcs_racing.planners import line as _line, view as _view
from pcs_racing.planners.planner import Parameter, Planner, offsets
from pcs_racing.track import frenet as _frenet

PARAMETERS = (
    *_line.TRAILING,
    Parameter(
        "evasion_dist", 0.4, 1.25, 0.65, "distance across the track from the opponent to keep, m"
    ),
    Parameter(
        "spline_bound_mindist",
        0.05,
        0.6,
        0.2,
        "least distance from the side of the car to a wall, m",
    ),
    Parameter(
        "ramp",
        1.0,
        10.0,
        5.0,
        "length of the spline's way off the race line, and back to it, m",
    ),
    Parameter("horizon", 1.0, 8.0, 5.0, "max time until the end of a pass, s"),
    Parameter(
        "begin",
        0.6,
        3.0,
        1.2,
        "length of the region of collision behind the opponent, m",
    ),
    Parameter("end", 0.6, 3.0, 1.2, "length of the region of collision before the opponent, m"),
    Parameter(
        "length_scale",
        1.0,
        20.0,
        5.0,
        "distance over which the opponent's driving is correlated, m",
    ),
    Parameter(
        "observation_noise",
        0.02,
        1.0,
        0.1,
        "variance of an observation, as a share of the process's",
    ),
)
EVASION, BOUND, RAMP, HORIZON, BEGIN, END, LENGTH_SCALE, NOISE = range(
    len(_line.TRAILING), len(PARAMETERS)
)

BINS = 160  # bins per lap
AHEAD = 48  # predicted bins from the opponent on
KEPT = 0.5  # weight of a bin's old value when the opponent comes by again
STEP = 0.1  # s
ACCELERATION = 4.0  # own acceleration up to the profile, m/s^2
NEVER = 1e3  # end of an endless region, m ahead
SIGHT = 20.0  # max distance of a predicted opponent, m

# Memory: the side of the pass (-1, 0, 1), the last observed bin (counted from 1), and for each bin
# the opponent's distance from the race line, its speed as a share of the profile, and an observed
# flag.
_SIDE, _LAST, _D, _V, _SEEN, MEMORY = offsets(1, 1, BINS, BINS, BINS)
# Scratch: means ahead of distance and speed, work, the lane.
_, _MEAN_V, _WORK, _LANE, SCRATCH = offsets(AHEAD, AHEAD, AHEAD, _line.LANE_SIZE)


@inner_kernel
def remember(memory, at, d, share):
    """Store the opponent's driving in the bin ``at``.

    ``d`` is its distance from the race line (m), ``share`` its share of the profile's speed.
    """
    kept = KEPT if memory[_SEEN + at] > 0.0 else 0.0
    # While the opponent is in the bin, the mean moves slowly.
    kept = 0.8 if memory[_LAST] == at + 1.0 else kept
    memory[_D + at] = kept * memory[_D + at] + (1.0 - kept) * d
    memory[_V + at] = kept * memory[_V + at] + (1.0 - kept) * share
    memory[_SEEN + at] = 1.0
    memory[_LAST] = at + 1.0


class Process(NamedTuple):
    """A process along the bins, with variance 1."""

    keep: float  #: Correlation of two neighbouring bins.
    noise: float  #: Variance of an observation.
    now: float  #: Present value of the opponent, known without noise.
    prior: float  #: Mean.


@inner_kernel
def smooth_ahead(memory, first, values, process, mean, work):
    """Write posterior means of a process with exponential kernel.

    The means are in `AHEAD` bins from the opponent's bin on.

    Parameters
    ----------
    memory : ndarray
        Observations, from index ``values`` on.
    first : int
        The opponent's bin.
    process : Process
    """
    keep, noise, now, prior = process
    inner = (1.0 + keep * keep) / (1.0 - keep * keep)
    side = -keep / (1.0 - keep * keep)
    # The first bin is given; the precision matrix of the others is tridiagonal.
    mean[0] = now - prior
    work[0] = 0.0
    for k in range(1, AHEAD):
        at = (first + k) % BINS
        weight = memory[_SEEN + at] / noise
        diagonal = (inner if k < AHEAD - 1 else 1.0 / (1.0 - keep * keep)) + weight
        right = weight * (memory[values + at] - prior) - (side * mean[0] if k == 1 else 0.0)
        before = side if k > 1 else 0.0
        pivot = diagonal - before * work[k - 1]
        work[k] = side / pivot
        mean[k] = (right - before * (mean[k - 1] if k > 1 else 0.0)) / pivot
    for k in range(AHEAD - 2, 0, -1):
        mean[k] -= work[k] * mean[k + 1]
    for k in range(AHEAD):
        mean[k] += prior


@inner_kernel(forceinline=True)
def _ahead(means, per_bin, along):
    """Return a mean at a distance (m) beyond the opponent, interpolated between the bins."""
    u = min(max(along * per_bin, 0.0), AHEAD - 1.001)
    k = int(u)
    return means[k] + (u - k) * (means[k + 1] - means[k])


@inner_kernel
def _region(track, theta, view, scale, gap, per_bin, shares):
    """Return begin and end of the region of collision, m from the car; end 0: no region."""
    s0 = view[_view.OWN_S]
    own, opponent, v, t = 0.0, gap, view[_view.OWN_V], 0.0
    begins = -1.0
    while t < theta[HORIZON]:
        if opponent - own < theta[BEGIN] and begins < 0.0:
            begins = own
        if opponent - own < -theta[END]:
            return max(begins, 0.0), own
        v = min(
            v + ACCELERATION * STEP,
            scale * track.line[_line.line_index(track, s0 + own), _frenet.SPEED],
        )
        profile = scale * track.line[_line.line_index(track, s0 + opponent), _frenet.SPEED]
        own += STEP * v
        opponent += STEP * profile * _ahead(shares, per_bin, opponent - gap)
        t += STEP
    return max(begins, 0.0), 0.0


@inner_kernel(forceinline=True)
def _ramp(u):
    """Return a cubic from 0 at u <= 0 to 1 at u >= 1."""
    u = min(max(u, 0.0), 1.0)
    return u * u * (3.0 - 2.0 * u)


class _Evasion(NamedTuple):
    """An evasion of the opponent, ``gap`` m ahead."""

    gap: float
    per_bin: float  #: Bins per metre.
    side: float  #: 1 to the left, -1 to the right.
    begins: float  #: Begin and end of the region of collision, m from the car.
    ends: float


@inner_kernel(forceinline=True)
def _evasion(theta, offsets, way, x):
    """Return the offset of an evasion from the race line, ``x`` m ahead of the car."""
    begun = _ramp((x - way.begins) / theta[RAMP] + 1.0)
    share = begun * (1.0 - _ramp((x - way.ends) / theta[RAMP]))
    return share * (_ahead(offsets, way.per_bin, x - way.gap) + way.side * theta[EVASION])


@inner_kernel
def _least_room(track, theta, view, offsets, way):
    """Return the min room (m) of an evasion to the walls, over its whole length."""
    keep = theta[BOUND] + 0.5 * view[_view.OWN_WIDTH]
    least = np.inf
    x = max(way.begins - theta[RAMP], 0.0)
    while x <= way.ends + theta[RAMP]:
        sample = track.line[_line.line_index(track, view[_view.OWN_S] + x)]
        d = _evasion(theta, offsets, way, x)
        if abs(d) > _line.ON_LINE:
            least = min(
                least,
                (sample[_frenet.LEFT] - d if way.side > 0.0 else sample[_frenet.RIGHT] + d) - keep,
            )
        x += 0.8
    return least


@kernel
def plan(track, theta, view, memory, scratch, path):
    """Record the opponent, predict it, and pass or trail."""
    gap = _line.gap_ahead(track, view)
    scale = _line.speed_scale(view, theta[0])
    per_bin = BINS / track.length
    opp_s = _frenet.wrap_s(track, view[_view.OPP_S])
    first = min(int(opp_s * per_bin), BINS - 1)
    share = view[_view.OPP_V] / (scale * track.line[_line.line_index(track, opp_s), _frenet.SPEED])
    remember(memory, first, view[_view.OPP_D], share)
    lane = scratch[_LANE:SCRATCH]
    offsets, shares, work = scratch[:_MEAN_V], scratch[_MEAN_V:_WORK], scratch[_WORK:_LANE]
    memory_side = memory[_SIDE]
    memory[_SIDE] = 0.0
    cap = np.inf
    if -theta[END] < gap < SIGHT and (gap > 0.0 or memory_side != 0.0):
        keep = exponential(-1.0 / (per_bin * theta[LENGTH_SCALE]))
        noise = theta[NOISE]
        sideways = Process(keep, noise, view[_view.OPP_D], 0.0)
        smooth_ahead(memory, first, _D, sideways, offsets, work)
        smooth_ahead(memory, first, _V, Process(keep, noise, share, share), shares, work)
        begins, ends = _region(track, theta, view, scale, gap, per_bin, shares)
        way = _Evasion(gap, per_bin, 1.0, begins, ends)
        left = _least_room(track, theta, view, offsets, way)
        way = _Evasion(gap, per_bin, -1.0, begins, ends)
        right = _least_room(track, theta, view, offsets, way)
        side = memory_side if memory_side != 0.0 else (1.0 if left > right else -1.0)
        passes = ends > 0.0 and (left if side > 0.0 else right) > 0.0
        # Without room or time for a pass the car trails, but it aborts a pass only with room to
        # brake.
        committed = memory_side != 0.0 and gap < _line.room_to_brake(theta, view)
        if passes or committed:
            memory[_SIDE] = side
            ends = ends if ends > 0.0 else NEVER
            way = _Evasion(gap, per_bin, side, begins, ends)
            for j in range(_line.LANE_POINTS):
                lane[j] = _evasion(theta, offsets, way, j * _line.lane_step(view))
            if not passes and gap > 0.0:
                cap = _line.trailing_speed(theta, view, gap)
            _line.hold_off(track, view, theta[BOUND] + 0.5 * view[_view.OWN_WIDTH], lane)
    if memory[_SIDE] == 0.0:
        cap = _line.follow_line(track, theta, view, gap, SIGHT, lane)
    _line.ease_onto(track, view, scale, cap, lane, path)


PREDICTIVE_SPLINER = Planner(
    name="predictive-spliner",
    parameters=PARAMETERS,
    plan=plan,
    memory_size=MEMORY,
    scratch_size=SCRATCH,
    variants={"early": {"begin": 2.0, "ramp": 8.0}, "wide": {"evasion_dist": 0.8}},
)
"""The predictive spliner: a learned model of the opponent, and a pass where both cars meet."""
