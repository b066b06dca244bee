"""Work of the planner node, without ROS: messages go in, commands come out."""

from dataclasses import dataclass, field
from math import copysign, cos, hypot, sin
from typing import Any, NamedTuple

import numpy as np

from .messages import MessageError, moved, ranges_at, stamp_of, state_of

LIMITS = {"speed_share": 1.5, "steering_rate": 100.0, "timeout": 5.0}
WINDOW = 0.25  # s: poses and speeds of the odometry are compared over this time
SIDEWAYS = 0.8  # rad: max slip angle of a car that has not spun
STOP = (0.0, 0.0)
CARS = ("odometry", "opponent")
BRAKING = 0.55  # m/s: max reduction of the speed by a command
CAR = {
    "wheelbase": 0.01,
    "rear_axle": 0.0,
    "steer_max": 0.01,
    "rear_slip": 0.0,
    "understeer": -10.0,
    "understeer_gain": 0.0,
}
"""Min values of the description of a vehicle."""


class MapPolicy:
    """Policy on a map: it needs odometry in the frame of the map, and no scan."""

    needs = ("odometry",)

    def __init__(self, policy: str, track: str, rules: str) -> None:
        from pcs_racing_agents.agents import PolicyOnCar

        self.on_car = PolicyOnCar(policy, track, rules=rules)
        self.reset = self.on_car.reset

    def command(
        self, time: float, car: np.ndarray, opponent: np.ndarray | None, scan: Any
    ) -> tuple[float, float]:
        """Return steering angle (rad) and speed (m/s)."""
        return self.on_car.command(time, car, opponent)


def pursue(car: np.ndarray, start: np.ndarray, arc: np.ndarray, about: dict[str, float]) -> float:
    """Return the steering angle (rad) along an arc, by pure pursuit as in races.

    ``start`` is the state of the car at the start of the arc (curvature and speed); ``about``
    describes the vehicle.
    """
    kappa, speed = arc
    v, slip = car[3], about["rear_axle"] - about["rear_slip"] * np.array([start[3], car[3]]) ** 2
    course, own = kappa * slip + (start[4], car[4])
    s = np.linspace(0.0, 0.5 + 0.25 * start[3], 101)
    chord, angle = s * np.sinc(0.5 * kappa * s / np.pi), course + 0.5 * kappa * s
    ahead = start[0] - car[0] + chord * np.cos(angle)
    aside = start[1] - car[1] + chord * np.sin(angle)
    away = np.hypot(ahead, aside)
    goal = np.argmin(away)
    far = np.flatnonzero(away[goal:] >= 0.3 + 0.1 * v)
    goal = goal + far[0] if len(far) else len(s) - 1
    bend = 2.0 * (aside[goal] * np.cos(own) - ahead[goal] * np.sin(own)) / away[goal] ** 2
    understeer = about["understeer"] + about["understeer_gain"] * min(10.0 * (speed - v), 9.5)
    steering = np.arctan(about["wheelbase"] * bend) + understeer * v * v * kappa
    return float(np.clip(steering, -about["steer_max"], about["steer_max"]))


