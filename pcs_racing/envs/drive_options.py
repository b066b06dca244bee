"""Arguments of the environments at the level of steering and speed, and the elements of their
observations.
"""

import re
from dataclasses import asdict, dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from annotated_types import Interval, Len
from numpy.typing import NDArray

from pcs_racing.base.errors import ConfigError, InputError, check_number
from pcs_racing.base.settings import ANYTHING, Checked, OneOf
from pcs_racing.base.typing import ObservationElement as Element
from pcs_racing.car.lidar_kernel import FIELD_OF_VIEW, MAX_BEAMS, MAX_RANGE, Beams
from pcs_racing.car.vehicle import F1TENTH, VehicleParams
from pcs_racing.envs.drive_kernel import Limits, Sight
from pcs_racing.envs.randomization import EpisodeOptions
from pcs_racing.race.config import DT, MAX_LAPS, Rules, load_rules
from pcs_racing.race.state import MAX_CARS
from pcs_racing.track.track import Track

if TYPE_CHECKING:
    pass

SEE_OPPONENT = ("never", "in sight", "always")
"""When the opponent is observed; each at the index that the kernel knows it by."""


KEPT = (
    "action",
    "observation",
    "time_step",
    "min_speed",
    "top_speed",
    "beams",
    "fov",
    "max_range",
    "look_ahead",
    "own_state",
    "own_pose",
    "see_opponent",
    "time_left",
    "normalize",
    "normalized",
)
"""Arguments of an environment that define a model's observations and actions."""


ONLY_WITH_ARCS = {
    "time_step": 0.1,
    "normalized": True,
    "beams": 0,
    "min_speed": 0.0,
    "top_speed": 8.0,
    "own_pose": False,
    "time_left": False,
}
"""Values of the arguments that arcs and sectors leave no choice of."""


def _source(name: str, value: Any, kind: type) -> Any:
    """Return a name, a path or a value of a class."""
    if not isinstance(value, str | Path | kind):
        raise ConfigError(f"{name} is {value!r}; it must be a name, a path or a {kind.__name__}")
    return value


def _archive(name: str, value: Any) -> Any:
    if isinstance(value, str | Path):  # no other value needs the class
        return value
    from pcs_racing.game.archive import PolicyArchive

    return _source(name, value, PolicyArchive)


def _time_step(name: str, value: Any) -> float:
    step = check_number(name, value, DT, 1.0)
    if abs(step / DT - round(step / DT)) > 1e-9:
        raise InputError(f"{name} is {step!r} s; it must be a multiple of {DT:g} s")
    return step


def _opponents(name: str, value: Any) -> tuple[Any, ...]:
    if not isinstance(value, list | tuple) or len(value) >= MAX_CARS:
        raise InputError(f"{name} is {value!r:.80}; it must list at most {MAX_CARS - 1} opponents")
    return tuple(value)


def rivals_of(opponent: Any, opponents: Any) -> tuple[Any, ...]:
    """Return the opponents of the cars without an agent: none for a lone car."""
    given = (opponent,) if opponents is None else _opponents("opponents", opponents)
    return () if len(given) == 1 and given[0] is None else given


Rival = Annotated[
    Any,
    ANYTHING,
    '"lattice", "lattice:pace=0.8", "lane-switcher:3", a policy, or a planner; a model that was'
    ' trained here, or its file "model.zip" (:func:`pcs_racing.envs.models.model_policy`). Or'
    " an agent of the game of moves (:class:`pcs_racing.envs.duel.DuelEnv`), by name or as an"
    ' object, such as "cfr-argmax": it changes its policy of the archive every 8 s. Of a list of'
    " opponents or (weight, opponent) pairs, one is drawn for each episode; planners may differ."
    " None for no opponent: the agent is alone on the track, and the elements of the second car are"
    " 0. With two agents or more, the opponent replaces the last agent.",
]
GivenRules = Annotated[
    str | Path | Rules,
    Checked(partial(_source, kind=Rules)),
    'Rules of the race: "paper", "contest", a YAML file or a configuration.',
]
TimeStep = Annotated[
    float, Checked(_time_step, "a multiple of 0.01, up to 1"), "Length of a step, s."
]
Rivalry = Annotated[
    float, Interval(ge=-1e6, le=1e6), "Share of the opponent's progress subtracted from the reward."
]


