"""Observations of a game and of a match: name, unit, bounds, meaning and value of each number."""

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
"""Lead that players observe as 1, m."""
LEAD_BOUND = 5.0

# Observation between the races of a match:
AFTER_AXES = 3  # lead, score and share of the duration follow the coordinates of a race


class ObservationElement(NamedTuple):
    """One number of an observation, for spaces and documentation."""

    name: str
    unit: str
    low: float  #: Min value, inclusive.
    high: float  #: Max value, inclusive.
    meaning: str


def _shared_elements(
    characteristics: Sequence[Characteristic], form: str, own: str, opponent: str, lead: str
) -> list[ObservationElement]:
    """Return the elements of one step or race that both kinds of observations have.

    ``form`` is the form of the names; the other texts are the meanings.
    """
    unit = f"{LEAD_SCALE:g} m"
    return [
        *(
            ObservationElement(
                form.format(f"{player}_{axis.name}"), "range", LOW, HIGH, meaning.format(axis.name)
            )
            for player, meaning in (("own", own), ("opponent", opponent))
            for axis in characteristics
        ),
        ObservationElement(form.format("lead"), unit, -LEAD_BOUND, LEAD_BOUND, lead),
    ]


def observation_elements(
    characteristics: Sequence[Characteristic], moves: int
) -> tuple[ObservationElement, ...]:
    """Return the elements of an observation, for these axes and this number of moves."""
    elements = []
    for k in range(moves + 1):
        elements += _shared_elements(
            characteristics,
            f"{{}}_{k}",
            f"the own policy's {{}} in step {k}, from the archive",
            f"the opponent's {{}} as measured in step {k} alone",
            f"own lead at the end of step {k}",
        )
        meaning = f"1 once step {k} is over; until then it and the numbers above are 0"
        elements.append(ObservationElement(f"seen_{k}", "1", 0.0, 1.0, meaning))
    return (
        *elements,
        ObservationElement("step", "1", 0.0, 1.0, "share of the moves that have been made"),
    )


def encode_observation(
    own: Floats, estimates: Floats, leads: Floats, step: Indices
) -> NDArray[np.float32]:
    """Encode the players' observations in the order of :func:`observation_elements`, (B, 2, D).

    The arrays are fields of :class:`pcs_racing.game.state.GameState`, for ``N = moves + 1`` steps;
    ``step`` is the last finished step. The elements of later steps are 0, whatever the arrays hold.
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


class RaceMemory(NamedTuple):
    """Earlier races of B matches, decoded from an observation."""

    own: Floats  #: shape (B, R, G): Normalised coordinates of the own policy.
    opponent: Floats  #: shape (B, R, G): Normalised coordinates of the opponent, as measured.
    lead: Floats  #: shape (B, R): Own lead at the end, in units of 20 m.
    score: Floats  #: shape (B, R): 1 for a race won, 1/2 for a tie.
    #: shape (B, R): Share of the duration that a race lasted; 0 for future races, like all their
    #: numbers.
    driven: Floats


def match_elements(
    characteristics: Sequence[Characteristic], races: int
) -> tuple[ObservationElement, ...]:
    """Return the elements of an observation between races, for these axes and number of races."""
    elements = []
    for r in range(races):
        elements += _shared_elements(
            characteristics,
            f"race_{r}_{{}}",
            f"the own policy's {{}} in race {r}, from the archive",
            f"the opponent's {{}} as measured over race {r}",
            f"own lead at the end of race {r}",
        )
        meaning = f"1 if race {r} was won, 0.5 if it was a tie"
        elements.append(ObservationElement(f"race_{r}_score", "1", 0.0, 1.0, meaning))
        meaning = (
            f"share of its duration that race {r} lasted; until it is over it and the numbers above"
            " are 0"
        )
        elements.append(ObservationElement(f"race_{r}_driven", "1", 0.0, 1.0, meaning))
    return (
        *elements,
        ObservationElement("races_left", "1", 0.0, 1.0, "share of the races that are not over"),
        ObservationElement(
            "front", "1", 0.0, 1.0, "1 if the own car starts the next race on the left or in front"
        ),
    )


def encode_match(
    own: Floats,
    measured: Floats,
    leads: Floats,
    scores: Floats,
    driven: Floats,
    race: NDArray[np.int64],
    front: NDArray[np.bool_],
) -> NDArray[np.float32]:
    """Encode the players' observations of earlier races in the order of :func:`match_elements`.

    The shape is (B, 2, D). The arrays are fields of :class:`pcs_racing.game.match.MatchState`;
    ``front``, of shape (B, 2), is true if the car starts the next race on the left or in front, and
    false if there is no next race.
    """
    matches, races = leads.shape
    lead = np.clip(leads / LEAD_SCALE, -LEAD_BOUND, LEAD_BOUND)
    shared = np.broadcast_to(driven[:, None, :, None], (matches, 2, races, 1))
    # 0.0 - lead, not -lead: a lead of 0 must not become -0.0, whose bits differ.
    leads_of_cars = np.stack([lead, 0.0 - lead], axis=1)[..., None]
    parts = np.concatenate(
        [own, measured[:, ::-1], leads_of_cars, scores[..., None], shared], axis=-1
    )
    left = np.broadcast_to(((races - race) / races)[:, None, None], (matches, 2, 1))
    return np.concatenate([parts.reshape(matches, 2, -1), left, front[..., None]], axis=-1).astype(
        np.float32
    )


def decode_match(observation: NDArray[np.float32], races: int, axes: int) -> RaceMemory:
    """Return the earlier races in observations of shape (B, D)."""
    width = 2 * axes + AFTER_AXES
    blocks = np.asarray(observation[:, : races * width], np.float64).reshape(
        len(observation), races, width
    )
    rest = (blocks[:, :, 2 * axes + i] for i in range(AFTER_AXES))
    return RaceMemory(blocks[:, :, :axes], blocks[:, :, axes : 2 * axes], *rest)
