"""The package of ROS 2: its logic without ROS, its files, and a runner without our packages."""

import importlib
import json
import re
import shutil
import subprocess
import sys
import zipfile
from array import array
from copy import deepcopy
from functools import reduce
from types import SimpleNamespace
from xml.etree import ElementTree

import numpy as np
import pytest
import yaml
from refusal import refused
from repository import REPOSITORY

from pcs_racing import load_track
from pcs_racing.car.lidar import Lidar
from pcs_racing.planners.ros_nodes import Node, ask_node, modules
from pcs_racing_agents.agents import PolicyOnCar, export_onnx

PACKAGE = REPOSITORY / "examples" / "ros2_bridge"
NAME = "pcs_racing_ros"


@pytest.fixture
def ros(monkeypatch):
    """The package of the bridge, as ROS imports it."""
    monkeypatch.syspath_prepend(str(PACKAGE))
    yield lambda name: importlib.import_module(f"{NAME}.{name}")
    for name in [name for name in sys.modules if name.partition(".")[0] == NAME]:
        del sys.modules[name]


def message(fields, **more):
    """Return a message with some fields; the field of a mapping is a message, too."""
    parts = {k: message(v) if isinstance(v, dict) else v for k, v in fields.items()}
    return SimpleNamespace(**{**more, **parts})


@pytest.fixture(scope="module")
def lidar_ppo(tmp_path_factory):
    pytest.importorskip("onnx")
    pytest.importorskip("onnxruntime")
    return export_onnx("lidar-ppo", tmp_path_factory.mktemp("exported") / "lidar-ppo.onnx")


def test_the_simulator_drives_by_commands_and_publishes_what_the_gym_does(ros):
    race = ros("simulation").Simulation("Pipkin", opponent=None, beams=9)
    race.put(*load_track("Pipkin").to_cartesian([0.0, 0.0]))
    for _ in range(25):
        race.command(0, 0.0, 2.0)
        race.command(1, np.nan, 9.0)  # left out
        messages = {message.topic: message for message in race.step()}
    assert set(messages) == {"/scan", "/opp_scan", "/ego_racecar/odom", "/opp_racecar/odom", "/tf"}
    assert {message.time for message in messages.values()} == {500_000_000}
    speeds = [
        messages[f"/{car}_racecar/odom"].fields["twist"]["twist"]["linear"]["x"]
        for car in ("ego", "opp")
    ]
    assert 1.5 < speeds[0] < 2.1
    assert abs(speeds[1]) < 0.1
    assert len(messages["/scan"].fields["ranges"]) == 9


KINDS = {"/scan": "scan", "/ego_racecar/odom": "odometry", "/opp_racecar/odom": "opponent"}


@pytest.mark.parametrize("policy", ["line-ppo", "lidar-ppo"])
def test_a_policy_drives_by_messages_as_in_races(ros, lidar_ppo, policy, monkeypatch):
    """The simulator's messages go to the planner node's logic, and its commands come back."""
    race = ros("simulation").Simulation("Brackwater", opponent="lattice:pace=0", seed=1, beams=271)
    planning = ros("planning").Planning(str(lidar_ppo) if policy == "lidar-ppo" else policy)
    monkeypatch.setattr(
        "pcs_racing_agents.agents.on_car.scans", lambda planner: False
    )  # as in a race
    on_car = PolicyOnCar(policy, "Brackwater")
    began = race.info["car_0"]["progress"]
    for k in range(400):
        for one in race.step():
            if one.topic in KINDS:
                planning.hear(KINDS[one.topic], message(one.fields, range_min=0.0), 1e-9 * one.time)
        command = planning.command(1e-9 * one.time)
        race.command(0, *command)
        car, opponent = (
            ros("messages").state_of(planning.heard[kind].message, steering, 0.0)
            for kind, steering in (("odometry", planning.steering), ("opponent", 0.0))
        )
        expected = on_car.command(0.02 * k, car, opponent)
        assert (np.abs(np.subtract(command, expected)) < [0.01, 0.1]).all()  # rad, m/s
        assert race.env.agents  # no crash ended the race
    assert race.info["car_0"]["progress"] - began > 55.0  # m in 8 s


