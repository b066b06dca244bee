"""A race as messages of ROS 2, read again by two other libraries, and the bridge's logic without
ROS.
"""

import re
from dataclasses import replace

import numpy as np
import pytest
from refusal import refused

from pcs_racing import load_rules, load_track, racer, record_race
from pcs_racing.car.lidar import Lidar
from pcs_racing_agents.watch.frames import write_video
from pcs_racing_agents.watch.ros_messages import car_topics, definition, race_messages, write_bag


@pytest.fixture(scope="module")
def race():
    calm, bold = racer("lattice:pace=0.3"), racer("lattice:pace=0.6")
    return record_race(load_track("Pipkin"), calm, bold, load_rules("paper", duration=1.0), seed=1)


TOPICS = {
    "/map": "nav_msgs/msg/OccupancyGrid",
    "/scan": "sensor_msgs/msg/LaserScan",
    "/opp_scan": "sensor_msgs/msg/LaserScan",
    "/ego_racecar/odom": "nav_msgs/msg/Odometry",
    "/opp_racecar/odom": "nav_msgs/msg/Odometry",
    "/tf": "tf2_msgs/msg/TFMessage",
}


def test_what_is_published_when(race):
    messages = list(race_messages(race, load_track("Pipkin"), beams=9))
    assert {message.topic: message.kind for message in messages} == TOPICS
    times = [message.time for message in messages]
    assert times == sorted(times)
    assert times[-1] == 10**9
    assert len(messages) == 1 + 5 * len(race.cars)
    kinds = re.findall("^MSG: ([a-z0-9_]+)/([A-Z][A-Za-z]+)$", definition(TOPICS["/tf"]), re.M)
    assert {("geometry_msgs", "TransformStamped"), ("std_msgs", "Header")} <= set(kinds)


def quaternion(psi):
    return {
        "x": 0.0,
        "y": 0.0,
        "z": pytest.approx(np.sin(psi / 2.0)),
        "w": pytest.approx(np.cos(psi / 2.0)),
    }


def test_each_message_holds_what_the_race_says_at_its_time(race):
    """All fields of the cars, from their states x, y, delta, v, psi, psi_dot and beta."""
    track, lidar = load_track("Pipkin"), Lidar(load_track("Pipkin"), beams=9)
    circuit, *messages = race_messages(race, track, beams=9)
    info, arrays = circuit.fields["info"], track.arrays
    assert (info["width"], info["height"], info["resolution"]) == (
        *arrays.distance.shape[::-1],
        arrays.cell,
    )
    assert info["origin"]["position"] == {"x": arrays.origin_x, "y": arrays.origin_y, "z": 0.0}
    assert set(circuit.fields["data"]) == {0, 100}
    for frame, states in enumerate(race.cars):
        time = round(frame * 4e7)
        own, other, *odometry, tf = messages[5 * frame : 5 * frame + 5]
        stamp = {"sec": time // 10**9, "nanosec": time % 10**9}
        for car, (message, state) in enumerate(zip(odometry, states, strict=True)):
            name = ("ego", "opp")[car]
            x, y, _, v, psi, psi_dot, beta = state
            pose = {"position": {"x": x, "y": y, "z": 0.0}, "orientation": quaternion(psi)}
            linear = {
                "x": pytest.approx(v * np.cos(beta)),
                "y": pytest.approx(v * np.sin(beta)),
                "z": 0.0,
            }
            assert message.fields == {
                "header": {"stamp": stamp, "frame_id": "map"},
                "child_frame_id": f"{name}_racecar/base_link",
                "pose": {"pose": pose},
                "twist": {"twist": {"linear": linear, "angular": {"z": psi_dot}}},
            }
            moved = {"translation": pose["position"], "rotation": pose["orientation"]}
            still = {"translation": {"x": 0.0, "y": 0.0, "z": 0.0}, "rotation": quaternion(0.0)}
            frames = [("map", f"{name}_racecar/base_link", moved)]
            frames += [(f"{name}_racecar/base_link", f"{name}_racecar/laser", still)]
            assert tf.fields["transforms"][2 * car : 2 * car + 2] == [
                {
                    "header": {"stamp": stamp, "frame_id": parent},
                    "child_frame_id": child,
                    "transform": transform,
                }
                for parent, child, transform in frames
            ]
        for car, scan in enumerate((own, other)):
            ranges = scan.fields.pop("ranges")
            assert ranges == lidar.scan(states[car, [0, 1, 4]], states[1 - car, [0, 1, 4]]).tolist()
            assert scan.fields == {
                "header": {"stamp": stamp, "frame_id": f"{('ego', 'opp')[car]}_racecar/laser"},
                "angle_min": -2.35,
                "angle_max": 2.35,
                "angle_increment": pytest.approx(4.7 / 8),
                "range_max": 30.0,
            }
    assert car_topics(2) == ("opp2_racecar", "/opp2_scan", "/opp2_racecar/odom")
    alone = replace(
        race,
        car_names=("a",),
        cars=race.cars[:1, :1],
        progress=race.progress[:1, :1],
        paths=None,
        ittc=None,
        events=(),
        candidates=None,
        costs=None,
    )
    _, scan, _, _ = race_messages(alone, track, beams=9)
    assert scan.fields["ranges"] == lidar.scan(race.cars[0, 0, [0, 1, 4]], None).tolist()


def check_read(race, kept):
    """The messages that a library reads again, by topic, are the race."""
    expected = {topic: 1 if topic == "/map" else len(race.cars) for topic in TOPICS}
    assert {topic: len(found) for topic, found in kept.items()} == expected
    track, last = load_track("Pipkin"), race.cars[-1]
    pose = kept["/opp_racecar/odom"][-1].pose.pose
    assert [pose.position.x, pose.position.y] == last[1, :2].tolist()
    scan = kept["/scan"][-1]
    expected = Lidar(track, beams=9).scan(last[0, [0, 1, 4]], last[1, [0, 1, 4]])
    np.testing.assert_array_equal(np.asarray(scan.ranges), expected.astype(np.float32))
    cells = np.reshape(kept["/map"][0].data, track.arrays.distance.shape)
    np.testing.assert_array_equal(cells == 0, track.arrays.distance > 0.0)


def test_mcap_ros2_reads_the_file_again(race, tmp_path):
    reader = pytest.importorskip(
        "mcap_ros2.reader", reason="mcap-ros2-support, of the extra ros, is not installed"
    )
    path = write_bag(race, load_track("Pipkin"), tmp_path / "race.mcap", beams=9)
    kept = {}
    for message in reader.read_ros2_messages(str(path)):
        kept.setdefault(message.channel.topic, []).append(message.ros_msg)
    check_read(race, kept)


def test_other_names_of_files_are_refused_and_a_video_is_written(race, tmp_path):
    refused("write_video writes .mp4 files", write_video, race, tmp_path / "race.avi")
    ffmpeg = pytest.importorskip(
        "imageio_ffmpeg", reason="imageio-ffmpeg, of the extra video, is not installed"
    )
    path = write_video(race, tmp_path / "race.mp4")
    about = next(ffmpeg.read_frames(str(path)))
    assert about["size"] == (960, 640)
    assert (about["fps"], about["duration"]) == (25.0, pytest.approx(1.04, abs=0.05))
    assert [file.name for file in tmp_path.iterdir()] == ["race.mp4"]
