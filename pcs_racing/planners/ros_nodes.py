"""Replacements for ``rclpy`` and its messages, for drivers that are nodes of ROS 2, without ROS.

A class derived from ``Node`` is a driver. Its callbacks get the lidar's scan and the odometry 50
times a second. Its timers run by the race time. Its command is the last Ackermann message that it
published.
"""

import math
from array import array
from collections.abc import Callable, Mapping
from functools import cache, partial
from importlib.util import find_spec
from types import ModuleType, SimpleNamespace
from typing import Any

from pcs_racing.base.errors import say_once

SILENCE = 1.0  # s from the start; a node without a command is then reported
HEARD = ("Odometry", "PoseStamped", "PoseWithCovarianceStamped", "LaserScan")
"""Messages that a node can subscribe to, in the order of their callbacks."""

_PACKAGES = (
    *("ackermann_msgs", "builtin_interfaces", "geometry_msgs", "nav_msgs", "rcl_interfaces"),
    *("sensor_msgs", "std_msgs", "visualization_msgs"),
)
_RCLPY = (
    *("clock", "callback_groups", "duration", "executors", "logging", "node", "parameter"),
    *("qos", "time"),
)
_KINDS = ("bool", "integer", "double", "string", "byte")
_VALUES = [f"{kind}{end}_value" for kind in _KINDS for end in ("", "_array")]


class Free:
    """Message, message type, or any other ROS object; an unset attribute is a `Free`."""

    def __init__(self, *given: Any, **fields: Any) -> None:
        vars(self).update(fields)

    def __getattr__(self, name: str) -> Any:
        if name[:2] == "__":
            raise AttributeError(name)
        return vars(self).setdefault(name, Free())

    def __call__(self, *given: Any, **named: Any) -> Any:
        """Return another such object."""
        return Free(**named)


class Time:
    """Time or duration."""

    def __init__(self, *, seconds: float = 0, nanoseconds: float = 0, **other: Any) -> None:
        self.nanoseconds = round(1e9 * seconds + nanoseconds)

    def __sub__(self, other: Any) -> "Time":
        return Time(nanoseconds=self.nanoseconds - other.nanoseconds)

    def seconds_nanoseconds(self) -> tuple[int, int]:
        """Return whole seconds, and the rest in ns."""
        return divmod(self.nanoseconds, 10**9)

    def to_msg(self) -> Any:
        """Return the time as a message."""
        seconds, rest = self.seconds_nanoseconds()
        return Free(sec=seconds, nanosec=rest)


def _parameter(name: str = "", type_: Any = None, value: Any = None, **other: Any) -> Any:
    """Return a parameter with its value under the name of every type."""
    values = SimpleNamespace(**dict.fromkeys(_VALUES, value))
    return SimpleNamespace(name=name, value=value, get_parameter_value=lambda: values)


class Node:
    """Node; a derived class drives a car."""

    def __init__(self, node_name: str = "node", **other: Any) -> None:
        # One attribute, with a name that a derived class will not use.
        self._in_race = SimpleNamespace(now=0.0, command=None, heard=[], timers=[], parameters={})

    def __getattr__(self, name: str) -> Any:
        """Return an object that does nothing, in place of a node's other methods."""
        if not name.startswith(
            ("add_", "count_", "create_", "destroy_", "get_", "remove_", "resolve_", "set_")
        ):
            raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")
        return Free()

    def create_subscription(
        self, msg_type: Any, topic: str, callback: Any, *other: Any, **named: Any
    ) -> Any:
        """Register a callback for the messages of a type."""
        self._in_race.heard.append((msg_type.__name__, topic, callback))
        return Free()

    def create_publisher(self, msg_type: Any, topic: str, *other: Any, **named: Any) -> Any:
        """Return an object that publishes messages."""

        def publish(message: Any) -> None:
            kind = msg_type.__name__
            if kind.startswith("AckermannDrive"):
                drive = vars(message.drive if kind.endswith("Stamped") else message)
                fields = drive.get("steering_angle", 0.0), drive.get("speed", 0.0)
                self._in_race.command = tuple(map(float, fields))

        return SimpleNamespace(publish=publish, topic_name=topic, get_subscription_count=lambda: 1)

    def create_timer(
        self, timer_period_sec: float, callback: Callable[[], Any], *other: Any, **named: Any
    ) -> Any:
        """Register a callback, called once per period (s)."""
        period = max(float(timer_period_sec), 1e-3)
        timer = SimpleNamespace(period=period, due=None, callback=callback, on=True)
        timer.cancel = partial(setattr, timer, "on", False)
        timer.reset = partial(setattr, timer, "on", True)
        self._in_race.timers.append(timer)
        return timer

    def declare_parameter(self, name: str, value: Any = None, *other: Any, **named: Any) -> Any:
        """Declare a parameter with its default."""
        return self._in_race.parameters.setdefault(name, _parameter(name, None, value))

    def declare_parameters(self, namespace: str, parameters: Any, *other: Any) -> list[Any]:
        """Declare several parameters: names, or tuples that begin with name and default."""
        listed = ([one] if isinstance(one, str) else one for one in parameters)
        return [self.declare_parameter(*one) for one in listed]

    def get_parameter(self, name: str) -> Any:
        """Return a parameter; an undeclared parameter has no value."""
        return self._in_race.parameters.get(name, _parameter(name))

    def get_clock(self) -> Any:
        """Return the clock of the race."""
        return SimpleNamespace(now=lambda: Time(seconds=self._in_race.now))