def odometry(x=1.0, y=2.0, heading=0.0, vx=3.0, vy=0.0, yaw_rate=0.0):
    quaternion = {"x": 0.0, "y": 0.0, "z": np.sin(0.5 * heading), "w": np.cos(0.5 * heading)}
    pose = {"pose": {"position": {"x": x, "y": y}, "orientation": quaternion}}
    twist = {"twist": {"linear": {"x": vx, "y": vy}, "angular": {"z": yaw_rate}}}
    return message({"pose": pose, "twist": twist})


def tell(planning, kind, one, time):
    """Stamp a message, and send it."""
    stamp = SimpleNamespace(sec=int(time), nanosec=round(1e9 * (time % 1.0)))
    one.header = SimpleNamespace(stamp=stamp, frame_id="map")
    planning.hear(kind, one, time)


def test_odometry_of_the_rear_axle_becomes_the_state_of_the_centre(ros):
    heard = odometry(heading=0.5 * np.pi, vx=2.0, yaw_rate=1.0)
    found = ros("messages").state_of(heard, 0.1, 0.17)
    x, y, steering, speed, heading, yaw_rate, slip = found
    np.testing.assert_allclose([x, y, steering, heading], [1.0, 2.17, 0.1, 0.5 * np.pi])
    np.testing.assert_allclose([speed * np.cos(slip), speed * np.sin(slip)], [2.0, 0.17])
    assert yaw_rate == 1.0


def test_a_beam_without_a_range_is_as_near_as_its_neighbours(ros):
    ranges = [1.0, 2.0, 0.0, np.inf, np.nan, 20.0, -np.inf, 3.0]
    heard = SimpleNamespace(angle_min=-0.06, angle_increment=0.03, range_min=0.1, ranges=ranges)
    angles = 0.03 * np.arange(-3, 7)
    found = ros("messages").ranges_at(heard, angles, 15.0)
    np.testing.assert_array_equal(found, [1.0, 1.0, 2.0, 2.0, 15.0, 15.0, 15.0, 0.1, 3.0, 3.0])


# Forms of messages: (kind, form of a message at a step, text of the stop or "" if the car drives).

TURN = 2.0 * np.pi


def seen(first, step, count):
    """Beams of another lidar; the simulator's has 1441 in a turn."""

    def form(one, _):
        index = np.rint((first + step * np.arange(count) + np.pi) / TURN * 1440).astype(int)
        one.ranges = array("f", np.asarray(one.ranges)[index % 1440])
        one.angle_min, one.angle_increment = first, step
        return [one]

    return form


def put(path, change, since=0):
    """A field with another value, or a function of its value, from a step on."""
    *above, name = path.split(".")

    def form(one, k):
        at = one
        for part in above:
            at = getattr(at, part)
        old = getattr(at, name)
        if k >= since:
            setattr(at, name, change(old) if callable(change) else change)
        return [one]

    return form


def ranges_as(change):
    return put("ranges", lambda ranges: change(np.array(ranges)))


def turned(*numbers):
    return put("pose.pose.orientation", SimpleNamespace(**dict(zip("xyzw", numbers, strict=True))))


def scaled(x, y, z, w):
    """An orientation with its four numbers multiplied."""

    def change(q):
        return SimpleNamespace(x=x * q.z, y=y * q.w, z=z * q.z, w=w * q.w)

    return put("pose.pose.orientation", change)


