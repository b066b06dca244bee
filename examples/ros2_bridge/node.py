"""A node of ROS 2 that runs a race, with the topics and frames of f1tenth_gym_ros.

    source /opt/ros/humble/setup.bash
    python examples/ros2_bridge/node.py --track Brackwater --opponent cfr-argmax

It publishes /scan, /opp_scan, /ego_racecar/odom, /opp_racecar/odom, /tf and, latched, /map. It
listens to /drive (ackermann_msgs/AckermannDriveStamped), to /opp_drive with ``--opponent topic``,
and to /initialpose, which puts the ego somewhere else. It needs rclpy, ackermann_msgs and this
package in the Python of ROS; what it does is in ``logic.py``.
"""

import argparse
from importlib import import_module

import numpy as np
from logic import TIME_STEP, Bridge, fill

from pcs_racing import InputError
from pcs_racing_agents import watch


def message_class(kind: str) -> type:
    """Return the class of a type of message, like "sensor_msgs/msg/LaserScan"."""
    package, _, name = kind.split("/")
    return getattr(import_module(f"{package}.msg"), name)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--track", default="Brackwater", help="name of a shipped circuit or a map folder"
    )
    parser.add_argument(
        "--opponent",
        default="lattice",
        help='driver or agent of the second car; "topic": /opp_drive',
    )
    parser.add_argument(
        "--rules", default="paper", help="rules of the race: paper, contest or a YAML file"
    )
    parser.add_argument("--seed", type=int, default=0, help="root of the starts and the noise")
    arguments = parser.parse_args()

    import rclpy
    from ackermann_msgs.msg import AckermannDriveStamped
    from geometry_msgs.msg import PoseWithCovarianceStamped, TransformStamped
    from rclpy.node import Node
    from rclpy.qos import DurabilityPolicy, QoSProfile

    opponent = None if arguments.opponent == "topic" else arguments.opponent
    bridge = Bridge(arguments.track, opponent, arguments.rules, arguments.seed)
    rclpy.init()
    node = Node("pcs_racing")
    publishers: dict[str, object] = {}

    def publish(message: watch.RosMessage, qos: QoSProfile | int = 10) -> None:
        if message.topic not in publishers:
            publishers[message.topic] = node.create_publisher(
                message_class(message.kind), message.topic, qos
            )
        filled = fill(
            message_class(message.kind)(), message.fields, {"transforms": TransformStamped}
        )
        publishers[message.topic].publish(filled)

    def drive(car: int):
        return lambda message: bridge.command(
            car, message.drive.steering_angle, message.drive.speed
        )

    def place(message: PoseWithCovarianceStamped) -> None:
        pose = message.pose.pose
        try:
            heading = 2.0 * float(np.arctan2(pose.orientation.z, pose.orientation.w))
            bridge.put(pose.position.x, pose.position.y, heading)
        except InputError as error:
            node.get_logger().error(str(error))

    def step() -> None:
        for message in bridge.step():
            publish(message)

    publish(bridge.map(), QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL))
    node.create_subscription(AckermannDriveStamped, "/drive", drive(0), 10)
    if opponent is None:
        node.create_subscription(AckermannDriveStamped, "/opp_drive", drive(1), 10)
    node.create_subscription(PoseWithCovarianceStamped, "/initialpose", place, 10)
    node.create_timer(TIME_STEP, step)
    try:
        rclpy.spin(node)
    except KeyboardInterrupt:
        node.destroy_node()


if __name__ == "__main__":
    main()
