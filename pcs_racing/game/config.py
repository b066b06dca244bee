"""The rules of the game that is played on top of a race: how long, which moves, and the utility of an outcome."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.checks import is_number
from pcs_racing.base.errors import ConfigError, InputError
from pcs_racing.base.settings import Settings, checked, choice, flag, load_settings, number, setting, tenths, whole
from pcs_racing.game.characteristics import get_characteristics
from pcs_racing.game.moves import EPSILON, check_epsilon
from pcs_racing.race.config import PAPER, RaceConfig, load_race_config

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
    """Return lengths of steps: whole tenths of a second, in which plans are made; the first one may be 0."""
    lengths = value if isinstance(value, list | tuple) else None
    if lengths is None or not all(is_number(one) and abs(10.0 * one - round(10.0 * one)) < 1e-9 for one in lengths):
        raise InputError(f"first_steps is {value!r:.80}; it must be a list of seconds in whole tenths")
    if any(not (0.1 <= one <= 600.0 or (k == 0 and one == 0.0)) for k, one in enumerate(lengths)):
        raise InputError(f"first_steps is {value!r:.80}; steps last 0.1 to 600 s, and the first one may last 0")
    return tuple(map(float, lengths))


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
    moves: int = setting(4, whole(1, 100), "Moves of each player; one step without moves precedes the first.")
    step_seconds: float = setting(8.0, tenths(0.1, 600.0), "Simulated time per move, s.")
    first_steps: tuple[float, ...] = setting(
        (),
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
        False, flag(), "Whether the action mask forbids a move if an earlier move leads to the same policy."
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.first_steps) > self.moves:
            raise ConfigError(
                f"first_steps is {list(self.first_steps)}; with {self.moves} moves it may have {self.moves} lengths, "
                "since the step after the last move takes step_seconds"
            )
        if self.horizon > 3600.0:
            raise ConfigError(f"{self.moves} moves of {self.step_seconds:g} s make a race of over 3600 s; take fewer")
        # What the preset decides is written down, so that equal rules are equal values.
        if self.stay is None:
            object.__setattr__(self, "stay", self.race.stay_move)
        if self.utility is None:
            object.__setattr__(self, "utility", "lead" if self.race.crash_rule == "nobody" else "win")

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
    if not isinstance(source, GameConfig):  # stay and utility follow from the race
        source = GameConfig(race=changes.pop("race", source))
    return load_settings("game", source, **changes)
