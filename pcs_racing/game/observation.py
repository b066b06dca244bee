"""Observations of a game: name, unit, bounds, meaning and value of each number."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.typing import Floats, Indices, ObservationElement
from pcs_racing.game.characteristics import Characteristic

LOW, HIGH = -1.0, 2.0
"""Bounds of the normalised characteristics that players observe."""
LEAD_SCALE = 20.0
"""Lead that players observe as 1, m."""
LEAD_BOUND = 5.0


def observation_elements(
    characteristics: Sequence[Characteristic], moves: int, handicaps: bool = False
) -> tuple[ObservationElement, ...]:
    """Return the elements of an observation, for these axes and this number of moves.

    ``handicaps``: True for rules that give handicaps.
    """
    elements: list[ObservationElement] = []
    for k in range(moves + 1):
        elements += [
            ObservationElement(
                f"own_{axis.name}_{k}",
                "range",
                LOW,
                HIGH,
                f"the own policy's {axis.name} in step {k}, from the archive",
            )
            for axis in characteristics
        ]
        elements += [
            ObservationElement(
                f"opponent_{axis.name}_{k}",
                "range",
                LOW,
                HIGH,
                f"the opponent's {axis.name} as measured in step {k} alone",
            )
            for axis in characteristics
        ]
        lead = f"own lead at the end of step {k}"
        seen = f"1 once step {k} is over; until then it and the numbers above are 0"
        elements += [
            ObservationElement(f"lead_{k}", f"{LEAD_SCALE:g} m", -LEAD_BOUND, LEAD_BOUND, lead),
            ObservationElement(f"seen_{k}", "1", 0.0, 1.0, seen),
        ]
    about = "share of the commanded speed that the own car lacks"
    return (
        *elements,
        ObservationElement("step", "1", 0.0, 1.0, "share of the moves that have been made"),
        *([ObservationElement("handicap", "1", 0.0, 1.0, about)] if handicaps else []),
    )


def encode_observation(
    own: Floats, estimates: Floats, leads: Floats, step: Indices, handicaps: Floats | None = None
) -> NDArray[np.float32]:
    """Encode the players' observations in the order of :func:`observation_elements`, (B, 2, D).

    The arrays are fields of :class:`pcs_racing.game.state.GameState`, for ``N = moves + 1`` steps;
    ``step`` is the last finished step. The elements of later steps are 0 for any arrays.
    ``handicaps`` of the cars have the shape (B, 2); None for rules without handicaps.
    """
    games, steps = leads.shape
    axes = own.shape[-1]
    # np.clip takes three times as long.
    lead = np.minimum(np.maximum(leads / LEAD_SCALE, -LEAD_BOUND), LEAD_BOUND)
    size = steps * (2 * axes + 2)
    observation = np.empty((games, 2, size + 1 + (handicaps is not None)), np.float32)
    parts = observation[..., :size].reshape(games, 2, steps, 2 * axes + 2)  # the same memory
    parts[..., :axes] = own
    parts[..., axes:-2] = estimates[:, ::-1]
    parts[:, 0, :, -2] = lead
    parts[:, 1, :, -2] = -lead
    parts[..., -1] = 1.0
    unseen = np.arange(steps) > step[:, None]
    parts.transpose(0, 2, 1, 3)[unseen] = 0.0
    observation[..., size] = (step / (steps - 1))[:, None]
    if handicaps is not None:
        observation[..., -1] = handicaps
    return observation
