"""The rules of one race on the track: start, noise, durations and what a crash costs."""

import os
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, Literal

from pcs_racing.base.errors import ConfigError, UnknownNameError
from pcs_racing.base.reading import MAX_YAML, parse_yaml, read_limited

__all__ = ["CONTEST", "PAPER", "PRESETS", "RaceConfig", "load_race_config"]


@dataclass(frozen=True)
class RaceConfig:
    """How two cars race; :data:`PAPER` and :data:`CONTEST` are the two presets.

    Attributes
    ----------
    name : str
        Name that archives, trees, networks and results carry.
    duration : float
        Length of a race in s, a multiple of 0.1 s in (0, 3600].
    start : {"side-by-side", "staggered", "rolling"}
        Both cars on one line; one ``start_gap`` behind the other; or one behind the other at the speed of the race
        line.
    start_gap : float
        Distance between the cars along the track for staggered and rolling starts, m.
    start_spacing : float
        Distance between their centres across the track, m. On a circuit where that never works, a preset takes the
        nearest distance that does.
    start_speed : float
        Speed at the start in m/s (a rolling start takes the race line's speed instead).
    start_lines : int
        Number of start lines, spread evenly over the places of the circuit from which two cars get away.
    steering_noise : float
        Standard deviation of the AR(1) disturbance that is added to every steering command, rad; 0 for none.
    noise_time : float
        Its correlation time, s.
    speed_range : tuple of two floats, or None
        Speed scales that stand for pace 0 and pace 1; None takes the circuit's calibrated range for this preset.
    crash_rule : {"nobody", "fault-loses"}
        Who is paid after a crash: nobody (the paper), or the car that was not at fault.
    aggressiveness : {"lead", "pace"}
        Mean lead in m (the paper), or lead per time driven scaled to the full duration, which does not charge a crash
        twice.
    ittc_horizon : float
        Largest time to collision that counts, s; without a cap the mean is infinite.
    stay_move : bool
        Whether the game offers a move that keeps the policy.
    """

    name: str = "paper"
    duration: float = 40.0
    start: Literal["side-by-side", "staggered", "rolling"] = "side-by-side"
    start_gap: float = 0.0
    start_spacing: float = 0.9
    start_speed: float = 4.0
    start_lines: int = 50
    steering_noise: float = 0.0
    noise_time: float = 0.28
    speed_range: tuple[float, float] | None = None
    crash_rule: Literal["nobody", "fault-loses"] = "nobody"
    aggressiveness: Literal["lead", "pace"] = "lead"
    ittc_horizon: float = 10.0
    stay_move: bool = False

    def __post_init__(self) -> None:
        if isinstance(self.speed_range, list):
            object.__setattr__(self, "speed_range", tuple(self.speed_range))
        _check_choice(self, "start", ("side-by-side", "staggered", "rolling"))
        _check_choice(self, "crash_rule", ("nobody", "fault-loses"))
        _check_choice(self, "aggressiveness", ("lead", "pace"))
        _check_number(self, "duration", 0.1, 3600.0)
        _check_number(self, "start_gap", 0.0, 50.0)
        _check_number(self, "start_spacing", 0.0, 10.0)
        _check_number(self, "start_speed", 0.0, 15.0)
        _check_number(self, "steering_noise", 0.0, 0.4)
        _check_number(self, "noise_time", 0.01, 60.0)
        _check_number(self, "ittc_horizon", 0.1, 1000.0)
        if abs(self.duration * 10.0 - round(self.duration * 10.0)) > 1e-9:
            raise ConfigError(f"duration is {self.duration!r} s; it must be a multiple of 0.1 s")
        if (
            isinstance(self.start_lines, bool)
            or not isinstance(self.start_lines, int)
            or not 1 <= self.start_lines <= 1000
        ):
            raise ConfigError(f"start_lines is {self.start_lines!r}; it must be a whole number from 1 to 1000")
        if not isinstance(self.stay_move, bool):
            raise ConfigError(f"stay_move is {self.stay_move!r}; it must be true or false")
        if not isinstance(self.name, str) or not self.name:
            raise ConfigError(f"name is {self.name!r}; it must be a non-empty text")
        if self.start == "side-by-side" and self.start_spacing < 0.4:
            raise ConfigError(f"start_spacing is {self.start_spacing!r} m; cars side by side need at least 0.4 m")
        if self.start != "side-by-side" and self.start_gap < 0.8:
            raise ConfigError(f"start_gap is {self.start_gap!r} m; a {self.start} start needs at least 0.8 m")
        if self.speed_range is not None:
            ok = isinstance(self.speed_range, tuple) and len(self.speed_range) == 2
            ok = ok and all(isinstance(v, int | float) and not isinstance(v, bool) for v in self.speed_range)
            if not ok or not 0.1 <= self.speed_range[0] < self.speed_range[1] <= 3.0:
                raise ConfigError(
                    f"speed_range is {self.speed_range!r}; it must be [low, high] with 0.1 <= low < high <= 3"
                )

    @property
    def ticks(self) -> int:
        """Length of the race in simulation steps of 0.01 s."""
        return round(self.duration * 100.0)


