"""The package of ROS 2: its logic without ROS, its files, and a runner without our packages."""

import importlib
import shutil
import subprocess
import sys
import zipfile
from types import SimpleNamespace
from xml.etree import ElementTree

import numpy as np
import pytest
import yaml
from repository import REPOSITORY

from pcs_racing import load_track
from pcs_racing.envs import PolicyOnCar
from pcs_racing.planners.ros_nodes import Node, ask_node, modules
from pcs_racing_agents.agents import export_onnx

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
    frames = SimpleNamespace(transforms=None)

    def new():
        parts = SimpleNamespace(translation=SimpleNamespace(), rotation=SimpleNamespace())
        return SimpleNamespace(header=SimpleNamespace(stamp=SimpleNamespace()), transform=parts)

    ros("messages").fill(frames, messages["/tf"].fields, {"transforms": new})
    assert [frame.child_frame_id for frame in frames.transforms][:2] == [
        "ego_racecar/base_link",
        "ego_racecar/laser",
    ]


@pytest.mark.parametrize("policy", ["line-ppo", "lidar-ppo"])
def test_a_policy_drives_by_messages_as_in_races(ros, lidar_ppo, policy):
    """The simulator's messages go to the planner node's logic, and its commands come back."""
    race = ros("simulation").Simulation("Brackwater", opponent="lattice:pace=0", seed=1, beams=271)
    planning = ros("planning").Planning(str(lidar_ppo) if policy == "lidar-ppo" else policy)
    on_car = PolicyOnCar(policy, "Brackwater")
    kinds = {"/scan": "scan", "/ego_racecar/odom": "odometry", "/opp_racecar/odom": "opponent"}
    began = race.info["car_0"]["progress"]
    for k in range(400):
        for one in race.step():
            if one.topic in kinds:
                planning.hear(kinds[one.topic], message(one.fields, range_min=0.0), 1e-9 * one.time)
        command = planning.command(1e-9 * one.time)
        race.command(0, *command)
        car, opponent = (
            ros("messages").state_of(planning.heard[kind][1], steering, 0.0)
            for kind, steering in (("odometry", planning.steering), ("opponent", 0.0))
        )
        expected = on_car.command(0.02 * k, car, opponent)
        assert (np.abs(np.subtract(command, expected)) < [0.01, 0.1]).all()  # rad, m/s
        assert race.env.agents  # no crash ended the race
    assert race.info["car_0"]["progress"] - began > 55.0  # m in 8 s


def odometry(x=1.0, y=2.0, heading=0.0, vx=3.0, vy=0.0, yaw_rate=0.0):
    quaternion = {"z": np.sin(0.5 * heading), "w": np.cos(0.5 * heading)}
    pose = {"pose": {"position": {"x": x, "y": y}, "orientation": quaternion}}
    twist = {"twist": {"linear": {"x": vx, "y": vy}, "angular": {"z": yaw_rate}}}
    return message({"pose": pose, "twist": twist})


def test_odometry_of_the_rear_axle_becomes_the_state_of_the_centre(ros):
    heard = odometry(heading=0.5 * np.pi, vx=2.0, yaw_rate=1.0)
    found = ros("messages").state_of(heard, 0.1, 0.17)
    x, y, steering, speed, heading, yaw_rate, slip = found
    np.testing.assert_allclose([x, y, steering, heading], [1.0, 2.17, 0.1, 0.5 * np.pi])
    np.testing.assert_allclose([speed * np.cos(slip), speed * np.sin(slip)], [2.0, 0.17])
    assert yaw_rate == 1.0


def test_a_beam_without_a_range_sees_nothing_and_a_near_obstacle_is_near(ros):
    ranges = [1.0, 2.0, 0.0, np.inf, np.nan, 20.0, -np.inf]
    heard = SimpleNamespace(angle_min=-1.0, angle_increment=0.5, range_min=0.1, ranges=ranges)
    angles = np.array([-1.5, -1.0, -0.4, 0.0, 0.5, 1.0, 1.5, 2.0])
    found = ros("messages").ranges_at(heard, angles, 15.0)
    np.testing.assert_array_equal(found, [15.0, 1.0, 2.0, 15.0, 15.0, 15.0, 15.0, 0.1])


