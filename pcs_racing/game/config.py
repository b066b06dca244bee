"""The rules of the game that is played on top of a race: how long, which moves, and what an outcome is worth."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

from pcs_racing.base.errors import ConfigError, InputError
from pcs_racing.game.characteristics import get_characteristics
from pcs_racing.game.moves import EPSILON, check_epsilon
from pcs_racing.race.config import PAPER, RaceConfig, load_race_config

__all__ = ["UTILITIES", "GameConfig", "load_game_config"]

UTILITIES = {
    "lead": "lead in m at the horizon; after a crash 0 for both",
    "lead-at-crash": "lead in m when the race ended, be it by a crash",
    "win": "1 for the winner and -1 for the other; 0 for a tie; after a crash as the race's crash_rule says",
}
"""What the outcome of a game is worth to a car; the other car gets minus that."""


@dataclass(frozen=True)
class GameConfig:
    """Rules of the game (Section V of the paper, with the choices that it leaves open as options).

    Attributes
    ----------
    race : RaceConfig
        Rules of the race; a preset's name or a YAML file is loaded. Its duration is replaced by ``(moves + 1) *
        step_seconds``.
    moves : int
        Moves of each player, 1 to 100. The game starts with one step of driving in which the players only watch.
    step_seconds : float
        Driving per move, s; a multiple of 0.1 in [0.1, 600].
    epsilon : float or tuple of float
        How far a move goes, in units of the archive's range; with several values there are moves of each.
    stay : bool, optional
        Whether there is a move that keeps the policy; by default as the race's ``stay_move`` says.
    utility : {"lead", "lead-at-crash", "win"}, optional
        See :data:`UTILITIES`; by default the paper's "lead", and "win" where the race's crash rule names a loser.
    fault_penalty : float
        What the car to blame for a crash pays to the other, in units of the utility; 0 or above.
    discount : float
        Factor per move made, in (0, 1]: an early end of the game is worth more.
    characteristics : tuple of str, optional
        Axes of the game, out of the archive's; all of them by default.
    mask_duplicates : bool
        Whether the action mask forbids moves that lead where an earlier move of the list leads, too.

    Raises
    ------
    ConfigError
        If a value is impossible.
    """

    race: RaceConfig = PAPER
    moves: int = 4
    step_seconds: float = 8.0
    epsilon: float | tuple[float, ...] = EPSILON
    stay: bool | None = None
    utility: str | None = None
    fault_penalty: float = 0.0
    discount: float = 1.0
    characteristics: tuple[str, ...] | None = None
    mask_duplicates: bool = False

    def __post_init__(self) -> None:
        def put(key: str, value: Any) -> None:
            object.__setattr__(self, key, value)

        if not isinstance(self.race, RaceConfig):
            if not isinstance(self.race, str | Path):
                raise ConfigError(f"race is {self.race!r}; it must be a preset's name, a YAML file or a RaceConfig")
            put("race", load_race_config(self.race))
        if isinstance(self.moves, bool) or not isinstance(self.moves, int) or not 1 <= self.moves <= 100:
            raise ConfigError(f"moves is {self.moves!r}; it must be a whole number from 1 to 100")
        self._check_number("step_seconds", 0.1, 600.0)
        if abs(self.step_seconds * 10.0 - round(self.step_seconds * 10.0)) > 1e-9:
            raise ConfigError(f"step_seconds is {self.step_seconds!r}; it must be a multiple of 0.1 s")
        if (self.moves + 1) * self.step_seconds > 3600.0:
            raise ConfigError(f"{self.moves} moves of {self.step_seconds:g} s make a race of over 3600 s; take fewer")
        try:
            steps = check_epsilon(self.epsilon)
        except InputError as error:
            raise ConfigError(str(error)) from None
        put("epsilon", steps[0] if len(steps) == 1 else steps)
        put("stay", self.race.stay_move if self.stay is None else self.stay)
        for key in ("stay", "mask_duplicates"):
            if not isinstance(getattr(self, key), bool):
                raise ConfigError(f"{key} is {getattr(self, key)!r}; it must be true or false")
        if self.utility is None:
            put("utility", "lead" if self.race.crash_rule == "nobody" else "win")
        if not isinstance(self.utility, str) or self.utility not in UTILITIES:
            raise ConfigError(f"utility is {self.utility!r}; it must be one of {', '.join(UTILITIES)}")
        self._check_number("fault_penalty", 0.0, 1e6)
        self._check_number("discount", 1e-6, 1.0)
        if self.characteristics is not None:
            names = self.characteristics
            if isinstance(names, str) or not isinstance(names, Sequence):
                raise ConfigError(f"characteristics is {names!r}; it must be a list of names")
            get_characteristics(names)
            put("characteristics", tuple(names))

    def _check_number(self, key: str, low: float, high: float) -> None:
        value = getattr(self, key)
        if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
            raise ConfigError(f"{key} is {value!r}; it must be a number from {low:g} to {high:g}")

    @property
    def horizon(self) -> float:
        """Length of the race, s."""
        return round((self.moves + 1) * self.step_seconds, 1)

    @property
    def step_ticks(self) -> int:
        """Simulation steps of 0.01 s in a step of the game."""
        return round(self.step_seconds * 100.0)

    @property
    def race_rules(self) -> RaceConfig:
        """Rules of the race with the game's horizon as its duration."""
        return replace(self.race, duration=self.horizon)


def load_game_config(source: "str | Path | RaceConfig | GameConfig" = "paper", **changes: Any) -> GameConfig:
    """Return game rules from game rules, race rules, a race preset's name or a race's YAML file, with fields changed.

    Raises
    ------
    ConfigError
        If a key is unknown or a value impossible.

    Examples
    --------
    >>> load_game_config("contest", moves=2).utility
    'win'
    """
    known = [field.name for field in fields(GameConfig)]
    for key in changes:
        if key not in known:
            raise ConfigError(f"unknown game setting {key!r}; known are {', '.join(known)}")
    if isinstance(source, GameConfig):
        return replace(source, **changes)
    return GameConfig(**{"race": source, **changes})
