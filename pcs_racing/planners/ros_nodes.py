"""Stand-ins for what drivers that are nodes of ROS 2 import, where ROS is not installed: ``rclpy`` and its messages.

A class derived from ``Node`` is a driver. Its callbacks get the lidar's scan and the odometry 50 times a second, its
timers run by the time of the race, and the last Ackermann message that it published is its command.
"""

import math
from array import array
from collections.abc import Callable, Mapping
from functools import lru_cache, partial
from importlib.util import find_spec
from types import ModuleType, SimpleNamespace
from typing import Any

_TYPES = {
    "Time": "sec nanosec", "Header": "stamp:Time frame_id:''", "Vector3": "x y z", "Point": "x y z",
    "Quaternion": "x y z w", "Pose": "position:Point orientation:Quaternion", "Twist": "linear:Vector3 angular:Vector3",
    "PoseStamped": "header:Header pose:Pose", "PoseWithCovariance": "pose:Pose covariance:[]",
    "PoseWithCovarianceStamped": "header:Header pose:PoseWithCovariance", "TwistWithCovariance": "twist:Twist",
    "Odometry": "header:Header child_frame_id:'' pose:PoseWithCovariance twist:TwistWithCovariance",
    "LaserScan": "header:Header angle_min angle_max angle_increment time_increment scan_time range_min range_max "
    "ranges:[] intensities:[]",
    "AckermannDrive": "steering_angle steering_angle_velocity speed acceleration jerk",
    "AckermannDriveStamped": "header:Header drive:AckermannDrive",
    "Bool": "data:False", "String": "data:''", "Float32": "data", "Float64": "data", "Int32": "data",
    "Float32MultiArray": "layout:Free data:[]", "Float64MultiArray": "layout:Free data:[]",
}  # fmt: skip
"""Fields of messages: numbers, unless a type or a value follows a colon."""
_PACKAGES = (
    "ackermann_msgs builtin_interfaces geometry_msgs nav_msgs rcl_interfaces sensor_msgs std_msgs visualization_msgs"
)
_RCLPY = "clock callback_groups duration executors logging parameter qos time"


class Free:
    """A message, or anything else of ROS, with any attributes: one that was not set is such an object, too."""

    def __init__(self, *given: Any, **fields: Any) -> None:
        vars(self).update(fields)

    def __getattr__(self, name: str) -> Any:
        if name[:2] == "__":
            raise AttributeError(name)
        vars(self)[name] = Free()
        return vars(self)[name]

    def __call__(self, *given: Any, **named: Any) -> Any:
        """Return another such object."""
        return Free(**named)


class _FreeType(type):
    def __getattr__(cls, name: str) -> Any:
        """Constants of a type of messages."""
        if name[:2] == "__":
            raise AttributeError(name)
        return name


def _message(name: str) -> type:
    """Return a type of messages."""
    fields = dict(field.partition(":")[::2] for field in _TYPES.get(name, "").split())

    def make(self: Any, **given: Any) -> None:
        values = {"": 0.0, "''": "", "False": False}
        for field, kind in fields.items():
            made = [] if kind == "[]" else values[kind] if kind in values else types[kind]()
            setattr(self, field, made)
        vars(self).update(given)

    return _FreeType(name, (Free,), {"__init__": make if fields else Free.__init__})


types: Mapping[str, Any] = {name: _message(name) for name in _TYPES} | {"Free": Free}


