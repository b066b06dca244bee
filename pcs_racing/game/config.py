"""The rules of the game that is played on top of a race: how long, which moves, and the utility of
an outcome.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from annotated_types import Interval, MultipleOf
from numpy.typing import NDArray

from pcs_racing.base.errors import ConfigError, InputError
from pcs_racing.base.settings import Checked, OneOf, Settings, load_settings
from pcs_racing.game.characteristics import get_characteristics
from pcs_racing.game.moves import EPSILON, check_epsilon
from pcs_racing.race.config import PAPER, RaceConfig, check_steps, load_race_config

UTILITIES = {
    "lead": "lead in m at the horizon; after a crash 0 for both",
    "lead-at-crash": "lead in m at the end of the race, crashes included",
    "win": (
        "1 for the winner and -1 for the other; 0 for a tie; after a crash as the race's crash_rule"
        " says"
    ),
}
"""Utilities of the outcome of a game for a car; the other car gets the negative."""


def _race(name: str, value: Any) -> RaceConfig:
    """Return rules of a race from rules, a preset's name or a YAML file."""
    if not isinstance(value, str | Path | RaceConfig):
        raise InputError(
            f"{name} is {value!r}; it must be a preset's name, a YAML file or a RaceConfig"
        )
    return load_race_config(value)


def _epsilon(_: str, value: Any) -> float | tuple[float, ...]:
    """Return the step sizes of the moves: a number if there is a single one."""
    steps = check_epsilon(value)
    return steps[0] if len(steps) == 1 else steps


STEP_SIZES = Checked(_epsilon, "above 0 up to 10")
"""Length of moves: a number, or several different ones."""


FIRST_STEPS = Checked(partial(check_steps, minimum=0))
"""Lengths of the first steps of a game, s."""


def _axes(name: str, value: Any) -> tuple[str, ...]:
    """Return the names of characteristics."""
    if isinstance(value, str) or not isinstance(value, Sequence):
        raise InputError(f"{name} is {value!r}; it must be a list of names")
    get_characteristics(value)
    return tuple(value)


@dataclass(frozen=True)
class GameConfig(Settings):
    """Rules of the game (Section V of the paper), with the choices left open there as options."""

    race: Annotated[
        RaceConfig,
        Checked(_race),
        "Rules of the race, a preset's name or a YAML file; its duration is replaced by the sum of"
        " all steps.",
    ] = PAPER
    moves: Annotated[
        int,
        Interval(ge=1, le=100),
        "Moves of each player; one step without moves precedes the first. Without moves,"
        " step_seconds and first_steps the race gives the steps; with one of them, the defaults of"
        " the others are 4, 8 s and ().",
    ] = None  # type: ignore[assignment]
    step_seconds: Annotated[
        float,
        Interval(ge=0.1, le=600.0),
        MultipleOf(0.1),
        "Simulated time per move, s.",
    ] = None  # type: ignore[assignment]
    first_steps: Annotated[
        tuple[float, ...],
        FIRST_STEPS,
        "Lengths of the first steps, s, if other than step_seconds: with [0, 2], players move"
        " before the start, 2 s after it, and then every step_seconds.",
    ] = None  # type: ignore[assignment]
    epsilon: Annotated[
        float | tuple[float, ...],
        STEP_SIZES,
        "Length of a move, in units of the archive's range; each of several values has its own"
        " moves.",
    ] = EPSILON
    stay: Annotated[
        bool | None,
        "Whether there is a move that keeps the policy; None for the race's stay_move.",
    ] = None
    utility: Annotated[
        str | None,
        OneOf(UTILITIES),
        'Utility of an outcome; None for "lead" (the paper), or "win" if the crash rule names a'
        " loser.",
    ] = None
    fault_penalty: Annotated[
        float,
        Interval(ge=0.0, le=1e6),
        "Utility that is transferred from the car at fault for a crash to the other car.",
    ] = 0.0
    discount: Annotated[
        float,
        Interval(ge=1e-6, le=1.0),
        "Factor per move made: below 1 an early end of the game counts more.",
    ] = 1.0
    characteristics: Annotated[
        tuple[str, ...] | None,
        Checked(_axes),
        "Axes of the game, out of the archive's; None for all of them.",
    ] = None
    mask_duplicates: Annotated[
        bool,
        "Whether the action mask rules out all but the first move to the same policy, and no-ops.",
    ] = True

    def __post_init__(self) -> None:
        super().__post_init__()
        # What the rules of the race decide is written down, so that equal rules are equal values.
        if all(value is None for value in (self.moves, self.step_seconds, self.first_steps)):
            *first, length = self.race.steps
            while first and first[-1] == length:
                first.pop()
            self._set(moves=len(self.race.steps) - 1, step_seconds=length, first_steps=tuple(first))
        self._set(moves=4, step_seconds=8.0, first_steps=(), stay=self.race.stay_move)
        self._set(utility="lead" if self.race.crash_rule == "nobody" else "win")
        if len(self.first_steps) > self.moves:
            raise ConfigError(
                f"first_steps is {list(self.first_steps)}; with {self.moves} moves it may have"
                f" {self.moves} lengths, since the step after the last move takes step_seconds"
            )
        if self.horizon > 3600.0:
            raise ConfigError(
                f"{self.moves} moves of {self.step_seconds:g} s make a race of over 3600 s; take"
                " fewer"
            )

    def _set(self, **values: Any) -> None:
        """Give fields that are None a value."""
        for name, value in values.items():
            if getattr(self, name) is None:
                object.__setattr__(self, name, value)

    @property
    def ends(self) -> tuple[float, ...]:
        """Time at which each of the ``moves + 1`` steps ends, s: a move is made at all of them but
        the last.
        """
        return tuple(float(tick) / 100.0 for tick in self.end_ticks)

    @cached_property
    def end_ticks(self) -> NDArray[np.int64]:
        """The same in simulation steps of 0.01 s, shape (moves + 1,)."""
        rest = [self.step_seconds] * (self.moves + 1 - len(self.first_steps))
        return np.cumsum([round(length * 100.0) for length in (*self.first_steps, *rest)])

    @property
    def horizon(self) -> float:
        """Length of the race, s."""
        return self.ends[-1]

    @property
    def race_rules(self) -> RaceConfig:
        """Rules of the race with the game's horizon as its duration."""
        return replace(self.race, duration=self.horizon)


def load_game_config(
    source: "str | Path | RaceConfig | GameConfig" = "paper", **changes: Any
) -> GameConfig:
    """Return game rules from game rules, race rules, a race preset's name or a race's YAML file,
    with fields changed.

    Examples
    --------
    >>> load_game_config("contest", moves=2).utility
    'win'
    """
    # values of the race's rules are set once these are known
    if not isinstance(source, GameConfig):
        own = ("moves", "step_seconds", "first_steps")
        race = changes.pop("race") if "race" in changes else _race("rules", source)
        source = GameConfig(race, **{name: changes.pop(name, None) for name in own})
    return load_settings("game", source, **changes)
