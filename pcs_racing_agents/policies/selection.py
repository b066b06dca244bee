"""Choice of an archive's policies: distant policies not clearly beaten, or a pool with headroom.

Coordinates are means over races and have errors. A policy stays if another policy beats it by less
than the error of their difference, since it may belong to the front. All policies drive the same
races, so that error is small.

A Pareto front of speed and restraint is a line of ever faster policies. If the faster policy wins,
one policy is the best response to all others. For headroom the archive is a pool with a game of
rock, paper and scissors. *Candidates* of all speeds, each beaten by some others, race each other on
all tracks. The choice is the pool with the maximum headroom, with equally many policies from each
group along the first axis (:func:`pcs_racing_agents.policies.choosing.choose_pool`).
"""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.errors import InputError
from pcs_racing.planners.planner import Policy
from pcs_racing.planners.registry import get_planner
from pcs_racing_agents.base.chunks import Arrays
from pcs_racing_agents.policies.archive_search import PolicyRaces
from pcs_racing_agents.policies.choosing import choose_pool, denoised, pool_headroom
from pcs_racing_agents.policies.config import ArchiveConfig
from pcs_racing_agents.policies.evaluate import Evaluation
from pcs_racing_agents.policies.headroom import headroom, transitive_share
from pcs_racing_agents.policies.policy_pool import PolicyPool

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]
Notes = Mapping[str, str | float]

MOST_FOLDS = 16
INTERVALS_PER_GROUP = 4
"""Number of intervals per group, to spread candidates along the first axis more than the pool."""


def front_layers(points: Floats) -> Indices:
    """Return the layer of each point, shape (K,).

    Layer 0 holds points that no other point beats, layer 1 points that only points of layer 0 beat,
    and so on. A point beats another point if it is at least as large in all coordinates and larger
    in one.
    """
    points = np.asarray(points, np.float64)
    better = np.all(points[:, None] >= points[None], axis=-1) & np.any(
        points[:, None] > points[None], axis=-1
    )
    layer = np.full(len(points), -1, np.int64)
    depth = 0
    while (layer < 0).any():
        remaining = np.flatnonzero(layer < 0)
        layer[remaining[~better[np.ix_(remaining, remaining)].any(axis=0)]] = depth
        depth += 1
    return layer


def difference_errors(raced: Arrays) -> Floats:
    """Return standard errors of coordinate differences between K policies, shape (K, K, G).

    ``raced`` is the result of :func:`~pcs_racing_agents.policies.evaluate.race_policies`: the same
    R races for all policies.
    """
    totals, segments = raced["totals"], raced["segments"].astype(np.float64)
    races = totals.shape[1]
    coordinates = totals.sum(axis=1) / segments.sum(axis=1)[:, None]
    # Contribution of each race to the error of a ratio of sums, linearised.
    shares = (totals - coordinates[:, None] * segments[..., None]) / segments.sum(axis=1)[
        :, None, None
    ]
    # No BLAS: its order of a sum depends on its threads and on the processor.
    products = np.einsum("irg,jrg->ijg", shares, shares)
    own = np.einsum("iig->ig", products)
    squares = own[:, None] + own[None] - 2.0 * products
    return np.asarray(np.sqrt(np.maximum(squares, 0.0) * races / max(races - 1, 1)), np.float64)


def beaten(coordinates: Floats, errors: Floats, error_bars: float) -> NDArray[np.bool_]:
    """Return which of K policies are beaten beyond the error bars, shape (K,).

    A policy is beaten if another policy is better on all axes. Differences below ``error_bars``
    standard errors (``errors``, shape (K, K, G)) do not count; with 0 every policy that is smaller
    on all axes is beaten.
    """
    # Difference of j from i, at (i, j).
    ahead = coordinates[None] - coordinates[:, None]
    return np.asarray(np.all(ahead > error_bars * errors, axis=-1).any(axis=1))


def spread_first(points: Floats, spacing: float, count: int) -> Indices:
    """Return the best ``count`` of K normalised points with a minimum spacing, by front layer.

    Points of one layer are ordered by index; a point nearer than ``spacing`` to a better point is
    skipped.
    """
    kept: list[int] = []
    for candidate in np.lexsort((np.arange(len(points)), front_layers(points))).tolist():
        away = np.sqrt(np.sum((points[kept] - points[candidate]) ** 2, axis=1))
        if len(kept) < count and not (away < spacing).any():
            kept.append(candidate)
    return np.array(kept, np.int64)


def thin_out(points: Floats, spacing: float, maximum: int) -> Indices:
    """Choose normalised points with a minimum spacing; return ascending indices.

    The choice is the result of :func:`spread_first`; the spacing is widened until at most
    ``maximum`` points remain.
    """
    while len(kept := spread_first(points, spacing, len(points))) > maximum:
        # A spacing of 0 would never grow.
        spacing = max(1.05 * spacing, 1e-4)
    return np.sort(kept)


