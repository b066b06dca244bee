"""What all against all says: who scores how much against whom, ratings, and the game of choosing an agent.

A rating is one number for each agent; the equilibrium and alpha-rank see that the best agent depends on whom it meets
(:mod:`pcs_racing_agents.tournament.meta_game`).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.errors import InputError
from pcs_racing_agents.results.races import RaceTable
from pcs_racing_agents.tournament.meta_game import alpha_rank, excess, zero_sum_equilibrium
from pcs_racing_agents.tournament.ratings import Ratings, rate

__all__ = ["RoundRobin", "drivers", "round_robin"]

Floats = NDArray[np.float64]

FEWEST_LINES = 5
"""With fewer start lines an interval from drawing them again would say nothing."""


@dataclass(frozen=True, eq=False)
class RoundRobin:
    """All against all between N agents.

    Attributes
    ----------
    names : tuple of str
        N agents.
    scores : ndarray, shape (N, N)
        Score of the row's agent against the column's: races won, a tie counting half; NaN where they did not meet.
    alike : float
        A difference of two agents' scores against each other that is within the noise: 1.96 of its standard errors,
        start lines being drawn (the root of the mean square over the pairs); NaN where there are too few lines to say.
    ratings : Ratings, optional
        None where the races do not tell.
    equilibrium : ndarray, shape (N,), optional
        How often to send whom, if the other side chooses its agent as cleverly; where all pairs met.
    alpha_rank : ndarray, shape (N,), optional
        Share of the time that evolution spends at each agent, differences within the noise counting as none; with
        OpenSpiel, where all pairs met on several lines.
    """

    names: tuple[str, ...]
    scores: Floats
    alike: float
    ratings: Ratings | None
    equilibrium: Floats | None
    alpha_rank: Floats | None

    def rating(self, name: str) -> tuple[float, float, float]:
        """Return an agent's rating on the scale of chess with the ends of its interval; NaN where they are unknown."""
        found = self.ratings
        if found is None or name not in found.names:
            return np.nan, np.nan, np.nan
        i = found.names.index(name)
        return tuple(float(value) for value in found.to_elo([found.strength[i], found.low[i], found.high[i]]))  # type: ignore[return-value]


def round_robin(names: Sequence[str], races: RaceTable, *, seed: int = 0) -> RoundRobin:
    """Sum up the races of all against all.

    Parameters
    ----------
    names : sequence of str
        The agents, in the order that the result is to have.
    races : RaceTable
        All pairs shared the start lines. A crash without a winner pays neither: it is no tie.
    seed : int
        Of the intervals of the ratings.

    Raises
    ------
    InputError
        If an agent raced that is not named.
    """
    one, other = drivers(names, races).T
    won = np.array([1.0, -1.0, 0.0])[races.winner]
    unpaid = races.crashed & (won == 0.0)
    total, count = np.zeros((len(names),) * 2), np.zeros((len(names),) * 2)
    paid = np.where(unpaid, 0.0, 0.5)
    np.add.at(total, (one, other), paid * (1.0 + won))
    np.add.at(total, (other, one), paid * (1.0 - won))
    np.add.at(count, (one, other), 1.0)
    np.add.at(count, (other, one), 1.0)
    scores = np.divide(total, count, out=np.full_like(total, np.nan), where=count > 0.0)
    places = races.places
    alike = _noise(np.minimum(one, other), np.maximum(one, other), np.where(one < other, won, -won), places)
    met = bool((count[~np.eye(len(names), dtype=bool)] > 0.0).all())
    return RoundRobin(
        names=tuple(names),
        scores=scores,
        alike=alike,
        ratings=_ratings(np.array(names)[one], np.array(names)[other], won, unpaid, places, seed),
        equilibrium=zero_sum_equilibrium(excess(scores)).row if met else None,
        alpha_rank=_alpha_rank(scores, alike) if met else None,
    )


def drivers(names: Sequence[str], races: RaceTable) -> NDArray[np.intp]:
    """Return who drove each car of each race: places in ``names``, shape (N, 2).

    Raises
    ------
    InputError
        If an agent raced that is not named.
    """
    words = races.agents.words
    strange = sorted({words[code] for code in np.unique(races.agents.codes).tolist()} - set(names))
    if strange:
        raise InputError(f"{strange[0]!r} raced, but is not one of {', '.join(names)}")
    place = np.array([names.index(word) if word in names else -1 for word in words], np.intp)
    return place[races.agents.codes]


def _noise(one: NDArray[np.intp], other: NDArray[np.intp], won: Floats, line: NDArray[np.intp]) -> float:
    """Return 1.96 standard errors of a pair's difference in score, from how its start lines differ."""
    variances = []
    for i, j in sorted(set(zip(one.tolist(), other.tolist(), strict=True))):
        rows = (one == i) & (other == j)
        which = np.unique(line[rows], return_inverse=True)[1]
        each = np.bincount(which, won[rows]) / np.bincount(which)
        if len(each) > 1:
            variances.append(float(each.var(ddof=1)) / len(each))
    return 1.96 * float(np.sqrt(np.mean(variances))) if variances else np.nan


def _ratings(
    ego: NDArray[np.str_],
    opponent: NDArray[np.str_],
    won: Floats,
    unpaid: NDArray[np.bool_],
    line: NDArray[np.intp],
    seed: int,
) -> Ratings | None:
    """Fit the ratings; with intervals where there are start lines to draw from."""
    several = len(np.unique(line[~unpaid])) >= FEWEST_LINES
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(6_000_000,))) if several else None
    try:
        return rate(ego.tolist(), opponent.tolist(), won, nobody=unpaid, unit=line, rng=rng)
    except InputError:  # too few races that somebody won, or groups that never met: there is nothing to rate
        return None


def _alpha_rank(scores: Floats, alike: float) -> Floats | None:
    if len(scores) < 2 or np.isnan(alike):
        return None
    try:
        return alpha_rank(scores, alike=alike)
    except ModuleNotFoundError:
        return None
