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


def heading_of(orientation: Any) -> float:
    """Return the heading (rad) of a quaternion of a car on flat ground."""
    return 2.0 * math.atan2(orientation.z, orientation.w)


def state_of(odometry: Any, steering: float, to_centre: float) -> np.ndarray:
    """Return the state of a car from its odometry, shape (7,).

    x, y (m), steering angle (rad), speed (m/s), heading (rad), yaw rate (rad/s) and slip angle
    (rad) of the centre of gravity, ``to_centre`` (m) ahead of the frame of the odometry.
    """
    at, twist = odometry.pose.pose, odometry.twist.twist
    heading, yaw_rate = heading_of(at.orientation), twist.angular.z
    x = at.position.x + to_centre * math.cos(heading)
    y = at.position.y + to_centre * math.sin(heading)
    forward, aside = twist.linear.x, twist.linear.y + to_centre * yaw_rate
    speed = math.copysign(math.hypot(forward, aside), forward)
    slip = math.atan2(aside, forward) if forward > 0.5 else 0.0
    return np.array([x, y, steering, speed, heading, yaw_rate, slip])


def ranges_at(scan: Any, angles: np.ndarray, max_range: float) -> np.ndarray | None:
    """Return the ranges (m) of the beams nearest to some angles (rad) from the heading.

    A beam without a valid range, or out of the field of view, has the max range; -inf, an obstacle
    too near to measure, has the min range. Infinity, or a range beyond the max range, is open
    space. Return None for an unusable scan: fewer than half of these beams see an obstacle or open
    space.
    """
    ranges = np.append(np.asarray(scan.ranges, float), np.nan)  # the last one: out of view
    with np.errstate(all="ignore"):  # an increment of 0
        beams = np.rint((angles - scan.angle_min) / np.float64(scan.angle_increment))
    inside = (beams >= 0) & (beams < len(ranges) - 1)
    found = ranges[np.where(inside, beams, -1).astype(int)]
    valid = (found > 0.0) & (found >= scan.range_min)
    if 2 * np.count_nonzero(valid) < len(angles):
        return None
    clipped = np.where(valid, np.minimum(found, max_range), max_range)
    return np.where(np.isneginf(found), scan.range_min, clipped)