class ScanPolicy:
    """Policy of a file of ``pcs-racing export lidar-ppo``: it needs scans, and no map."""

    needs = ("scan", "odometry")

    def __init__(self, file: str) -> None:
        from .onnx_policy import OnnxPolicy, number

        self.network = OnnxPolicy(file)
        about, shapes = self.network.about, self.network.shapes
        if about["inputs"].keys() != {"ranges", "own"}:
            raise ValueError(
                f"{file} takes {', '.join(about['inputs'])}; the planner node runs files that take"
                " ranges and own: export lidar-ppo, or name a planner with a map"
            )
        beams, vehicle = about["inputs"]["ranges"], about.get("vehicle")
        if not isinstance(beams, dict) or not isinstance(vehicle, dict):
            raise ValueError(f"{file} describes no beams or no vehicle: export it again")
        self.period = number(file, about, "period", 0.01, 1.0)
        count = number(file, beams, "beams", 2, 10_000)
        first, last = (number(file, beams, f"angle_{end}", -3.2, 3.2) for end in ("min", "max"))
        self.max_range = number(file, beams, "max_range", 1.0, 1000.0)
        self.vehicle = {name: number(file, vehicle, name, low, 10.0) for name, low in CAR.items()}
        if shapes["ranges"] != (1, count) or shapes["own"] != (1, 3) or not first < last:
            raise ValueError(
                f"{file} has {count:g} beams from {first:g} to {last:g} rad in its description; its"
                f" network takes ranges {shapes['ranges']} and own {shapes['own']}: export it again"
            )
        self.angles = np.linspace(first, last, int(count))
        self.reset()
        arc = self._decide(np.full(int(count), self.max_range), np.zeros(3))
        if np.shape(arc) != (2,):
            raise ValueError(f"{file} gives no arc of two numbers: export it again")
        self.reset()

    def _decide(self, ranges: np.ndarray, own: np.ndarray) -> Any:
        return self.network.decide(ranges=ranges, own=own).get("arc")

    def reset(self) -> None:
        """Forget all decisions: the next command begins an arc."""
        self.network.reset()
        self.due, self.start, self.arc = 0.0, np.zeros(7), np.zeros(2)

    def command(
        self, time: float, car: np.ndarray, opponent: np.ndarray | None, scan: Any
    ) -> tuple[float, float]:
        """Return steering angle (rad) and speed (m/s): of a new arc, or along the last one."""
        if time >= self.due - 1e-6:
            ranges = ranges_at(scan, self.angles, self.max_range)
            self.start, self.arc = car, self._decide(ranges, car[[3, 5, 2]]).astype(float)
            # Periods are counted from the last decision on time; a late one starts a new count.
            self.due = (self.due if time < self.due + self.period else time) + self.period
        speed = max(self.arc[1], car[3] - BRAKING)
        return pursue(car, self.start, np.array([self.arc[0], speed]), self.vehicle), float(speed)


class Heard(NamedTuple):
    """Message with the times of its arrival and of its stamp, s."""

    time: float
    stamp: float
    message: Any


class Odometer:
    """Comparison of the poses of an odometry with its speeds.

    Poses that jump, stand still or move in other units than the speeds are no odometry. The car
    then stops for 2 s, and four times as long each further time.
    """

    def __init__(self) -> None:
        self.stamp, self.pose = 0.0, np.zeros(3)  # at the begin of the window
        self.last, self.path = 0.0, np.nan  # last stamp, s; way by the speeds, m
        self.until, self.pause, self.reason = -np.inf, 2.0, ""

    def follow(self, stamp: float, car: np.ndarray) -> None:
        """Take the state of a car at a time (s); refuse it if it does not fit the last ones."""
        if abs(car[6]) > SIDEWAYS and car[3] > 2.0:
            raise MessageError(f"slides at {car[6]:.2f} rad; its twist must be in the car's frame")
        if not 0.0 <= stamp - self.stamp <= 4.0 * WINDOW:
            self.path = np.nan
        if np.isnan(self.path):
            self.stamp, self.last, self.pose, self.path = stamp, stamp, car[[0, 1, 4]], 0.0
        self.path += car[3] * (stamp - self.last)
        self.last = stamp
        (dx, dy), middle = car[:2] - self.pose[:2], 0.5 * (car[4] + self.pose[2])
        far = hypot(dx, dy)
        if cos(car[4] - middle) < 0.0:
            middle += np.pi
        along = copysign(far, dx * cos(middle) + dy * sin(middle))
        if abs(along - self.path) > 0.4 + 0.5 * abs(self.path):
            self.until, self.pause, self.path = stamp + self.pause, 4.0 * self.pause, np.nan
            self.reason = (
                f"moved {along:.2f} m in {stamp - self.stamp:.2f} s, which does not fit its speeds"
            )
        elif stamp - self.stamp >= WINDOW:
            self.path = np.nan
        if stamp < self.until:
            raise MessageError(self.reason)


