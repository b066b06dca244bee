"""Batches of matches between two competitors: several races, before each of which they may choose
their policies.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.game.competitor import Chooser, as_agent, ask_moves
from pcs_racing.game.match import KEEP, MatchGame, MatchState, ask_choices

Floats = NDArray[np.float64]


class PlayedMatches(NamedTuple):
    """Results of a batch of B matches of R races; the ego drove car 0."""

    scores: Floats  #: shape (B, 2, R): Score of each car in each race: 1 for a win, 1/2 for a tie.
    #: shape (B, 2, R): Policy of the archive that each race was started with.
    policy: NDArray[np.int64]
    #: shape (B, 2, D): What both players know of the match at its end.
    observations: NDArray[np.float32]


class FixedChoice(NamedTuple):
    """A chooser that takes the same policy before every race."""

    policy: int

    def choose(self, observation: NDArray[np.float32]) -> NDArray[np.int64]:
        """Return the policy for each observation."""
        return np.full(len(observation), self.policy)


class KnownOpponentChoice(NamedTuple):
    """A chooser that knows the opponent of each match of a batch: takes the best reply to it."""

    replies: NDArray[np.int64]  #: shape (B,): Best reply to the opponent of each match.

    def choose(self, observation: NDArray[np.float32]) -> NDArray[np.int64]:
        """Return the best replies; all matches must be asked about."""
        return self.replies


def play_matches(
    match: MatchGame,
    ego: Any,
    opponent: Any,
    *,
    keys: NDArray[np.uint64],
    policies: ArrayLike,
    lines: ArrayLike | None = None,
    sides: ArrayLike | None = None,
) -> PlayedMatches:
    """Play a batch of matches.

    Parameters
    ----------
    ego, opponent : Competitor or None
        Who drives car 0 and car 1 with policies of the archive: a chooser chooses them before each
        race; others start each race with the same policy, and make their moves; None keeps the
        policy.
    keys : ndarray of uint64, shape (B,)
        Of the matches' noise, and of what is not given.
    policies : array_like of int, shape (B, 2) or (2,)
        Policies that cars start their races with whose players do not choose; -1 draws one.
    lines, sides : array_like, optional
        As for :meth:`pcs_racing.game.match.MatchGame.begin`.
    """
    ego, opponent = (one if one is None else as_agent(one) for one in (ego, opponent))
    state = match.begin(keys, policies=policies, lines=lines, sides=sides)
    chosen = np.full((len(keys), 2, match.races), -1, np.int64)
    for race in range(match.races):
        choices = np.stack(
            [_choices(player, match, state, car) for car, player in enumerate((ego, opponent))],
            axis=1,
        )
        state = match.start(state, choices)
        chosen[:, :, race] = state.policy
        memories: list[list[Any]] = [[None] * len(keys), [None] * len(keys)]
        while state.racing.any():
            seen = match.game.observation(state.game)
            moves = [
                _moves(player, match, state, car, seen[:, car], memories[car])
                for car, player in enumerate((ego, opponent))
            ]
            state = match.move(state, np.stack(moves, axis=1))
    return PlayedMatches(state.scores, chosen, match.memory(state))


def _choices(player: Any, match: MatchGame, state: MatchState, car: int) -> NDArray[np.int64]:
    if player is None:
        return np.full(state.matches, KEEP, np.int64)
    return ask_choices(player, match, state, car)


def _moves(
    player: Any,
    match: MatchGame,
    state: MatchState,
    car: int,
    seen: NDArray[np.float32],
    memories: list[Any],
) -> NDArray[np.int64]:
    if player is None or isinstance(player, Chooser):
        return np.full(state.matches, len(match.game.competitor_moves) - 1)  # to stay
    rows = np.flatnonzero(state.racing)
    return ask_moves(
        player, match.game, state.game, car, rows=rows, observation=seen, memories=memories
    )
