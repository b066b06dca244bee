"""The rules of one race on the track: start, noise, durations and what a crash costs."""

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Any, Literal

from annotated_types import Interval, MultipleOf

from pcs_racing.base.checks import check_path, check_text, is_number
from pcs_racing.base.errors import ConfigError, InputError
from pcs_racing.base.settings import Checked, Settings, Text, load_settings

# When the parts of a race take their turn, in steps of the simulation:
DT = 0.01  # s, one simulation step
PLAN_EVERY = 10  # steps: 10 Hz
CONTROL_EVERY = 2  # 50 Hz, as are progress and collisions
ITTC_EVERY = 5  # 20 Hz


def _speed_range(name: str, value: Any) -> tuple[float, float]:
    """Return two speed scales as a tuple."""
    pair = isinstance(value, list | tuple) and len(value) == 2 and all(map(is_number, value))
    if not pair or not 0.1 <= value[0] < value[1] <= 3.0:
        raise InputError(f"{name} is {value!r}; it must be [low, high] with 0.1 <= low < high <= 3")
    return value[0], value[1]


def _printable(name: str, value: Any) -> str:
    """Return a text that a terminal can show on one line."""
    if not check_text(name, value).isprintable():
        raise InputError(f"{name} is {value!r}; it must be a text of printable characters")
    return str(value)


def check_steps(name: str, value: Any, minimum: int = 2) -> tuple[float, ...]:
    """Return lengths of a game's steps: whole tenths of a second, in which plans are made; the
    first one may be 0.
    """
    lengths = value if isinstance(value, list | tuple) else [None]
    whole_tenths = [
        is_number(one) and abs(10.0 * one - round(10.0 * one)) < 1e-9 for one in lengths
    ]
    if len(lengths) < minimum or not all(whole_tenths):
        raise InputError(
            f"{name} is {value!r:.80}; it must list {minimum} or more lengths in whole tenths"
            " of 1 s"
        )
    if any(not (0.1 <= one <= 600.0 or (k == 0 and one == 0.0)) for k, one in enumerate(lengths)):
        raise InputError(
            f"{name} is {value!r:.80}; steps last 0.1 to 600 s, and the first one may last 0"
        )
    return tuple(map(float, lengths))


MAX_LAPS = 100
MAX_SECONDS = 3600.0
LAP_SECONDS = 40.0  # s: default length of a race, and of each lap of a race with laps

CONTACTS = ("end", "stop", "restart")
"""Consequences of a contact, each at its index in the kernel."""


