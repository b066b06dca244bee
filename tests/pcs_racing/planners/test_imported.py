"""Third-party drivers race unchanged: small ones of each form, and checkouts of courses."""

import os
import pickle
import random
import sys
from pathlib import Path

import numpy as np
import pytest
from refusal import refused

from pcs_racing import CONTEST, load_track, racer, run_races
from pcs_racing.planners import registry
from pcs_racing.planners.imported import drivers_from, object_policy
from pcs_racing.planners.own_files import own_file
from pcs_racing.planners.planner import Policy
from pcs_racing.planners.shipped import split_name
from pcs_racing.race.config import Rules
from pcs_racing.race.start_grid import Starts
from pcs_racing_agents.cli.main import main

FILE = """
import numpy as np
from beside import FAST

class Helper:
    pass

class Farthest:
    def process_lidar(self, ranges):
        assert ranges.shape == (1080,) and ranges.max() <= 30.0
        return FAST, 0.5 * (np.argmax(ranges[270:-270]) - 270) * 4.7 / 1079

class Counts(Farthest):
    calls = 0
    def process_observation(self, ranges, ego_odom):
        self.calls += 1
        self.x = getattr(self, "x", ego_odom["pose_x"])
        assert self.calls > 1 or abs(ego_odom["pose_x"] - self.x) == 0.0, "two races share a driver"
        return 1.0 + 0.01 * self.calls, self.process_lidar(ranges)[1]

class Plans:
    def plan(self, obs):
        assert obs["vehicle_state"][3] == obs["vehicle_speed"] == obs["linear_vel_x"]
        return np.array([0.5 * (np.argmax(obs["scan"][270:-270]) - 270) * 4.7 / 1079, 2.5])
"""
SHORT = Rules(duration=0.4, start="rolling", start_gap=20.0, start_spacing=0.0)
DRIVER = """
{0}
class Driver:
    def process_lidar(self, ranges):
        {1}
        return {2}, 0.0
"""


@pytest.fixture
def folder(tmp_path, monkeypatch) -> Path:
    """A folder for drivers, whose names are forgotten after the test."""
    monkeypatch.setattr(registry, "_planners", dict(registry._planners))
    return tmp_path


def written(folder: Path, text: str, **beside: str) -> Path:
    """Write a file ``driver.py``, and modules in the same folder."""
    for name, content in {**beside, "driver": text}.items():
        place = folder / f"{name.replace('__', '/')}.py"
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_text(content)
    return folder / "driver.py"


def team(folder: Path, text: str, **beside: str) -> Policy:
    """Return the policy of a new file's first driver."""
    return next(iter(drivers_from(written(folder, text, **beside)).values()))


def plain_modules():
    return {name: one for name, one in sys.modules.items() if not name.startswith("drivers of ")}


def speeds(driver, races=1, seed=1, opponent="pure-pursuit"):
    """Return the speeds that a driver commanded last, in each of some races."""
    result = run_races(load_track("Tarnfjord"), [driver] * races, opponent, SHORT, seed=seed)
    return result.state.memory[:, 0, 1].tolist()


def test_all_forms_drive_and_every_race_has_its_own_driver(folder):
    file = written(folder, FILE, beside="FAST = 3.0")
    drivers = drivers_from(file)
    assert list(drivers) == ["Farthest", "Counts", "Plans"]
    names = ["Farthest", "Counts", "Counts", "Plans"]
    copied = object_policy(vars(own_file(file).module)["Counts"]())
    egos = [*map(drivers.__getitem__, names)]
    config = Rules(duration=4.0, start="rolling", start_gap=20.0, start_spacing=0.0)
    starts = Starts(np.full(4, 20.0), np.ones(4, np.int64))
    track, rival = load_track("Tarnfjord"), racer("pure-pursuit")
    result, again = (run_races(track, egos, rival, config, starts=starts) for _ in range(2))
    assert (result.state.progress[:, 0] > -20.0 + 0.9 * 4.0).all()
    assert not result.crashed.any()
    np.testing.assert_array_equal(again.state.cars, result.state.cars)
    assert speeds(copied, 2) == speeds(drivers["Counts"], 2)


