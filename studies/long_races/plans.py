"""Plans by the size of the lead: agents that move to one policy of several by their lead alone."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple, Unpack

import numpy as np

from pcs_racing.base.typing import Floats
from pcs_racing.game.observation import LEAD_SCALE
from pcs_racing.game.rules import RaceGame
from pcs_racing_agents.agents.agent import Agent
from pcs_racing_agents.agents.blind import WalkStrategy, walk_to
from pcs_racing_agents.agents.observing import ObservationBatch, lead
from pcs_racing_agents.base.jobs import Run
from pcs_racing_agents.tournament.fitting import TrainingRaces, evaluate

EDGES = (5.0, 20.0)
"""Candidates for the lead where a plan by the size of the lead changes its policy, m."""
MEMBERS = 3
"""Number of policies that plans are made of: the best ones of the fixed policies."""


class Plan(NamedTuple):
    """Target policies of an archive by the lead."""

    edges: tuple[float, ...]  #: Leads where the target changes, m, ascending.
    targets: tuple[int, ...]  #: Index of the target: below the first edge, ..., from the last edge.

    def __str__(self) -> str:
        bounds = [f"from {edge:g} m: " for edge in self.edges]
        parts = zip(["", *bounds], self.targets, strict=True)
        return ", ".join(f"{bound}policy {target}" for bound, target in parts)


@dataclass(frozen=True, eq=False)
class PlanStrategy:
    """A path through the archive to the target of the last measured lead."""

    edges: Floats  #: Leads where the target changes, m, shape (E,).
    walks: tuple[WalkStrategy, ...]  #: Paths to the E + 1 targets.

    def __call__(self, observation: ObservationBatch) -> Floats:
        """Return the probabilities of the moves, shape (B, M)."""
        axes = len(self.walks[0].archive.characteristics)
        metres = LEAD_SCALE * lead(observation, axes).astype(np.float64)
        place = np.searchsorted(self.edges, metres, side="right")
        moves = np.stack([walk(observation) for walk in self.walks])
        return moves[place, np.arange(len(place))]


def plan_agent(spec: RaceGame, plan: Plan, name: str) -> Agent:
    """Return an agent that follows a plan."""
    walks = tuple(walk_to(spec, target) for target in plan.targets)
    return Agent(name, PlanStrategy(np.array(plan.edges), walks), spec, 0, {"plan": str(plan)})


def fit_plans(
    training: TrainingRaces, name: str, **run: Unpack[Run]
) -> dict[str, tuple[Plan, float]]:
    """Return the best plan of each arm with its score in the training races.

    The arms are a fixed policy, a plan by the sign of the lead, and a plan by the size of the lead.
    Each search starts with the plan of the arm before it. ``name``: prefix of the job's chunks.
    """
    scores: dict[Plan, float] = {}

    def raced(plans: Sequence[Plan]) -> Plan:
        new = [plan for plan in plans if plan not in scores]
        if new:
            agents = [plan_agent(training.spec, plan, "plan") for plan in new]
            found = evaluate(training, agents, f"{name}-{len(scores)}", **run)
            scores.update(zip(new, found.tolist(), strict=True))
        return max(plans, key=lambda plan: scores[plan])

    fixed = [Plan((), (k,)) for k in range(len(training.spec.archive))]
    best = raced(fixed)
    ranked = sorted(fixed, key=lambda plan: scores[plan], reverse=True)
    members = [plan.targets[0] for plan in ranked[:MEMBERS]]
    sign = climb(Plan((0.0,), best.targets * 2), members, raced)
    behind, ahead = sign.targets
    starts = [Plan((-edge, edge), (behind, ahead, ahead)) for edge in EDGES]
    size = raced([climb(start, members, raced) for start in starts])
    arms = {"best-fixed": best, "best-lead-plan": sign, "lead-size-plan": size}
    return {arm: (plan, scores[plan]) for arm, plan in arms.items()}


def climb(start: Plan, members: Sequence[int], raced: Callable[[Sequence[Plan]], Plan]) -> Plan:
    """Make the best change of one target until no change is an improvement.

    ``raced``: returns the first of the plans with the highest score.
    """
    current = start
    while True:
        changed = [
            current._replace(targets=(*current.targets[:k], other, *current.targets[k + 1 :]))
            for k in range(len(current.targets))
            for other in members
        ]
        better = raced([current, *changed])
        if better == current:
            return current
        current = better
