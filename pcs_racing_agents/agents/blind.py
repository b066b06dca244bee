"""Baselines for adaptive agents: open-loop agents and a lead-conditioned agent.

Open-loop agents follow constant probabilities, a sequence of moves or a path to a policy.
:mod:`pcs_racing_agents.tournament.fitting` chooses the best open-loop sequence, the best target
policy and the best lead plan on training races. The moves of a lead plan depend on the leading car,
and on nothing else of the opponent: the gain of an agent over the lead plan comes from knowing the
opponent. A policy with ``pace_behind`` reacts to the lead by itself, so a race with such policies
is lead-conditioned for any agent.

A fit is a choice made on training races, as a small file: a sequence of moves, or target policies.

Fixed policies of the zoo, from outside the archive.
"""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.artifacts import ManifestFormat
from pcs_racing.base.errors import InputError, UnknownNameError, check_whole, is_whole
from pcs_racing.base.typing import Floats
from pcs_racing.game.archive import PolicyArchive
from pcs_racing.game.identity import (
    GameIdentity,
    check_same_game,
    plain_identity,
    read_identity,
)
from pcs_racing.game.players import never_switch, random_moves
from pcs_racing.game.rules import RaceGame
from pcs_racing.planners.planner import PolicySet
from pcs_racing_agents.agents.agent import Agent
from pcs_racing_agents.agents.observing import ObservationBatch, lead, moves_made, own
from pcs_racing_agents.agents.training import shipped_name, training_text
from pcs_racing_agents.agents.zoo import Entry

FIT_FORMAT = ManifestFormat(
    "fit",
    ("kind", "choice", "archive", "archive_sha256", "rules", "epsilon", "decisions", "training"),
    "save_fit",
)
KINDS: dict[str, tuple[type, str]] = {
    "best-schedule": (list, "a list of moves"),
    "best-fixed": (int, "the index of a policy"),
    "best-lead-plan": (dict, "the indices of two policies, behind and ahead"),
}
"""Kinds of fits: type and description of the choice."""


@dataclass(frozen=True, eq=False)
class Fit:
    """A choice made on training races, with the game that it is valid for."""

    kind: str  #: Name of the agent that follows the choice.
    choice: Any  #: Names of moves, index of a policy, or indices of the policies behind and ahead.
    #: Game of the training races; a file records no names of moves and elements.
    game: GameIdentity
    #: Facts about the training and its result: texts and numbers by name.
    training: Mapping[str, str | int | float | bool] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not isinstance(self.kind, str) or self.kind not in KINDS:
            raise UnknownNameError(
                f"fit of {self.kind!r} is unknown; there are fits of {', '.join(KINDS)}"
            )
        kind, wanted = KINDS[self.kind]
        # A bool is an int in Python, but no index of a policy.
        if not (is_whole(self.choice) if kind is int else isinstance(self.choice, kind)):
            raise InputError(f"the choice of {self.kind} is {self.choice!r}; it must be {wanted}")
        if not isinstance(self.training, Mapping):
            raise InputError(f"training is {self.training!r}; it must be a mapping")

    def check_fits(self, spec: RaceGame) -> None:
        """Check that a choice is valid for a game."""
        check_same_game(self.game, spec.identity, f"the fit of {self.kind}")


def make_fit(kind: str, choice: Any, spec: RaceGame, training: Mapping[str, Any]) -> Fit:
    """Return the fit of a choice for a game spec."""
    return Fit(kind, choice, spec.identity._replace(elements=(), moves=()), dict(training))


def save_fit(fit: Fit, path: str | Path) -> Path:
    """Write a fit as YAML, atomically."""
    fields = {
        "kind": fit.kind,
        "choice": fit.choice,
        **plain_identity(fit.game),
        "training": dict(fit.training),
    }
    FIT_FORMAT.write(Path(path), fields)
    return Path(path)