def test_a_driver_has_a_name_and_reaches_other_processes(folder, capsys):
    file = written(folder / "a=1, b", FILE, beside="FAST = 3.0")
    policy = drivers_from(file)["Plans"]
    assert policy.name == f"{file.as_posix()}:Plans"
    assert racer(policy.name).planner is policy.planner
    assert list(pickle.loads(pickle.dumps(policy.planner)).drive.makers)[2] == "Plans"
    words = ["--ego", f"{file}:Counts", "--opponent", "pure-pursuit", "--duration", "0.4"]
    assert main(["race", *words]) == 0
    assert f"car 0: {file.as_posix()}:Counts" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("top", "lazy", "speed", "beside"),
    [
        ("from utils import SPEED", "", "SPEED", "utils"),
        ("", "import utils", "utils.SPEED", "utils"),
        ("import parts.speeds.fast", "", "parts.speeds.fast.SPEED", "parts__speeds__fast"),
        ("from .utils import SPEED", "", "SPEED", "utils"),
        ("import pickle", "", r"pickle.loads(b'cutils\nSPEED\n.')", "utils"),
        ("import sys, utils", "", "sys.modules['utils'].SPEED", "utils"),
        (
            "import os, sys\nsys.path.append(os.path.dirname(__file__) + '/lib')\nimport utils",
            "",
            "utils.SPEED",
            "lib__utils",
        ),
        ("import statistics", "", "statistics.SPEED", "statistics"),
    ],
)
def test_two_files_with_modules_of_one_name_stay_apart(top, lazy, speed, beside, folder):
    before = plain_modules(), sys.path[:], sys.meta_path[:]
    teams = [
        team(folder / name, DRIVER.format(top, lazy, speed), **{beside: f"SPEED = {value}"})
        for name, value in {"a": 1.0, "b": 3.0}.items()
    ]
    assert [speeds(one)[0] for one in teams] == [1.0, 3.0]
    assert [speeds(one)[0] for one in reversed(teams)] == [3.0, 1.0]
    assert (sys.path, sys.meta_path) == before[1:]
    assert plain_modules().items() >= before[0].items()
    assert not {"utils", "parts"} & plain_modules().keys() - before[0].keys()


def test_a_class_beside_a_file_is_found_again_by_its_name(folder):
    module = own_file(written(folder, "from model import Agent", model="class Agent: pass")).module
    assert pickle.loads(pickle.dumps(module.Agent)) is module.Agent


@pytest.mark.parametrize(
    ("top", "speed"),
    [
        ("import random", "random.uniform(1.0, 2.0)"),
        ("from random import gauss", "1.5 + 0.1 * gauss(0.0, 1.0)"),
        ("import numpy as np", "1.5 + 0.1 * np.random.randn()"),
        ("import drawing", "drawing.speed()"),
        ("import time; from time import monotonic as now", "1.0 + time.time() % 1 + now() % 1"),
    ],
)
def test_a_race_is_the_same_alone_among_others_and_again(top, speed, folder):
    """For any draws of the driver; the generators of this process go on as without a driver."""
    drawing = "import random\ndef speed():\n    return 1.0 + random.random()\n"
    driver = team(folder, DRIVER.format(top, "", speed), drawing=drawing)
    random.seed(1)
    np.random.seed(1)
    expected = [random.random(), np.random.randn()]
    random.seed(1)
    np.random.seed(1)
    (alone,) = speeds(driver)
    assert [random.random(), np.random.randn()] == expected
    assert [speeds(driver, races)[0] for races in (3, 1)] == [alone, alone]
    race = run_races(load_track("Tarnfjord"), [driver], driver, SHORT, seed=1)
    own, other = race.state.memory[0, :, 1]
    assert own == alone
    if "time" not in top:
        assert other != alone != speeds(driver, seed=2)[0]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("import sys; sys.exit()", "driver.py can't be loaded: SystemExit"),
        ("import nothing_of_the_kind", "can't be loaded: ModuleNotFoundError"),
        ("class Odd(BaseException): __str__ = None\nraise Odd", "can't be loaded: Odd"),
        ("class Helper: pass", "has no driver: a class with a method"),
        (DRIVER.format("", "raise SystemExit(3)", "1.0"), "driver.py:Driver: SystemExit: 3"),
        (DRIVER.format("", "return None", "1.0"), "driver.py:Driver: TypeError"),
        (DRIVER.format("", "return 'fast', 'left'", "1.0"), "driver.py:Driver: ValueError"),
    ],
)
def test_an_error_of_own_code_is_one_line(text, words, folder, capsys):
    refused(words, lambda: speeds(team(folder, text)))
    words = ["race", "--ego", f"{folder}/driver.py", "--opponent", "pure-pursuit"]
    assert main(words) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_a_missing_file_is_refused_and_an_interruption_passes(folder):
    refused("there is no Python file", drivers_from, folder / "none.py")
    driver = team(folder, DRIVER.format("", "raise KeyboardInterrupt", "1.0"))
    with pytest.raises(KeyboardInterrupt):
        speeds(driver)


