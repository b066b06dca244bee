"""Rules of races and of their game: start, noise, durations, crashes, moves and utility."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from annotated_types import Interval, MultipleOf
from numpy.typing import NDArray

from pcs_racing.base.errors import ConfigError, InputError, check_path, check_text, is_number
from pcs_racing.base.settings import Checked, Names, OneOf, Settings, Text, load_settings

# When the parts of a race take their turn, in steps of the simulation:
DT = 0.01  # s, one simulation step
PLAN_EVERY = 10  # steps: 10 Hz
CONTROL_EVERY = 2  # 50 Hz, as are progress and collisions
ITTC_EVERY = 5  # 20 Hz


def _ends(largest: float, less: str) -> Checked:
    """Return the check of a range from two numbers, ``low < high`` or ``low <= high``."""
    form = f"0.1 <= low {less} high <= {largest:g}"

    def check(name: str, value: Any) -> tuple[float, float]:
        pair = isinstance(value, list | tuple) and len(value) == 2 and all(map(is_number, value))
        equal = pair and value[0] == value[1] and less == "<"
        if not pair or equal or not 0.1 <= value[0] <= value[1] <= largest:
            raise InputError(f"{name} is {value!r}; it must be [low, high] with {form}")
        return value[0], value[1]

    return Checked(check, form)


def _printable(name: str, value: Any) -> str:
    """Return a text that a terminal can show on one line."""
    if not check_text(name, value).isprintable():
        raise InputError(f"{name} is {value!r}; it must be a text of printable characters")
    return str(value)


def _steps(name: str, value: Any) -> tuple[float, ...]:
    """Return lengths of a game's steps: whole tenths of a second, the period of the plans; the
    first length may be 0.
    """
    lengths = value if isinstance(value, list | tuple) else []
    whole_tenths = [
        is_number(one) and abs(10.0 * one - round(10.0 * one)) < 1e-9 for one in lengths
    ]
    if not 2 <= len(lengths) <= 101 or not all(whole_tenths):
        raise InputError(
            f"{name} is {value!r:.80}; it must list 2 to 101 lengths in whole tenths of 1 s"
        )
    if any(not (0.1 <= one <= 600.0 or (k == 0 and one == 0.0)) for k, one in enumerate(lengths)):
        raise InputError(
            f"{name} is {value!r:.80}; steps last 0.1 to 600 s, and the first one may last 0"
        )
    if sum(lengths) > MAX_SECONDS:
        raise InputError(f"{name} is {value!r:.80}; a game lasts at most {MAX_SECONDS:.0f} s")
    return tuple(map(float, lengths))


def check_epsilon(epsilon: Any) -> tuple[float, ...]:
    """Return the step sizes of the moves as a tuple of different positive numbers."""
    several = isinstance(epsilon, list | tuple) or (
        isinstance(epsilon, np.ndarray) and epsilon.ndim == 1
    )
    given = list(epsilon) if several else [epsilon]
    lengths = [
        length.item() if isinstance(length, np.ndarray) and length.ndim == 0 else length
        for length in given
    ]
    steps = tuple(float(length) for length in lengths if is_number(length) and 0.0 < length <= 10.0)
    if not steps or len(steps) < len(lengths) or len(set(steps)) < len(steps):
        raise InputError(
            f"epsilon is {epsilon!r}; it must be a number in (0, 10], or several different ones"
        )
    return steps


def _epsilon(_: str, value: Any) -> float | tuple[float, ...]:
    """Return the step sizes of the moves: a number if there is a single one."""
    steps = check_epsilon(value)
    return steps[0] if len(steps) == 1 else steps


EPSILON = 0.5
"""Default length of a move: half of the archive's range on an axis."""

UTILITIES = {
    "lead": "lead in m at the horizon; after a crash 0 for both",
    "lead-at-crash": "lead in m at the end of the race, crashes included",
    "win": (
        "1 for the winner and -1 for the other; 0 for a tie; after a crash as the race's crash_rule"
        " says"
    ),
}
"""Utilities of the outcome of a game for a car; the other car gets the negative."""

MAX_LAPS = 100
MAX_SECONDS = 3600.0
LAP_SECONDS = 40.0  # s: default length of a race, and of each lap of a race with laps

FULL_SIGHT = 2.0 * np.pi  # rad

CONTACTS = ("end", "stop", "restart")
"""Consequences of a contact, each at its index in the kernel."""