def load_fit(path: str | Path) -> Fit:
    """Read a fit."""
    if not isinstance(path, str | os.PathLike):
        raise InputError(f"fit {path!r} must be the path of a file")
    fields = FIT_FORMAT.read(path)
    try:
        return Fit(fields["kind"], fields["choice"], read_identity(fields), fields["training"])
    except InputError as error:
        raise type(error)(f"{path}: {error}") from None


def shipped_fits() -> Path:
    """Return the folder of the shipped fits; files have names ``ARCHIVE-RULES-KIND.yaml``."""
    return Path(__file__).resolve().parents[1] / "data" / "fits"


FitSource = str | Path | Fit | None
"""A fit, its file, or None for the shipped fit."""


def find_fit(kind: str, spec: RaceGame, source: FitSource = None) -> Fit:
    """Return a fit for a game spec: the given fit, a fit from a file, or the shipped fit."""
    if source is None:
        known = sorted(path.stem for path in shipped_fits().glob("*.yaml"))
        how = "choose one with pcs_racing_agents.tournament.fitting and give it as fit=FILE"
        name = shipped_name(spec, kind, known, f"agent {kind!r}", how)
        source = shipped_fits() / f"{name}.yaml"
    fit = source if isinstance(source, Fit) else load_fit(source)
    if fit.kind != kind:
        raise InputError(f"the fit is one of {fit.kind!r}; agent {kind!r} needs its own")
    fit.check_fits(spec)
    return fit


LEAD_PLAN = ("behind", "ahead")
"""Situations of a lead plan, with a policy for each."""


@dataclass(frozen=True, eq=False)
class OpenLoopStrategy:
    """An open-loop strategy: a sequence of moves chosen before the race."""

    sequence: NDArray[np.int64]  #: shape (m,): Move of each step.
    count: int  #: Number M of all moves.
    axes: int  #: Number of axes of the game.

    def __call__(self, observation: ObservationBatch) -> Floats:
        """Return the probabilities of the moves, shape (B, M)."""
        step = np.minimum(moves_made(observation, self.axes), len(self.sequence) - 1)
        return np.eye(self.count)[self.sequence[step]]


@dataclass(frozen=True, eq=False)
class WalkStrategy:
    """A path through the archive: the next move depends only on the own policy."""

    next_move: NDArray[np.int64]  #: shape (K,): Next move from each policy.
    archive: PolicyArchive
    count: int  #: Number M of all moves.

    def __call__(self, observation: ObservationBatch) -> Floats:
        """Return the probabilities of the moves, shape (B, M)."""
        policy = self.archive.nearest(own(observation, len(self.archive.characteristics)))
        return np.eye(self.count)[self.next_move[policy]]


@dataclass(frozen=True, eq=False)
class LeadPlanStrategy:
    """A path through the archive to one policy while the opponent leads, else to another policy."""

    behind: WalkStrategy  #: ``behind``, ``ahead``: The paths; level cars count as ahead.
    ahead: WalkStrategy

    def __call__(self, observation: ObservationBatch) -> Floats:
        """Return the probabilities of the moves, shape (B, M)."""
        leads = lead(observation, len(self.ahead.archive.characteristics)) >= 0.0
        return np.where(leads[:, None], self.ahead(observation), self.behind(observation))


def walk_to(spec: RaceGame, target: int) -> WalkStrategy:
    """Return a strategy that follows a shortest path of moves to a policy and then stays there.

    If no path leads to the target, the path ends at the nearest reachable policy. Among several
    shortest paths, the strategy takes the path with moves that come first in the list.
    """
    policies = len(spec.archive)
    if not is_whole(target) or not 0 <= target < policies:
        raise InputError(
            f"target is {target!r}; it must be the index of a policy in archive"
            f" {spec.archive.name!r}, 0 to {policies - 1}"
        )
    moves = path_moves(spec.table, spec.archive.normalised, int(target))
    return WalkStrategy(moves, spec.archive, len(spec.moves))


