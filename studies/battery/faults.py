"""Series with faults: should risk depend on the score of a series and on the faults left?

A series is the best of three races under `roboracer`; faults add up over its races, and a car with
`FAULTS` of them has lost it. Between the races an ego chooses one of several policies.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np

from pcs_racing.race.config import ROBORACER
from pcs_racing.race.races import run_races, starts_of
from pcs_racing.track.track import Track
from pcs_racing_agents.base.statistics import Estimate, clustered_mean
from studies.battery.rules import Floats

FAULTS, RACES = 3, 3
POLICIES = [f"line-ppo:risk={risk},pace={pace}" for risk in (0, 1) for pace in (1.2, 1.4, 1.6, 1.8)]
OPPONENTS = ("lattice", "line-ppo")

Score = tuple[int, int, int, int]
"""Races won by the ego and by the opponent, and faults of both."""
Plan = dict[tuple[int, Score], int]
"""Policy by race and score of the series."""


@dataclass(frozen=True, eq=False)
class Sample:
    """Races of all policies against one opponent."""

    track: Track
    opponent: str
    lines: int
    split: str
    seed: int


def race_sample(sample: Sample) -> dict[str, Floats]:
    """Return winner (2: none) and faults of both cars, shape (policies, lines, 2 sides, 3)."""
    index = np.arange(2 * sample.lines)
    starts = starts_of(sample.track, ROBORACER, index, sample.seed, split=sample.split)
    found = []
    for policy in POLICIES:
        raced = run_races(
            sample.track,
            policy,
            sample.opponent,
            ROBORACER,
            seed=sample.seed,
            starts=starts,
            threads=1,
        )
        faults = np.minimum(raced.state.fault, FAULTS)
        found.append(np.column_stack([np.where(raced.winner < 0, 2, raced.winner), faults]))
    return {"outcomes": np.array(found).reshape(len(POLICIES), sample.lines, 2, 3)}


def chances(outcomes: Floats) -> Floats:
    """Return the probabilities of outcomes, shape (policies, 3, FAULTS + 1, FAULTS + 1)."""
    found = np.zeros((len(outcomes), 3, FAULTS + 1, FAULTS + 1))
    for policy, rows in enumerate(outcomes.reshape(len(outcomes), -1, 3)):
        np.add.at(found[policy], tuple(rows.T), 1.0 / len(rows))
    return found


def over(race: int, score: Score) -> float | None:
    """Return the ego's score of a series that is over, else None."""
    won, lost, own, other = score
    if max(own, other) >= FAULTS:
        return 0.5 * (1.0 + (other >= FAULTS) - (own >= FAULTS))
    if race == RACES or max(won, lost) > RACES // 2:
        return 0.5 + 0.5 * np.sign(won - lost)
    return None


def series(given: Floats, plan: Plan, otherwise: int | None = None) -> float:
    """Return the expected score of a series from the probabilities of the races' outcomes.

    Where the plan holds no policy, the policy is ``otherwise``, by default the best one, which then
    joins the plan.
    """
    outcomes = np.argwhere(given.any(axis=0)).tolist()

    @cache
    def value(race: int, score: Score) -> float:
        ended = over(race, score)
        if ended is not None:
            return ended
        worth, (won, lost, before, behind) = np.zeros(len(given)), score
        for winner, own, other in outcomes:
            now = (won + int(winner == 0), lost + int(winner == 1), before + own, behind + other)
            worth += given[:, winner, own, other] * value(race + 1, now)
        policy = plan.get((race, score), otherwise)
        if policy is None:
            policy = plan[race, score] = int(worth.argmax())
        return float(worth[policy])

    return value(0, (0, 0, 0, 0))


def series_gain(training: Floats, test: Floats, groups: int) -> Estimate:
    """Return the gain of choosing by the score of the series over the best fixed policy.

    Both are fitted to the training outcomes of each opponent, shape (opponents, policies, lines, 2,
    3), and judged on each group of test lines.
    """
    gains = np.empty((len(test), groups))
    for k, known in enumerate(map(chances, training)):
        best: Plan = {}
        series(known, best)
        fixed = int(np.argmax([series(known, {}, policy) for policy in range(len(known))]))
        for group, lines in enumerate(np.array_split(np.arange(test.shape[2]), groups)):
            fresh = chances(test[k][:, lines])
            gains[k, group] = series(fresh, best, fixed) - series(fresh, {}, fixed)
    return clustered_mean(gains.ravel(), np.indices(gains.shape)[1].ravel())
