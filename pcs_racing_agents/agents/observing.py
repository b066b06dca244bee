"""The parts of an observation: the number of moves made, the coordinates of both policies, and earlier observations.

An observation holds a block of numbers for every step, and then the share of the moves that have been made. A block is
the own coordinates, the opponent's, the lead, and whether the step is over
(:func:`pcs_racing.game.observation.observation_table`). All functions take observations of shape (B, D) and the number
G of the game's axes.
"""

import numpy as np
from numpy.typing import NDArray

ObservationBatch = NDArray[np.float32]


def step_count(observation: ObservationBatch, axes: int) -> int:
    """Number of steps in an observation: one more than there are moves."""
    return (observation.shape[-1] - 1) // (2 * axes + 2)


def _blocks(observation: ObservationBatch, axes: int) -> ObservationBatch:
    return observation[:, :-1].reshape(len(observation), step_count(observation, axes), 2 * axes + 2)


def moves_made(observation: ObservationBatch, axes: int) -> NDArray[np.int64]:
    """Moves made so far, shape (B,)."""
    return (_blocks(observation, axes)[..., -1] > 0.5).sum(axis=1) - 1


def own(observation: ObservationBatch, axes: int, step: int | None = None) -> ObservationBatch:
    """Own normalised coordinates in a step, by default in the last one that is over, shape (B, G)."""
    return _coordinates(observation, axes, step, 0)


def opponent(observation: ObservationBatch, axes: int, step: int | None = None) -> ObservationBatch:
    """Measured coordinates of the opponent in a step, by default in the last one that is over, shape (B, G)."""
    return _coordinates(observation, axes, step, axes)


def lead(observation: ObservationBatch, axes: int, step: int | None = None) -> ObservationBatch:
    """Own lead at the end of a step, by default of the last one that is over, in units of 20 m, shape (B,)."""
    return _coordinates(observation, axes, step, axes + 1)[:, -1]


def _coordinates(observation: ObservationBatch, axes: int, step: int | None, first: int) -> ObservationBatch:
    index = moves_made(observation, axes) if step is None else np.full(len(observation), step)
    return _blocks(observation, axes)[np.arange(len(observation)), index, first : first + axes]


def earlier(observation: ObservationBatch, axes: int, moves: int) -> ObservationBatch:
    """Return the observations after the given number of moves, shape (B, D)."""
    steps = step_count(observation, axes)
    before = observation.copy()
    before[:, (moves + 1) * (2 * axes + 2) : -1] = 0.0
    before[:, -1] = np.float32(moves / (steps - 1))
    return before
