"""Fits on training races: three kinds of baselines, and the equilibrium mixture of agents.

The baselines are an open-loop sequence of moves, a fixed policy, and a lead plan (a policy behind
and a policy ahead). Every candidate drives the same training races (common random numbers), which
reduces the noise of their differences. The result of a baseline is a
:class:`pcs_racing_agents.agents.blind.Fit`, a small file for the agents "best-schedule",
"best-fixed" and "best-lead-plan".
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, product
from typing import Any, NamedTuple, Unpack

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.errors import InputError
from pcs_racing.game.players import Competitor
from pcs_racing.game.rules import RaceGame
from pcs_racing.planners.racers import own_name
from pcs_racing.track.track import Track
from pcs_racing_agents.agents.agent import Agent
from pcs_racing_agents.agents.blind import (
    LEAD_PLAN,
    Fit,
    best_fixed,
    best_lead_plan,
    best_schedule,
    make_fit,
)
from pcs_racing_agents.base.jobs import Run
from pcs_racing_agents.solvers.matrix_games import solve_matrix_games
from pcs_racing_agents.tournament.pairings import (
    Pairing,
    RaceSchedule,
    draw_schedule,
    play_pairings,
    schedule_pairing,
)
from pcs_racing_agents.tournament.races import series_of

Choices = tuple[int, ...]


@dataclass(frozen=True, eq=False)
class TrainingRaces:
    """Training races for the comparison of candidates."""

    tracks: tuple[Track, ...]
    opponents: tuple[Competitor, ...]  #: Opponents, with equal frequencies.
    spec: RaceGame
    races: int = 100  #: Races against each opponent on each track; even.
    seed: int = 1_000_003  #: Seed of starts, start policies and noise; different from test races.

    def __post_init__(self) -> None:
        if len(self.tracks) == 0 or len(self.opponents) == 0:
            raise InputError("training races need at least one track and one opponent")

    def facts(self, reached: float, candidates: int) -> dict[str, str | int | float]:
        """Return facts about the selection of a fit, for its file."""
        return {
            "tracks": ", ".join(track.name for track in self.tracks),
            "opponents": ", ".join(map(own_name, self.opponents)),
            "races": self.races * len(self.tracks) * len(self.opponents),
            "candidates": candidates,
            "seed": self.seed,
            "reached": round(reached, 4),
        }


def evaluate(
    training: TrainingRaces,
    candidates: Sequence[Agent],
    name: str = "candidates",
    **run: Unpack[Run],
) -> NDArray[np.float64]:
    """Return the mean score of each candidate over the training races, shape (len(candidates),)."""
    common: list[Pairing] = []
    for game, schedule in _games(training):
        for k, opponent in enumerate(training.opponents):
            # Start policies differ between opponents, but not between candidates.
            rolled = schedule._replace(draws=np.roll(schedule.draws, 2 * k, axis=0))
            common.append(schedule_pairing(game, candidates[0], opponent, rolled, training.seed))
    # Pairings differ only in their ego: common parts of the candidates' races are simulated once.
    pairings = [replace(pairing, ego=candidate) for candidate in candidates for pairing in common]
    raced = play_pairings(pairings, name=name, **run)
    means = np.array([series_of(races, training.spec.rules).score.mean() for races in raced])
    return means.reshape(len(candidates), -1).mean(axis=1)


def _games(training: TrainingRaces) -> list[tuple[RaceGame, RaceSchedule]]:
    """Return the game and the race schedule of each track."""
    spec, rules = training.spec, training.spec.rules.for_game
    return [
        (
            RaceGame(track, spec.archive, spec.rules),
            draw_schedule(track, rules, training.races, training.seed),
        )
        for track in training.tracks
    ]


def fit_best_schedule(training: TrainingRaces, **run: Unpack[Run]) -> Fit:
    """Find the open-loop sequence of moves with the highest mean score.

    The search starts with the best constant sequence, and repeatedly makes the best change of one
    step until no change is an improvement.
    """
    spec = training.spec

    def moves(choice: Choices) -> list[str]:
        return [spec.moves[i] for i in choice]

    return _fit(
        training,
        "best-schedule",
        lambda choice: best_schedule(spec, moves=moves(choice)),
        moves,
        range(len(spec.moves)),
        spec.rules.moves,
        **run,
    )


def fit_best_fixed(
    training: TrainingRaces, *, targets: Sequence[int] | None = None, **run: Unpack[Run]
) -> Fit:
    """Find the target policy with the highest mean score, for an agent that moves there and stays.

    ``targets``: candidates; by default all policies of the archive.
    """
    spec = training.spec
    return _fit(
        training,
        "best-fixed",
        lambda choice: best_fixed(spec, target=choice[0]),
        lambda choice: choice[0],
        range(len(spec.archive)) if targets is None else targets,
        1,
        **run,
    )


def fit_best_lead_plan(
    training: TrainingRaces, *, targets: Sequence[int] | None = None, **run: Unpack[Run]
) -> Fit:
    """Find the two target policies of a lead plan (behind, ahead) with the highest mean score.

    The search starts with the best fixed policy, used behind and ahead, and repeatedly makes the
    best change of one target until no change is an improvement. In the training races the plan is
    at least as good as the best fixed policy.

    Parameters
    ----------
    targets : sequence of int, optional
        Candidates; by default all policies of the archive.
    """
    spec = training.spec

    def plan(choice: Choices) -> dict[str, int]:
        return dict(zip(LEAD_PLAN, choice, strict=True))

    return _fit(
        training,
        "best-lead-plan",
        lambda choice: best_lead_plan(spec, targets=plan(choice)),
        plan,
        range(len(spec.archive)) if targets is None else targets,
        len(LEAD_PLAN),
        **run,
    )


def _fit(
    training: TrainingRaces,
    name: str,
    agent: Callable[[Choices], Agent],
    plain: Callable[[Choices], Any],
    options: Sequence[int],
    places: int,
    **run: Unpack[Run],
) -> Fit:
    """Search the best choice of an option for each place.

    ``agent``: returns the agent of a choice. ``plain``: returns a choice as the fit stores it.
    """

    def raced(choices: Sequence[Choices], before: int) -> NDArray[np.float64]:
        return evaluate(training, list(map(agent, choices)), f"{name}-{before}", **run)

    best, scores = _search(raced, options, places)
    return make_fit(name, plain(best), training.spec, training.facts(scores[best], len(scores)))


def _search(
    raced: Callable[[Sequence[Choices], int], NDArray[np.float64]],
    options: Sequence[int],
    places: int,
) -> tuple[Choices, dict[Choices, float]]:
    """Search the best choice of an option for each place; return it with all evaluated scores.

    The search starts with the best constant choice (one option at all places), and repeatedly makes
    the best change of one place until no change is an improvement. Ties go to the choice with the
    lowest numbers.

    Parameters
    ----------
    raced : callable
        ``raced(choices, before)`` returns the scores of choices; ``before`` is the number of
        choices raced earlier.
    """
    scores: dict[Choices, float] = {}

    def race_new(choices: Sequence[Choices]) -> Choices:
        new = [choice for choice in dict.fromkeys(choices) if choice not in scores]
        if new:
            scores.update(zip(new, raced(new, len(scores)).tolist(), strict=True))
        return max(scores, key=lambda choice: (scores[choice], [-i for i in choice]))

    # Every choice is raced once. The search ends after a round without an improvement.
    current: Choices = ()
    best = race_new([(option,) * places for option in options])
    while current != best:
        current = best
        best = race_new(
            [(*current[:k], option, *current[k + 1 :]) for k in range(places) for option in options]
        )
    return best, scores


class MetaStrategy(NamedTuple):
    """Equilibrium of the zero-sum meta-game; both players choose one of N agents."""

    weights: NDArray[np.float64]  #: shape (N,): Probability of each agent.
    #: shape (N, N): Row agent's share of races won minus column agent's share.
    payoffs: NDArray[np.float64]


def fit_psro(
    training: TrainingRaces,
    members: Sequence[Agent],
    *,
    known: MetaStrategy | None = None,
    **run: Unpack[Run],
) -> MetaStrategy:
    """Find the equilibrium probabilities of agents in the zero-sum game of choosing an agent.

    The payoff of an agent against another agent is the difference of their shares of races won,
    over the same races from both sides of the grid (empirical game of PSRO, Lanctot et al. 2017).

    Parameters
    ----------
    training : TrainingRaces
        Training races; the opponents are not used.
    members : sequence of Agent
        At least two agents.
    known : MetaStrategy, optional
        Equilibrium of the first members; their payoffs are reused.
    """
    first = 0 if known is None else len(known.payoffs)
    pairs = [(i, j) for i, j in combinations(range(len(members)), 2) if j >= first]
    pairings = [
        schedule_pairing(game, members[i], members[j], schedule, training.seed)
        for (i, j), (game, schedule) in product(pairs, _games(training))
    ]
    played = play_pairings(pairings, name=f"psro-{first}-{len(members)}", **run)
    # Wins minus losses: a no-contest counts as 0, like a tie.
    scored = [series_of(races, training.spec.rules) for races in played]
    excess = [np.mean(1.0 * (races.winner == 0) - 1.0 * (races.winner == 1)) for races in scored]
    # The game is zero-sum: one direction of each pair is sufficient.
    payoffs = np.zeros((len(members), len(members)))
    if known is not None:
        payoffs[:first, :first] = known.payoffs
    for (i, j), value in zip(pairs, np.reshape(excess, (len(pairs), -1)).mean(axis=1), strict=True):
        payoffs[i, j], payoffs[j, i] = value, -value
    return MetaStrategy(solve_matrix_games(payoffs).rows[0], payoffs)
