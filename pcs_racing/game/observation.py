"""What the players of the game observe: name, unit, bounds and meaning of each number, and how they are computed."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcs_racing.game.characteristics import Characteristic

Indices = NDArray[np.int64]
Floats = NDArray[np.float64]

LOW, HIGH = -1.0, 2.0
"""Bounds of the normalised characteristics that players observe."""
LEAD_SCALE = 20.0
"""Metres of lead that players observe as 1."""
LEAD_BOUND = 5.0


class ObservationElement(NamedTuple):
    """What one number of an observation is: spaces and documentation are made of these."""

    name: str
    unit: str
    low: float  #: Smallest value, inclusive.
    high: float  #: Largest value, inclusive.
    meaning: str


def observation_elements(characteristics: Sequence[Characteristic], moves: int) -> tuple[ObservationElement, ...]:
    """What each number of an observation is, for these axes and so many moves."""
    elements = []
    for k in range(moves + 1):
        for axis in characteristics:
            meaning = f"the own policy's {axis.name} in step {k}, from the archive"
            elements.append(ObservationElement(f"own_{axis.name}_{k}", "range", LOW, HIGH, meaning))
        for axis in characteristics:
            meaning = f"the opponent's {axis.name} as measured in step {k} alone"
            elements.append(ObservationElement(f"opponent_{axis.name}_{k}", "range", LOW, HIGH, meaning))
        meaning = f"own lead at the end of step {k}"
        elements.append(ObservationElement(f"lead_{k}", f"{LEAD_SCALE:g} m", -LEAD_BOUND, LEAD_BOUND, meaning))
        meaning = f"1 once step {k} is over; until then it and the numbers above are 0"
        elements.append(ObservationElement(f"seen_{k}", "1", 0.0, 1.0, meaning))
    return (*elements, ObservationElement("step", "1", 0.0, 1.0, "share of the moves that have been made"))


def observation_table(elements: Sequence[ObservationElement], moves: int | None = None) -> str:
    """Table of an observation's elements in Markdown; with ``moves``, those of all steps ``k`` share a row."""
    rows = [(str(i), *element) for i, element in enumerate(elements)]
    if moves is not None:
        block = (len(elements) - 1) // (moves + 1)
        shared = [
            element._replace(name=element.name[:-1] + "k", meaning=element.meaning.replace("step 0", "step k"))
            for element in elements[:block]
        ]
        rows = [(f"{block}k + {i}", *element) for i, element in enumerate(shared)] + rows[-1:]
    head = ("index", "name", "unit", "low", "high", "meaning")
    cells = [head, ("---",) * len(head), *((*row[:3], f"{row[3]:g}", f"{row[4]:g}", row[5]) for row in rows)]
    return "\n".join(f"| {' | '.join(row)} |" for row in cells)


def encode_observation(own: Floats, estimates: Floats, leads: Floats, step: Indices) -> NDArray[np.float32]:
    """Put what the players saw in the order of :func:`observation_elements`, shape (B, 2, D).

    The arrays are those of :class:`pcs_racing.game.state.GameState`, for ``N = moves + 1`` steps of which ``step`` are
    over; of later steps nothing is shown, whatever the arrays hold.
    """
    games, steps = leads.shape
    axes = own.shape[-1]
    # np.clip takes three times as long.
    lead = np.minimum(np.maximum(leads / LEAD_SCALE, -LEAD_BOUND), LEAD_BOUND)
    size = steps * (2 * axes + 2)
    observation = np.empty((games, 2, size + 1), np.float32)
    parts = observation[..., :size].reshape(games, 2, steps, 2 * axes + 2)  # the same memory
    parts[..., :axes] = own
    parts[..., axes:-2] = estimates[:, ::-1]
    parts[:, 0, :, -2] = lead
    parts[:, 1, :, -2] = -lead
    parts[..., -1] = 1.0
    unseen = np.arange(steps) > step[:, None]
    parts.transpose(0, 2, 1, 3)[unseen] = 0.0
    observation[..., -1] = (step / (steps - 1))[:, None]
    return observation
