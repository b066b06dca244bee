"""Work of the planner node, without ROS: messages go in, commands come out."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from .messages import ranges_at, state_of

STOP = (0.0, 0.0)
LIMITS = {"speed_share": 1.5, "steering_rate": 100.0, "timeout": 5.0}
BRAKING = 0.55  # m/s: max reduction of the speed by a command


class MapPolicy:
    """Policy on a map: it needs odometry in the frame of the map, and no scan."""

    needs = ("odometry",)

    def __init__(self, policy: str, track: str, rules: str) -> None:
        from pcs_racing.envs import PolicyOnCar

        if policy.partition(":")[0] == "lidar-ppo":  # it would scan the map
            raise ValueError("lidar-ppo needs scans: pcs-racing export lidar-ppo writes its file")
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
        from .onnx_policy import OnnxPolicy

        self.network = OnnxPolicy(file)
        about = self.network.about
        if about["inputs"].keys() != {"ranges", "own"}:
            raise ValueError(
                f"{file} takes {', '.join(about['inputs'])}; the planner node runs files that take"
                " ranges and own: export lidar-ppo, or name a planner with a map"
            )
        beams, self.period = about["inputs"]["ranges"], about["period"]
        self.angles = np.linspace(beams["angle_min"], beams["angle_max"], beams["beams"])
        self.max_range, self.vehicle = beams["max_range"], about["vehicle"]
        self.reset()

    def reset(self) -> None:
        """Forget all decisions: the next command begins an arc."""
        self.network.reset()
        self.due, self.start, self.arc = 0.0, np.zeros(7), np.zeros(2)

    def command(
        self, time: float, car: np.ndarray, opponent: np.ndarray | None, scan: Any
    ) -> tuple[float, float]:
        """Return steering angle (rad) and speed (m/s): of a new arc, or along the last one.

        An unusable scan stops the car, until there is a usable one.
        """
        if time >= self.due - 1e-6:
            ranges = ranges_at(scan, self.angles, self.max_range)
            if ranges is None:
                return STOP
            outputs = self.network.decide(ranges=ranges, own=car[[3, 5, 2]])
            self.start, self.arc = car, outputs["arc"].astype(float)
            # Periods are counted from the last decision on time; a late one starts a new count.
            self.due = (self.due if time < self.due + self.period else time) + self.period
        speed = max(self.arc[1], car[3] - BRAKING)
        return pursue(car, self.start, np.array([self.arc[0], speed]), self.vehicle), float(speed)


@dataclass
class Planning:
    """Commands of a policy from the last messages; without fresh messages the car stops."""

    policy: str = "line-ppo"  #: Planner with a map, or a file of ``pcs-racing export lidar-ppo``.
    track: str = "Brackwater"  #: Name of a shipped track, or a map folder.
    rules: str = "paper"  #: Rules with the speed range.
    speed_share: float = 1.0  #: Factor of the commanded speed.
    to_centre: float = 0.0  #: m: from the frame of the odometry forward to the centre of gravity.
    steering_rate: float = 3.2  #: rad/s: rate at which the servo follows a command.
    timeout: float = 0.2  #: s: age from which a message counts as lost.
    heard: dict[str, tuple[float, Any]] = field(init=False, default_factory=dict)
    steering: float = field(init=False, default=0.0)  #: rad: estimated steering angle.

    def __post_init__(self) -> None:
        for name, most in LIMITS.items():
            value = getattr(self, name)
            if not 0.0 < value <= most:  # NaN, too
                raise ValueError(f"{name} is {value}; it must be above 0 and at most {most:g}")
        if self.policy.endswith(".onnx"):
            self.chosen: MapPolicy | ScanPolicy = ScanPolicy(self.policy)
        else:
            self.chosen = MapPolicy(self.policy, self.track, self.rules)
        self.begin: float | None = None
        self.last, self.wanted = 0.0, 0.0

    def hear(self, kind: str, message: Any, time: float) -> None:
        """Keep the last message of a kind: "scan", "odometry" or "opponent"."""
        self.heard[kind] = time, message

    def command(self, time: float) -> tuple[float, float]:
        """Return the steering angle (rad) and the speed (m/s) to command at a time (s).

        If the clock was set back, the car stops and begins with new messages.
        """
        if time < max([self.last, *(at for at, _ in self.heard.values())]):
            self.heard.clear()
            self.chosen.reset()
            self.begin, self.last = None, time
        reach = self.steering_rate * (time - self.last)
        self.steering += float(np.clip(self.wanted - self.steering, -reach, reach))
        self.last = time
        self.wanted, speed = self._decide(time)
        return self.wanted, self.speed_share * speed

    def _decide(self, time: float) -> tuple[float, float]:
        fresh = {kind: one for kind, (at, one) in self.heard.items() if time - at <= self.timeout}
        if any(kind not in fresh for kind in self.chosen.needs):
            return STOP
        self.begin = time if self.begin is None else self.begin
        car = state_of(fresh["odometry"], self.steering, self.to_centre)
        opponent = fresh.get("opponent")
        other = None if opponent is None else state_of(opponent, 0.0, self.to_centre)
        if not np.isfinite(car).all() or (other is not None and not np.isfinite(other).all()):
            return STOP
        return self.chosen.command(time - self.begin, car, other, fresh.get("scan"))