UNUSABLE = {
    "empty": {"ranges": []},
    "NaN": {"ranges": [np.nan] * 271},
    "zeros": {"ranges": [0.0] * 271, "range_min": 0.0},
    "too near": {"ranges": [-np.inf] * 271},
    "a third": {"ranges": [2.0] * 90 + [np.nan] * 181},
    "a narrow view": {"ranges": [2.0] * 90},
    "no increment": {"angle_increment": 0.0},
    "increment of NaN": {"angle_increment": np.nan},
    "min range of NaN": {"range_min": np.nan},
}


@pytest.mark.parametrize("fields", UNUSABLE.values(), ids=UNUSABLE)
def test_with_an_unusable_scan_the_car_stops(ros, lidar_ppo, fields):
    planning = ros("planning").Planning(str(lidar_ppo))
    commands = []
    for time, more in (
        (0.0, {}),
        (0.1, fields),
        (0.12, fields),
        (0.14, {"ranges": [np.inf] * 271}),
    ):
        planning.hear("odometry", odometry(), time)
        planning.hear("scan", scan(**more), time)
        commands.append(planning.command(time))
    assert commands[1:3] == [(0.0, 0.0)] * 2
    assert min(commands[0][1], commands[3][1]) > 1.0


def test_without_fresh_messages_the_car_stops(ros):
    planning = ros("planning").Planning("pure-pursuit", "Pipkin", speed_share=0.5)
    x, y, heading = load_track("Pipkin").to_cartesian([0.0, 0.0])
    assert planning.command(5.0) == (0.0, 0.0)
    planning.hear("odometry", odometry(x, y, heading), 5.0)
    _, slow = planning.command(5.02)
    assert slow > 0.0
    planning.hear("opponent", odometry(np.nan), 5.02)
    assert planning.command(5.04) == (0.0, 0.0)
    planning.hear("odometry", odometry(x, y, heading), 5.3)  # the opponent is lost by now
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
            planning.hear(kind, heard, begin + 0.01)
        commands += [planning.command(begin + after) for after in (0.02, 0.04)]
        for kind, heard in (("odometry", odometry(x, y, heading)), ("scan", scan())):
            planning.hear(kind, heard, begin + 0.05)
        commands.append(planning.command(begin + 0.06))
    assert min(speed for _, speed in (*commands[:3], commands[5])) > 1.0
    assert commands[3:5] == [(0.0, 0.0)] * 2
    assert commands[5] == pytest.approx(commands[0], abs=0.02)  # rad, m/s; the servo moved
    planning.hear("odometry", odometry(x, y, heading), 50.2)  # by a clock that was set back since
    assert planning.command(50.1) == (0.0, 0.0)


def test_the_steering_angle_follows_the_command_to_stop(ros):
    planning = ros("planning").Planning("pure-pursuit", "Pipkin")
    x, y, heading = load_track("Pipkin").to_cartesian([0.0, 0.5])
    planning.hear("odometry", odometry(x, y, heading), 0.0)
    assert abs(planning.command(0.0)[0]) > 0.05
    assert planning.command(0.3) == (0.0, 0.0)  # until now the last command held
    assert abs(planning.steering) > 0.05
    planning.command(0.6)
    assert planning.steering == 0.0


@pytest.mark.parametrize(
    ("parameters", "said"),
    [
        ({"policy": "line-ppo.onnx"}, "takes situation, moves, speeds, candidates"),
        ({"policy": "none.onnx"}, "there is no file none.onnx"),
        ({"policy": "lidar-ppo"}, "lidar-ppo needs scans: pcs-racing export"),
        ({"policy": "latice"}, "did you mean 'lattice'"),
        ({"speed_share": 30.0}, "speed_share is 30.0; it must be above 0 and at most 1.5"),
        ({"timeout": np.nan}, "timeout is nan"),
    ],
)
def test_bad_parameters_are_refused(ros, lidar_ppo, tmp_path, monkeypatch, parameters, said):
    monkeypatch.chdir(tmp_path)
    export_onnx("line-ppo", "line-ppo.onnx")
    with pytest.raises(ValueError, match=said):
        ros("planning").Planning(**parameters)


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