def path_moves(table: ArrayLike, points: ArrayLike, target: int) -> NDArray[np.int64]:
    """Return the first move of a shortest path from each policy to a target, shape (K,).

    At the end of its path, a policy gets the move with the nearest result: a move that keeps the
    policy, if such a move exists.

    Parameters
    ----------
    table : array_like, shape (K, M)
        Policy that every move leads to from every policy.
    points : array_like, shape (K, G)
        Coordinates of the policies.
    """
    leads_to = np.asarray(table, np.int64)
    coordinates = np.asarray(points, np.float64)
    policies = len(leads_to)
    # The number of moves decides the path. If no path leads to the target, the distance in the
    # space decides the goal.
    steps = _distances(leads_to)
    distance = np.linalg.norm(coordinates - coordinates[target], axis=1)
    first = np.empty(policies, np.int64)
    for k in range(policies):
        reached = np.flatnonzero(steps[k] < policies)
        goal = target if steps[k, target] < policies else reached[np.argmin(distance[reached])]
        if goal == k:
            first[k] = np.argmin(np.linalg.norm(coordinates[leads_to[k]] - coordinates[k], axis=1))
            # The move "stay" comes last and is preferred among moves that keep the policy.
            if leads_to[k, -1] == k:
                first[k] = leads_to.shape[1] - 1
        else:
            first[k] = np.argmax(steps[leads_to[k], goal] == steps[k, goal] - 1)
    return first