@pytest.mark.parametrize(
    ("text", "name", "rest"),
    [
        ("lattice:pace=0.8", "lattice", "pace=0.8"),
        (" my drivers/own.py:A ", "my drivers/own.py", "A "),
        (r"C:\My Drivers\own.py:A", r"C:\My Drivers\own.py", "A"),
        ("C:/a=b,c/own.py", "C:/a=b,c/own.py", ""),
        ("cfr-argmax:network=own.py", "cfr-argmax", "network=own.py"),
    ],
)
def test_a_name_ends_at_its_colon(text, name, rest):
    assert split_name(text) == (name, ":" if rest else "", rest)


NODE = """
import rclpy
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy, qos_profile_sensor_data
import sensor_msgs.msg
from sensor_msgs.msg import LaserScan
from nav_msgs.msg import Odometry
from std_msgs.msg import Float32, ColorRGBA
from geometry_msgs.msg import PoseStamped
from visualization_msgs.msg import Marker
from ackermann_msgs.msg import AckermannDriveStamped, AckermannDrive
from tf_transformations import euler_from_quaternion

class Follower(Node):
    def __init__(self):
        super().__init__("follower")
        self.declare_parameter("gain", 0.5)
        self.declare_parameters("", [("top", 2.0)])
        self.gain = self.get_parameter("gain").get_parameter_value().double_value
        topic = self.get_parameter("scan").value or "/scan"
        self.create_subscription(LaserScan, topic, self.scan, qos_profile_sensor_data)
        self.create_subscription(Odometry, "/ego_racecar/odom", self.odom, QoSProfile(depth=10))
        self.create_subscription(PoseStamped, "/pf/viz/inferred_pose", self.pose, 10)
        self.create_subscription(Odometry, "/opp_racecar/odom", self.other, 10)
        self.drive = self.create_publisher(AckermannDriveStamped, "/drive", 10)
        self.marks = self.create_publisher(Marker, "/mark", 10)
        self.timer = self.create_timer(0.1, self.tick)
        self.began, self.ticks, self.heading, self.away = self.get_clock().now(), 0, None, 0.0
        self.get_logger().info("ready")

    def odom(self, message):
        o = message.pose.pose.orientation
        self.heading = euler_from_quaternion([o.x, o.y, o.z, o.w])[2]
        self.at, self.speed = message.pose.pose.position, message.twist.twist.linear.x

    def other(self, message):
        self.away = message.pose.pose.position.x - self.at.x

    def pose(self, message):
        assert message.pose.position.x == self.at.x and message.header.stamp.sec >= 0

    def tick(self):
        self.ticks += 1
        mark = Marker()
        mark.type, mark.pose.position.x, mark.color = Marker.SPHERE, 1.0, ColorRGBA(r=1.0)
        self.marks.publish(mark)

    def scan(self, scan):
        assert self.heading is not None and len(scan.ranges) == 1080 and self.away != 0.0
        dt = (self.get_clock().now() - self.began).nanoseconds * 1e-9
        message = AckermannDriveStamped()
        message.header.stamp = self.get_clock().now().to_msg()
        message.drive.speed = 1.0 + 0.1 * self.ticks + 0.001 * round(dt, 3)
        message.drive.steering_angle = scan.angle_min + 540 * scan.angle_increment
        self.drive.publish(message)

def main(args=None):
    rclpy.init(args=args)
    rclpy.spin(Follower())
    rclpy.shutdown()

if __name__ == "__main__":
    main()
"""


def test_a_node_of_ros_drives(folder):
    """Its timer has run thrice in the 0.38 s before the last command, whose clock it shows."""
    driver = team(folder, NODE)
    assert driver.name.endswith(":Follower")
    assert speeds(driver, 2) == pytest.approx([1.3 + 0.00038] * 2)
    assert "rclpy" not in sys.modules


def test_drivers_of_courses_race_unchanged(folder):
    """``PCS_RACING_DRIVERS`` is a folder of checkouts, or a file."""
    given = Path(os.environ.get("PCS_RACING_DRIVERS", "nowhere"))
    patterns = ("drivers.py", "drivers/*.py")
    files = [given] if given.is_file() else [one for p in patterns for one in given.rglob(p)]
    if not files:
        pytest.skip("PCS_RACING_DRIVERS holds no drivers")
    for policy in [policy for file in files for policy in drivers_from(file).values()]:
        result = run_races(load_track("Tarnfjord"), [policy], "pure-pursuit", CONTEST, seed=1)
        assert result.state.progress[0, 0] > 2.0
