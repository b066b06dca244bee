"""Fits on training races: the best blind agents of three kinds, and the equilibrium mixture of agents.

Blind agents are an open-loop sequence of moves, a fixed policy, and a lead plan (a policy behind and one ahead). Every
candidate drives the same training races (common random numbers), which reduces the noise of their differences. A blind
agent's result is a :class:`pcs_racing_agents.agents.fits.Fit`, a small file for the agents "best-schedule",
"best-fixed" and "best-lead-plan".
"""

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from itertools import combinations, product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.errors import InputError
from pcs_racing.game.competitor import competitor_name
from pcs_racing.game.rules import RaceGame
from pcs_racing.track.track import Track
from pcs_racing_agents.agents.agent import Agent, Competitor
from pcs_racing_agents.agents.blind import LEAD_PLAN, best_fixed, best_lead_plan, best_schedule
from pcs_racing_agents.agents.fits import Fit, make_fit
from pcs_racing_agents.agents.setting import Setting
from pcs_racing_agents.jobs.jobs import Job
from pcs_racing_agents.jobs.progress import Progress
from pcs_racing_agents.tournament.games import PlayedGames
from pcs_racing_agents.tournament.pairings import Pairing, draw_schedule, schedule_pairing
from pcs_racing_agents.tournament.runner import play_pairings

Choices = tuple[int, ...]

OBJECTIVES: dict[str, Callable[[PlayedGames], NDArray[np.float64]]] = {
    "score": lambda games: games.score,
    "utility": lambda games: games.utility,
}
"""Objectives to maximise: races won (a tie counts half), or the game's utility."""


@dataclass(frozen=True, eq=False)
class TrainingRaces:
    """The races in which candidates are compared."""

    tracks: tuple[Track, ...]
    opponents: tuple[Competitor, ...]  #: Each is met equally often.
    setting: Setting
    races: int = 100  #: Races against each opponent on each track; even.
    seed: int = 1_000_003  #: Of starts, start policies and noise: another one than that of the test races.
    objective: str = "score"  #: "score" or "utility"

    def __post_init__(self) -> None:
        if self.objective not in OBJECTIVES:
            raise InputError(f"objective is {self.objective!r}; it must be one of {', '.join(OBJECTIVES)}")
        if len(self.tracks) == 0 or len(self.opponents) == 0:
            raise InputError("training races need at least one track and one opponent")
        object.__setattr__(self, "tracks", tuple(self.tracks))
        object.__setattr__(self, "opponents", tuple(self.opponents))

    def facts(self, reached: float, candidates: int) -> dict[str, str | int | float]:
        """Return how a fit was selected, for its file."""
        return {
            "tracks": ", ".join(track.name for track in self.tracks),
            "opponents": ", ".join(map(competitor_name, self.opponents)),
            "races": self.races * len(self.tracks) * len(self.opponents),
            "candidates": candidates,
            "seed": self.seed,
            "objective": self.objective,
            "reached": round(reached, 4),
        }


class RunOptions(NamedTuple):
    """Where training races are simulated, and who is told of their progress: options of :func:`play_pairings`."""

    job: Job | None = None
    executor: Executor | None = None
    progress: Progress | None = None


def evaluate(training: TrainingRaces, candidates: Sequence[Agent], run: RunOptions, name: str) -> NDArray[np.float64]:
    """Return the mean objective of each candidate over the training races, shape (len(candidates),)."""
    setting = training.setting
    common: list[Pairing] = []
    for track in training.tracks:
        schedule = draw_schedule(track, setting.config.race_rules, training.races, training.seed)
        game = RaceGame(track, setting.archive, setting.config)
        for k, opponent in enumerate(training.opponents):
            # Different start policies against each opponent, the same for all candidates.
            rolled = schedule._replace(draws=np.roll(schedule.draws, 2 * k, axis=0))
            common.append(schedule_pairing(game, candidates[0], opponent, rolled, training.seed))
    pairings = [replace(pairing, ego=candidate) for candidate in candidates for pairing in common]
    played = play_pairings(pairings, name=name, **run._asdict())
    means = np.array([OBJECTIVES[training.objective](games).mean() for games in played])
    return means.reshape(len(candidates), -1).mean(axis=1)