def late(seconds, since=0):
    def change(stamp):
        shifted = round(1e9 * (stamp.sec - seconds)) + stamp.nanosec
        return SimpleNamespace(sec=shifted // 10**9, nanosec=shifted % 10**9)

    return put("header.stamp", change, since)


def in_the_frame_of_the_map(one, _):
    q, along = one.pose.pose.orientation, one.twist.twist.linear
    way = (q.w + 1j * q.z) ** 2 * complex(along.x, along.y)
    along.x, along.y = way.real, way.imag
    return [one]


def every(steps):
    return lambda one, k: [one] * (k % steps == 0)


def held(path, steps):
    """A part that stays as it was after so many steps."""
    kept = []

    def form(one, k):
        if k <= steps:
            kept[:] = [deepcopy(reduce(getattr, path.split("."), one))]
        return put(path, kept[0])(one, k)

    return form


def overtaken():
    """The message of every third step arrives after the next one."""
    kept = []

    def form(one, k):
        if k % 3 == 0:
            kept[:] = [one]
        return ([], [one, *kept], [one])[k % 3]

    return form


POSITION, SPEED = "pose.pose.position.x", "twist.twist.linear.x"
DEGREE = TURN / 360
SCANS = {
    "0 to 2 pi": (seen(0.0, 0.5 * DEGREE, 720), ""),
    "2 pi to 0": (seen(TURN, -0.5 * DEGREE, 720), ""),
    "pi to -pi": (seen(np.pi, -0.5 * DEGREE, 721), ""),
    "from -3 pi / 2": (seen(-0.75 * TURN, 0.5 * DEGREE, 720), ""),
    "360 beams": (seen(0.0, DEGREE, 360), ""),
    "270 degrees": (seen(-135 * DEGREE, 0.25 * DEGREE, 1081), ""),
    "270 degrees clockwise": (seen(135 * DEGREE, -0.25 * DEGREE, 1081), ""),
    "180 degrees": (seen(-90 * DEGREE, 0.5 * DEGREE, 361), ""),
    "zeros for far": (ranges_as(lambda r: np.where(r > 8.0, 0.0, r)), ""),
    "infinity for far": (ranges_as(lambda r: np.where(r > 10.0, np.inf, r)), ""),
    "65.533 for far": (ranges_as(lambda r: np.where(r > 10.0, 65.533, r)), ""),
    "a third NaN": (ranges_as(lambda r: np.where(np.arange(len(r)) % 3, r, np.nan)), ""),
    "two thirds NaN": (ranges_as(lambda r: np.where(np.arange(len(r)) % 3, np.nan, r)), "67%"),
    "all NaN": (ranges_as(lambda r: np.nan * r), "no valid range in 100%"),
    "all zeros": (ranges_as(lambda r: 0.0 * r), "no valid range in 100%"),
    "all too near": (ranges_as(lambda r: -np.inf + r), "no valid range in 100%"),
    "no front": (seen(50 * DEGREE, 0.5 * DEGREE, 521), "no valid range in 100%"),
    "mm": (ranges_as(lambda r: 1000.0 * r), "no valid range in 100%"),
    "empty": (put("ranges", []), "no valid range in 100%"),
    "a narrow view": (seen(-45 * DEGREE, 0.5 * DEGREE, 181), "no valid range"),
    "no increment": (put("angle_increment", 0.0), "0 rad apart"),
    "increment of NaN": (put("angle_increment", np.nan), "nan rad apart"),
    "degrees": (put("angle_increment", 0.25), "0.25 rad apart"),
    "24 beams": (seen(0.0, 15 * DEGREE, 24), "0.262 rad apart"),
    "begin of NaN": (put("angle_min", np.nan), "no valid range in 100%"),
    "min range of NaN": (put("range_min", np.nan), "no valid range in 100%"),
    "another frame": (put("header.frame_id", ""), ""),
    "each twice": (lambda one, _: [one, deepcopy(one)], ""),
    "10 Hz": (every(5), ""),
    "2 Hz": (every(25), "no scan for 0.1 s"),
    "out of order": (overtaken(), ""),
    "5 s late": (late(5.0), "scan is stamped 5.00 s before the clock"),
    "5 s early": (late(-5.0), "scan is stamped -5.00 s before the clock"),
    "without stamps": (put("header.stamp", SimpleNamespace(sec=0, nanosec=0), 50), "is stamped"),
}
CARS = {
    "orientation 0": (turned(0.0, 0.0, 0.0, 0.0), "orientation 0, 0, 0, 0 is no quaternion"),
    "orientation NaN": (turned(0.0, 0.0, np.nan, 1.0), "nan, 1 is no quaternion"),
    "half an orientation": (scaled(0.0, 0.0, 0.5, 0.5), "is no quaternion"),
    "upside down": (scaled(1.0, 1.0, 0.0, 0.0), "orientation is tilted"),
    "x 1e256": (put(POSITION, 1e256), r"holds 1e\+256"),
    "x NaN": (put(POSITION, np.nan), "holds nan"),
    "speed infinite": (put(SPEED, -np.inf), "holds -inf"),
    "speed 1e9": (put(SPEED, 1e9), r"holds 1e\+09"),
    "5 s late": (late(5.0), "is stamped 5.00 s before the clock of this node"),
}
ODOMETRY = {
    **CARS,
    "the other quaternion": (scaled(0.0, 0.0, -1.0, -1.0), ""),
    "a little roll": (scaled(0.05, 0.05, 0.999, 0.999), ""),
    "out of order": (overtaken(), ""),
    "10 Hz": (every(5), ""),
    "0.05 s late": (late(0.05), ""),
    "none after 2 s": (lambda one, k: [one] * (k < 100), "no odometry for 0.1 s"),
    "held after 2 s": (held("pose", 100), "does not fit its speeds"),
    "stamps held after 2 s": (held("header.stamp", 100), "odometry is stamped"),
}
ON_THE_MAP = {
    "speeds of 0": (put("twist.twist", odometry(vx=0.0).twist.twist), "does not fit its speeds"),
    "speeds of the map": (in_the_frame_of_the_map, "does not fit its speeds"),
    "500 m off": (put(POSITION, lambda x: x + 500.0), "not on track 'Brackwater'"),
    "frame odom": (put("header.frame_id", "odom"), "odometry is in the frame 'odom', not in 'map'"),
    "no frame": (put("header.frame_id", ""), "odometry is in the frame '', not in 'map'"),
    "frame /map": (put("header.frame_id", "/map"), ""),
}
OPPONENT = {
    **CARS,
    "500 m off": (put(POSITION, lambda x: x + 500.0), "opponent is at"),
    "the own pose": (None, "opponent: its pose is the own pose"),
    "frame odom": (put("header.frame_id", "odom"), "opponent is in the frame 'odom'"),
}
FORMS = [
    (policy, kind, name)
    for policy, kind, forms in (
        ("lidar-ppo", "scan", SCANS),
        ("line-ppo", "odometry", ODOMETRY | ON_THE_MAP),
        ("lidar-ppo", "odometry", ("x NaN", "out of order", "10 Hz", "held after 2 s")),
        ("line-ppo", "opponent", OPPONENT),
    )
    for name in forms
]


@pytest.mark.parametrize(("policy", "kind", "name"), FORMS, ids=map("-".join, FORMS))
def test_every_form_of_messages_drives_or_stops_by_a_line(ros, lidar_ppo, policy, kind, name):
    forms = {"scan": SCANS, "odometry": ODOMETRY | ON_THE_MAP, "opponent": OPPONENT}
    form, said = forms[kind][name]
    race = ros("simulation").Simulation("Brackwater", opponent="lattice:pace=0", seed=1)
    race.lidar = Lidar(race.circuit, beams=1441, fov=TURN)
    race.put(*load_track("Brackwater").to_cartesian([0.0, 0.0]))
    policy = str(lidar_ppo) if policy == "lidar-ppo" else policy
    share = 0.5 if said and policy == "line-ppo" else 1.0
    planning, lines, began = ros("planning").Planning(policy, speed_share=share), set(), None
    for k in range(150):
        sent = {one.topic: message(one.fields, range_min=0.05) for one in race.step()}
        now = 0.02 * (k + 1)
        for topic, one in KINDS.items():
            given = [sent[topic]]
            if one == kind and form is None:
                given = [deepcopy(sent["/ego_racecar/odom"])]
            elif one == kind:
                given = form(given[0], k)
            for heard in given:
                planning.hear(one, heard, now)
        race.command(0, *planning.command(now))
        lines.add(planning.stopped)
        began = race.info["car_0"]["progress"] if began is None else began
        assert race.env.agents, f"a crash after {now} s; {lines}"
    lines = {line for line in lines - {""} if "no scan for" not in line or "2 Hz" in name}
    if said:
        assert any(re.search(said, line) for line in lines), lines
        assert abs(race.info["car_0"]["velocities"][0][0]) < 2.0
    else:
        assert lines <= {f"no {kind} for 0.1 s"}  # before the first message
        assert race.info["car_0"]["progress"] - began > 2.0


def test_without_fresh_messages_the_car_stops(ros):
    planning = ros("planning").Planning("pure-pursuit", "Pipkin", speed_share=0.5)
    x, y, heading = load_track("Pipkin").to_cartesian([0.0, 0.0])
    assert planning.command(5.0) == (0.0, 0.0)
    tell(planning, "odometry", odometry(x, y, heading, 1.0), 5.0)
    _, slow = planning.command(5.02)
    assert slow > 0.0
    tell(planning, "opponent", odometry(np.nan), 5.02)
    assert planning.command(5.04) == (0.0, 0.0)
    tell(planning, "odometry", odometry(x, y, heading, 1.0), 5.3)  # the opponent is lost by now
    assert planning.command(5.32)[1] > 0.0
    assert planning.command(5.6) == (0.0, 0.0)


def scan(**fields):
    usual = {"angle_min": -2.35, "angle_increment": 4.7 / 270, "range_min": 0.1}
    return SimpleNamespace(**{**usual, "ranges": [2.0] * 271, **fields})


@pytest.mark.parametrize("policy", ["line-ppo", "lidar-ppo"])
def test_the_car_stops_and_begins_again_when_the_clock_is_set_back(ros, lidar_ppo, policy):
    planning = ros("planning").Planning(str(lidar_ppo) if policy == "lidar-ppo" else policy)
    x, y, heading = load_track("Brackwater").to_cartesian([0.0, 0.0])
    commands = []
    for begin in (100.0, 50.0):
        for kind, heard in (("odometry", odometry(x, y, heading)), ("scan", scan())):
            tell(planning, kind, heard, begin + 0.01)
        commands += [planning.command(begin + after) for after in (0.02, 0.04)]
        for kind, heard in (("odometry", odometry(x, y, heading)), ("scan", scan())):
            tell(planning, kind, heard, begin + 0.05)
        commands.append(planning.command(begin + 0.06))
    assert min(speed for _, speed in (*commands[:3], commands[5])) > 1.0
    assert commands[3:5] == [(0.0, 0.0)] * 2
    assert commands[5] == pytest.approx(commands[0], abs=0.02)  # rad, m/s; the servo moved
    tell(planning, "odometry", odometry(x, y, heading), 50.2)  # by a clock that was set back since
    assert planning.command(50.1) == (0.0, 0.0)


def test_the_steering_angle_follows_the_command_to_stop(ros):
    planning = ros("planning").Planning("pure-pursuit", "Pipkin")
    x, y, heading = load_track("Pipkin").to_cartesian([0.0, 0.5])
    tell(planning, "odometry", odometry(x, y, heading), 0.0)
    assert abs(planning.command(0.0)[0]) > 0.05
    assert planning.command(0.3) == (0.0, 0.0)  # until now the last command held
    assert abs(planning.steering) > 0.05
    planning.command(0.6)
    assert planning.steering == 0.0


OTHER = """<ir_version: 8, opset_import: ["" : 17]>
other (float[1,2] observation) => (float[1,2] command) { command = Identity (observation) }"""
"""Network of other inputs than a planner with a lidar."""


@pytest.mark.parametrize(
    ("parameters", "said"),
    [
        ({"policy": "network.onnx"}, "takes observation"),
        ({"policy": "none.onnx"}, "there is no file none.onnx"),
        ({"policy": "lidar-ppo"}, "planner 'lidar-ppo' would scan the map"),
        ({"policy": "gap-follower:top_speed=5"}, "planner 'gap-follower' would scan the map"),
        ({"policy": "latice"}, "did you mean 'lattice'"),
        ({"speed_share": 30.0}, "speed_share is 30.0; it must be above 0 and at most 1.5"),
        ({"timeout": np.nan}, "timeout is nan"),
        ({"to_centre": np.inf}, "to_centre is inf"),
    ],
)
def test_bad_parameters_are_refused(ros, lidar_ppo, tmp_path, monkeypatch, parameters, said):
    monkeypatch.chdir(tmp_path)
    onnx = pytest.importorskip("onnx")
    model = onnx.parser.parse_model(OTHER)
    about = {
        "name": "other",
        "period": 0.1,
        "inputs": {"observation": []},
        "outputs": {"command": []},
    }
    onnx.helper.set_model_props(model, {"pcs_racing": json.dumps(about)})
    onnx.save(model, "network.onnx")
    refused(said, ros("planning").Planning, error=ValueError, **parameters)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"period": "x"}, "period 'x'; it must be a number from"),
        ({"period": -1}, "period -1; it must be"),
        ({"period": None}, "period None; it must be"),
        ({"state": {"memory": "nothing"}}, "its description has others"),
        ({"state": 3}, "was not written by pcs-racing export"),
        ({"inputs": None}, "was not written by pcs-racing export"),
        ({"inputs": {"ranges": {}, "own": {}}, "state": {}}, "its description has others"),
        ({"inputs": {"ranges": [], "own": {}}}, "describes no beams"),
        ({"inputs": {"ranges": {"beams": 270}, "own": {}}}, "angle_min None"),
        ({"ranges": {"beams": 270}}, "270 beams from -2.35 to 2.35 rad"),
        ({"ranges": {"angle_min": 3.0}}, "271 beams from 3 to 2.35 rad"),
        ({"ranges": {"max_range": "far"}}, "max_range 'far'"),
        ({"vehicle": None}, "no vehicle"),
        ({"vehicle": {"wheelbase": 0.0}}, "wheelbase 0.0; it must be a number from 0.01"),
    ],
)
def test_a_file_is_checked_before_the_first_command(ros, lidar_ppo, tmp_path, change, said):
    onnx = pytest.importorskip("onnx")
    model = onnx.load(lidar_ppo)
    about = json.loads(model.metadata_props[0].value)
    about["inputs"]["ranges"] |= change.pop("ranges", {})
    onnx.helper.set_model_props(model, {"pcs_racing": json.dumps(about | change)})
    onnx.save(model, tmp_path / "other.onnx")
    refused(said, ros("planning").Planning, str(tmp_path / "other.onnx"), error=ValueError)


