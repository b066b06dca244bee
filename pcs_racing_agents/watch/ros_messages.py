"""Cars and scans as ROS 2 messages, with the topics and frames of f1tenth_gym_ros.

A message is a mapping of its fields; an omitted field is 0 or empty. Times are race times, from 0.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from pcs_racing.base.elementary import sines_cosines
from pcs_racing.base.typing import Floats
from pcs_racing.car import vehicle as _vehicle
from pcs_racing.car.lidar import Lidar
from pcs_racing.track.track import Track


class RosMessage(NamedTuple):
    """A message with the topic and time of its publication."""

    topic: str
    kind: str  #: Message type, like "sensor_msgs/msg/LaserScan".
    time: int  #: Time since the start of the race, ns.
    fields: dict[str, Any]


def car_topics(car: int) -> tuple[str, str, str]:
    """Return the name of a car's frames and its topics of scans and odometry."""
    name = ("ego", "opp")[car] if car < 2 else f"opp{car}"
    return f"{name}_racecar", "/scan" if car == 0 else f"/{name}_scan", f"/{name}_racecar/odom"


def stamp(time: int) -> dict[str, int]:
    """Return a time in ns as the two numbers of a message."""
    return {"sec": time // 10**9, "nanosec": time % 10**9}


def _header(time: int, frame: str) -> dict[str, Any]:
    return {"stamp": stamp(time), "frame_id": frame}


def _point(x: float, y: float) -> dict[str, float]:
    return {"x": float(x), "y": float(y), "z": 0.0}


def _turned(psi: float) -> dict[str, float]:
    """Return the quaternion of a heading."""
    sin, cos = sines_cosines(np.array([0.5 * psi]))
    return {"x": 0.0, "y": 0.0, "z": float(sin[0]), "w": float(cos[0])}


def _pose(x: float, y: float, psi: float = 0.0) -> dict[str, Any]:
    return {"position": _point(x, y), "orientation": _turned(psi)}


def map_message(track: Track) -> RosMessage:
    """Return the track as ``/map``: 100 in walls, 0 in free space."""
    arrays = track.arrays
    height, width = arrays.distance.shape
    info = {"resolution": arrays.cell, "width": width, "height": height, "map_load_time": stamp(0)}
    info["origin"] = _pose(arrays.origin_x, arrays.origin_y)
    cells = np.where(arrays.distance > 0.0, 0, 100).ravel().tolist()
    return RosMessage(
        "/map",
        "nav_msgs/msg/OccupancyGrid",
        0,
        {"header": _header(0, "map"), "info": info, "data": cells},
    )


def scan_message(lidar: Lidar, ranges: Sequence[float] | Floats, car: int, time: int) -> RosMessage:
    """Return the message of a car's lidar ranges, m, shape (beams,)."""
    name, topic, _ = car_topics(car)
    fields = {
        "header": _header(time, f"{name}/laser"),
        "angle_min": float(lidar.angles[0]),
        "angle_max": float(lidar.angles[-1]),
        "angle_increment": lidar.kernel.step,
        "range_max": lidar.max_range,
        "ranges": np.asarray(ranges).tolist(),
    }
    return RosMessage(topic, "sensor_msgs/msg/LaserScan", time, fields)


def pose_messages(cars: Floats, time: int) -> list[RosMessage]:
    """Return odometry and ``/tf`` for the states of all cars, shape (N, 7)."""
    messages, frames = [], []
    for car, state in enumerate(cars):
        name, _, topic = car_topics(car)
        at = state[[_vehicle.X, _vehicle.Y, _vehicle.PSI]]
        sin, cos = sines_cosines(state[[_vehicle.BETA]])
        speed = state[_vehicle.V]
        twist = {
            "linear": _point(speed * cos[0], speed * sin[0]),
            "angular": {"z": float(state[_vehicle.PSI_DOT])},
        }
        odometry = {
            "child_frame_id": f"{name}/base_link",
            "pose": {"pose": _pose(*at)},
            "twist": {"twist": twist},
        }
        messages.append(
            RosMessage(
                topic, "nav_msgs/msg/Odometry", time, {"header": _header(time, "map"), **odometry}
            )
        )
        for parent, child, pose in (
            ("map", "base_link", at),
            (f"{name}/base_link", "laser", np.zeros(3)),
        ):
            moved = {"translation": _point(pose[0], pose[1]), "rotation": _turned(pose[2])}
            head = {"header": _header(time, parent), "child_frame_id": f"{name}/{child}"}
            frames.append({**head, "transform": moved})
    return [*messages, RosMessage("/tf", "tf2_msgs/msg/TFMessage", time, {"transforms": frames})]