class Time:
    """A time or a duration, in ns."""

    def __init__(self, *, seconds: float = 0, nanoseconds: float = 0, **other: Any) -> None:
        self.nanoseconds = round(1e9 * seconds + nanoseconds)

    def __sub__(self, other: Any) -> "Time":
        return Time(nanoseconds=self.nanoseconds - other.nanoseconds)

    def __add__(self, other: Any) -> "Time":
        return Time(nanoseconds=self.nanoseconds + other.nanoseconds)

    def __lt__(self, other: Any) -> bool:
        return bool(self.nanoseconds < other.nanoseconds)

    def __gt__(self, other: Any) -> bool:
        return bool(self.nanoseconds > other.nanoseconds)

    def to_msg(self) -> Any:
        """Return the message of a time."""
        seconds, rest = divmod(self.nanoseconds, 10**9)
        return types["Time"](sec=seconds, nanosec=rest)

    def seconds_nanoseconds(self) -> tuple[int, int]:
        """Return whole seconds, and the rest in ns."""
        return divmod(self.nanoseconds, 10**9)

    @classmethod
    def from_msg(cls, message: Any, **other: Any) -> "Time":
        """Return the time of a message."""
        return cls(seconds=message.sec, nanoseconds=message.nanosec)


class _Parameter:
    Type = Free()

    def __init__(self, name: str = "", type_: Any = None, value: Any = None) -> None:
        self.name, self.value = name, value

    def get_parameter_value(self) -> Any:
        """Return the value as a message: under the name of every type."""
        kinds = "bool integer double string byte_array bool_array integer_array double_array string_array"
        return SimpleNamespace(**{f"{kind}_value": self.value for kind in kinds.split()})


class Node:
    """A node: a class derived from it drives a car."""

    def __init__(self, node_name: str = "node", **other: Any) -> None:
        # One attribute, whose name a derived class will not take.
        self._in_race = SimpleNamespace(name=node_name, now=0.0, command=(0.0, 0.0), heard=[], timers=[], parameters={})

    def __getattr__(self, name: str) -> Any:
        """Anything else that a node can do, which does nothing here."""
        if not name.startswith(("add_", "count_", "create_", "destroy_", "get_", "remove_", "resolve_")):
            raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")
        return Free()

    def create_subscription(self, msg_type: Any, topic: str, callback: Any, *other: Any, **named: Any) -> Any:
        """Call a function with the messages of a type."""
        self._in_race.heard.append((msg_type.__name__, topic, callback))
        return Free()

    def create_publisher(self, msg_type: Any, topic: str, *other: Any, **named: Any) -> Any:
        """Return an object that publishes messages."""

        def publish(message: Any) -> None:
            drive = message.drive if type(message).__name__ == "AckermannDriveStamped" else message
            if type(drive).__name__ == "AckermannDrive":
                self._in_race.command = float(drive.steering_angle), float(drive.speed)

        return SimpleNamespace(publish=publish, topic_name=topic, get_subscription_count=lambda: 1)

    def create_timer(self, timer_period_sec: float, callback: Callable[[], Any], *other: Any, **named: Any) -> Any:
        """Call a function once in a period, s."""
        timer = SimpleNamespace(period=max(float(timer_period_sec), 1e-3), due=None, callback=callback, on=True)
        timer.cancel, timer.reset = partial(setattr, timer, "on", False), partial(setattr, timer, "on", True)
        self._in_race.timers.append(timer)
        return timer

    def declare_parameter(self, name: str, value: Any = None, *other: Any, **named: Any) -> _Parameter:
        """Declare a parameter, which has its default."""
        made: _Parameter = self._in_race.parameters.setdefault(name, _Parameter(name, None, value))
        return made

    def declare_parameters(self, namespace: str, parameters: Any, *other: Any) -> list[_Parameter]:
        """Declare several parameters: names, or tuples that begin with name and default."""
        return [self.declare_parameter(*([one] if isinstance(one, str) else one)) for one in parameters]

    def get_parameter(self, name: str) -> _Parameter:
        """Return a parameter; without a declaration it has no value."""
        found: _Parameter = self._in_race.parameters.get(name, _Parameter(name))
        return found

    def set_parameters(self, parameters: Any) -> None:
        """Change parameters."""
        self._in_race.parameters.update((one.name, one) for one in parameters)

    def get_name(self) -> str:
        """Return the name."""
        return str(self._in_race.name)

    def get_clock(self) -> Any:
        """Return the clock of the race."""
        return SimpleNamespace(now=lambda: Time(seconds=self._in_race.now))