@dataclass(frozen=True, eq=False)
class RaceOptions(EpisodeOptions):
    """Arguments of the environments whose agents drive."""

    opponent: Rival = "lattice"
    opponents: Annotated[
        tuple[Any, ...] | None,
        Checked(_opponents, "at most 7"),
        "One opponent for each other car, in place of `opponent`; planners may differ."
        " `opponent` in the infos is -1 if there are several.",
    ] = None
    rules: GivenRules = "paper"
    duration: Annotated[
        float | None,
        ANYTHING,
        "Length of a race, s, a multiple of 0.1 (with laps its max length); by default the duration"
        " of the rules.",
    ] = None
    laps: Annotated[
        int | None,
        Interval(ge=1, le=MAX_LAPS),
        "Length of a race in laps of the first car; by default the laps of the rules.",
    ] = None
    start_lines: Annotated[int, ANYTHING, "Number of start lines to draw from."] = 100
    archive: Annotated[
        Any,
        Checked(_archive),
        "Archive of opponents that move between policies.",
    ] = "default"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.opponents is not None and str(self.opponent) not in ("None", RaceOptions.opponent):
            raise ConfigError(
                f"opponent is {self.opponent!r}, and opponents were given, too; give one of the two"
            )

    @property
    def cars_given(self) -> tuple[VehicleParams, ...]:
        """Parameters of the agents' cars."""
        return self.vehicle if isinstance(self.vehicle, tuple) else (self.vehicle,)


@dataclass(frozen=True, eq=False)
class DriveOptions(RaceOptions):
    """Arguments of the control-level environments."""

    time_step: TimeStep = 0.1
    action: Annotated[
        str,
        OneOf(("command", "arc")),
        'Action: "command", a steering angle and a speed; or "arc", the curvature of the arc that'
        " the car follows for 0.1 s, as a share of the largest at its speed, and a change of its"
        " speed, as a share of 1 m/s.",
    ] = "command"
    observation: Annotated[
        str,
        OneOf(("map", "sectors")),
        'Observation: "map", as the arguments below say; or "sectors", for arcs: 75 sectors of a'
        " lidar and their changes, and the own motion, as ``lidar-ppo`` sees them.",
    ] = "map"
    min_speed: Annotated[
        float,
        Interval(ge=F1TENTH.v_min, le=0.0),
        "Target speed of the action -1, m/s; below 0 a car can reverse, for instance away from a"
        " wall.",
    ] = 0.0
    top_speed: Annotated[
        float,
        Interval(ge=0.1, le=F1TENTH.v_max),
        "Target speed of the action 1, m/s.",
    ] = 8.0
    normalized: Annotated[
        bool,
        "Whether actions are in [-1, 1]; else they are a steering angle in rad and a speed in m/s.",
    ] = True
    beams: Annotated[int, Interval(ge=0, le=MAX_BEAMS), "Beams of the lidar; 0 for none."] = 0
    fov: Annotated[float, FIELD_OF_VIEW, "Angle from the first beam to the last, rad."] = 4.7
    max_range: Annotated[float, MAX_RANGE, "Max reported range, m."] = 30.0
    look_ahead: Annotated[
        tuple[Annotated[float, Interval(ge=0.0, le=1000.0)], ...],
        Len(0, 100),
        "Distances ahead of the observed curvature, speed and widths of the race line, m; () for"
        " none.",
    ] = (0.0, 1.0, 2.0, 4.0, 6.0, 9.0)
    own_state: Annotated[bool, "Whether the numbers about the own car are observed."] = True
    own_pose: Annotated[
        bool, "Whether x, y (m) and heading (rad) of the own car on the map follow them."
    ] = False
    see_opponent: Annotated[
        str,
        OneOf(SEE_OPPONENT),
        'Observation of the opponent. "in sight": its elements are 0 while a wall is between the'
        ' centres of the two cars, or their distance exceeds `max_range`; "never": no elements',
    ] = "always"
    time_left: Annotated[
        bool, "Whether an element before the beams is the share of the race that is left."
    ] = False
    normalize: Annotated[bool, "Whether observations are scaled to [-1, 1]."] = False
    progress_reward: Annotated[
        float, Interval(ge=-1e6, le=1e6), "Reward for a metre of progress."
    ] = 1.0
    rivalry: Rivalry = 0.0
    crash_penalty: Annotated[
        float, Interval(ge=0.0, le=1e6), "Penalty of a crash by own fault."
    ] = 10.0
    win_reward: Annotated[
        float, Interval(ge=0.0, le=1e6), "Reward of a win, and penalty of a defeat."
    ] = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        arcs, sectors = self.action == "arc", self.observation == "sectors"
        if arcs != sectors:
            raise ConfigError(
                f"action is {self.action!r} and observation {self.observation!r}; 'arc' and"
                " 'sectors' belong together"
            )
        for name, only in ONLY_WITH_ARCS.items() if arcs else ():
            if getattr(self, name) != only:
                raise ConfigError(f"{name} is {getattr(self, name)}; with arcs it is {only}")

    @property
    def ticks(self) -> int:
        """Simulation steps of 0.01 s in a step of the environment."""
        return round(self.time_step / DT)

    @cached_property
    def sees_handicap(self) -> bool:
        """True if the own handicap is observed: under rules with handicaps."""
        return load_rules(self.rules).gives_handicaps

    @property
    def limits(self) -> Limits:
        """Ends of the range of an action, for the agents' largest steering angle."""
        turn = max(car.steer_max for car in self.cars_given)
        return Limits(turn, float(self.min_speed), float(self.top_speed))