def _check_choice(config: RaceConfig, key: str, choices: tuple[str, ...]) -> None:
    if not isinstance(getattr(config, key), str) or getattr(config, key) not in choices:
        raise ConfigError(f"{key} is {getattr(config, key)!r}; it must be one of {', '.join(choices)}")


def _check_number(config: RaceConfig, key: str, low: float, high: float) -> None:
    value = getattr(config, key)
    if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
        raise ConfigError(f"{key} is {value!r}; it must be a number from {low:g} to {high:g}")


PAPER = RaceConfig()
"""The race of the paper: deterministic, side by side, a crash pays nobody."""

CONTEST = RaceConfig(
    name="contest",
    start="staggered",
    start_gap=1.4,
    start_spacing=0.45,
    steering_noise=0.01,
    crash_rule="fault-loses",
    aggressiveness="pace",
    stay_move=True,
)
"""The race in which adapting pays: staggered, disturbed, the car at fault loses."""

PRESETS = {preset.name: preset for preset in (PAPER, CONTEST)}


def load_race_config(source: str | Path | RaceConfig, **changes: Any) -> RaceConfig:
    """Return a race configuration from a preset's name, a YAML file or a configuration, with some fields changed.

    A YAML file is a mapping of the fields of :class:`RaceConfig`; a field that is absent takes the default, and
    ``preset`` names the preset that the defaults come from.

    Raises
    ------
    ConfigError
        If a key is unknown or a value impossible.
    UnknownNameError
        If the name is no preset and no file.

    Examples
    --------
    >>> load_race_config("contest", duration=16.0).start
    'staggered'
    """
    if isinstance(source, RaceConfig):
        return replace(source, **_known(changes, "the arguments"))
    if isinstance(source, str) and source in PRESETS:
        return replace(PRESETS[source], **_known(changes, "the arguments"))
    path = Path(source)
    if not os.path.isfile(path):
        raise UnknownNameError(
            f"race preset {str(source)!r} is unknown; use {', '.join(PRESETS)} or the path of a YAML file"
        )
    try:
        content = read_limited(path, MAX_YAML, "a file of race settings")
    except OSError as error:
        raise ConfigError(f"can't read {path}: {error.strerror or error}") from None
    values = parse_yaml(path, content, ConfigError)
    if not isinstance(values, dict):
        raise ConfigError(f"{path} holds {type(values).__name__}; it must be a mapping of race settings")
    values = dict(values)
    base = values.pop("preset", "paper")
    if not isinstance(base, str) or base not in PRESETS:
        raise ConfigError(f"{path}: preset is {base!r}; it must be one of {', '.join(PRESETS)}")
    return replace(PRESETS[base], **{**_known(values, str(path)), **_known(changes, "the arguments")})


def _known(values: dict[Any, Any], where: str) -> dict[str, Any]:
    names = [field.name for field in fields(RaceConfig)]
    for key in values:
        if key not in names:
            raise ConfigError(f"{where}: unknown race setting {key!r}; known are {', '.join(names)}")
    return values
