"""What came of races that a learner was judged by."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcs_racing.race.state import RaceState

__all__ = ["Cell", "Score", "score_of", "score_table", "total"]


class Cell(NamedTuple):
    """Races that an evaluation tells apart from others.

    Attributes
    ----------
    track, race, opponent : str
        Names of the circuit, of the rules and of who drove car 1.
    """

    track: str
    race: str
    opponent: str


class Score(NamedTuple):
    """What came of the races of a cell; shares add up to 1 with the ties and the crashes that pay nobody.

    Attributes
    ----------
    races : int
    worth : float
        What the learner wants, on average: in duels the utility of a game; in drives 1 for a win, -1 for a defeat or a
        crash by own fault.
    error : float
        Standard error of that.
    won, lost : float
        Shares of the races.
    crashed : float
        Share that ended in a crash, whoever's.
    at_fault : float
        Share that ended in a crash by the learner's fault.
    lead : float
        Mean lead at the end, m.
    """

    races: int
    worth: float
    error: float
    won: float
    lost: float
    crashed: float
    at_fault: float
    lead: float


def score_of(worth: NDArray[np.float64], winner: NDArray[np.int8], race: RaceState) -> Score:
    """Sum races up.

    Parameters
    ----------
    worth : ndarray, shape (B,)
    winner : ndarray, shape (B,)
        0 where the learner won, 1 where it lost, else -1.
    race : RaceState
        Where the races ended.
    """
    count = len(worth)
    return Score(
        races=count,
        worth=float(np.mean(worth)),
        error=float(np.std(worth, ddof=1) / np.sqrt(count)) if count > 1 else float("nan"),
        won=float(np.mean(winner == 0)),
        lost=float(np.mean(winner == 1)),
        crashed=float(np.mean(race.crashed)),
        at_fault=float(np.mean(race.fault[:, 0] == 1)),
        lead=float(np.mean(race.lead)),
    )


def total(scores: Mapping[Cell, Score], weights: Mapping[str, int]) -> Score:
    """Mean over cells, each counting as its opponent does.

    Parameters
    ----------
    scores : mapping of Cell to Score
    weights : mapping of str to int
        How often each opponent is met.
    """
    shares = np.array([weights[cell.opponent] for cell in scores], np.float64)
    shares /= shares.sum()
    rows = np.array([score[1:] for score in scores.values()])
    means = dict(zip(Score._fields[1:], (shares @ rows).tolist(), strict=True))
    means["error"] = float(np.sqrt(np.sum((shares * rows[:, Score._fields.index("error") - 1]) ** 2)))
    return Score(sum(score.races for score in scores.values()), **means)


def score_table(scores: Mapping[Cell, Score], weights: Mapping[str, int]) -> str:
    """Text for people: a line for each circuit and rules, the mean over opponents, and one for everything."""
    lines = [f"{'':28} {'worth':>8} {'+-':>6} {'won':>6} {'lost':>6} {'crashed':>8} {'at fault':>9} {'lead':>7}"]
    places = list(dict.fromkeys((cell.track, cell.race) for cell in scores))
    for place in [*places, None]:
        part = {cell: score for cell, score in scores.items() if place in (None, cell[:2])}
        mean = total(part, weights)
        lines.append(
            f"{' '.join(place) if place else 'all':28} {mean.worth:8.3f} {mean.error:6.3f} {mean.won:6.1%} "
            f"{mean.lost:6.1%} {mean.crashed:8.1%} {mean.at_fault:9.1%} {mean.lead:5.1f} m"
        )
    return "\n".join(lines)