def fit_best_schedule(
    training: TrainingRaces,
    *,
    method: str = "ascent",
    job: Job | None = None,
    executor: Executor | None = None,
    progress: Progress | None = None,
) -> Fit:
    """Find the open-loop sequence of moves with the highest mean objective.

    Parameters
    ----------
    method : {"ascent", "all"}
        "all" evaluates every sequence: M to the power of the number of moves, 625 for 5 moves and 4 steps. "ascent"
        begins with the best constant sequence and takes the best change of one step, until none is an improvement.
    """
    setting, run = training.setting, RunOptions(job, executor, progress)
    count, steps = len(setting.moves), setting.config.moves
    if method not in ("ascent", "all"):
        raise InputError(f"method is {method!r}; it must be 'ascent' or 'all'")
    if method == "all" and count**steps > 10_000:
        raise InputError(f"method 'all' would try {count**steps} sequences; take 'ascent'")

    def raced(sequences: Sequence[Choices], before: int) -> NDArray[np.float64]:
        plans = [best_schedule(setting, moves=[setting.moves[i] for i in sequence]) for sequence in sequences]
        return evaluate(training, plans, run, f"schedule-{before}")

    best, scores = _search(raced, range(count), steps, method == "all")
    facts = {"method": method, **training.facts(scores[best], len(scores))}
    return make_fit("best-schedule", [setting.moves[i] for i in best], setting, facts)


def _search(
    raced: Callable[[Sequence[Choices], int], NDArray[np.float64]],
    options: Sequence[int],
    places: int,
    every: bool = False,
) -> tuple[Choices, dict[Choices, float]]:
    """Search the best choice of an option for each of some places.

    Parameters
    ----------
    raced : callable
        ``raced(choices, before)`` returns what choices reach; ``before`` were raced earlier.
    every : bool
        Whether to race every choice; otherwise the search begins with the best of those with one option at all places,
        and takes the best change of one place until none is an improvement.

    Returns
    -------
    best : tuple of int
        Of equals the one with the lowest numbers.
    scores : dict of tuple of int to float
        What was raced.
    """
    scores: dict[Choices, float] = {}

    def race_new(choices: Sequence[Choices]) -> None:
        new = [choice for choice in dict.fromkeys(choices) if choice not in scores]
        if new:
            scores.update(zip(new, raced(new, len(scores)).tolist(), strict=True))

    def best() -> Choices:
        return max(scores, key=lambda choice: (scores[choice], [-i for i in choice]))

    if every:
        race_new(list(product(options, repeat=places)))
        return best(), scores
    race_new([(option,) * places for option in options])
    current: Choices | None = None
    while current != best():
        current = best()
        race_new([(*current[:k], option, *current[k + 1 :]) for k in range(places) for option in options])
    return current, scores


def fit_best_fixed(
    training: TrainingRaces,
    *,
    targets: Sequence[int] | None = None,
    job: Job | None = None,
    executor: Executor | None = None,
    progress: Progress | None = None,
) -> Fit:
    """Find the target policy with the highest mean objective, for an agent that goes there and keeps it.

    Parameters
    ----------
    targets : sequence of int, optional
        Candidates; all policies of the archive by default.
    """
    setting = training.setting
    candidates = list(range(len(setting.archive))) if targets is None else [int(target) for target in targets]
    walkers = [best_fixed(setting, target=target) for target in candidates]
    values = evaluate(training, walkers, RunOptions(job, executor, progress), "fixed")
    index = int(np.argmax(values))
    return make_fit("best-fixed", candidates[index], setting, training.facts(float(values[index]), len(candidates)))


