"""Arguments of the environments with a choice among candidates, and the elements of their
observations.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple

import numpy as np
from annotated_types import Interval
from numpy.typing import NDArray

from pcs_racing.base.errors import InputError, UnknownNameError, check_number, choices
from pcs_racing.base.settings import Checked
from pcs_racing.base.typing import ObservationElement as Element
from pcs_racing.envs.drive_options import GivenRules, RaceOptions, Rival
from pcs_racing.envs.line_kernel import LIMIT
from pcs_racing.planners.candidate_rows import CANDIDATES, GOALS, SPEEDS
from pcs_racing.planners.choice_rows import (
    BENDS,
    MOVE_FEATURES,
    PAIR_FEATURES,
    SITUATION_FEATURES,
    SPEED_FEATURES,
    WIDTHS,
)
from pcs_racing.planners.line_ppo import PARAMETERS
from pcs_racing.planners.planner import offsets
from pcs_racing.race.state import MAX_CARS

Reward = Annotated[float, Interval(ge=0.0, le=1e6)]


def _style(name: str, value: Any) -> dict[str, tuple[float, float]]:
    """Return the range of each given element of a style."""
    if not isinstance(value, Mapping):
        raise InputError(f"{name} is {value!r:.80}; it must map names of a style to numbers")
    found = {}
    bounds = {one.name: (one.low, one.high) for one in PARAMETERS}
    for key, given in value.items():
        if key not in bounds:
            raise UnknownNameError(
                f"{name} has the unknown key {key!r}; {choices(str(key), bounds)}"
            )
        ends = given if isinstance(given, list | tuple) else (given, given)
        if len(ends) != 2:
            raise InputError(f"{name} {key} is {given!r:.80}; it must be a number or (low, high)")
        low = check_number(f"{name} {key}", ends[0], *bounds[key])
        high = check_number(f"{name} {key}", ends[1], low, bounds[key][1])
        found[str(key)] = float(low), float(high)
    return found


@dataclass(frozen=True, eq=False)
class LineOptions(RaceOptions):
    """Arguments of the environments with a choice among candidates."""

    rules: GivenRules = "contest"
    style: Annotated[
        Any,
        Checked(_style),
        "Style of the agents' cars: numbers, or ranges to draw from for each race, such as"
        ' ``{"risk": 0.5, "pace": (0.9, 1.6)}``; the parameters and defaults of ``line-ppo``.',
    ] = None
    progress_reward: Annotated[Reward, "Reward for a metre of progress."] = 0.004
    gain_reward: Annotated[Reward, "Reward for a metre gained, at a price of 1."] = 0.02
    win_reward: Annotated[Reward, "Reward of a win, and penalty of a defeat, at a price of 1."] = (
        1.0
    )
    fault_penalty: Annotated[Reward, "Penalty of a crash by own fault, at risk 0."] = 6.0
    near_penalty: Annotated[
        Reward, "Penalty of 0.1 s at another car, at assertiveness 0; it falls to 0 at 0.9 m."
    ] = 0.03

    @property
    def styles(self) -> NDArray[np.float64]:
        """Range of each element of a style, shape (4, 2)."""
        given = self.style or {}
        return np.array([given.get(one.name, (one.default, one.default)) for one in PARAMETERS])

    @property
    def ticks(self) -> int:
        """Simulation steps of 0.01 s in a step of the environment."""
        return 10


@dataclass(frozen=True, eq=False)
class LineHeadToHeadOptions(LineOptions):
    """Arguments of the environments with a choosing agent in several cars."""

    opponent: Rival = None
    cars: Annotated[int, Interval(ge=1, le=MAX_CARS), "Cars in a race."] = 2


class Part(NamedTuple):
    """Part of an observation: a table, stored feature after feature."""

    first: int  #: Index of its first element.
    features: int  #: Number of features of each item.
    items: int  #: Number of moves, speeds or candidates; 1 for the context.


_CONTEXT = {
    **SITUATION_FEATURES,
    **{f"bend {k}": "curvature of the race line ahead, in 1/2 1/m" for k in range(BENDS)},
    **{
        f"{side} {k}": "free width of the track ahead, m"
        for side in ("left", "right")
        for k in range(WIDTHS)
    },
}
_TABLES = {
    "context": (_CONTEXT, 1),
    "moves": (MOVE_FEATURES, GOALS),
    "speeds": (SPEED_FEATURES, SPEEDS),
    "candidates": (PAIR_FEATURES, CANDIDATES),
}
_FIRST = offsets(*(len(features) * items for features, items in _TABLES.values()))
PARTS = {
    name: Part(first, len(features), items)
    for first, (name, (features, items)) in zip(_FIRST, _TABLES.items(), strict=False)
}
"""Parts of an observation by name: context, moves, speeds, candidates; two numbers follow."""

LINE_ELEMENTS = [
    Element(key if items == 1 else f"{name[:-1]} {k} {key}", "1", -LIMIT, LIMIT, text)
    for name, (features, items) in _TABLES.items()
    for key, text in features.items()
    for k in range(items)
]
LINE_ELEMENTS += [
    Element("time left", "1", 0.0, 1.0, "share of the race's duration that is left"),
    Element("handicap", "1", 0.0, 1.0, "share of the commanded speed that the car lacks"),
]


def split_observation(observations: Any) -> dict[str, Any]:
    """Return the parts of observations of `Line`, numpy arrays or torch tensors, shape (..., n).

    ``context`` has the shape (..., features), and ``moves`` (..., 16, features), ``speeds`` (...,
    4, features) and ``candidates`` (..., 64, features) have a row for each. Candidate ``c`` has the
    speed ``c // 16`` and the move ``c % 16``; its last feature is -1 if it is rejected.

    Examples
    --------
    >>> parts = split_observation(np.zeros((5, len(LINE_ELEMENTS))))
    >>> {name: part.shape for name, part in parts.items()}
    {'context': (5, 46), 'moves': (5, 16, 14), 'speeds': (5, 4, 8), 'candidates': (5, 64, 7)}
    """
    if observations.shape[-1] != len(LINE_ELEMENTS):
        raise InputError(
            f"observations have {observations.shape[-1]} numbers; Line's have {len(LINE_ELEMENTS)}"
        )
    found = {}
    for name, (first, features, items) in PARTS.items():
        part = observations[..., first : first + features * items]
        table = part.reshape(*part.shape[:-1], features, items)
        found[name] = part if items == 1 else table.swapaxes(-1, -2)
    return found


def draw_style(ends: NDArray[np.float64], generator: np.random.Generator) -> NDArray[np.float64]:
    """Draw a style, shape (4,), from its ranges (4, 2); a fixed element takes no draw."""
    drawn = ends[:, 1] > ends[:, 0]
    out: NDArray[np.float64] = ends[:, 0].copy()
    out[drawn] = generator.uniform(ends[drawn, 0], ends[drawn, 1])
    return out
