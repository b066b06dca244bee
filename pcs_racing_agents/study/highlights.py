"""Example races of a study: a win by switching, a loss and a crash, selected by a rule."""

from importlib.util import find_spec
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcs_racing.race.replay import Replay
from pcs_racing_agents.explain.explain import explain_game
from pcs_racing_agents.explain.words import story
from pcs_racing_agents.results.races import RaceTable
from pcs_racing_agents.tournament.pairings import Pairing

KINDS = ("win", "loss", "crash")


class ExplainedRace(NamedTuple):
    """A race with explanation and replay for a report."""

    title: str
    text: str  #: The explanation; may be empty.
    replay: Replay
    #: The moves, as :func:`pcs_racing_agents.explain.pictures.explanation_picture` draws them, SVG; may be empty.
    picture: bytes = b""


class Highlight(NamedTuple):
    """An example race of an agent."""

    title: str
    race: int  #: Its number in the pairing.


def select_highlights(races: RaceTable, baseline: RaceTable) -> dict[str, Highlight]:
    """Select a win by switching, a loss, and a crash of an agent, by kind; a kind that did not occur is absent.

    Preferred are a win that the agent without moves loses in the same race, a loss that it wins, and a crash by the
    agent's fault after its first move. Of several such races the one with the median lead is selected, which is typical
    of its kind.

    Parameters
    ----------
    races, baseline : RaceTable
        The same races, driven by the agent and by the one that never switches.
    """
    clean, switched = ~races.crashed, races.switches[:, 0] > 0
    won, lost, fault = clean & (races.winner == 0), clean & (races.winner == 1), races.fault[:, 0] > 0
    ego, comparison = races[0].ego, f"{baseline[0].ego} starts alike and"
    criteria = (
        {
            f"A win by switching; {comparison} loses": won & switched & (baseline.winner == 1),
            "A win, policies being switched": won & switched,
        },
        {f"A loss; {comparison} wins": lost & (baseline.winner == 0), "A loss": lost},
        {
            f"A crash that {ego} is to blame for": fault & (races.moves.codes[:, 0, 0] >= 0),
            f"A crash before the first move that {ego} is to blame for": fault,
        },
    )
    highlights = {}
    for kind, choices in zip(KINDS, criteria, strict=True):
        for title, mask in choices.items():
            numbers = np.flatnonzero(mask)
            if len(numbers):
                highlights[kind] = Highlight(title, _median(numbers, races.lead))
                break
    return highlights


def watch_race(pairing: Pairing, race: int, title: str) -> ExplainedRace:
    """Repeat a race for the report; the pairing's ego makes moves."""
    explanation = explain_game(pairing.game, pairing.ego, pairing.opponent, **pairing.race_arguments(race))
    picture = b""
    if find_spec("matplotlib") is not None:
        from pcs_racing_agents.explain.pictures import explanation_picture
        from pcs_racing_agents.pictures.style import picture_bytes

        picture = picture_bytes(explanation_picture(explanation))
    return ExplainedRace(title, story(explanation), explanation.replay, picture)


def _median(races: NDArray[np.intp], lead: NDArray[np.float64]) -> int:
    order = races[np.argsort(lead[races], kind="stable")]
    return int(order[(len(order) - 1) // 2])
