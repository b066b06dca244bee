"""Cars and scans as messages of ROS 2, and a race as a video."""

import numpy as np
import pytest
from refusal import refused

from pcs_racing import load_rules, load_track, racer, record_race
from pcs_racing.car.lidar import Lidar
from pcs_racing_agents.watch.frames import write_video
from pcs_racing_agents.watch.ros_messages import (
    car_topics,
    map_message,
    pose_messages,
    scan_message,
)


@pytest.fixture(scope="module")
def race():
    calm, bold = racer("lattice:pace=0.3"), racer("lattice:pace=0.6")
    return record_race(load_track("Pipkin"), calm, bold, load_rules("paper", duration=1.0), seed=1)


def quaternion(psi):
    return {
        "x": 0.0,
        "y": 0.0,
        "z": pytest.approx(np.sin(psi / 2.0)),
        "w": pytest.approx(np.cos(psi / 2.0)),
    }


def test_each_message_holds_what_the_race_says_at_its_time(race):
    """All fields of the cars, from their states x, y, delta, v, psi, psi_dot and beta."""
    track = load_track("Pipkin")
    lidar, circuit, arrays = Lidar(track, beams=9), map_message(track), track.arrays
    assert circuit[:3] == ("/map", "nav_msgs/msg/OccupancyGrid", 0)
    info = circuit.fields["info"]
    assert (info["width"], info["height"]) == arrays.distance.shape[::-1]
    assert info["resolution"] == arrays.cell
    assert info["origin"]["position"] == {"x": arrays.origin_x, "y": arrays.origin_y, "z": 0.0}
    assert set(circuit.fields["data"]) == {0, 100}
    for frame, states in enumerate(race.cars):
        time = round(frame * 4e7)
        *odometry, tf = pose_messages(states, time)
        stamp = {"sec": time // 10**9, "nanosec": time % 10**9}
        assert tf[:3] == ("/tf", "tf2_msgs/msg/TFMessage", time)
        for car, (message, state) in enumerate(zip(odometry, states, strict=True)):
            name = ("ego", "opp")[car]
            odom = (f"/{name}_racecar/odom", "nav_msgs/msg/Odometry", time)
            assert message[:3] == odom
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
        for car, name in enumerate(("ego", "opp")):
            ranges = lidar.scan(states[car, [0, 1, 4]], states[1 - car, [0, 1, 4]])
            scan = scan_message(lidar, ranges, car, time)
            assert scan[:3] == (("/scan", "/opp_scan")[car], "sensor_msgs/msg/LaserScan", time)
            assert scan.fields.pop("ranges") == ranges.tolist()
            assert scan.fields == {
                "header": {"stamp": stamp, "frame_id": f"{name}_racecar/laser"},
                "angle_min": -2.35,
                "angle_max": 2.35,
                "angle_increment": pytest.approx(4.7 / 8),
                "range_max": 30.0,
            }
    assert car_topics(2) == ("opp2_racecar", "/opp2_scan", "/opp2_racecar/odom")


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