@pytest.fixture
def spun(monkeypatch) -> list[Node]:
    """Nodes that spin, with replacements for ROS that record messages by topic."""
    replaced = modules() or pytest.skip("ROS is installed")
    frames = SimpleNamespace(TFMessage=replaced["geometry_msgs.msg"].TFMessage)
    for name, module in {**replaced, "tf2_msgs": frames, "tf2_msgs.msg": frames}.items():
        monkeypatch.setitem(sys.modules, name, module)

    def create_publisher(node, kind, topic, *other):
        node.published = getattr(node, "published", {})
        return SimpleNamespace(publish=lambda message: node.published.update({topic: message}))

    monkeypatch.setattr(Node, "create_publisher", create_publisher)
    nodes: list[Node] = []
    monkeypatch.setattr(replaced["rclpy"], "spin", nodes.append)
    return nodes


def odometry_at(s: float) -> dict[str, float]:
    """Return the odometry of a car on the race line, as a replacement for ROS takes it."""
    x, y, heading = load_track("Brackwater").to_cartesian([s, 0.0])
    pose = {"pose_x": x, "pose_y": y, "pose_theta": heading}
    return pose | {"linear_vel_x": 4.0, "linear_vel_y": 0.0, "angular_vel_z": 0.0}


def test_the_planner_node_publishes_commands(ros, spun):
    ros("nodes").planner()
    (node,) = spun
    for k in range(5):
        ask_node(node, 0.02 * k, np.ones(9), odometry_at(0.0), odometry_at(2.0))
    drive = node.published["/drive"].drive
    assert drive.speed > 3.0
    assert abs(drive.steering_angle) < 0.42


