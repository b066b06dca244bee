"""Arguments of the environments at the level of steering and speed, and the elements of their observations."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pcs_racing.base.errors import InputError
from pcs_racing.car.lidar import MOST_BEAMS
from pcs_racing.car.vehicle import F1TENTH
from pcs_racing.game.archive import PolicyArchive
from pcs_racing.race.config import RaceConfig
from pcs_racing.race.kernel import CONTROL_EVERY, DT
from pcs_racing.track.track import Track

__all__ = ["DriveOptions", "Element", "drive_elements"]


class Element(NamedTuple):
    """One number of the observation: its name, unit, bounds and meaning."""

    name: str
    unit: str
    low: float
    high: float
    meaning: str


@dataclass(frozen=True, eq=False)
class DriveOptions:
    """Arguments of the control-level environments; :class:`pcs_racing.envs.drive.DriveEnv` describes them.

    Raises
    ------
    InputError
        If one is impossible; the message names it.
    """

    track: str | Path | Track = "Tarnfjord"
    opponent: Any = "lattice"
    race: str | Path | RaceConfig = "paper"
    duration: float | None = None
    time_step: float = 0.1
    top_speed: float = 8.0
    beams: int = 0
    fov: float = 4.7
    max_range: float = 30.0
    lidar_noise: float = 0.0
    look_ahead: tuple[float, ...] = (0.0, 1.0, 2.0, 4.0, 6.0, 9.0)
    normalize: bool = False
    progress_reward: float = 1.0
    rivalry: float = 0.0
    crash_penalty: float = 10.0
    start_lines: int = 100
    archive: str | Path | PolicyArchive = "default"

    def __post_init__(self) -> None:
        for name, kind in (("track", Track), ("race", RaceConfig), ("archive", PolicyArchive)):
            value = getattr(self, name)
            if not isinstance(value, str | Path | kind):
                raise InputError(f"{name} is {value!r}; it must be a name, a path or a {kind.__name__}")
        _number("time_step", self.time_step, CONTROL_EVERY * DT, 1.0)
        if abs(self.time_step / (CONTROL_EVERY * DT) - round(self.time_step / (CONTROL_EVERY * DT))) > 1e-9:
            raise InputError(f"time_step is {self.time_step!r} s; it must be a multiple of {CONTROL_EVERY * DT:g} s")
        _number("top_speed", self.top_speed, 0.1, F1TENTH.v_max)
        whole = isinstance(self.beams, int | np.integer) and not isinstance(self.beams, bool)
        if not whole or not 0 <= self.beams <= MOST_BEAMS:
            raise InputError(f"beams is {self.beams!r}; it must be a whole number from 0 to {MOST_BEAMS}")
        _number("lidar_noise", self.lidar_noise, 0.0, 10.0)
        for name in ("fov", "max_range"):  # their limits are the lidar's to judge
            _number(name, getattr(self, name), 0.0, float("inf"))
        distances = self.look_ahead if isinstance(self.look_ahead, Sequence) else ()
        if not distances or isinstance(distances, str) or len(distances) > 100:
            raise InputError(f"look_ahead is {self.look_ahead!r}; it must list 1 to 100 distances in m")
        for distance in distances:
            _number("look_ahead", distance, 0.0, 1000.0)
        if not isinstance(self.normalize, bool | np.bool_):
            raise InputError(f"normalize is {self.normalize!r}; it must be true or false")
        for name in ("progress_reward", "rivalry", "crash_penalty"):
            _number(name, getattr(self, name), -1e6 if name != "crash_penalty" else 0.0, 1e6)

    @property
    def ticks(self) -> int:
        """Simulation steps of 0.01 s in a step of the environment."""
        return CONTROL_EVERY * round(self.time_step / (CONTROL_EVERY * DT))


def _number(name: str, value: object, low: float, high: float) -> None:
    fine = isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)
    if not fine or not low <= value <= high:  # type: ignore[operator]
        raise InputError(f"{name} is {value!r}; it must be a number from {low:g} to {high:g}")


def drive_elements(options: DriveOptions) -> list[Element]:
    """Every element of the observation, in order; values beyond the bounds are clipped to them."""
    pi = float(np.pi)
    top = F1TENTH.v_max
    elements = [
        Element("speed", "m/s", F1TENTH.v_min, top, "own speed"),
        Element("steering", "rad", -F1TENTH.steer_max, F1TENTH.steer_max, "own steering angle, positive to the left"),
        Element("yaw rate", "rad/s", -20.0, 20.0, "own yaw rate"),
        Element("slip", "rad", -pi, pi, "own slip angle: course minus heading"),
        Element("target steering", "rad", -F1TENTH.steer_max, F1TENTH.steer_max, "what the last action asked for"),
        Element("target speed", "m/s", 0.0, top, "what the last action asked for"),
        Element("offset", "m", -10.0, 10.0, "distance from the race line, positive to the left"),
        Element("heading error", "rad", -pi, pi, "own heading minus that of the race line"),
    ]
    for distance in options.look_ahead:
        at = f"{distance:g} m ahead"
        elements += [
            Element(f"curvature {at}", "1/m", -5.0, 5.0, f"curvature of the race line {at}, positive to the left"),
            Element(f"line speed {at}", "m/s", 0.0, top, f"speed of the race line {at}, at speed scale 1"),
            Element(f"left {at}", "m", 0.0, 10.0, f"free width left of the race line {at}"),
            Element(f"right {at}", "m", 0.0, 10.0, f"free width right of the race line {at}"),
        ]
    elements += [
        Element("opponent", "1", 0.0, 1.0, "1 if there is an opponent; else it and the next eight are 0"),
        Element("opponent gap", "m", -30.0, 30.0, "how far ahead the opponent is along the race line, the short way"),
        Element("opponent offset", "m", -20.0, 20.0, "its distance from the race line minus the own one"),
        Element("opponent x", "m", -30.0, 30.0, "its position in the own car's frame, forward"),
        Element("opponent y", "m", -30.0, 30.0, "its position in the own car's frame, to the left"),
        Element("opponent heading", "rad", -pi, pi, "its heading minus the own one"),
        Element("opponent vx", "m/s", -30.0, 30.0, "its velocity minus the own one, forward in the own frame"),
        Element("opponent vy", "m/s", -30.0, 30.0, "its velocity minus the own one, to the left in the own frame"),
        Element("lead", "m", -1000.0, 1000.0, "own progress minus the opponent's"),
    ]
    elements += [
        Element(f"beam {k}", "m", 0.0, float(options.max_range), f"range of beam {k}, counted counter-clockwise")
        for k in range(options.beams)
    ]
    return elements