def ask_node(
    node: Node,
    now: float,
    ranges: Any,
    odometry: Mapping[str, float],
    opponent: Mapping[str, float],
) -> tuple[float, float]:
    """Send messages to a node at a time (s), and return its last steering angle and speed.

    A car without a command stands still, which is reported once after a second.
    """
    own = node._in_race
    own.now, header = now, Free(stamp=Time(seconds=now).to_msg(), frame_id="map")
    for wanted in HEARD:
        for kind, topic, callback in [one for one in own.heard if one[0] == wanted]:
            callback(_heard(kind, header, ranges, opponent if "opp" in topic else odometry))
    for timer in list(own.timers):
        timer.due = timer.due or now + timer.period
        while timer.on and timer.due <= now + 1e-9:
            timer.due += timer.period
            timer.callback()
    if own.command is None and now > SILENCE:
        say_once(
            f"node {type(node).__name__} has published no AckermannDrive message in the first"
            f" {SILENCE:g} s of a race; its car stands still"
        )
    return own.command or (0.0, 0.0)


def _heard(kind: str, header: Any, ranges: Any, seen: Mapping[str, float]) -> Any:
    """Return a message of the lidar, or of a pose."""
    if kind == "LaserScan":
        angles = {"angle_min": -2.35, "angle_max": 2.35, "angle_increment": 4.7 / (len(ranges) - 1)}
        limits = {"range_min": 0.0, "range_max": 30.0, "scan_time": 0.02}
        return Free(header=header, ranges=array("f", ranges), **angles, **limits)
    half = 0.5 * seen["pose_theta"]
    at = Free(x=seen["pose_x"], y=seen["pose_y"], z=0.0)
    pose = Free(position=at, orientation=Free(x=0.0, y=0.0, z=math.sin(half), w=math.cos(half)))
    along = Free(x=seen["linear_vel_x"], y=seen["linear_vel_y"], z=0.0)
    twist = Free(twist=Free(linear=along, angular=Free(x=0.0, y=0.0, z=seen["angular_vel_z"])))
    return Free(header=header, pose=pose if kind == "PoseStamped" else Free(pose=pose), twist=twist)


def _euler_from_quaternion(quaternion: Any, *axes: Any) -> tuple[float, float, float]:
    x, y, z, w = quaternion
    roll = math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    pitch = math.asin(max(-1.0, min(1.0, 2.0 * (w * y - z * x))))
    return roll, pitch, math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def _message_type(name: str) -> Free:
    if name[:2] == "__":
        raise AttributeError(name)
    return Free(__name__=name)


def _module(name: str, **values: Any) -> ModuleType:
    """Return a module with some values; any other name in it is a message type."""
    module = ModuleType(name)
    module.__dict__.update(values, __getattr__=_message_type, __path__=[])
    return module


@cache
def modules() -> dict[str, ModuleType]:
    """Return the replaced modules by name; none if ROS is installed."""
    if find_spec("rclpy") is not None:
        return {}
    nothing = dict.fromkeys(["init", "shutdown", "spin", "spin_once", "try_shutdown"], Free())
    values = {"Time": Time, "Duration": Time, "Parameter": _parameter, "Node": Node}
    made = {
        "rclpy": _module("rclpy", ok=lambda **named: False, create_node=Node, **nothing),
        "tf_transformations": _module(
            "tf_transformations", euler_from_quaternion=_euler_from_quaternion
        ),
        **{name: _module(name, msg=_module(f"{name}.msg")) for name in _PACKAGES},
    }
    made |= {f"{name}.msg": made[name].msg for name in _PACKAGES}
    for name in _RCLPY:
        made[f"rclpy.{name}"] = _module(f"rclpy.{name}", **values)
        setattr(made["rclpy"], name, made[f"rclpy.{name}"])
    return made
