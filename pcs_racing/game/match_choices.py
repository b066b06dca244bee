"""The one way to ask a competitor for the policies that it starts the races of a match with."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.checks import as_array
from pcs_racing.base.errors import InputError
from pcs_racing.game.competitor import Chooser, competitor_name
from pcs_racing.game.match import KEEP, MatchGame, MatchState


def ask_choices(
    competitor: Any,
    match: MatchGame,
    state: MatchState,
    car: int,
    *,
    rows: NDArray[np.int64] | None = None,
    memory: NDArray[np.float32] | None = None,
) -> NDArray[np.int64]:
    """Ask a competitor for the policy of one car in the next race of each match that is between two races.

    Parameters
    ----------
    competitor : Competitor
    rows : ndarray of int, optional
        Matches to ask about, all by default.
    memory : ndarray, shape (B, D), optional
        What the car observes between races (:meth:`MatchGame.memory`), where it is known already.

    Returns
    -------
    ndarray of int, shape (B,)
        Policies of the archive; :data:`KEEP` where nobody is asked, and for a competitor that does not choose.
    """
    choices = np.full(state.matches, KEEP, np.int64)
    between = np.flatnonzero(~state.racing & ~match.done(state))
    rows = between if rows is None else np.intersect1d(rows, between)
    if not isinstance(competitor, Chooser) or len(rows) == 0:
        return choices
    seen = match.memory(state)[:, car] if memory is None else memory
    answer = as_array(competitor.choose(seen[rows]))
    count, name = len(match.game.archive), f"competitor {competitor_name(competitor)!r}"
    if answer.shape != rows.shape or answer.dtype.kind not in "iu":
        raise InputError(
            f"{name}: choose returned shape {answer.shape} and type {answer.dtype}; it must return whole numbers of "
            f"shape {rows.shape}, policies from 0 to {count - 1}"
        )
    wrong = np.flatnonzero((answer < 0) | (answer >= count))
    if len(wrong):
        raise InputError(
            f"{name}, match {rows[wrong[0]]}: it chose policy {answer[wrong[0]]}; there are policies 0 to {count - 1}"
        )
    choices[rows] = answer
    return choices