@dataclass(frozen=True)
class RaceConfig(Settings):
    """Rules of a race; :data:`PAPER`, :data:`CONTEST` and :data:`ROBORACER` are the presets."""

    name: Annotated[
        Text, Checked(_printable), "Name of the rules in archives, trees, networks and results."
    ] = "paper"
    duration: Annotated[
        float | None,
        Interval(ge=0.1, le=MAX_SECONDS),
        MultipleOf(0.1),
        "Length of a race, s; max length of a race with laps. None for 40 s, with laps 40 s a lap.",
    ] = None
    laps: Annotated[
        int | None,
        Interval(ge=1, le=MAX_LAPS),
        "Length of a race in laps of the first car, counted at the start line of the front car;"
        " None for a race by time.",
    ] = None
    start: Annotated[
        Literal["side-by-side", "staggered", "rolling"],
        "Both cars on one line; one start_gap behind the other; or the same at the speed of the"
        " race line.",
    ] = "side-by-side"
    start_gap: Annotated[
        float,
        Interval(ge=0.0, le=50.0),
        "Distance between the cars along the track for staggered and rolling starts, m.",
    ] = 0.0
    start_spacing: Annotated[
        float,
        Interval(ge=0.0, le=10.0),
        "Distance between their centres across the track, m; on a circuit where that is impossible,"
        " a preset takes the nearest possible distance.",
    ] = 0.9
    start_speed: Annotated[
        float, Interval(ge=0.0, le=15.0), "Speed at the start, m/s; not for rolling starts."
    ] = 4.0
    start_lines: Annotated[
        int,
        Interval(ge=1, le=1000),
        "Start lines, spread evenly over the places of the circuit where two cars get away.",
    ] = 50
    steering_noise: Annotated[
        float,
        Interval(ge=0.0, le=0.4),
        "Standard deviation of the AR(1) disturbance added to every steering command, rad; 0 for"
        " none.",
    ] = 0.0
    noise_time: Annotated[
        float, Interval(ge=0.01, le=60.0), "Correlation time of that disturbance, s."
    ] = 0.28
    speed_range: Annotated[
        tuple[float, float] | None,
        Checked(_speed_range, "0.1 <= low < high <= 3"),
        "Speed scales of pace 0 and pace 1; None for the circuit's calibrated range of this"
        " preset.",
    ] = None
    crash_rule: Annotated[
        Literal["nobody", "fault-loses"],
        "Reward after a crash: none for either car (the paper), or only for the car that was not at"
        " fault.",
    ] = "nobody"
    aggressiveness: Annotated[
        Literal["lead", "pace", "speed"],
        "First axis of an archive: mean lead in m (the paper); lead per time driven scaled to the"
        " full duration, which does not charge a crash twice; or speed in parts of the speed"
        " profile, which does not depend on the opponent.",
    ] = "lead"
    ittc_horizon: Annotated[
        float,
        Interval(ge=0.1, le=1000.0),
        "Cap of the time to collision, s; without a cap the mean is infinite.",
    ] = 10.0
    contact: Annotated[
        Literal["end", "stop", "restart"],
        "Consequence of a contact: the race ends; the car at fault, or in a wall, stands still"
        " where it was; or it is put back on the race line at rest, 2 m behind the other car, or"
        " where it was if it hit a wall.",
    ] = "end"
    most_faults: Annotated[
        int,
        Interval(ge=0, le=100),
        "Faults that put a car out of the race and make it lose, where contacts do not end the"
        " race; 0 for no limit.",
    ] = 0
    heats: Annotated[
        int,
        Interval(ge=1, le=99),
        "Races per scored series of a tournament, from alternate sides: best of so many.",
    ] = 1
    stay_move: Annotated[bool, "Whether the game offers a move that keeps the policy."] = False
    steps: Annotated[
        tuple[float, ...],
        Checked(check_steps),
        "Lengths of the steps of the game, s, with a move of both players between two of them;"
        " after a first step of 0 s players move before the start.",
    ] = (8.0,) * 5

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.start == "side-by-side" and self.start_spacing < 0.4:
            raise ConfigError(
                f"start_spacing is {self.start_spacing!r} m; cars side by side need at least 0.4 m"
            )
        if self.start != "side-by-side" and self.start_gap < 0.8:
            raise ConfigError(
                f"start_gap is {self.start_gap!r} m; a {self.start} start needs at least 0.8 m"
            )

    @property
    def seconds(self) -> float:
        """Length of a race, s; max length of a race with laps."""
        if self.duration is not None:
            return self.duration
        return min(LAP_SECONDS * (self.laps or 1), MAX_SECONDS)

    @property
    def hashed_values(self) -> list[Any]:
        """Values for a hash: races by time have the hash from before there were laps."""
        values = {one.name: getattr(self, one.name) for one in fields(self)}
        values["duration"] = self.seconds
        return [value for name, value in values.items() if name != "laps" or value is not None]

    @property
    def ticks(self) -> int:
        """Length of a race in simulation steps of 0.01 s; max length with laps."""
        return round(self.seconds * 100.0)


PAPER = RaceConfig()
"""The race of the paper: deterministic, side by side, a crash is a no-contest."""

CONTEST = RaceConfig(
    name="contest",
    start="staggered",
    start_gap=1.4,
    start_spacing=0.45,
    steering_noise=0.02,
    crash_rule="fault-loses",
    aggressiveness="speed",
    stay_move=True,
    steps=(0.0, 2.0, 6.0, 8.0, 8.0, 8.0, 8.0),
)
"""The race in which adapting pays: staggered, disturbed, the car at fault loses."""

ROBORACER = RaceConfig(
    name="roboracer",
    start_spacing=0.62,
    start_speed=0.0,
    steering_noise=0.02,
    crash_rule="fault-loses",
    aggressiveness="speed",
    contact="restart",
    most_faults=3,
    heats=3,
    stay_move=True,
    steps=CONTEST.steps,
)
"""Head-to-head races of the RoboRacer league: from rest, a car's width apart; three faults are too
many; best of 3.
"""

PRESETS = {preset.name: preset for preset in (PAPER, CONTEST, ROBORACER)}


def load_race_config(source: str | Path | RaceConfig, **changes: Any) -> RaceConfig:
    """Return rules of a race from a preset's name, a YAML file or other rules, with some fields
    changed.

    A YAML file is a mapping of the fields of :class:`RaceConfig`; a field that is absent takes the
    default, and ``rules`` names the preset that the defaults come from.

    Examples
    --------
    >>> load_race_config("contest", duration=16.0).start
    'staggered'
    """
    if not isinstance(source, RaceConfig):
        check_path("rules", source, ConfigError)
    return load_settings("race", PAPER, source, PRESETS, "rules", **changes)
