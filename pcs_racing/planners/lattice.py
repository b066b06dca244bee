"""Lattice planner along the race line: the candidate with the min cost.

The candidates and their costs are in :mod:`pcs_racing.planners.candidates`. Differences from the
paper's planner, with reasons: ``docs/paper.md``.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.compilation import inner_kernel, kernel
from pcs_racing.planners import candidate_rows as rows, view as _view
from pcs_racing.planners.candidate_rows import CANDIDATES, GOALS, SCRATCH, SEGMENTS, SPEEDS
from pcs_racing.planners.candidates import (
    MEMORY,
    PARAMETERS,
    PROXIMITY,
    REJECTED,
    SIDE_MARGIN,
    SIGHT,
    lay_candidates,
    meet_opponent,
    power_of_ten,
    situation,
    take,
)
from pcs_racing.planners.planner import Parameter, Planner
from pcs_racing.track import frenet as _frenet

_EARLY = {
    "length": (-2.0, 0.0, -1.0),
    "max_curvature": (-2.0, 0.0, -1.0),
    "mean_curvature": (-2.0, 0.0, -1.0),
    "curvature_rate": (-2.0, 0.0, -1.5),
    "lateral_acceleration": (-2.0, 0.0, -1.0),
    "braking": (-2.0, 0.5, -1.5),
    "similarity": (-1.0, 1.0, 0.0),
    "progress": (0.0, 2.0, 1.0),
    "deviation": (-0.7, 1.0, 0.0),
    "walls": (-1.5, 1.0, -0.5),
    "proximity": (-1.5, 1.0, -0.5),
    "overtaking": (-1.0, 2.0, 1.0),
    "blocking": (-2.0, 1.0, -0.5),
    "pace": (0.0, 1.0, 0.5),
    "attack": (0.0, 0.3, 0.2),
    "side_margin": (0.2, 0.45, 0.32),
    "pace_behind": (-0.5, 0.5, 0.15),
}
EARLY_PARAMETERS = tuple(Parameter(one.name, *_EARLY[one.name], one.meaning) for one in PARAMETERS)
"""Parameters with the bounds and defaults set by hand, before any search."""


@inner_kernel(forceinline=True)
def choose(theta, laid, slack, scratch):
    """Return the candidate with the min cost.

    The opponent only adds to a cost. So the candidate with the min cost without the opponent comes
    first, and of the others only candidates that could still come within ``slack`` of the best.
    """
    now = laid.now
    side_reach = now.body + (theta[SIDE_MARGIN] if now.gives_way else 0.5 * theta[SIDE_MARGIN])
    w_proximity = power_of_ten(theta[PROXIMITY]) / 6.0
    first = chosen = np.int64(np.argmin(scratch[rows.MIN_COST : rows.COSTS]))
    best = 1e30
    for k in range(-1, CANDIDATES):
        c = np.int64(first if k < 0 else k)
        cost = scratch[rows.MIN_COST + c]
        if cost >= best + slack:
            continue
        scratch[rows.MIN_COST + c] = np.inf
        if now.meets:
            most = best + slack - cost
            met, _ = meet_opponent(
                scratch, now, laid.start, c // GOALS, c % GOALS, side_reach, w_proximity, most
            )
            cost += met
        scratch[rows.COSTS + c] = cost
        if cost < best:
            best = cost
            chosen = c
    return chosen


@inner_kernel
def _search(track, theta, view, memory, scratch, path, slack):
    """Choose a candidate and write its path.

    Candidates within ``slack`` of the best get a full cost.
    """
    now = situation(track, theta, view, memory)
    laid = lay_candidates(track, theta, view, memory, now, scratch)
    chosen = choose(theta, laid, slack, scratch)
    take(track, view, memory, laid, now.attacks, scratch, chosen, path)


@kernel
def plan(track, theta, view, memory, scratch, path):
    """Choose a candidate and write its path."""
    _search(track, theta, view, memory, scratch, path, 0.0)


@kernel
def _weigh_all(track, theta, view, memory, scratch, path):
    """Choose as ``plan`` does, with the full cost of every candidate in the scratch."""
    _search(track, theta, view, memory, scratch, path, np.inf)


def candidates(
    track: _frenet.TrackArrays,
    theta: NDArray[np.float64],
    view: NDArray[np.float64],
    memory: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return all candidates of ``plan``, for pictures.

    Returns
    -------
    points : ndarray, shape (64, 9, 2)
        Points of each candidate in m (the four speeds of one move share them).
    costs : ndarray, shape (64,)
        Weighted cost; infinite for a rejected candidate.
    """
    scratch = np.zeros(SCRATCH)
    _weigh_all(track, theta, view, memory.copy(), scratch, np.zeros((_view.PATH_POINTS, 4)))
    points = np.empty((GOALS, SEGMENTS + 1, 2))
    points[:, 0] = view[_view.OWN_X], view[_view.OWN_Y]
    for axis, first in enumerate((rows.POINT_X, rows.POINT_Y)):
        points[:, 1:, axis] = scratch[first : first + SEGMENTS * GOALS].reshape(SEGMENTS, GOALS).T
    costs = scratch[rows.COSTS : rows.COSTS + CANDIDATES].copy()
    costs[costs >= 0.02 * REJECTED] = np.inf
    return np.tile(points, (SPEEDS, 1, 1)), costs


LATTICE = Planner(
    name="lattice",
    parameters=PARAMETERS,
    plan=plan,
    memory_size=MEMORY,
    scratch_size=SCRATCH,
    candidates=candidates,
    variants={"early": [parameter.default for parameter in EARLY_PARAMETERS]},
    sight=SIGHT,
)
"""Lattice planner: moves across the track along the race line."""

REFERENCE = replace(LATTICE, parameters=EARLY_PARAMETERS, variants={})
"""Lattice with its first bounds and defaults, which calibrates circuits: their speed ranges and
start places do not change with the defaults."""
