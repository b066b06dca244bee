"""The best that can be done without looking at the race, and the best mixture of agents: chosen on training races.

Every candidate drives the same training races (common random numbers), so that the choice is between candidates and
not between their luck. What is found is a :class:`pcs_racing_agents.agents.fits.Fit`, a small file that the agents
"best-schedule", "best-fixed" and "psro" follow.
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
from pcs_racing_agents.agents.blind import best_fixed, best_schedule
from pcs_racing_agents.agents.fits import Fit, make_fit
from pcs_racing_agents.agents.setting import Setting
from pcs_racing_agents.jobs.jobs import Job, Progress
from pcs_racing_agents.tournament.matches import Matches
from pcs_racing_agents.tournament.pairings import Pairing, schedule_pairing
from pcs_racing_agents.tournament.runner import play_pairings
from pcs_racing_agents.tournament.schedule import draw_schedule

__all__ = ["OBJECTIVES", "TrainingRaces", "fit_best_fixed", "fit_best_schedule", "fit_psro"]

OBJECTIVES: dict[str, Callable[[Matches], NDArray[np.float64]]] = {
    "score": lambda matches: matches.score,
    "utility": lambda matches: matches.utility,
}
"""What is made as large as possible: races won (a tie counting half), or the game's utility."""


@dataclass(frozen=True, eq=False)
class TrainingRaces:
    """What candidates are tried on.

    Attributes
    ----------
    tracks : tuple of Track
    opponents : tuple of Competitor
        Each is met equally often.
    setting : Setting
    races : int
        Races against each opponent on each track; even.
    seed : int
        Of starts, start policies and noise: another one than that of the test races.
    objective : {"score", "utility"}
    """

    tracks: tuple[Track, ...]
    opponents: tuple[Competitor, ...]
    setting: Setting
    races: int = 100
    seed: int = 1_000_003
    objective: str = "score"

    def __post_init__(self) -> None:
        if self.objective not in OBJECTIVES:
            raise InputError(f"objective is {self.objective!r}; it must be one of {', '.join(OBJECTIVES)}")
        if len(self.tracks) == 0 or len(self.opponents) == 0:
            raise InputError("training races need at least one track and one opponent")
        object.__setattr__(self, "tracks", tuple(self.tracks))
        object.__setattr__(self, "opponents", tuple(self.opponents))

    def facts(self, found: float, tried: int) -> dict[str, str | int | float]:
        """What a fit says of how it was found."""
        return {
            "tracks": ", ".join(track.name for track in self.tracks),
            "opponents": ", ".join(map(competitor_name, self.opponents)),
            "races": self.races * len(self.tracks) * len(self.opponents),
            "candidates": tried,
            "seed": self.seed,
            "objective": self.objective,
            "reached": round(found, 4),
        }


class Work(NamedTuple):
    """Where training races are driven.

    Attributes
    ----------
    job : Job or None
    executor : Executor or None
    progress : callable or None
    """

    job: Job | None = None
    executor: Executor | None = None
    progress: Progress | None = None


def evaluate(training: TrainingRaces, candidates: Sequence[Agent], work: Work, name: str) -> NDArray[np.float64]:
    """Mean objective of each candidate over the training races, shape (len(candidates),)."""
    setting = training.setting
    same: list[Pairing] = []
    for track in training.tracks:
        schedule = draw_schedule(track, setting.config.race_rules, training.races, training.seed)
        game = RaceGame(track, setting.archive, setting.config)
        for k, opponent in enumerate(training.opponents):
            # Other start policies against every opponent; the same for all candidates.
            rolled = schedule._replace(lots=np.roll(schedule.lots, 2 * k, axis=0))
            same.append(schedule_pairing(game, candidates[0], opponent, rolled, training.seed))
    pairings = [replace(pairing, ego=candidate) for candidate in candidates for pairing in same]
    played = play_pairings(pairings, name=name, **work._asdict())
    means = np.array([OBJECTIVES[training.objective](matches).mean() for matches in played])
    return means.reshape(len(candidates), -1).mean(axis=1)