@dataclass
class Planning:
    """Commands of a policy from the last messages; without usable messages the car stops."""

    policy: str = "line-ppo"  #: Planner with a map, or a file of ``pcs-racing export lidar-ppo``.
    track: str = "Brackwater"  #: Name of a shipped track, or a map folder.
    rules: str = "paper"  #: Rules with the speed range.
    speed_share: float = 1.0  #: Factor of the commanded speed.
    to_centre: float = 0.0  #: m: from the frame of the odometry forward to the centre of gravity.
    steering_rate: float = 3.2  #: rad/s: rate of the servo.
    timeout: float = 0.1  #: s: min age of a lost message.
    map_frame: str = "map"  #: Frame of the odometry that a planner with a map needs.
    stopped: str = field(init=False, default="no command yet")  #: Reason of a stop, or "".
    heard: dict[str, Heard] = field(init=False, default_factory=dict)
    steering: float = field(init=False, default=0.0)  #: rad: estimated steering angle.

    def __post_init__(self) -> None:
        for name, most in LIMITS.items():
            value = getattr(self, name)
            if not 0.0 < value <= most:  # NaN, too
                raise ValueError(f"{name} is {value}; it must be above 0 and at most {most:g}")
        if not abs(self.to_centre) <= 10.0:
            raise ValueError(f"to_centre is {self.to_centre}; it must be from -10 to 10 m")
        if self.policy.endswith(".onnx"):
            self.chosen: MapPolicy | ScanPolicy = ScanPolicy(self.policy)
        else:
            self.chosen = MapPolicy(self.policy, self.track, self.rules)
        self.wanted = 0.0
        self._restart(0.0)

    def _restart(self, time: float) -> None:
        self.heard.clear()
        self.chosen.reset()
        self.begin: float | None = None
        self.last = time
        self.odometer = Odometer()

    def hear(self, kind: str, message: Any, time: float) -> None:
        """Keep the last message of a kind: "scan", "odometry" or "opponent".

        A message that a later one has overtaken is left out.
        """
        stamp, last = stamp_of(message), self.heard.get(kind)
        if last is None or not (time >= last.time and 0.0 < last.stamp - stamp <= self.timeout):
            self.heard[kind] = Heard(time, stamp, message)

    def command(self, time: float) -> tuple[float, float]:
        """Return the steering angle (rad) and the speed (m/s) to command at a time (s).

        If the car stops, ``stopped`` says why in a line. If the clock was set back, the car stops
        and begins with new messages.
        """
        if time < max([self.last, *(one.time for one in self.heard.values())]):
            self._restart(time)
        reach, self.last = self.steering_rate * (time - self.last), time
        self.steering += float(np.clip(self.wanted - self.steering, -reach, reach))
        try:
            self.wanted, speed = self._decide(time)
            self.stopped = ""
        except Exception as error:  # after any error: a car without a decision stops
            self.wanted, speed = STOP
            self.stopped = " ".join(str(error).split()) or type(error).__name__
        return self.wanted, self.speed_share * speed

    def _decide(self, time: float) -> tuple[float, float]:
        fresh = {kind: one for kind, one in self.heard.items() if time - one.time <= self.timeout}
        for kind in self.chosen.needs:
            if kind not in fresh:
                raise MessageError(f"no {kind} for {self.timeout:g} s")
        for kind, one in fresh.items():
            if not abs(time - one.stamp) <= self.timeout + 1e-6:
                raise MessageError(
                    f"{kind} is stamped {time - one.stamp:.2f} s before the clock of this node; set"
                    " the clocks of the computers, and use_sim_time in all nodes or in none"
                )
        states = [self._state(kind, fresh[kind], time) for kind in CARS if kind in fresh]
        car, other = states[0], states[1] if len(states) > 1 else None
        if other is not None and hypot(*(other - car)[:2]) < 0.1:
            raise MessageError("opponent: its pose is the own pose")
        self.begin = time if self.begin is None else self.begin
        scan = fresh["scan"].message if "scan" in fresh else None
        answer = self.chosen.command(time - self.begin, car, other, scan)
        if not np.isfinite(answer).all():
            raise MessageError(f"the policy answers {answer}")
        return answer

    def _state(self, kind: str, heard: Heard, time: float) -> np.ndarray:
        """Return the state of a car now; refuse a message in another frame than the map."""
        message, own = heard.message, kind == "odometry"
        frame = message.header.frame_id.strip("/")
        if isinstance(self.chosen, MapPolicy) and frame != self.map_frame.strip("/"):
            raise MessageError(f"{kind} is in the frame {frame!r}, not in {self.map_frame!r}")
        try:
            car = state_of(message, self.steering if own else 0.0, self.to_centre)
            if own:
                self.odometer.follow(heard.stamp, car)
        except MessageError as error:
            raise MessageError(f"{kind}: {error}") from None
        return moved(car, max(time - heard.stamp, 0.0))