@dataclass(frozen=True)
class Rules(Settings):
    """Rules of races and games, such as :data:`PAPER`, :data:`CONTEST` and :data:`ROBORACER`.

    The game is the game of Section V of the paper, with the choices left open there as options.
    """

    #: Fields that change no fingerprint at their defaults: results made before them stay valid.
    added_fields: ClassVar[tuple[str, ...]] = ("sight", "front_pace")

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
        " the shipped rules take the nearest possible distance.",
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
    sight: Annotated[
        float,
        Interval(ge=0.1, le=FULL_SIGHT),
        "Visible angle around the lidar's heading, rad; a car with all four corners outside is not"
        " visible.",
    ] = FULL_SIGHT
    front_pace: Annotated[
        tuple[float, float],
        _ends(1.0, "<="),
        "Range of the factor on the speed of the car in front at the start, drawn for each race;"
        " without effect on cars that start side by side.",
    ] = (1.0, 1.0)
    speed_range: Annotated[
        tuple[float, float] | None,
        _ends(3.0, "<"),
        "Speed scales of pace 0 and pace 1; None for the circuit's calibrated range of these"
        " rules.",
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
        "Races per scored series of a tournament, from alternate sides: best of so many; 2 for two"
        " legs of the same race, scored by the sum of their rewards.",
    ] = 1
    steps: Annotated[
        tuple[float, ...],
        Checked(_steps),
        "Lengths of the steps of the game, s, with a move of both players between two of them;"
        " after a first step of 0 s players move before the start. With a duration or laps, the"
        " steps are stretched to the length of the race; else they are the length of a game.",
    ] = (8.0,) * 5
    epsilon: Annotated[
        float | tuple[float, ...],
        Checked(_epsilon, "above 0 up to 10"),
        "Length of a move, in units of the archive's range; each of several values has its own"
        " moves.",
    ] = EPSILON
    stay: Annotated[bool, "Whether the game offers a move that keeps the policy."] = False
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
        Names | None,
        "Axes of the game, out of the archive's; None for all of them.",
    ] = None
    mask_duplicates: Annotated[
        bool,
        "Whether the action mask rules out all but the first move to the same policy, and no-ops.",
    ] = True

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
    def legs(self) -> int:
        """Number of races with the same key, from exchanged places: 2 if a series has two."""
        return 2 if self.heats == 2 else 1

    @property
    def gives_handicaps(self) -> bool:
        """True if the car in front at the start is slower than its driver commands."""
        return self.front_pace[0] < 1.0 and self.start != "side-by-side"

    @property
    def ticks(self) -> int:
        """Length of a race in simulation steps of 0.01 s; max length with laps."""
        return round(self.seconds * 100.0)

    @property
    def moves(self) -> int:
        """Number of moves of each player."""
        return len(self.steps) - 1

    @property
    def payoff(self) -> str:
        """Name of the utility of an outcome."""
        return self.utility or ("lead" if self.crash_rule == "nobody" else "win")

    @cached_property
    def end_ticks(self) -> NDArray[np.int64]:
        """End of each step of the game, in simulation steps of 0.01 s, shape (moves + 1,).

        A move is made at all of them but the last.
        """
        parts = np.array([round(length * 10.0) for length in self.steps])
        if self.duration is None and self.laps is None:
            return np.cumsum(10 * parts)
        # Whole tenths of a second, the time between two plans: a step of 8.1666 s would end
        # between two plans.
        parts //= np.gcd.reduce(parts)
        unit, rest = divmod(self.ticks, 10 * int(parts.sum()))
        if unit == 0 or rest:
            raise InputError(
                f"duration is {self.seconds:g} s; a game of {self.moves} moves lasts a multiple of"
                f" {0.1 * int(parts.sum()):g} s"
            )
        return np.cumsum(10 * unit * parts)

    @property
    def ends(self) -> tuple[float, ...]:
        """End time of each step of the game, s."""
        return tuple(float(tick) / 100.0 for tick in self.end_ticks)

    @property
    def step_seconds(self) -> float:
        """Length of the last step of the game, s."""
        return float(self.end_ticks[-1] - self.end_ticks[-2]) / 100.0

    @property
    def for_game(self) -> "Rules":
        """Rules with the length of the game as the duration of a race."""
        return replace(self, duration=self.ends[-1])


PAPER = Rules()
"""The race of the paper: deterministic, side by side, a crash is a no-contest."""

CONTEST = Rules(
    name="contest",
    start="staggered",
    start_gap=1.4,
    start_spacing=0.45,
    steering_noise=0.02,
    sight=4.7,
    front_pace=(0.88, 1.0),
    crash_rule="fault-loses",
    aggressiveness="speed",
    heats=2,
    utility="lead-at-crash",
    fault_penalty=20.0,
    steps=(0.0, 2.0, 6.0, 8.0, 8.0, 8.0, 8.0),
    stay=True,
)
"""A race with a reason to pass: the slower car starts in front and does not see behind itself; two
legs with exchanged grids, scored by the sum of their leads.
"""

ROBORACER = Rules(
    name="roboracer",
    start_spacing=0.62,
    start_speed=0.0,
    steering_noise=0.02,
    sight=4.7,
    crash_rule="fault-loses",
    aggressiveness="speed",
    contact="restart",
    most_faults=3,
    heats=3,
    steps=CONTEST.steps,
    stay=True,
)
"""Head-to-head races of the RoboRacer league: from rest, a car's width apart; three faults are too
many; best of 3.
"""

KNOWN_RULES = {rules.name: rules for rules in (PAPER, CONTEST, ROBORACER)}
"""Shipped rules by name; each circuit has a calibration for each of them."""


def load_rules(source: str | Path | Mapping[str, Any] | Rules = "paper", **changes: Any) -> Rules:
    """Return rules from a shipped name, a YAML file, a mapping or rules, with some fields changed.

    A file or mapping holds fields of :class:`Rules`; an absent field has its default, and ``rules``
    names the shipped rules with the defaults.

    Examples
    --------
    >>> load_rules("contest", duration=16.0).start
    'staggered'
    """
    if isinstance(source, Mapping):
        changes = {**source, **changes}
        source = changes.pop("rules", "paper")
    if not isinstance(source, Rules):
        check_path("rules", source, ConfigError)
    return load_settings("rules", PAPER, source, KNOWN_RULES, "rules", **changes)
