"""Fresh pools of policies that span speed evenly, to learn characteristics from and to judge them on."""

from collections.abc import Sequence
from typing import Unpack

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.checks import check_seed, check_whole
from pcs_racing.base.errors import InputError
from pcs_racing.planners.planner import Planner, Policy
from pcs_racing.race.config import RaceConfig
from pcs_racing.track.track import Track
from pcs_racing_agents.base.jobs import Run
from pcs_racing_agents.policies.archive_run import draw_policies
from pcs_racing_agents.policies.evaluate import draw_scenarios, race_policies, summarise
from pcs_racing_agents.policies.policy_pool import race_scores
from studies.axes.behaviour import run_blocks

Floats = NDArray[np.float64]

CANDIDATES = 6
"""Policies that are drawn for each policy of a pool."""
_OPPONENTS = 4
CANDIDATE_RACES = 2 * _OPPONENTS
"""Races of each of them on each circuit."""


def draw_pool(
    planner: Planner,
    tracks: Sequence[Track | str],
    config: RaceConfig,
    size: int,
    *,
    seed: int = 0,
    segment_seconds: float = 8.0,
    **run: Unpack[Run],
) -> tuple[Policy, ...]:
    """Draw policies at random, race them against random opponents, and keep good ones of all speeds.

    Parameters
    ----------
    size : int
        Policies to keep, from 3; six times as many are drawn.
    seed : int
        Root of the policies, start lines and noise.
    segment_seconds : float
        Length of the segments in which speed is measured, s.

    Returns
    -------
    tuple of Policy
        From slow to fast.
    """
    check_whole("size", size, 3, 1000)
    drawn, rivals = (
        draw_policies(planner, count, np.random.SeedSequence(check_seed(seed), spawn_key=(key,)))
        for key, count in enumerate((CANDIDATES * size, _OPPONENTS))
    )
    scenarios = draw_scenarios(
        tracks, config, rivals, ["speed"], planner=planner.name, starts=1, segment_seconds=segment_seconds, seed=seed
    )
    raced = run_blocks(scenarios, drawn, None, race_policies, "candidates", **run)
    score = race_scores(raced["winner"]).mean(axis=1)
    kept = best_of_intervals(summarise(raced).coordinates[:, 0], score, size)
    return tuple(Policy(planner, drawn[i], f"drawn {seed} {i}") for i in kept)


def best_of_intervals(axis: Floats, score: Floats, size: int) -> NDArray[np.int64]:
    """Return the best scored policy of each of ``size`` equal intervals of an axis, in the order of the axis.

    Where an interval is empty, the best scored of all that are left is taken instead.
    """
    if len(axis) < size:
        raise InputError(f"there are {len(axis)} policies; {size} are to be chosen")
    edges = np.linspace(axis.min(), axis.max(), size + 1)[1:-1]
    interval = np.searchsorted(edges, axis, side="right")
    ranked = np.argsort(-score, kind="stable")
    first = np.unique(interval[ranked], return_index=True)[1]
    rest = np.delete(ranked, first)[: size - len(first)]
    chosen = np.concatenate([ranked[first], rest])
    return np.asarray(chosen[np.argsort(axis[chosen], kind="stable")], np.int64)
