"""Parts of an observation: moves made, coordinates of both policies, earlier observations.

An observation holds a block of numbers for each step, then the share of the moves made, and the
own handicap where the rules give any. A block
holds the own coordinates, the opponent's coordinates, the lead, and a 1 once the step is over
(:func:`pcs_racing.game.observation.observation_elements`). All functions take observations of shape
(B, D) and the number G of the game's axes.
"""

import numpy as np
from numpy.typing import NDArray

ObservationBatch = NDArray[np.float32]


def step_count(observation: ObservationBatch, axes: int) -> int:
    """Return the number of steps in an observation: the number of moves plus one."""
    return (observation.shape[-1] - 1) // (2 * axes + 2)


def _blocks(observation: ObservationBatch, axes: int) -> ObservationBatch:
    steps, size = step_count(observation, axes), 2 * axes + 2
    return observation[:, : steps * size].reshape(len(observation), steps, size)


def moves_made(observation: ObservationBatch, axes: int) -> NDArray[np.int64]:
    """Return the number of moves made so far, shape (B,)."""
    return (_blocks(observation, axes)[..., -1] > 0.5).sum(axis=1) - 1


def own(observation: ObservationBatch, axes: int, step: int | None = None) -> ObservationBatch:
    """Return the own normalised coordinates in a step, shape (B, G).

    The default is the last finished step.
    """
    return _coordinates(observation, axes, step, 0)


def opponent(observation: ObservationBatch, axes: int, step: int | None = None) -> ObservationBatch:
    """Return the measured coordinates of the opponent in a step, shape (B, G).

    The default is the last finished step.
    """
    return _coordinates(observation, axes, step, axes)


def lead(observation: ObservationBatch, axes: int, step: int | None = None) -> ObservationBatch:
    """Return the own lead at the end of a step, in units of 20 m, shape (B,).

    The default is the last finished step.
    """
    return _coordinates(observation, axes, step, axes + 1)[:, -1]


def _coordinates(
    observation: ObservationBatch, axes: int, step: int | None, first: int
) -> ObservationBatch:
    index = moves_made(observation, axes) if step is None else np.full(len(observation), step)
    return _blocks(observation, axes)[np.arange(len(observation)), index, first : first + axes]


def earlier(observation: ObservationBatch, axes: int, moves: int) -> ObservationBatch:
    """Return the observations after the given number of moves, shape (B, D)."""
    steps = step_count(observation, axes)
    before = observation.copy()
    before[:, (moves + 1) * (2 * axes + 2) : -1] = 0.0
    before[:, -1] = np.float32(moves / (steps - 1))
    return before