def ask_node(
    node: Node, now: float, ranges: Any, odometry: Mapping[str, float], opponent: Mapping[str, float]
) -> tuple[float, float]:
    """Hand messages to a node at a time (s), and return the steering angle and the speed that it published last."""
    own = node._in_race
    own.now = now
    header = types["Header"](stamp=Time(seconds=now).to_msg(), frame_id="map")
    for wanted in ("Odometry", "PoseStamped", "PoseWithCovarianceStamped", "LaserScan"):
        for kind, topic, callback in [one for one in own.heard if one[0] == wanted]:
            seen = opponent if "opp" in topic else odometry
            callback(_scan(header, ranges) if kind == "LaserScan" else _odometry(kind, header, seen))
    for timer in list(own.timers):
        timer.due = timer.due or now + timer.period
        while timer.on and timer.due <= now + 1e-9:
            timer.due += timer.period
            timer.callback()
    command: tuple[float, float] = own.command
    return command


def _scan(header: Any, ranges: Any) -> Any:
    step = 4.7 / (len(ranges) - 1)
    beams = {"angle_min": -2.35, "angle_max": 2.35, "angle_increment": step, "range_max": 30.0, "scan_time": 0.02}
    return types["LaserScan"](header=header, ranges=array("f", ranges), **beams)


def _odometry(kind: str, header: Any, seen: Mapping[str, float]) -> Any:
    half = 0.5 * seen["pose_theta"]
    at = types["Point"](x=seen["pose_x"], y=seen["pose_y"])
    pose = types["Pose"](position=at, orientation=types["Quaternion"](z=math.sin(half), w=math.cos(half)))
    message = types[kind](header=header, pose=pose if kind == "PoseStamped" else types["PoseWithCovariance"](pose=pose))
    if kind == "Odometry":
        message.twist.twist.linear.x, message.twist.twist.linear.y = seen["linear_vel_x"], seen["linear_vel_y"]
        message.twist.twist.angular.z = seen["angular_vel_z"]
    return message


def _euler_from_quaternion(quaternion: Any, *axes: Any) -> tuple[float, float, float]:
    x, y, z, w = quaternion
    pitch = math.asin(max(-1.0, min(1.0, 2.0 * (w * y - z * x))))
    roll, yaw = math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y)), 2.0 * (w * z + x * y)
    return roll, pitch, math.atan2(yaw, 1.0 - 2.0 * (y * y + z * z))


def _module(name: str, **values: Any) -> ModuleType:
    """Return a module with some values; any other name of it is a type of messages or an object that does nothing."""

    def missing(other: str) -> Any:
        if other[:2] == "__":
            raise AttributeError(other)
        return values.setdefault(other, _message(other))

    module = ModuleType(name)
    module.__dict__.update(values, __getattr__=missing, __path__=[])
    return module


@lru_cache(maxsize=1)
def modules() -> dict[str, ModuleType]:
    """Return the modules by name; none if ROS is installed."""
    if find_spec("rclpy") is not None:
        return {}
    nothing = dict.fromkeys(["init", "shutdown", "spin", "spin_once", "try_shutdown"], Free())
    times = {"Time": Time, "Duration": Time, "Parameter": _Parameter}
    made = {"rclpy": _module("rclpy", ok=lambda **named: False, create_node=Node, **nothing)}
    made |= {f"rclpy.{name}": _module(f"rclpy.{name}", **times) for name in _RCLPY.split()}
    made["rclpy.node"] = _module("rclpy.node", Node=Node)
    for package in _PACKAGES.split():
        made[package] = _module(package)
        made[f"{package}.msg"] = _module(f"{package}.msg", **types)
    made["tf_transformations"] = _module("tf_transformations", euler_from_quaternion=_euler_from_quaternion)
    for name, module in made.items():
        parent, _, child = name.rpartition(".")
        if parent:
            setattr(made[parent], child, module)
    return made