def test_the_simulator_node_publishes_what_the_gym_does(ros, spun):
    ros("nodes").simulator()
    (node,) = spun
    assert node.published["/map"].info.resolution > 0.0
    for k in range(3):
        ask_node(node, 0.02 * k, np.ones(9), odometry_at(5.0), {})  # which is /initialpose, too
    topics = {"/map", "/scan", "/opp_scan", "/ego_racecar/odom", "/opp_racecar/odom", "/tf"}
    assert node.published.keys() == topics
    assert len(node.published["/scan"].ranges) == 1080
    at = node.published["/ego_racecar/odom"].pose.pose.position
    assert np.hypot(at.x - odometry_at(5.0)["pose_x"], at.y - odometry_at(5.0)["pose_y"]) < 0.1


ALONE = """
import runpy, sys

class Blocked:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in ("pcs_racing", "pcs_racing_agents", "torch", "onnx"):
            raise ImportError(f"{name} is blocked")

sys.meta_path.insert(0, Blocked())
package, file = sys.argv[1:]
sys.path.insert(0, package)
sys.argv = ["onnx_policy.py", file, "--hz", "100", "--seconds", "0.2"]
runpy.run_path(f"{package}/pcs_racing_ros/onnx_policy.py", run_name="__main__")

from pcs_racing_ros.planning import Planning

print("planner node:", Planning(file).command(0.0))
"""


