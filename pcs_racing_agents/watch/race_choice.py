"""Selection of tournament races to show: spread over agents and outcomes, closest races first.

For one of its agents a race is a win by switching, another win, a loss, a crash by its own fault or
the other's, or a tie. A win is by switching if "never-switch" loses to the same opponent, from the
same start and policy. Agents and outcomes alternate. Within an agent and outcome, opponents and
tracks alternate; each group of races is sorted by the final distance between the cars. Selected
races are closer than typical races; the tournament's table gives the typical results.
"""

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from pcs_racing.game.players import NEVER_SWITCH
from pcs_racing_agents.tournament import RaceTable

OUTCOMES = (
    "a win by switching",
    "a win with switches",
    "a loss",
    "a crash of its own",
    "a win without switching",
    "a crash of the other's",
    "a tie, or a no-contest",
)


def outcomes(races: RaceTable, car: int) -> NDArray[np.int64]:
    """Return the outcome of each race for one of its cars as an index in ``OUTCOMES``, shape (N,).

    ``car``: 0 or 1.
    """
    crashed, fault = races.crashed, races.fault > 0
    own, other = fault[:, car], fault[:, 1 - car] & ~fault[:, car]
    won, lost = races.winner == car, races.winner == 1 - car
    switched = races.switches[:, car] > 0
    decided = won & switched & _lost_by_staying(races, car)
    cases = [crashed & own, crashed & other, decided, won & switched, won, lost & ~crashed]
    # The first true case counts: a crash comes before the winner.
    return np.select(cases, [3, 5, 0, 1, 4, 2], 6)


def _lost_by_staying(races: RaceTable, car: int) -> NDArray[np.bool_]:
    """Return whether never-switch lost the same race of a car, shape (N,); False without a race."""
    names = races.agents.codes
    other, own = names[:, 1 - car], names[:, car]
    starts = (
        races.preset.codes,
        races.track.codes,
        races.seed.codes,
        races.race,
        races.variants[:, car],
        other,
    )
    keys = np.stack(starts, axis=1).astype(np.int64)
    staying = own == (
        races.agents.words.index(NEVER_SWITCH) if NEVER_SWITCH in races.agents.words else len(names)
    )
    lost = {tuple(key) for key in keys[staying & (races.winner == 1 - car)].tolist()}
    return np.array([tuple(key) in lost for key in keys.tolist()], np.bool_)


def choose_races(races: RaceTable, count: int) -> dict[int, str]:
    """Return races to show, by a deterministic rule, in order of selection.

    The keys are lines of the results, counted from 0, and the values agent and outcome, e.g.
    ``"cfr-argmax: a win by switching"``.
    """
    agents = range(len(races.agents.words))
    by_car = np.array([outcomes(races, car) for car in range(2)])
    # Outcomes outside, agents inside: each outcome goes through all agents before the next outcome.
    piles = [
        (
            agent,
            outcome,
            _in_turns(races, agent, (by_car == outcome) & (agent == races.agents.codes.T)),
        )
        for outcome in range(len(OUTCOMES))
        for agent in agents
    ]
    picks: dict[int, str] = {}
    while piles and len(picks) < min(count, len(races)):
        remaining = []
        for agent, outcome, pile in piles:
            race = next((number for number in pile if number not in picks), None)
            if race is None:
                continue
            remaining.append((agent, outcome, pile))
            picks[race] = f"{races.agents.words[agent]}: {OUTCOMES[outcome]}"
            if len(picks) >= count:
                break
        piles = remaining
    return picks


def _in_turns(races: RaceTable, agent: int, mask: NDArray[np.bool_]) -> Iterator[int]:
    """Yield an agent's races of an outcome: tracks and opponents alternate, closest races first.

    ``mask``: shape (2, N), the races by the agent's car.
    """
    cars, numbers = np.nonzero(mask)
    gap = np.abs(races.lead[numbers])
    others = races.agents.codes[numbers, 1 - cars]
    tracks = races.track.codes[numbers]
    groups: list[Sequence[int]] = []
    for pair in sorted(
        {*zip(tracks.tolist(), others.tolist(), strict=True)}, key=lambda pair: pair[::-1]
    ):
        rows = np.flatnonzero((tracks == pair[0]) & (others == pair[1]))
        groups.append(numbers[rows][np.argsort(gap[rows], kind="stable")].tolist())
    # Each agent starts with another group: else all agents would show the same opponent.
    groups = groups[agent % len(groups) :] + groups[: agent % len(groups)] if groups else []
    for turn in range(max(map(len, groups), default=0)):
        for group in groups:
            if turn < len(group):
                yield group[turn]