@dataclass(frozen=True, eq=False)
class HeadToHeadOptions(DriveOptions):
    """Arguments of the environments with an agent in several cars."""

    opponent: Rival = None
    time_step: TimeStep = 0.02
    rivalry: Rivalry = 1.0
    cars: Annotated[int, Interval(ge=1, le=MAX_CARS), "Cars in a race."] = 2


def drive_arguments(options: DriveOptions, cars: int) -> dict[str, Any]:
    """Return the arguments of an environment that define a model's observations and actions."""
    values = {name: getattr(options, name) for name in KEPT} | {
        "cars": cars,
        "look_ahead": list(options.look_ahead),
    }
    if options.sees_handicap:
        values["front_pace"] = list(load_rules(options.rules).front_pace)
    vehicles = options.cars_given
    if any(car != F1TENTH for car in vehicles):
        values["vehicle"] = [asdict(car) for car in vehicles]
    return values


def drive_elements(options: DriveOptions, cars: int = 2) -> list[Element]:
    """Return each element of the observation, in order; values are clipped to the bounds."""
    if options.observation == "sectors":
        from pcs_racing.envs.sector_elements import SECTOR_ELEMENTS

        return SECTOR_ELEMENTS
    vehicles = options.cars_given
    pi = float(np.pi)
    top = max(F1TENTH.v_max, *(car.v_max for car in vehicles))
    turn = max(F1TENTH.steer_max, *(car.steer_max for car in vehicles))
    low = min(F1TENTH.v_min, *(car.v_min for car in vehicles))
    elements: list[Element] = []
    if options.own_state:
        elements += [
            Element("speed", "m/s", low, top, "own speed"),
            Element("steering", "rad", -turn, turn, "own steering angle, positive to the left"),
            Element("yaw rate", "rad/s", -20.0, 20.0, "own yaw rate"),
            Element("slip", "rad", -pi, pi, "own slip angle: course minus heading"),
            Element("target steering", "rad", -turn, turn, "steering angle of the last action"),
            Element(
                "target speed",
                "m/s",
                float(options.min_speed),
                top,
                "speed of the last action",
            ),
            Element(
                "offset", "m", -10.0, 10.0, "distance from the race line, positive to the left"
            ),
            Element("heading error", "rad", -pi, pi, "own heading minus heading of the race line"),
        ]
    if options.own_pose:
        elements += [Element(name, "m", -1e4, 1e4, "own place on the map") for name in ("x", "y")]
        elements.append(
            Element("heading", "rad", -pi, pi, "own heading on the map, counter-clockwise from x")
        )
    for distance in options.look_ahead:
        at = f"{distance:g} m ahead"
        elements += [
            Element(
                f"curvature {at}",
                "1/m",
                -5.0,
                5.0,
                f"curvature of the race line {at}, positive to the left",
            ),
            Element(
                f"line speed {at}",
                "m/s",
                0.0,
                top,
                f"speed of the race line {at}, at speed scale 1",
            ),
            Element(f"left {at}", "m", 0.0, 10.0, f"free width left of the race line {at}"),
            Element(f"right {at}", "m", 0.0, 10.0, f"free width right of the race line {at}"),
        ]
    if options.see_opponent != "never":
        rival = [
            Element(
                "opponent",
                "1",
                0.0,
                1.0,
                "1 if there is an opponent (in sight), else all nine are 0",
            ),
            Element(
                "opponent gap",
                "m",
                -30.0,
                30.0,
                "lead of the opponent along the race line, the short way",
            ),
            Element(
                "opponent offset",
                "m",
                -20.0,
                20.0,
                "offset of the opponent minus own offset",
            ),
            Element("opponent x", "m", -30.0, 30.0, "position in the own car's frame, forward"),
            Element("opponent y", "m", -30.0, 30.0, "position in the own car's frame, to the left"),
            Element("opponent heading", "rad", -pi, pi, "opponent's heading minus own heading"),
            Element(
                "opponent vx",
                "m/s",
                -30.0,
                30.0,
                "velocity minus own velocity, forward in the own frame",
            ),
            Element(
                "opponent vy",
                "m/s",
                -30.0,
                30.0,
                "velocity minus own velocity, to the left in the own frame",
            ),
            Element("lead", "m", -1000.0, 1000.0, "own progress minus progress of the opponent"),
        ]
        # The nearest opponent comes first.
        for k in range(max(1, cars - 1)):
            nth = f" {k + 1}" if k else ""
            elements += [
                one._replace(name=re.sub("opponent|lead", rf"\g<0>{nth}", one.name))
                for one in rival
            ]
    if options.time_left:
        elements.append(
            Element("time left", "1", 0.0, 1.0, "share of the race's duration that is left")
        )
    if options.sees_handicap:
        elements.append(
            Element("handicap", "1", 0.0, 1.0, "share of the commanded speed that the car lacks")
        )
    elements += [
        Element(
            f"beam {k}",
            "m",
            0.0,
            float(options.max_range),
            f"range of beam {k}, counted counter-clockwise",
        )
        for k in range(options.beams)
    ]
    if not elements:
        raise InputError(
            "nothing is observed; leave own_state on, or take look_ahead, see_opponent or beams"
        )
    return elements