def test_runner_and_planner_node_run_a_file_without_our_packages(lidar_ppo, tmp_path):
    (tmp_path / "alone.py").write_text(ALONE, encoding="utf-8")
    command = [sys.executable, "alone.py", str(PACKAGE), str(lidar_ppo)]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "'command': [" in done.stdout
    assert "2 decisions: " in done.stdout  # one in 0.1 s
    assert "planner node: (0.0, 0.0)" in done.stdout


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["none.onnx"], "there is no file none.onnx"),
        (["junk.onnx"], "junk.onnx is no ONNX file"),
        (["other.onnx"], "other.onnx was not written by pcs-racing export"),
        (["garbled.onnx"], "garbled.onnx was not written by pcs-racing export"),
        (["junk.onnx", "--hz", "0"], "argument --hz: 0 is not above 0"),
        (["junk.onnx", "--hz", "fast"], "argument --hz: invalid positive value: 'fast'"),
        (["junk.onnx", "--seconds", "nan"], "argument --seconds: nan is not above 0"),
    ],
)
def test_the_runner_refuses_bad_input_by_a_line(
    ros, lidar_ppo, tmp_path, monkeypatch, capsys, arguments, said
):
    onnx = pytest.importorskip("onnx")
    model = onnx.load(lidar_ppo)
    for name, about in (("other", {}), ("garbled", {"pcs_racing": "{"})):
        onnx.helper.set_model_props(model, about)
        onnx.save(model, tmp_path / f"{name}.onnx")
    (tmp_path / "junk.onnx").write_text("junk", encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["onnx_policy.py", *arguments])
    with pytest.raises(SystemExit, match="2"):
        ros("onnx_policy").main()
    *usage, line = capsys.readouterr().err.splitlines()
    assert said in line
    assert all("Traceback" not in one for one in usage)


