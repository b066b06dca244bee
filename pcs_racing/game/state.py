"""The state of a batch of games as a plain value: copy it, pickle it, pick games from it."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.race.state import RaceState, take as take_races


class GameState(NamedTuple):
    """A batch of B games at one moment: plain arrays, game axis first.

    A game has ``N = moves + 1`` steps of driving; in step 0 the players only watch.
    """

    race: RaceState  #: State of the cars.
    step: NDArray[np.int64]  #: shape (B,): Number of moves made so far.
    #: shape (B, 2): Policy in use: its index in the archive, or -1 for a policy from outside the
    #: archive.
    policy: NDArray[np.int64]
    theta: NDArray[np.float64]  #: shape (B, 2, P): Parameters of the policy in use.
    #: shape (B, 2, N, G): Normalised archive coordinates of each car's policy in each step;
    #: estimates for a policy from outside.
    own: NDArray[np.float64]
    #: shape (B, 2, N, G): Normalised coordinates of each car, measured from outside on that step of
    #: driving alone.
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
    """Return copies of some games, in the given order (a game may be taken more than once)."""
    chosen = np.asarray(indices)
    return GameState(
        take_races(state.race, chosen),
        *(np.ascontiguousarray(array[chosen]) for array in state[1:]),
    )


def put_games(state: GameState, indices: ArrayLike, values: GameState) -> None:
    """Overwrite some games of a batch, in place, with the games of another batch."""
    chosen = np.asarray(indices)
    for array, new in zip(_arrays(state), _arrays(values), strict=True):
        array[chosen] = new


def _arrays(state: GameState) -> list[NDArray[Any]]:
    rest: Any = state[1:]
    return [*state.race, *rest]