def samples_ahead(options: DriveOptions, track: Track) -> NDArray[np.int64]:
    """Look-ahead distances in samples of a track's race line."""
    return np.array(
        [round(one / track.arrays.ds) % len(track.arrays.line) for one in options.look_ahead],
        np.int64,
    )


def make_sight(options: DriveOptions, cars: int, players: int, track: Track) -> Sight:
    """Return the observation of players in races of so many cars on a track, without the end of a
    race.
    """
    elements = drive_elements(options, cars)
    low, high = (
        np.array([getattr(element, end) for element in elements]) for end in ("low", "high")
    )
    gain = 2.0 / (high - low) if options.normalize else np.ones(len(low))
    nothing = np.empty(0)
    nothing.flags.writeable = False  # as a lidar's are: both have the same compiled type then
    beams = Beams(0.0, 1.0, float(options.max_range), nothing, nothing)
    if options.beams > 0:
        from pcs_racing.car.lidar import Lidar

        beams = Lidar(track, options.beams, options.fov, options.max_range).kernel
    return Sight(
        players=players,
        own_state=options.own_state,
        own_pose=options.own_pose,
        ahead=samples_ahead(options, track),
        others=0 if options.see_opponent == SEE_OPPONENT[0] else max(1, cars - 1),
        in_sight=options.see_opponent == SEE_OPPONENT[1] if cars > 1 else None,
        time_left=options.time_left,
        handicap=options.sees_handicap,
        end_tick=0,
        beams=beams,
        low=low,
        high=high,
        gain=gain,
        shift=-1.0 - low * gain if options.normalize else np.zeros(len(low)),
    )


def shares(actions: NDArray[np.float64], limits: tuple[float, float, float]) -> NDArray[np.float64]:
    """Return actions in rad and m/s as shares from -1 to 1 of the limits, shape (..., 2)."""
    turn, low, top = limits
    return (actions - (0.0, 0.5 * (low + top))) / (turn, 0.5 * (top - low))