# The files of the package


def test_the_package_installs_what_it_names(tmp_path):
    """It builds without ROS, and package.xml, launch file and parameters fit its nodes."""
    pytest.importorskip("setuptools")
    source = shutil.copytree(PACKAGE, tmp_path / "source")
    code = "from setuptools.build_meta import build_wheel; print(build_wheel('.'))"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=source, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    (wheel,) = source.glob("*.whl")
    with zipfile.ZipFile(wheel) as file:
        installed = set(file.namelist())
        (entries,) = (name for name in installed if name.endswith("entry_points.txt"))
        lines = file.read(entries).decode().splitlines()
    nodes = dict(line.split(" = ") for line in lines if " = " in line)
    manifest = ElementTree.parse(PACKAGE / "package.xml").getroot()
    assert (manifest.findtext("name"), manifest.findtext("export/build_type")) == (
        NAME,
        "ament_python",
    )
    assert wheel.name.startswith(f"{NAME}-{manifest.findtext('version')}-")
    data = f"{NAME}-{manifest.findtext('version')}.data/data/share"
    shared = {
        f"{data}/ament_index/resource_index/packages/{NAME}",
        *(f"{data}/{NAME}/{one}" for one in ("package.xml", "launch/race.launch.py")),
        f"{data}/{NAME}/config/parameters.yaml",
    }
    assert shared <= installed
    modules = {f"{NAME}/{path.name}" for path in (PACKAGE / NAME).glob("*.py")}
    assert modules <= installed
    assert nodes == {name: f"{NAME}.nodes:{name}" for name in ("planner", "simulator")}


def test_the_parameters_are_those_of_the_nodes(ros):
    nodes, text = ros("nodes"), (PACKAGE / "config" / "parameters.yaml").read_text("utf-8")
    values = {name: one["ros__parameters"] for name, one in yaml.safe_load(text).items()}
    assert values == {"simulator": nodes.SIMULATOR, "planner": nodes.PLANNER}
