"""The state of a batch of games as a plain value: copy it, pickle it, pick games from it."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.race.state import RaceState
from pcs_racing.race.state import take as take_races


class GameState(NamedTuple):
    """A batch of B games at one moment: plain arrays, game axis first.

    A game has ``N = moves + 1`` steps of driving; step 0 is the one in which the players only watch.
    """

    race: RaceState  #: Where the cars are.
    step: NDArray[np.int64]  #: shape (B,): Moves made so far.
    #: shape (B, 2): Policy in use: its index in the archive, or -1 for a driver from outside the archive.
    policy: NDArray[np.int64]
    theta: NDArray[np.float64]  #: shape (B, 2, P): Its parameters.
    #: shape (B, 2, N, G): Normalised archive coordinates of the policy that each car used in each step; for a driver
    #: from outside what was estimated.
    own: NDArray[np.float64]
    #: shape (B, 2, N, G): Normalised coordinates of each car as seen from outside: measured on that step of driving
    #: alone.
    estimates: NDArray[np.float64]
    leads: NDArray[np.float64]  #: shape (B, N): Lead of car 0 at the end of each step, m.

    @property
    def games(self) -> int:
        """Number of games in the batch."""
        return len(self.step)

    def copy(self) -> "GameState":
        """Return an independent copy."""
        rest: Any = self[1:]
        return GameState(self.race.copy(), *(array.copy() for array in rest))


def take_games(state: GameState, indices: ArrayLike) -> GameState:
    """Return copies of some games, in the order asked for (a game may be taken more than once)."""
    chosen = np.asarray(indices)
    return GameState(take_races(state.race, chosen), *(np.ascontiguousarray(array[chosen]) for array in state[1:]))


def put_games(state: GameState, indices: ArrayLike, values: GameState) -> None:
    """Overwrite some games of a batch, in place, with the games of another."""
    chosen = np.asarray(indices)
    for array, new in zip(_arrays(state), _arrays(values), strict=True):
        array[chosen] = new


def _arrays(state: GameState) -> list[NDArray[Any]]:
    rest: Any = state[1:]
    return [*state.race, *rest]
