"""Drivers of others race unchanged: small ones of the forms in use, and others' where there is a
checkout.
"""

import os
import pickle
import random
import sys
from pathlib import Path

import numpy as np
import pytest
from refusal import refused

from pcs_racing import CONTEST, load_race_config, load_track, parse_policy, run_races
from pcs_racing.planners import registry
from pcs_racing.planners.imported import drivers_from
from pcs_racing.planners.own_files import run_file
from pcs_racing.planners.planner import Policy
from pcs_racing.planners.registry import register_planner
from pcs_racing.planners.shipped import split_name
from pcs_racing.race.config import RaceConfig
from pcs_racing.race.start_grid import Starts
from pcs_racing_agents.agents.own_code import own_code
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

class Fails:
    def __init__(self, needs):
        pass
    def process_lidar(self, ranges):
        return 1.0, 0.0
"""


@pytest.fixture
def file(tmp_path, monkeypatch) -> Path:
    """A file with drivers, which are forgotten after the test."""
    monkeypatch.setattr(registry, "_planners", dict(registry._planners))
    (tmp_path / "beside.py").write_text("FAST = 3.0\n")
    (tmp_path / "theirs.py").write_text(FILE)
    return tmp_path / "theirs.py"


def test_all_forms_drive_and_every_race_has_its_own_driver(file):
    drivers = drivers_from(file)
    assert list(drivers) == ["Farthest", "Counts", "Plans", "Fails"]
    track = load_track("Tarnfjord")
    egos = [drivers["Farthest"], drivers["Counts"], drivers["Counts"], drivers["Plans"]]
    config = RaceConfig(duration=4.0, start="rolling", start_gap=20.0, start_spacing=0.0)
    starts = Starts(np.full(4, 20.0), np.ones(4, np.int64))
    result, again = (
        run_races(track, egos, parse_policy("pure-pursuit"), config, starts=starts)
        for _ in range(2)
    )
    assert (result.state.progress[:, 0] > -20.0 + 0.9 * 4.0).all()
    assert not result.crashed.any()
    np.testing.assert_array_equal(again.state.cars, result.state.cars)


def test_a_driver_has_a_name_and_reaches_other_processes(file):
    policy = drivers_from(file)["Plans"]
    assert policy.name == f"{file.as_posix()}:Plans"
    assert parse_policy(policy.name).planner is policy.planner
    assert pickle.loads(pickle.dumps(policy.planner)).drive.names[2] == "Plans"


def test_the_command_line_takes_files(file, capsys):
    assert (
        main(["race", "--ego", f"{file}:Counts", "--opponent", "pure-pursuit", "--duration", "1"])
        == 0
    )
    assert f"car 0: {file.as_posix()}:Counts" in capsys.readouterr().out


SHORT = RaceConfig(duration=0.4, start="rolling", start_gap=20.0, start_spacing=0.0)


def speeds(driver, races=1, seed=1, opponent="pure-pursuit"):
    """Return the speeds that a driver asked for last, in each of some races."""
    result = run_races(load_track("Tarnfjord"), [driver] * races, opponent, SHORT, seed=seed)
    return result.state.memory[:, 0, 1].tolist()


def team(folder: Path, driver: str, **modules: str) -> Policy:
    """Write a driver whose method ends with lines of its own, and files beside it; return its
    policy.
    """
    for name, text in {**modules, "driver": driver}.items():
        place = folder / f"{name.replace('__', '/')}.py"
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_text(text)
    return next(iter(drivers_from(folder / "driver.py").values()))


DRIVER = """
{0}
class Driver:
    def process_lidar(self, ranges):
        {1}
        return {2}, 0.0
