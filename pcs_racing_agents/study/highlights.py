"""Races of a study that are worth watching: a win by switching, a loss, a crash; chosen by rule, not by taste."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcs_racing.game import RaceGame
from pcs_racing.replay import Replay
from pcs_racing_agents.explaining.explain import explain_match
from pcs_racing_agents.explaining.words import story
from pcs_racing_agents.strategies.agent import Competitor
from pcs_racing_agents.tournament.cells import Cell

__all__ = ["KINDS", "Watched", "telling_races", "watch_race"]

KINDS: Mapping[str, str] = {
    "win": "A win by switching: the same race is lost by the agent that keeps its policy",
    "loss": "A loss: the same race is won by the agent that keeps its policy",
    "crash": "A crash that the agent is to blame for",
}
"""What races are picked, and what the report says about each."""


class Watched(NamedTuple):
    """A race to be watched in a report.

    Attributes
    ----------
    title : str
    text : str
        What happened, in words; may be empty.
    replay : Replay
    """

    title: str
    text: str
    replay: Replay


def telling_races(agent: Cell, base: Cell) -> dict[str, int]:
    """Pick a race of each kind of :data:`KINDS` from the cells of an agent and of the one that never switches.

    Of crashes one after a move is taken, if there is any. Where there are several races, it is the one with the median
    lead: typical of its kind, not the most spectacular.

    Parameters
    ----------
    agent, base : Cell
        With the same units.

    Returns
    -------
    dict of str to int
        The number of the race in the cells; kinds that did not occur are left out. Where the base never did the
        contrary, a win or a loss of its own is taken.
    """
    ours, theirs = agent.matches, base.matches
    clean = ~ours.crash.any(axis=1)
    switched = (ours.policy[:, 0] != ours.policy[:, 0, :1]).any(axis=1)
    won, lost = clean & (ours.winner == 0), clean & (ours.winner == 1)
    wanted = {
        "win": [won & switched & (theirs.winner == 1), won & switched],
        "loss": [lost & (theirs.winner == 0), lost],
        "crash": [(ours.fault[:, 0] > 0) & (ours.moves[:, 0, 0] >= 0), ours.fault[:, 0] > 0],
    }
    found = {}
    for kind, choices in wanted.items():
        races = next((rows for rows in map(np.flatnonzero, choices) if len(rows)), None)
        if races is not None:
            found[kind] = _median(races, ours.lead)
    return found


def watch_race(
    game: RaceGame,
    ego: Competitor,
    opponent: Competitor,
    cell: Cell,
    race: int,
    title: str,
    *,
    candidates: bool = False,
) -> Watched:
    """Drive a race of a cell again, for the report.

    Parameters
    ----------
    game : RaceGame
        The cell's.
    ego, opponent : Competitor
        Those of the cell; the ego an agent that moves.
    cell : Cell
    race : int
        Number of the race in it.
    title : str
    candidates : bool
        Whether to keep the paths that the planners chose from: about a megabyte.
    """
    units = cell.units
    explanation = explain_match(
        game,
        ego,
        opponent,
        policies=units.variants[race],
        start=units.starts.take([race]),
        seed=int(units.seeds[race]),
        candidates=candidates,
    )
    return Watched(title, story(explanation), explanation.replay)


def _median(races: NDArray[np.intp], lead: NDArray[np.float64]) -> int:
    order = races[np.argsort(lead[races], kind="stable")]
    return int(order[(len(order) - 1) // 2])