def fit_best_lead_plan(
    training: TrainingRaces,
    *,
    targets: Sequence[int] | None = None,
    job: Job | None = None,
    executor: Executor | None = None,
    progress: Progress | None = None,
) -> Fit:
    """Find two target policies with the highest mean objective, for an agent that goes to one behind and one ahead.

    The search begins with the best fixed policy, the same behind and ahead, and takes the best change of one of the
    two until none is an improvement: on the training races the plan is at least as good as the best fixed policy.

    Parameters
    ----------
    targets : sequence of int, optional
        Candidates; all policies of the archive by default.
    """
    setting, run = training.setting, RunOptions(job, executor, progress)
    candidates = list(range(len(setting.archive))) if targets is None else [int(target) for target in targets]

    def raced(plans: Sequence[Choices], before: int) -> NDArray[np.float64]:
        agents = [best_lead_plan(setting, targets=dict(zip(LEAD_PLAN, plan, strict=True))) for plan in plans]
        return evaluate(training, agents, run, f"lead-plan-{before}")

    best, scores = _search(raced, candidates, len(LEAD_PLAN))
    choice = dict(zip(LEAD_PLAN, best, strict=True))
    return make_fit("best-lead-plan", choice, setting, training.facts(scores[best], len(scores)))


class MetaStrategy(NamedTuple):
    """An equilibrium of the zero-sum game in which both players choose one of N agents."""

    weights: NDArray[np.float64]  #: shape (N,): Probability of each agent.
    payoffs: NDArray[np.float64]  #: shape (N, N): Mean excess of each agent's objective over each other's.


def fit_psro(
    training: TrainingRaces,
    members: Sequence[Agent],
    *,
    known: MetaStrategy | None = None,
    job: Job | None = None,
    executor: Executor | None = None,
    progress: Progress | None = None,
) -> MetaStrategy:
    """Find the equilibrium probabilities of agents, in the zero-sum game in which both players choose an agent.

    The payoff of one agent against another is its mean objective minus the other's, over the same races from both
    sides of the grid (empirical game of PSRO, Lanctot et al. 2017).

    Parameters
    ----------
    training : TrainingRaces
        Its opponents are not used.
    members : sequence of Agent
        At least two.
    known : MetaStrategy, optional
        Of the first members: their payoffs are taken from it.
    """
    from pcs_racing_agents.tournament.round_robin import zero_sum_equilibrium

    names = [member.name for member in members]
    if len(members) < 2 or len(set(names)) < len(names):
        raise InputError(f"members are {', '.join(names) or 'nobody'}; psro needs at least two, with different names")
    first = 0 if known is None else len(known.payoffs)
    if first > len(members):
        raise InputError(f"payoffs of {first} agents are known, and there are {len(members)} members; give all of them")
    setting = training.setting
    pairs = [(i, j) for i, j in combinations(range(len(members)), 2) if j >= first]
    games_and_schedules = []
    for track in training.tracks:
        schedule = draw_schedule(track, setting.config.race_rules, training.races, training.seed)
        games_and_schedules.append((RaceGame(track, setting.archive, setting.config), schedule))
    pairings = [
        schedule_pairing(game, members[i], members[j], schedule, training.seed)
        for (i, j), (game, schedule) in product(pairs, games_and_schedules)
    ]
    name = f"psro-{first}-{len(members)}"
    played = play_pairings(pairings, name=name, job=job, executor=executor, progress=progress)
    excess = [_excess(games, training.objective) for games in played]
    payoffs = np.zeros((len(members), len(members)))
    if known is not None:
        payoffs[:first, :first] = known.payoffs
    for (i, j), value in zip(pairs, np.reshape(excess, (len(pairs), -1)).mean(axis=1), strict=True):
        payoffs[i, j], payoffs[j, i] = value, -value
    return MetaStrategy(zero_sum_equilibrium(payoffs).row, payoffs)


def _excess(games: PlayedGames, objective: str) -> float:
    """Return the ego's mean objective minus the opponent's."""
    if objective == "utility":
        return float(games.utility.mean())  # of a zero-sum game
    return float(np.mean(1.0 * (games.winner == 0) - 1.0 * (games.winner == 1)))