def choose_for_headroom(races: PolicyRaces, allowed: Indices, seed: int) -> tuple[Floats, Notes]:
    """Race all pairs of candidates of all speeds, and choose the pool with maximum headroom.

    Candidates come from the ``allowed`` policies of the search; ``seed`` is the root of start
    lines, noise and the search for the pool. Return the parameters that vary, shape
    (config.max_policies, P), in the order of the first axis, and notes with the expected headroom.
    """
    config = races.config
    theta, explored = races.explored()
    first = explored.coordinates[allowed, 0]
    intervals = config.groups * INTERVALS_PER_GROUP
    rows = allowed[
        best_of_each_interval(first, explored.won[allowed], config.candidates, intervals)
    ]
    if len(rows) < config.max_policies:
        raise InputError(
            f"{len(rows)} candidates differ in {config.axes[0]}; a pool of {config.max_policies}"
            " needs more: search longer, raise crash_limit or lower max_policies"
        )
    payoffs = races.payoffs(
        "choice", _pool(config, theta[rows], config.tracks, config.payoff_races, seed)
    )
    expected = np.array([denoised(folds) for folds in payoffs])
    groups = np.array_split(np.arange(len(rows)), config.groups)
    pool = choose_pool(expected, groups, config.max_policies, seed=seed)
    last = races.history[-1]
    races.note(
        "choice",
        last.generation,
        last.hypervolume,
        len(pool),
        Evaluation(*(values[rows[pool]] for values in explored)),
    )
    return theta[rows[pool]], {
        "choice_candidates": len(rows),
        "choice_headroom": pool_headroom(expected, pool[None]).mean(),
        "choice_headroom_of_all_candidates": (
            pool_headroom(expected, np.arange(len(rows))[None]).mean()
        ),
    }


def judge_headroom(races: PolicyRaces, parameters: Floats, seed: int) -> Notes:
    """Race all pairs of an archive's policies in new races, and report headroom on each track.

    Tracks of ``config.judging_tracks`` are not used for the choice.
    """
    config = races.config
    tracks = (*config.tracks, *(config.judging_tracks or ()))
    payoffs = races.payoffs(
        "judgement", _pool(config, parameters, tracks, config.judging_races, seed)
    )
    estimates = [headroom(folds) for folds in payoffs]
    notes: dict[str, str | float] = {}
    for name, part in (
        ("", slice(len(config.tracks))),
        ("_elsewhere", slice(len(config.tracks), None)),
    ):
        if estimates[part]:
            notes[f"headroom{name}"] = float(
                np.mean([estimate.value for estimate in estimates[part]])
            )
            notes[f"headroom_low{name}"] = float(
                np.mean([estimate.low for estimate in estimates[part]])
            )
            shares = [share for share in map(transitive_share, payoffs[part]) if np.isfinite(share)]
            notes[f"transitive_share{name}"] = float(np.mean(shares)) if shares else "unknown"
    for track, estimate in zip(tracks, estimates, strict=True):
        notes[f"headroom_{track}"] = f"{estimate.value:+.3f} +- {estimate.opponents_error:.3f}"
    last = races.history[-1]
    races.callback(last._replace(stage="judgement", done=1.0))
    return notes


def best_of_each_interval(axis: Floats, score: Floats, count: int, intervals: int) -> Indices:
    """Choose up to ``count`` policies that span an axis, in its order, by score and interval.

    Each round takes the best remaining policy of each of several equal intervals, until ``count``
    policies are chosen or none is left.
    """
    edges = np.linspace(axis.min(), axis.max(), intervals + 1)[1:-1]
    interval = np.searchsorted(edges, axis, side="right")
    # The index decides between equal scores, so that the choice does not depend on the sorting.
    ranked = np.lexsort((np.arange(len(axis)), -score))
    rank = np.zeros(len(axis), np.int64)  # rank within the interval
    for k in range(intervals):
        inside = ranked[interval[ranked] == k]
        rank[inside] = np.arange(len(inside))
    # First the best of every interval, then the second best of each, and so on.
    chosen = np.lexsort((-score, rank))[:count]
    return np.asarray(chosen[np.argsort(axis[chosen], kind="stable")], np.int64)


def _pool(
    config: ArchiveConfig, parameters: Floats, tracks: tuple[str, ...], races: int, seed: int
) -> PolicyPool:
    """Return the races of all pairs of some policies.

    The number of folds is an even divisor of the number of start lines, up to 16.
    """
    planner = get_planner(config.planner)
    complete = planner.complete(config.varied, parameters)
    policies = tuple(Policy(planner, theta, f"policy {k}") for k, theta in enumerate(complete))
    rules = config.rules_of(config.final_duration)
    lines = races // 2
    # An even number, since equally many folds are added and subtracted.
    folds = max(k for k in range(2, MOST_FOLDS + 1, 2) if lines % k == 0)
    return PolicyPool(policies, tracks, rules, races=races, folds=folds, seed=seed)
