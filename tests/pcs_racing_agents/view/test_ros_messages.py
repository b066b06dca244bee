"""A race as messages of ROS 2, read again by two other libraries, and the bridge's logic without ROS."""

import numpy as np
import pytest
from refusal import refused

from pcs_racing import Lidar, load_race_config, load_track, parse_policy, record_race
from pcs_racing.race.frames import write_video
from pcs_racing_agents.view.ros_messages import definition, race_messages, write_bag


@pytest.fixture(scope="module")
def race():
    calm, bold = parse_policy("lattice:pace=0.3"), parse_policy("lattice:pace=0.6")
    return record_race(load_track("Pipkin"), calm, bold, load_race_config("paper", duration=1.0), seed=1)


TOPICS = {
    "/map": "nav_msgs/msg/OccupancyGrid",
    "/scan": "sensor_msgs/msg/LaserScan",
    "/opp_scan": "sensor_msgs/msg/LaserScan",
    "/ego_racecar/odom": "nav_msgs/msg/Odometry",
    "/opp_racecar/odom": "nav_msgs/msg/Odometry",
    "/tf": "tf2_msgs/msg/TFMessage",
    "/race_markers": "visualization_msgs/msg/MarkerArray",
}


def test_what_is_published_when(race):
    messages = list(race_messages(race, load_track("Pipkin"), beams=9))
    assert {message.topic: message.kind for message in messages} == TOPICS
    times = [message.time for message in messages]
    assert times == sorted(times)
    assert times[-1] == 10**9
    assert len(messages) == 1 + 6 * len(race.cars)
    # TransformStamped, Header, Time, Transform, Vector3, Quaternion
    assert definition("tf2_msgs/msg/TFMessage").count("MSG: ") == 6


def check_read(race, kept):
    """What a library read again, by topic, is the race."""
    expected = {topic: 1 if topic == "/map" else len(race.cars) for topic in TOPICS}
    assert {topic: len(found) for topic, found in kept.items()} == expected
    track, last = load_track("Pipkin"), race.cars[-1]
    odometry = kept["/opp_racecar/odom"][-1]
    assert (odometry.header.frame_id, odometry.child_frame_id) == ("map", "opp_racecar/base_link")
    assert odometry.header.stamp.sec == 1
    pose = odometry.pose.pose
    heading = 2.0 * np.arctan2(pose.orientation.z, pose.orientation.w)
    np.testing.assert_allclose(np.exp(1j * heading), np.exp(1j * last[1, 4]), atol=1e-12)
    assert [pose.position.x, pose.position.y] == last[1, :2].tolist()
    assert np.hypot(odometry.twist.twist.linear.x, odometry.twist.twist.linear.y) == pytest.approx(last[1, 3])
    scan = kept["/scan"][-1]
    expected = Lidar(track, beams=9).scan(last[0, [0, 1, 4]], last[1, [0, 1, 4]])
    np.testing.assert_array_equal(np.asarray(scan.ranges), expected.astype(np.float32))
    assert scan.angle_min + 8 * scan.angle_increment == pytest.approx(scan.angle_max)
    cells = np.reshape(kept["/map"][0].data, track.arrays.distance.shape)
    np.testing.assert_array_equal(cells == 0, track.arrays.distance > 0.0)
    frames = {(one.header.frame_id, one.child_frame_id) for one in kept["/tf"][0].transforms}
    assert ("map", "ego_racecar/base_link") in frames
    assert ("opp_racecar/base_link", "opp_racecar/laser") in frames
    assert len(kept["/race_markers"][-1].markers) == 4


def test_mcap_ros2_reads_the_file_again(race, tmp_path):
    reader = pytest.importorskip("mcap_ros2.reader", reason="mcap-ros2-support, of the extra ros, is not installed")
    path = write_bag(race, load_track("Pipkin"), tmp_path / "race.mcap", beams=9)
    kept = {}
    for message in reader.read_ros2_messages(str(path)):
        kept.setdefault(message.channel.topic, []).append(message.ros_msg)
    check_read(race, kept)


def test_rosbags_reads_the_file_again(race, tmp_path):
    """It knows the definitions of ROS 2 by itself; those in the file must be the same."""
    pytest.importorskip("mcap_ros2", reason="mcap-ros2-support, of the extra ros, is not installed")
    rosbags = pytest.importorskip("rosbags.highlevel", reason="rosbags, of the extra test, is not installed")
    from rosbags.typesys import Stores, get_typestore

    path = write_bag(race, load_track("Pipkin"), tmp_path / "race.mcap", beams=9)
    store, kept = get_typestore(Stores.ROS2_HUMBLE), {}
    with rosbags.AnyReader([path], default_typestore=store) as reader:
        for connection, _, data in reader.messages():
            kept.setdefault(connection.topic, []).append(store.deserialize_cdr(data, connection.msgtype))
    check_read(race, kept)


def test_other_names_of_files_are_refused_and_a_video_is_written(race, tmp_path):
    refused("write_bag writes .mcap files", write_bag, race, load_track("Pipkin"), tmp_path / "race.bag")
    refused("write_video writes .mp4 files", write_video, race, tmp_path / "race.avi")
    ffmpeg = pytest.importorskip("imageio_ffmpeg", reason="imageio-ffmpeg, of the extra video, is not installed")
    path = write_video(race, tmp_path / "race.mp4")
    about = next(ffmpeg.read_frames(str(path)))
    assert about["size"] == (960, 640)
    assert (about["fps"], about["duration"]) == (25.0, pytest.approx(1.04, abs=0.05))
    assert [file.name for file in tmp_path.iterdir()] == ["race.mp4"]