def _distances(leads_to: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the min number of moves from each policy to each other policy, shape (K, K).

    It is K if no path exists.
    """
    policies = len(leads_to)
    steps = np.full((policies, policies), policies, np.int64)
    np.fill_diagonal(steps, 0)
    # No path is longer than the number of policies; usually the first rounds find all paths.
    for _ in range(policies):
        shorter = np.minimum(steps, 1 + steps[leads_to].min(axis=1))
        if (shorter == steps).all():
            break
        steps = shorter
    return steps


# Agents


def _choice(
    kind: str, spec: RaceGame, agent: str, given: Any, fit: FitSource
) -> tuple[Any, dict[str, str]]:
    """Return the given choice without facts, or the choice of a fit with its training facts."""
    if given is None:
        loaded = find_fit(kind, spec, fit)
        return loaded.choice, {"trained on": training_text(loaded.training)}
    if fit is not None:
        raise InputError(f"agent {agent!r} got {given!r} and a fit; give one of the two")
    return given, {}


def best_schedule(
    spec: RaceGame,
    *,
    name: str = "best-schedule",
    seed: int = 0,
    moves: Sequence[str] | None = None,
    fit: FitSource = None,
) -> Agent:
    """Return an agent that makes the same sequence of moves in every race.

    Parameters
    ----------
    moves : sequence of str, optional
        Names of the moves, as many as a game has moves.
    fit : Fit or path, optional
        A sequence selected by :func:`pcs_racing_agents.tournament.fitting.fit_best_schedule`;
        by default the shipped sequence.
    """
    moves, facts = _choice("best-schedule", spec, name, moves, fit)
    if isinstance(moves, str) or len(moves) != spec.rules.moves:
        raise InputError(
            f"agent {name!r} got the plan {moves!r}; a game has {spec.rules.moves} moves"
        )
    sequence = np.array([spec.move(move) for move in moves], np.int64)
    strategy = OpenLoopStrategy(sequence, len(spec.moves), len(spec.archive.characteristics))
    return Agent(
        name, strategy, spec, seed, {**facts, "plan": ", ".join(spec.moves[i] for i in sequence)}
    )


def best_fixed(
    spec: RaceGame,
    *,
    name: str = "best-fixed",
    seed: int = 0,
    target: int | None = None,
    fit: FitSource = None,
) -> Agent:
    """Return an agent that follows a shortest path of moves to one policy and then stays there.

    Parameters
    ----------
    target : int, optional
        Index of the policy.
    fit : Fit or path, optional
        A target selected by :func:`pcs_racing_agents.tournament.fitting.fit_best_fixed`;
        by default the shipped target.
    """
    target, facts = _choice("best-fixed", spec, name, target, fit)
    strategy = walk_to(spec, target)
    return Agent(name, strategy, spec, seed, {**facts, "target": _policy_text(spec, target)})


def best_lead_plan(
    spec: RaceGame,
    *,
    name: str = "best-lead-plan",
    seed: int = 0,
    targets: Mapping[str, int] | None = None,
    fit: FitSource = None,
) -> Agent:
    """Return an agent that moves to one policy while the opponent leads, else to another policy.

    It follows shortest paths of moves. From its observation it uses only the own policy and the
    sign of the lead at the end of the last step.

    Parameters
    ----------
    targets : mapping, optional
        Index of the policy for ``"behind"`` and for ``"ahead"``.
    fit : Fit or path, optional
        Targets selected by :func:`pcs_racing_agents.tournament.fitting.fit_best_lead_plan`;
        by default the shipped targets.
    """
    targets, facts = _choice("best-lead-plan", spec, name, targets, fit)
    if not isinstance(targets, Mapping) or set(targets) != set(LEAD_PLAN):
        raise InputError(
            f"agent {name!r} got targets {targets!r}; give a policy for each of"
            f" {', '.join(LEAD_PLAN)}"
        )
    strategy = LeadPlanStrategy(*(walk_to(spec, targets[place]) for place in LEAD_PLAN))
    plan = {place: _policy_text(spec, targets[place]) for place in LEAD_PLAN}
    return Agent(name, strategy, spec, seed, {**facts, **plan})


def _policy_text(spec: RaceGame, index: int) -> str:
    """Return a policy with its coordinates as text: ``policy 3 (speed 0.20, restraint 0.91)``."""
    point = zip(spec.archive.characteristics, spec.archive.normalised[index], strict=True)
    return f"policy {index} ({', '.join(f'{axis} {value:.2f}' for axis, value in point)})"


NEVER_SWITCH = Entry(
    never_switch, "keeps its start policy for the whole race", "the paper's non-GT agent"
)
RANDOM_MOVES = Entry(random_moves, "draws every move, all with the same probability", "baseline")
BEST_SCHEDULE = Entry(
    best_schedule,
    "makes a fixed sequence of moves, the best one on training races",
    "baseline: open-loop moves; a policy with pace_behind reacts to the lead",
    "fit",
)
BEST_FIXED = Entry(
    best_fixed,
    "moves to one policy of the archive, the best one on training races, and keeps it",
    "baseline: open-loop moves; a policy with pace_behind reacts to the lead",
    "fit",
)
BEST_LEAD_PLAN = Entry(
    best_lead_plan,
    "moves to one policy of the archive while the opponent leads and to another one otherwise, the"
    " best two on training races",
    "baseline: lead-conditioned, observes who leads and nothing else of the opponent",
    "fit",
)


def random_policy(
    spec: RaceGame, *, name: str = "random-policy", seed: int = 0, first: int | None = None
) -> PolicySet:
    """Return all policies that the archive's synthesis evaluated: the paper's random agent.

    Parameters
    ----------
    first : int, optional
        Number of policies, from the first; by default all. The initial sample comes first: its
        policies were drawn, not searched.
    """
    archive = spec.archive
    explored = len(archive.explored_parameters)
    if explored == 0:
        raise InputError(
            f"archive {archive.name!r} holds no explored policies, so there is no {name!r} to race"
        )
    count = explored if first is None else check_whole("first", first, 1, explored)
    return PolicySet(name, tuple(archive.explored_policy(i) for i in range(count)))


RANDOM_POLICY = Entry(
    random_policy,
    "keeps one of all policies that synthesis evaluated, in the archive or not",
    "the paper's random agent",
    moves=False,
)
