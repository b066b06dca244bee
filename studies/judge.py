"""Scores and own crashes of policies against opponents, in equal races on several circuits."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.typing import Floats
from pcs_racing.planners.registry import parse_policy
from pcs_racing.race.config import load_rules
from pcs_racing_agents.base.statistics import Estimate, clustered_mean
from pcs_racing_agents.policies.evaluate import draw_scenarios, race_points, race_policies

Labels = NDArray[np.str_]

SEED = 77


class Judgement(NamedTuple):
    """Races of K policies of one planner; all policies drive the same races."""

    points: Floats  #: shape (K, R): 1 for a win, 0.5 for a tie, else 0.
    own_crash: Floats  #: shape (K, R): 1 for a crash by the policy's own fault.
    opponent: NDArray[np.int64]  #: shape (R,): Index of the opponent.
    start: Labels  #: shape (R,): Circuit and start line.

    def score(self) -> Estimate:
        """Return the mean score over policies and races.

        Clusters are start lines, and policies and opponents if there are several.
        """
        kinds = np.broadcast_arrays(self.start, np.arange(len(self.points))[:, None], self.opponent)
        labels = [np.ravel(kind) for kind in kinds]
        several = [one for one in labels if len(np.unique(one)) > 1]
        return clustered_mean(self.points.ravel(), *several)


def judge(
    policies: Sequence[str],
    opponents: Sequence[str],
    tracks: Sequence[str],
    *,
    races: int,
    rules: str = "contest",
) -> Judgement:
    """Race policies of one planner against opponents: an even number of races a pair and circuit.

    Policies and opponents have the format of :func:`pcs_racing.racer`.
    """
    parsed = [parse_policy(text) for text in policies]
    scenarios = draw_scenarios(
        parsed[0].planner.name,
        tracks,
        load_rules(rules, duration=40.0),
        rivals=tuple(opponents),
        starts=races // 2,
        seed=SEED,
    )
    raced = race_policies((scenarios, np.stack([policy.parameters for policy in parsed])))
    places = zip(scenarios.track, scenarios.start_s, strict=True)
    starts = np.array([f"{track} {start:.3f}" for track, start in places])
    crashes = raced["own_crash"].astype(np.float64)
    return Judgement(race_points(raced), crashes, scenarios.opponent, starts)
