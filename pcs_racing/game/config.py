"""The rules of the game that is played on top of a race: how long, which moves, and the utility of an outcome."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.errors import ConfigError, InputError
from pcs_racing.base.settings import Settings, checked, choice, flag, load_settings, number, setting, tenths, whole
from pcs_racing.game.characteristics import get_characteristics
from pcs_racing.game.moves import EPSILON, check_epsilon
from pcs_racing.race.config import PAPER, RaceConfig, check_steps, load_race_config

UTILITIES = {
    "lead": "lead in m at the horizon; after a crash 0 for both",
    "lead-at-crash": "lead in m when the race ended, be it by a crash",
    "win": "1 for the winner and -1 for the other; 0 for a tie; after a crash as the race's crash_rule says",
}
"""Utilities of the outcome of a game for a car; the other car gets the negative."""


def _race(value: Any) -> RaceConfig:
    """Return rules of a race from rules, a preset's name or a YAML file."""
    if not isinstance(value, str | Path | RaceConfig):
        raise InputError(f"race is {value!r}; it must be a preset's name, a YAML file or a RaceConfig")
    return load_race_config(value)


def _epsilon(value: Any) -> float | tuple[float, ...]:
    """Return the step sizes of the moves: a number if there is a single one."""
    steps = check_epsilon(value)
    return steps[0] if len(steps) == 1 else steps


EPSILON_RULE = checked(_epsilon, "above 0 up to 10")
"""What settings that state how far moves go may say: a number, or several different ones."""


def check_lengths(value: Any) -> tuple[float, ...]:
    """Return the lengths of the first steps of a game, s."""
    return check_steps("first_steps", value, 0)


def _axes(value: Any) -> tuple[str, ...]:
    """Return the names of characteristics."""
    if isinstance(value, str) or not isinstance(value, Sequence):
        raise InputError(f"characteristics is {value!r}; it must be a list of names")
    get_characteristics(value)
    return tuple(value)


@dataclass(frozen=True)
class GameConfig(Settings):
    """Rules of the game (Section V of the paper, with the choices that it leaves open as options)."""

    race: RaceConfig = setting(
        PAPER,
        checked(_race),
        "Rules of the race, a preset's name or a YAML file; its duration is replaced by the sum of all steps.",
    )
    moves: int = setting(
        None,
        whole(1, 100),
        "Moves of each player; one step without moves precedes the first. With moves, step_seconds and first_steps all "
        "None the steps are those of the race; if one of them is given, 4 moves, 8 s and () stand for the others.",
    )
    step_seconds: float = setting(None, tenths(0.1, 600.0), "Simulated time per move, s.")
    first_steps: tuple[float, ...] = setting(
        None,
        checked(check_lengths),
        "Lengths of the first steps, s, where they are not step_seconds: with [0, 2], players move before the start, "
        "2 s after it, and then every step_seconds.",
    )
    epsilon: float | tuple[float, ...] = setting(
        EPSILON,
        EPSILON_RULE,
        "Length of a move, in units of the archive's range; each of several values has its own moves.",
    )
    stay: bool | None = setting(
        None, flag(), "Whether there is a move that keeps the policy; None takes the race's stay_move."
    )
    utility: str | None = setting(
        None,
        choice(tuple(UTILITIES)),
        'Utility of an outcome; None takes the paper\'s "lead", or "win" if the crash rule names a loser.',
    )
    fault_penalty: float = setting(
        0.0, number(0.0, 1e6), "Utility that is transferred from the car at fault for a crash to the other car."
    )
    discount: float = setting(
        1.0, number(1e-6, 1.0), "Factor per move made: below 1 an early end of the game counts more."
    )
    characteristics: tuple[str, ...] | None = setting(
        None, checked(_axes), "Axes of the game, out of the archive's; None takes all of them."
    )
    mask_duplicates: bool = setting(
        True, flag(), "Whether the action mask rules out a move that leads where an earlier one, or no move, leads."
    )

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
                f"first_steps is {list(self.first_steps)}; with {self.moves} moves it may have {self.moves} lengths, "
                "since the step after the last move takes step_seconds"
            )
        if self.horizon > 3600.0:
            raise ConfigError(f"{self.moves} moves of {self.step_seconds:g} s make a race of over 3600 s; take fewer")

    def _set(self, **values: Any) -> None:
        """Give fields that are None a value."""
        for name, value in values.items():
            if getattr(self, name) is None:
                object.__setattr__(self, name, value)

    @property
    def ends(self) -> tuple[float, ...]:
        """Time at which each of the ``moves + 1`` steps ends, s: a move is made at all of them but the last."""
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


def load_game_config(source: "str | Path | RaceConfig | GameConfig" = "paper", **changes: Any) -> GameConfig:
    """Return game rules from game rules, race rules, a race preset's name or a race's YAML file, with fields changed.

    Examples
    --------
    >>> load_game_config("contest", moves=2).utility
    'win'
    """
    if not isinstance(source, GameConfig):  # what the race decides is not decided before its rules are known
        own = ("moves", "step_seconds", "first_steps")
        source = GameConfig(changes.pop("race", source), **{name: changes.pop(name, None) for name in own})
    return load_settings("game", source, **changes)
