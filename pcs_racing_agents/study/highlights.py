"""Races of a study that are worth watching: a win by switching, a loss, a crash; chosen by rule, not by taste."""

from importlib.util import find_spec
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcs_racing.race.replay import Replay
from pcs_racing_agents.explain.explain import explain_match
from pcs_racing_agents.explain.words import story
from pcs_racing_agents.results.races import RaceTable
from pcs_racing_agents.tournament.pairings import Pairing

__all__ = ["KINDS", "TellingRace", "Watched", "telling_races", "watch_race"]

KINDS = ("win", "loss", "crash")


class Watched(NamedTuple):
    """A race to be watched in a report.

    Attributes
    ----------
    title : str
    text : str
        What happened, in words; may be empty.
    replay : Replay
    picture : bytes
        The moves, as :func:`pcs_racing_agents.explain.pictures.explanation_picture` draws them, SVG; may be empty.
    """

    title: str
    text: str
    replay: Replay
    picture: bytes = b""


class TellingRace(NamedTuple):
    """A race that tells something of an agent.

    Attributes
    ----------
    title : str
        What the race is.
    race : int
        Its number in the pairing.
    """

    title: str
    race: int


def telling_races(ours: RaceTable, theirs: RaceTable) -> dict[str, TellingRace]:
    """Pick a win by switching, a loss, and a crash from the races of an agent and of the one that never switches.

    A win or a loss is rather one where keeping the policy brings the contrary in the same race; a crash is the agent's
    fault, and rather one after its first move. Where there are several such races, it is the one with the median lead:
    typical of its kind, not the most spectacular.

    Parameters
    ----------
    ours, theirs : RaceTable
        The same races, driven by the agent and by the one that never switches.

    Returns
    -------
    dict of str to TellingRace
        By its kind, one of ``KINDS``; what did not occur is left out.
    """
    clean, switched = ~ours.crashed, ours.switches[:, 0] > 0
    won, lost, fault = clean & (ours.winner == 0), clean & (ours.winner == 1), ours.fault[:, 0] > 0
    ego, keeps = ours[0].ego, f"{theirs[0].ego} starts alike and"
    wanted = (
        {
            f"A win by switching; {keeps} loses": won & switched & (theirs.winner == 1),
            "A win, policies being switched": won & switched,
        },
        {f"A loss; {keeps} wins": lost & (theirs.winner == 0), "A loss": lost},
        {
            f"A crash that {ego} is to blame for": fault & (ours.moves.codes[:, 0, 0] >= 0),
            f"A crash before the first move that {ego} is to blame for": fault,
        },
    )
    found = {}
    for kind, choices in zip(KINDS, wanted, strict=True):
        for title, chosen in choices.items():
            races = np.flatnonzero(chosen)
            if len(races):
                found[kind] = TellingRace(title, _median(races, ours.lead))
                break
    return found


def watch_race(pairing: Pairing, race: int, title: str, *, candidates: bool = False) -> Watched:
    """Drive a race again, for the report.

    Parameters
    ----------
    pairing : Pairing
        Its ego is an agent that moves.
    race : int
        Number of the race in it.
    title : str
    candidates : bool
        Whether to keep the paths that the planners chose from: about a megabyte.
    """
    explanation = explain_match(pairing.game, pairing.ego, pairing.opponent, **pairing.one(race), candidates=candidates)
    picture = b""
    if find_spec("matplotlib") is not None:
        from pcs_racing_agents.explain.pictures import explanation_picture
        from pcs_racing_agents.pictures.style import picture_bytes

        picture = picture_bytes(explanation_picture(explanation))
    return Watched(title, story(explanation), explanation.replay, picture)


def _median(races: NDArray[np.intp], lead: NDArray[np.float64]) -> int:
    order = races[np.argsort(lead[races], kind="stable")]
    return int(order[(len(order) - 1) // 2])