"""


@pytest.mark.parametrize(
    ("top", "lazy", "speed", "beside"),
    [
        ("from utils import SPEED", "", "SPEED", "utils"),
        ("", "import utils", "utils.SPEED", "utils"),
        ("import parts.speeds.fast", "", "parts.speeds.fast.SPEED", "parts__speeds__fast"),
        ("from .utils import SPEED", "", "SPEED", "utils"),
        ("import importlib", "", "importlib.import_module('utils').SPEED", "utils"),
        ("import pickle", "", r"pickle.loads(b'cutils\nSPEED\n.')", "utils"),
        ("import pickle", "", r"pickle.loads(b'cparts.fast\nSPEED\n.')", "parts__fast"),
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
def test_what_a_file_imports_from_its_folder_is_its_own(top, lazy, speed, beside, file):
    before = set(sys.modules), sys.path[:]
    teams = [
        team(file.parent / name, DRIVER.format(top, lazy, speed), **{beside: f"SPEED = {value}"})
        for name, value in {"a": 1.0, "b": 3.0}.items()
    ]
    assert [speeds(one)[0] for one in teams] == [1.0, 3.0]
    assert [speeds(one)[0] for one in reversed(teams)] == [3.0, 1.0]
    assert sys.path == before[1]
    assert not {"utils", "parts"} & set(sys.modules) - before[0]
    # Classes beside a file are found again by their names, as in another process.
    module = run_file(file.parent / "a/driver.py")
    assert pickle.loads(pickle.dumps(vars(module)["Driver"])) is vars(module)["Driver"]


@pytest.mark.parametrize(
    ("top", "lines", "speed"),
    [
        ("N = 0", "global N; N += 1", "1.0 + 0.01 * N"),
        ("import counting", "counting.SEEN.append(1)", "1.0 + 0.01 * len(counting.SEEN)"),
        ("import random", "", "random.uniform(1.0, 2.0)"),
        ("from random import gauss", "", "1.5 + 0.1 * gauss(0.0, 1.0)"),
        ("import numpy as np", "", "1.5 + 0.1 * np.random.randn()"),
        ("import numpy as np; rng = np.random.default_rng()", "", "rng.uniform(1.0, 2.0)"),
        ("import numpy as np; np.random.seed(3)", "", "np.random.uniform(1.0, 2.0)"),
        ("import drawing", "", "drawing.speed()"),
        (
            "import time; from time import monotonic as now; began = now()",
            "",
            "1.0 + time.time() - began + now() % 1",
        ),
    ],
)
def test_a_race_is_the_same_alone_among_others_and_again(top, lines, speed, file):
    """Whatever the file keeps or draws; the generators of this process go on as if nobody had
    driven.
    """
    beside = {
        "counting": "SEEN = []",
        "drawing": "import random\ndef speed():\n    return 1.0 + random.random()\n",
    }
    driver = team(file.parent / "own", DRIVER.format(top, lines, speed), **beside)
    draws = [random.random, np.random.randn] * 2

    def seed() -> None:
        random.seed(1)
        np.random.seed(1)

    seed()
    expected = [draw() for draw in draws]
    seed()
    before = [draw() for draw in draws[:2]]
    alone = speeds(driver)[0]
    assert before + [draw() for draw in draws[2:]] == expected
    assert 0.0 < alone < 3.0
    for races in (3, 1):
        assert speeds(driver, races)[0] == alone
    against_itself = run_races(
        load_track("Tarnfjord"), [driver], driver, SHORT, seed=1
    ).state.memory[0, :, 1]
    assert against_itself[0] == alone
    if "random" in top and "seed" not in top:
        assert against_itself[1] != alone != speeds(driver, seed=2)[0]


@pytest.mark.parametrize(
    ("top", "call"),
    [
        ("from pcs_racing.planners import register_planner", "register_planner"),
        ("import pcs_racing.planners", "pcs_racing.planners.register_planner"),
        ("import pcs_racing.planners.registry as kept", "kept.register_planner"),
    ],
)
def test_a_file_that_registers_planners_is_run_again(top, call, file):
    top = f"from pcs_racing.planners import Planner; {top}\n{call}(Planner('mine', ()))"
    driver = team(file.parent / "own", DRIVER.format(top, "", "1.5"))
    assert speeds(driver, 2) == [1.5, 1.5]
    assert parse_policy("mine").planner.parameters == ()


def test_functions_of_numba_are_compiled_once_for_all_races(file):
    top = (
        "from numba import njit\nfrom compiled import half\n@njit\ndef twice(x):\n    return 2.0 *"
        " half(x)"
    )
    half = "from numba import njit\n@njit\ndef half(x):\n    return 0.5 * x\n"
    driver = team(
        file.parent / "own", DRIVER.format(top, "self.twice = twice", "twice(1.5)"), compiled=half
    )
    assert speeds(driver, 3) == [1.5] * 3
    runs = list(driver.planner.drive.racing.values())
    assert len({id(run.driver.twice) for run in runs}) == 1
    assert len({id(run.module) for run in runs}) == 3


@pytest.mark.parametrize(
    ("top", "lines", "words"),
    [
        ("import sys; sys.exit()", "", "can't be loaded: SystemExit"),
        ("exit()", "", "can't be loaded: SystemExit"),
        ("class Odd(BaseException): __str__ = None\nraise Odd", "", "can't be loaded: Odd"),
        (
            (
                "import argparse\np = argparse.ArgumentParser()\np.add_argument('--speed',"
                " required=True)\np.parse_args()"
            ),
            "",
            "driver.py can't be loaded: .*reads arguments of a command line.*--speed",
        ),
        (
            (
                "class M(type):\n    def __getattr__(cls, name): raise RuntimeError('no')\nclass"
                " A(metaclass=M): pass"
            ),
            "",
            "can't be loaded: RuntimeError: no",
        ),
        ("", "raise SystemExit(3)", "driver.py:Driver: SystemExit: 3"),
        ("", "return None", "driver.py:Driver: TypeError"),
        ("", "return 'fast', 'left'", "driver.py:Driver: ValueError"),
    ],
)
def test_whatever_own_code_raises_is_one_line(top, lines, words, file, capsys):
    def race():
        return speeds(team(file.parent / "own", DRIVER.format(top, lines or "pass", "1.0")))

    refused(words, race)
    assert (
        main(["race", "--ego", f"{file.parent}/own/driver.py", "--opponent", "pure-pursuit"]) == 2
    )
    assert capsys.readouterr().err.count("\n") == 1


def test_an_interruption_passes(file):
    driver = team(file.parent / "own", DRIVER.format("", "raise KeyboardInterrupt", "1.0"))
    with pytest.raises(KeyboardInterrupt):
        speeds(driver)


@pytest.mark.parametrize("folder", ["my drivers", "a=b", "c,d", "a=1, b=2"])
def test_a_path_may_hold_any_sign(folder, file, capsys):
    driver = team(file.parent / folder, DRIVER.format("", "", "1.5"))
    assert parse_policy(driver.name).planner is driver.planner
    words = [
        "--ego",
        f"{file.parent}/{folder}/driver.py:Driver",
        "--opponent",
        "pure-pursuit",
        "--duration",
        "0.4",
    ]
    assert main(["race", *words]) == 0
    assert "driver.py:Driver" in capsys.readouterr().out


def test_names_in_texts():
    for text, name, rest in [
        ("lattice:pace=0.8", "lattice", "pace=0.8"),
        (" my drivers/own.py:A ", "my drivers/own.py", "A "),
        (r"C:\My Drivers\own.py:A", r"C:\My Drivers\own.py", "A"),
        ("C:/a=b,c/own.py", "C:/a=b,c/own.py", ""),
        ("cfr-argmax:network=own.py", "cfr-argmax", "network=own.py"),
    ]:
        assert split_name(text) == (name, ":" if rest else "", rest)
    refused("must be text without", register_planner, "a.b:C", name="C:x")


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
from ackermann_msgs.msg import AckermannDriveStamped{imported}
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


@pytest.mark.parametrize("imported", ["", ", AckermannDrive"])
def test_a_node_of_ros_drives(imported, file):
    """Its timer has run thrice in the 0.38 s before the last command, whose clock it shows."""
    driver = team(file.parent / "own", NODE.format(imported=imported))
    assert driver.name.endswith(":Follower")
    assert speeds(driver, 2) == pytest.approx([1.3 + 0.00038] * 2)
    assert "rclpy" not in sys.modules


def test_what_is_no_driver_is_one_line(file):
    refused("there is no Python file", drivers_from, file.parent / "none.py")
    refused("has no driver: a class with a method", drivers_from, file.parent / "beside.py")
    (file.parent / "broken.py").write_text("import nothing_of_the_kind\n")
    refused("can't be loaded: ModuleNotFoundError", drivers_from, file.parent / "broken.py")
    fails = drivers_from(file)["Fails"]
    refused("Fails: TypeError", run_races, load_track("Pipkin"), [fails], fails, CONTEST)


def test_others_drivers_race_unchanged(monkeypatch):
    """``PCS_RACING_DRIVERS`` is a folder of checkouts, or a file."""
    monkeypatch.setattr(registry, "_planners", dict(registry._planners))
    given = Path(os.environ.get("PCS_RACING_DRIVERS", "nowhere"))
    files = (
        [given] if given.is_file() else [*given.rglob("drivers.py"), *given.rglob("drivers/*.py")]
    )
    if not files:
        pytest.skip("PCS_RACING_DRIVERS holds no drivers")
    for theirs in files:
        for policy in drivers_from(theirs).values():
            result = run_races(
                load_track("Tarnfjord"), [policy], parse_policy("pure-pursuit"), CONTEST, seed=1
            )
            assert result.state.progress[0, 0] > 2.0


def test_own_code_that_is_no_agent_is_one_line(file):
    (file.parent / "agents.py").write_text(
        "def fails():\n    raise SystemExit\ndef nothing(): pass\npr = print\n"
    )
    for name, words in {
        "fails": "fails: SystemExit",
        "nothing": "gives None",
        "none": "has no class and no fun",
    }.items():
        refused(words, own_code, f"{file.parent}/agents.py:{name}")
    refused("gives None", own_code, "builtins:print")
    refused("int: ValueError: no signature found", own_code, "builtins:int")


def test_a_file_changes_neither_the_working_folder_nor_the_output(tmp_path, monkeypatch):
    (tmp_path / "team").mkdir()
    (tmp_path / "team" / "driver.py").write_text(
        "import os, sys\nos.chdir(os.path.dirname(os.path.abspath(__file__)))\nsys.stdout ="
        " None\nclass Moves:\n    def process_lidar(self, ranges):\n        os.chdir('..')\n       "
        " return 1.0, 0.0\n"
    )
    monkeypatch.chdir(tmp_path)
    track, stdout = load_track("Pipkin"), sys.stdout
    (driver,) = drivers_from("team/driver.py").values()
    run_races(
        track,
        [driver],
        parse_policy("pure-pursuit"),
        load_race_config("paper", duration=0.2),
        seed=1,
    )
    assert (Path.cwd(), sys.stdout) == (tmp_path, stdout)


def test_a_node_that_never_commands_is_reported_once(file, capsys):
    silent = NODE.format(imported="").replace("self.drive.publish(message)", "pass")
    driver = team(file.parent / "own", silent)
    config = load_race_config(SHORT, duration=1.2)
    result = run_races(load_track("Tarnfjord"), [driver] * 2, "pure-pursuit", config, seed=1)
    assert (result.state.memory[:, 0, :2] == 0.0).all()
    said = capsys.readouterr().err
    assert "node Follower has published no AckermannDrive message in the first 1 s" in said
    assert said.count("\n") == 1
