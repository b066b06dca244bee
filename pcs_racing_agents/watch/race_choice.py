"""Selection of tournament races to show: spread over agents and outcomes, closest races first.

For one of its agents a race is a win by switching, another win, a loss, a crash by its own fault or
the other's, or a tie. A win is by switching if "never-switch" loses to the same opponent, from the
same start and policy. Agents and outcomes alternate. Within an agent and outcome, opponents and
tracks alternate; each group of races is sorted by the final distance between the cars. Selected
races are closer than typical races; the tournament's table gives the typical results.
"""

from typing import Any

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
    words, agents = races.agents.words, races.agents.codes
    own = words.index(NEVER_SWITCH) if NEVER_SWITCH in words else -1
    starts = (races.rules.codes, races.track.codes, races.seed.codes, races.race)
    keys = np.stack([*starts, races.variants[:, car], agents[:, 1 - car]], axis=1).tolist()
    lost = (agents[:, car] == own) & (races.winner == 1 - car)
    known = {tuple(key) for key, loses in zip(keys, lost.tolist(), strict=True) if loses}
    return np.array([tuple(key) in known for key in keys], np.bool_)


def choose_races(races: RaceTable, count: int) -> dict[int, str]:
    """Return races to show, by a deterministic rule, in order of selection.

    The keys are lines of the results, counted from 0, and the values agent and outcome, e.g.
    ``"cfr-argmax: a win by switching"``.
    """
    # An entry for each race and car: the car's agent and outcome, its opponent and the circuit.
    agent, other = races.agents.codes.T.ravel(), races.agents.codes[:, ::-1].T.ravel()
    outcome = np.concatenate([outcomes(races, car) for car in range(2)])
    track, gap = np.tile(races.track.codes, 2), np.tile(np.abs(races.lead), 2)
    turn = _places(gap, agent, outcome, other, track)
    # Each agent starts with another opponent: else all agents would show the same one.
    rival = (other - agent) % len(races.agents.words)
    place = _places(np.stack([track, rival, turn]), agent, outcome)
    picks: dict[int, str] = {}
    # Each outcome goes through all agents before the next outcome.
    for entry in np.lexsort((agent, outcome, place)).tolist():
        if len(picks) >= count:
            break
        why = f"{races.agents.words[agent[entry]]}: {OUTCOMES[outcome[entry]]}"
        picks.setdefault(entry % len(races), why)
    return picks


def _places(keys: NDArray[Any], *groups: NDArray[Any]) -> NDArray[np.int64]:
    """Return the place of each entry among the entries with equal values in all groups.

    ``keys``: shape (E,) or (K, E), order of the entries, the last key first. ``groups``: shape (E,)
    each.
    """
    order = np.lexsort((*np.atleast_2d(keys), *groups))
    values = np.stack(groups)[:, order]
    begins = np.append(True, (values[:, 1:] != values[:, :-1]).any(axis=0))
    places = np.arange(len(order))
    places[order] = places - np.maximum.accumulate(np.where(begins, places, 0))
    return places
