"""Messages of ROS 2 as numbers, and mappings of fields as messages."""

import math
from importlib import import_module
from typing import Any

import numpy as np


def message_class(kind: str) -> type:
    """Return the class of a type of message, like "sensor_msgs/msg/LaserScan"."""
    package, _, name = kind.split("/")
    return getattr(import_module(f"{package}.msg"), name)


def fill(message: Any, fields: dict[str, Any], kinds: dict[str, Any]) -> Any:
    """Set the fields of a message from a mapping.

    ``kinds`` holds the class of the items of each field that is a list of messages:
    ``{"transforms": TransformStamped}``.
    """
    for name, value in fields.items():
        if isinstance(value, dict):
            fill(getattr(message, name), value, kinds)
        elif name in kinds:
            setattr(message, name, [fill(kinds[name](), item, kinds) for item in value])
        else:
            setattr(message, name, value)
    return message


class MessageError(ValueError):
    """Message that no car can drive by; the text says why."""


FAST, FAR = 100.0, 1e5  # m/s and rad/s, m: larger numbers are no measurement
FLAT = 0.8  # min cosine of the tilt of a car
LONGEST = 200.0  # m: larger finite ranges are no lidar's, or in mm
COARSEST = 0.06  # rad: beams further apart pass by a car
AHEAD = 0.8  # rad: half of the beams up to this angle to both sides must be valid, too


def stamp_of(message: Any) -> float:
    """Return the time of a message, s."""
    return float(message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec)


def heading_of(orientation: Any) -> float:
    """Return the heading (rad) of a car's quaternion."""
    x, y, z, w = orientation.x, orientation.y, orientation.z, orientation.w
    if not abs(math.hypot(x, y, z, w) - 1.0) <= 0.01:  # NaN, too
        raise MessageError(f"orientation {x:.3g}, {y:.3g}, {z:.3g}, {w:.3g} is no quaternion")
    if w * w + z * z - x * x - y * y < FLAT:
        raise MessageError("the orientation is tilted; the car must be on flat ground")
    return math.atan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z)


def state_of(odometry: Any, steering: float, to_centre: float) -> np.ndarray:
    """Return the state of a car from its odometry, shape (7,).

    x, y (m), steering angle (rad), speed (m/s), heading (rad), yaw rate (rad/s) and slip angle
    (rad) of the centre of gravity, ``to_centre`` (m) ahead of the frame of the odometry.
    """
    at, twist = odometry.pose.pose, odometry.twist.twist
    heading, yaw_rate = heading_of(at.orientation), twist.angular.z
    for limit, numbers in (
        (FAR, (at.position.x, at.position.y)),
        (FAST, (twist.linear.x, twist.linear.y, yaw_rate)),
    ):
        if not max(map(abs, numbers)) <= limit or math.isnan(sum(numbers)):
            shown = ", ".join(f"{number:.3g}" for number in numbers)
            raise MessageError(f"holds {shown}; such numbers must be within +-{limit:g}")
    x = at.position.x + to_centre * math.cos(heading)
    y = at.position.y + to_centre * math.sin(heading)
    forward, aside = twist.linear.x, twist.linear.y + to_centre * yaw_rate
    speed = math.copysign(math.hypot(forward, aside), forward)
    slip = math.atan2(aside, forward) if forward > 0.5 else 0.0
    return np.array([x, y, steering, speed, heading, yaw_rate, slip])


def moved(car: np.ndarray, seconds: float) -> np.ndarray:
    """Return the state of a car some seconds later, at constant speed and yaw rate."""
    x, y, steering, speed, heading, yaw_rate, slip = car
    course = heading + slip + 0.5 * yaw_rate * seconds
    x, y = x + seconds * speed * np.cos(course), y + seconds * speed * np.sin(course)
    return np.array([x, y, steering, speed, heading + yaw_rate * seconds, yaw_rate, slip])


def ranges_at(scan: Any, angles: np.ndarray, max_range: float) -> np.ndarray:
    """Return the ranges (m) of the beams nearest to some angles (rad) from the car's heading.

    The beams of a scan may begin anywhere and turn either way. -inf, an obstacle too near to
    measure, has the min range; infinity, or a range beyond the max range, is open space. A beam
    without a valid range, or out of the field of view, has the smaller range of the next valid
    beams on both sides. A scan is unusable if fewer than half of these beams are valid.
    """
    ranges, step = np.append(np.asarray(scan.ranges, float), np.nan), abs(scan.angle_increment)
    if not 0.0 < step <= COARSEST or not step * (len(ranges) - 3) <= 2.0 * math.pi:
        raise MessageError(
            f"the scan has {len(ranges) - 1} beams, {scan.angle_increment:.3g} rad apart; they must"
            f" be up to {COARSEST} rad apart and within a turn"
        )
    turn = 2.0 * math.pi / step
    beams = (angles - scan.angle_min) / scan.angle_increment
    beams = np.rint(beams - turn * np.floor((beams + 0.5) / turn))
    last = len(ranges) - 1
    found = ranges[np.where(beams < last, beams, last).astype(int)]  # NaN out of view
    near = np.isneginf(found)
    found = np.where(near, scan.range_min, found)
    valid = (found > 0.0) & (found >= scan.range_min) & ((found <= LONGEST) | np.isposinf(found))
    far = valid & ~near
    share = min(np.mean(far), np.mean(far[np.abs(angles) < AHEAD]))
    if not share >= 0.5:
        raise MessageError(f"the scan has no valid range in {1.0 - share:.0%} of the beams")
    order = np.arange(len(found))
    right = np.maximum.accumulate(np.where(valid, order, -1))
    left = np.minimum.accumulate(np.where(valid, order, len(found))[::-1])[::-1]
    known = np.concatenate([found, [np.inf, np.inf]])  # beyond the outer beams, on both sides
    return np.minimum(np.minimum(known[right], known[left]), max_range)
