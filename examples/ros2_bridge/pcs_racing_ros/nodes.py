"""Run nodes of ROS 2: ``simulator``, a simulated race, and ``planner``, a policy on a car.

    ros2 launch pcs_racing_ros race.launch.py
    ros2 launch pcs_racing_ros race.launch.py simulator:=false parameters:=my_car.yaml

The simulator has the topics and frames of f1tenth_gym_ros: it publishes /scan, /opp_scan,
/ego_racecar/odom, /opp_racecar/odom, /tf and, latched, /map. It listens to /drive
(ackermann_msgs/AckermannDriveStamped), to /opp_drive if the parameter ``opponent`` is "topic", and
to /initialpose, which puts the ego somewhere else. The planner listens to scans and odometry and
publishes to /drive. The work of the nodes, without ROS, is in ``simulation.py`` and
``planning.py``. The Python of ROS needs pcs-racing (Python 3.11 or newer: ROS 2 Jazzy), or
onnxruntime alone for the planner with an ONNX file (ROS 2 Humble, too).
"""

from functools import partial
from time import perf_counter
from typing import Any

import numpy as np

from .messages import fill, heading_of, message_class

SIMULATOR: dict[str, Any] = {
    "track": "Brackwater",
    "opponent": "lattice",
    "rules": "paper",
    "seed": 0,
}
"""Parameters of the simulator and their defaults."""

PLANNER: dict[str, Any] = {
    "policy": "line-ppo",
    "track": "Brackwater",
    "rules": "paper",
    "rate": 50.0,
    "speed_share": 1.0,
    "to_centre": 0.0,
    "steering_rate": 3.2,
    "timeout": 0.1,
    "map_frame": "map",
    "scan_topic": "/scan",
    "odometry_topic": "/ego_racecar/odom",
    "opponent_topic": "/opp_racecar/odom",
    "drive_topic": "/drive",
}
"""Parameters of the planner and their defaults; no opponent is known with an empty topic."""

REPORT = 10.0  # s between two reports of the delay of a decision


def parameters_of(node: Any, defaults: dict[str, Any]) -> dict[str, Any]:
    """Declare parameters, and return their values by name."""
    return {name: node.declare_parameter(name, value).value for name, value in defaults.items()}


def spin(node: Any) -> None:
    """Let a node work until Ctrl-C."""
    import rclpy

    try:
        rclpy.spin(node)
    except KeyboardInterrupt:
        node.destroy_node()


def simulator() -> None:
    """Run a race in place of the cars."""
    import rclpy
    from ackermann_msgs.msg import AckermannDriveStamped
    from geometry_msgs.msg import PoseWithCovarianceStamped, TransformStamped
    from rclpy.node import Node
    from rclpy.qos import DurabilityPolicy, QoSProfile

    from .simulation import TIME_STEP, Simulation

    rclpy.init()
    node = Node("simulator")
    values = parameters_of(node, SIMULATOR)
    if values["opponent"] == "topic":
        values["opponent"] = None
    race = Simulation(**values)
    publishers: dict[str, Any] = {}

    def publish(message: Any, qos: Any = 10) -> None:
        kind = message_class(message.kind)
        if message.topic not in publishers:
            publishers[message.topic] = node.create_publisher(kind, message.topic, qos)
        filled = fill(kind(), message.fields, {"transforms": TransformStamped})
        publishers[message.topic].publish(filled)

    def drive(car: int, message: AckermannDriveStamped) -> None:
        race.command(car, message.drive.steering_angle, message.drive.speed)

    def place(message: PoseWithCovarianceStamped) -> None:
        pose = message.pose.pose
        try:
            race.put(pose.position.x, pose.position.y, heading_of(pose.orientation))
        except ValueError as error:
            node.get_logger().error(str(error))

    def step() -> None:
        for message in race.step():
            publish(message)

    publish(race.map(), QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL))
    node.create_subscription(AckermannDriveStamped, "/drive", partial(drive, 0), 10)
    if race.opponent is None:
        node.create_subscription(AckermannDriveStamped, "/opp_drive", partial(drive, 1), 10)
    node.create_subscription(PoseWithCovarianceStamped, "/initialpose", place, 10)
    node.create_timer(TIME_STEP, step)
    spin(node)


def planner() -> None:
    """Publish the commands of a policy, ``rate`` times a second."""
    import rclpy
    from ackermann_msgs.msg import AckermannDriveStamped
    from nav_msgs.msg import Odometry
    from rclpy.node import Node
    from rclpy.qos import qos_profile_sensor_data
    from sensor_msgs.msg import LaserScan

    from .planning import Planning

    rclpy.init()
    node = Node("planner")
    values = parameters_of(node, PLANNER)
    rate, out = values.pop("rate"), values.pop("drive_topic")
    if not 1.0 <= rate <= 1000.0:
        raise ValueError(f"rate is {rate}; it must be from 1 to 1000 commands a second")
    topics = {
        kind: (message, values.pop(f"{kind}_topic"))
        for kind, message in {"scan": LaserScan, "odometry": Odometry, "opponent": Odometry}.items()
    }
    planning, delays, said = Planning(**values), list[float](), ""
    publisher = node.create_publisher(AckermannDriveStamped, out, 10)

    def now() -> float:
        return 1e-9 * node.get_clock().now().nanoseconds

    def hear(kind: str, message: Any) -> None:
        planning.hear(kind, message, now())

    def decide() -> None:
        nonlocal said
        begin, message = perf_counter(), AckermannDriveStamped()
        steering, speed = planning.command(now())
        if planning.stopped != said:
            said = planning.stopped
            node.get_logger().warning(f"the car stops: {said}" if said else "the car drives")
        message.header.stamp = node.get_clock().now().to_msg()
        message.drive.steering_angle, message.drive.speed = steering, speed
        publisher.publish(message)
        delays.append(1e3 * (perf_counter() - begin))
        if len(delays) >= REPORT * rate:
            median, late = np.percentile(delays, [50, 99])
            node.get_logger().info(f"a decision takes {median:.2f} ms (99 %: {late:.2f} ms)")
            delays.clear()

    for kind, (message, topic) in topics.items():
        if topic:
            node.create_subscription(message, topic, partial(hear, kind), qos_profile_sensor_data)
    node.create_timer(1.0 / rate, decide)
    spin(node)