def fit_best_schedule(
    training: TrainingRaces,
    *,
    method: str = "ascent",
    job: Job | None = None,
    executor: Executor | None = None,
    progress: Progress | None = None,
) -> Fit:
    """Find the sequence of moves that does best if it is made whatever happens.

    Parameters
    ----------
    training : TrainingRaces
    method : {"ascent", "all"}
        "all" tries every sequence: M to the power of the number of moves, 625 for 5 moves and 4 steps. "ascent" begins
        with the best constant move, then changes one step at a time for the better, until no single change helps.
    job, executor, progress
        Where the races are driven; with a job, races that were driven before are not driven again.

    Returns
    -------
    Fit

    Raises
    ------
    InputError
        If the method is unknown, or "all" would try more than 10,000 sequences.
    """
    setting, work = training.setting, Work(job, executor, progress)
    count, steps = len(setting.moves), setting.config.moves
    known: dict[tuple[int, ...], float] = {}

    def try_out(sequences: Sequence[tuple[int, ...]]) -> None:
        new = [sequence for sequence in dict.fromkeys(sequences) if sequence not in known]
        plans = [best_schedule(setting, moves=[setting.moves[i] for i in sequence]) for sequence in new]
        if plans:
            values = evaluate(training, plans, work, f"schedule-{len(known)}")
            known.update(zip(new, values.tolist(), strict=True))

    def best() -> tuple[int, ...]:
        return max(known, key=lambda sequence: (known[sequence], [-i for i in sequence]))

    if method == "all":
        if count**steps > 10_000:
            raise InputError(f"method 'all' would try {count**steps} sequences; take 'ascent'")
        try_out(list(product(range(count), repeat=steps)))
    elif method == "ascent":
        try_out([(move,) * steps for move in range(count)])
        found: tuple[int, ...] | None = None
        while found != best():
            found = best()
            try_out([(*found[:k], move, *found[k + 1 :]) for k in range(steps) for move in range(count)])
    else:
        raise InputError(f"method is {method!r}; it must be 'ascent' or 'all'")
    chosen = best()
    facts = {"method": method, **training.facts(known[chosen], len(known))}
    return make_fit("best-schedule", [setting.moves[i] for i in chosen], setting, facts)


def fit_best_fixed(
    training: TrainingRaces,
    *,
    targets: Sequence[int] | None = None,
    job: Job | None = None,
    executor: Executor | None = None,
    progress: Progress | None = None,
) -> Fit:
    """Find the policy that it pays most to walk to and to keep.

    Parameters
    ----------
    training : TrainingRaces
    targets : sequence of int, optional
        Policies to try; all of the archive by default.
    job, executor, progress
        As for :func:`fit_best_schedule`.

    Raises
    ------
    InputError
        If the archive has no such policy.
    """
    setting = training.setting
    tried = list(range(len(setting.archive))) if targets is None else [int(target) for target in targets]
    walkers = [best_fixed(setting, target=target) for target in tried]
    values = evaluate(training, walkers, Work(job, executor, progress), "fixed")
    best = int(np.argmax(values))
    return make_fit("best-fixed", tried[best], setting, training.facts(float(values[best]), len(tried)))


def fit_psro(
    training: TrainingRaces,
    members: Sequence[Agent],
    *,
    job: Job | None = None,
    executor: Executor | None = None,
    progress: Progress | None = None,
) -> Fit:
    """Find how often to draw each agent: an exact equilibrium of the game in which both players choose an agent.

    The payoff of one agent to another is its mean objective minus the other's, over the same races from both seats
    (empirical game of PSRO, Lanctot et al. 2017). Best responses to a mixture may be added to the members, and the
    mixture found again.

    Parameters
    ----------
    training : TrainingRaces
        Its opponents play no role.
    members : sequence of Agent
        At least two.
    job, executor, progress
        As for :func:`fit_best_schedule`.

    Raises
    ------
    InputError
        If there are fewer than two members, or two of one name.
    """
    from pcs_racing_agents.tournament.meta_game import zero_sum_equilibrium

    names = [member.name for member in members]
    if len(members) < 2 or len(set(names)) < len(names):
        raise InputError(f"members are {', '.join(names) or 'nobody'}; psro needs at least two, with different names")
    setting = training.setting
    pairs = list(combinations(range(len(members)), 2))
    drawn = []
    for track in training.tracks:
        schedule = draw_schedule(track, setting.config.race_rules, training.races, training.seed)
        drawn.append((RaceGame(track, setting.archive, setting.config), schedule))
    pairings = [
        schedule_pairing(game, members[i], members[j], schedule, training.seed)
        for (i, j), (game, schedule) in product(pairs, drawn)
    ]
    played = play_pairings(pairings, name="psro", job=job, executor=executor, progress=progress)
    excess = [_excess(matches, training.objective) for matches in played]
    payoffs = np.zeros((len(members), len(members)))
    for (i, j), value in zip(pairs, np.reshape(excess, (len(pairs), -1)).mean(axis=1), strict=True):
        payoffs[i, j], payoffs[j, i] = value, -value
    weights = zero_sum_equilibrium(payoffs).row
    shares = {name: round(float(weight), 6) for name, weight in zip(names, weights, strict=True)}
    facts = training.facts(0.0, len(members))
    facts = {key: value for key, value in facts.items() if key not in ("opponents", "reached")}
    return make_fit("psro", shares, setting, {**facts, "least excess": round(float((weights @ payoffs).min()), 4)})


def _excess(matches: Matches, objective: str) -> float:
    """By how much the ego outdid the opponent: utilities add up to 0; scores add up to 1 less what nobody was paid."""
    if objective == "utility":
        return float(matches.utility.mean())
    return float(np.mean(1.0 * (matches.winner == 0) - 1.0 * (matches.winner == 1)))
