"""Logs of a driving car: files, and mistakes that are found before a search."""

from dataclasses import replace

import numpy as np
import pytest
from refusal import refused

from pcs_racing import load_race_config, load_track, parse_policy, record_race, save_replay
from pcs_racing.car.vehicle import F1TENTH_PACEJKA
from pcs_racing.identification import (
    DrivingLog,
    SensorNoise,
    read_log,
    record_test_drive,
    write_log,
)
from pcs_racing.identification.windows import make_windows


@pytest.fixture(scope="module")
def log():
    return record_test_drive(F1TENTH_PACEJKA, 6.0, effort=0.4, noise=SensorNoise(), seed=1)


def changed(log, **columns):
    return DrivingLog(**{**dict(log.columns()), **columns})


def test_a_seed_is_one_drive_and_noise_has_the_stated_size(log):
    same = record_test_drive(F1TENTH_PACEJKA, 6.0, effort=0.4, noise=SensorNoise(), seed=1)
    exact = record_test_drive(F1TENTH_PACEJKA, 6.0, effort=0.4, seed=1)
    np.testing.assert_array_equal(log.v_x, same.v_x)
    np.testing.assert_array_equal(log.steer, exact.steer)
    for name, deviation in (("v_x", 0.05), ("psi_dot", 0.05), ("delta", 0.01), ("x", 0.02)):
        noise = getattr(log, name) - getattr(exact, name)
        assert np.std(noise) == pytest.approx(deviation, rel=0.15)


def test_late_commands_arrive_late():
    late = replace(F1TENTH_PACEJKA, steer_delay=0.1)
    on_time, delayed = (record_test_drive(car, 6.0, effort=0.2) for car in (F1TENTH_PACEJKA, late))
    np.testing.assert_allclose(delayed.delta[5:], on_time.delta[:-5], atol=1e-12)


def test_a_csv_file_holds_a_log_and_other_columns_are_left_out(log, tmp_path):
    file = write_log(log, tmp_path / "drive.csv")
    again = read_log(file)
    assert [name for name, _ in again.columns()] == [name for name, _ in log.columns()]
    np.testing.assert_allclose(again.psi_dot, log.psi_dot, rtol=1e-5, atol=1e-6)
    lines = file.read_text().splitlines()
    file.write_text("\n".join([f"{lines[0]},battery", *(f"{line},7.4" for line in lines[1:])]))
    np.testing.assert_array_equal(read_log(file).steer, again.steer)


def test_a_replay_is_a_log_of_each_car(tmp_path):
    rules = load_race_config("paper", duration=6.0)
    policies = parse_policy("lattice"), parse_policy("pure-pursuit")
    race = record_race(load_track("Pipkin"), *policies, rules, seed=1)
    file = save_replay(race, tmp_path / "race.json")
    log = read_log(file, car=1)
    assert log.steer is None
    np.testing.assert_allclose(log.x, race.cars[:, 1, 0], atol=1e-3)
    np.testing.assert_allclose(np.hypot(log.v_x, log.v_y), race.cars[:, 1, 3], atol=2e-3)
    refused("car is 2; it must be a whole number from 0 to 1", read_log, file, car=2)


@pytest.mark.parametrize(
    ("column", "change", "message"),
    [
        ("t", lambda t: t[::-1], "goes from 5.98 to 5.96 s at row 1"),
        ("t", lambda t: 0.1 * t, "the log lasts 0.598 s; it must last at least 5 s"),
        ("t", lambda t: np.where(t > 3.0, t - 1.0, t), "the time of the log goes from 3 to 2.02 s"),
        ("t", lambda t: np.where(t > 3.0, t + 1.0, t), "a gap of 1.02 s after t = 3 s"),
        ("t", lambda t: 1e3 * t, "the rows of the log are 20 s apart"),
        ("steer", np.degrees, "steer of the log reaches .*; in rad .*: is it in deg"),
        ("psi_dot", np.degrees, "psi_dot of the log reaches .*: is it in deg/s"),
        ("psi", np.degrees, "psi_dot of the log is .* times as large as psi says"),
        ("v_x", lambda v: 3.6 * v, "v_x of the log is 3.* times as large as the path x, y says"),
        ("steer", lambda angle: -angle, ""),
        ("delta", lambda angle: -angle, "turns right where it steers left"),
        ("v_x", lambda v: np.where(v == v[7], np.nan, v), "column 'v_x' of the log is nan in row"),
        ("v_x", lambda v: v[:-1], "column 'v_x' of the log has shape"),
        ("v_x", lambda v: ["fast"] * len(v), "column 'v_x' of the log must hold numbers"),
    ],
)
def test_mistakes_are_one_line(log, column, change, message):
    columns = {column: change(getattr(log, column))}
    if message:
        refused(message, changed, log, **columns)
    else:  # measured angles count, where both are given
        changed(log, **columns)


@pytest.mark.parametrize(
    ("absent", "message"),
    [
        (("steer", "delta"), "no column steer or delta; it has psi, psi_dot, speed"),
        (("v_x", "x", "y"), "no column v_x or x, y"),
        (("psi", "psi_dot"), "no column psi_dot or psi"),
        (("x",), "only one of the columns x and y"),
    ],
)
def test_missing_columns_are_named(log, absent, message):
    refused(message, log.without, *absent)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.csv", "", "is not a csv file"),
        ("a.csv", "time,v\n0,1\n", "t among them; it begins with time, v"),
        ("a.csv", "t,v_x\n0,1\n1,fast\n", "row 1 of .* is 1,fast; it must hold 2 numbers"),
        ("a.csv", "t,v_x\n0,1\n1\n", "row 1 of .* is 1; it must hold 2 numbers"),
        ("a.db3", "", "'ros2 bag convert' makes MCAP of it"),
        ("a.txt", "", "is no log: give a .csv, .mcap, .json or .html file"),
        ("a.json", "{}", "is not a replay"),
    ],
)
def test_damaged_files_are_one_line(tmp_path, name, content, message):
    (tmp_path / name).write_text(content)
    refused(message, read_log, tmp_path / name)


def test_rows_at_uneven_times_become_even(log):
    uneven = np.delete(np.arange(len(log.t)), np.arange(5, 290, 7))
    columns = {name: values[uneven] for name, values in log.columns()}
    windows = make_windows(DrivingLog(**columns), F1TENTH_PACEJKA)
    assert windows.period == pytest.approx(0.02)
    assert len(windows.rows) == 11  # the last one is not complete
    np.testing.assert_allclose(
        windows.v, make_windows(log, F1TENTH_PACEJKA).v[: len(windows.v)], atol=0.1
    )


ACKERMANN = """std_msgs/Header header
AckermannDrive drive
================================================================================
MSG: ackermann_msgs/AckermannDrive
float32 steering_angle
float32 steering_angle_velocity
float32 speed
float32 acceleration
float32 jerk
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
ODOMETRY = "nav_msgs/msg/Odometry"
DRIVE = "ackermann_msgs/msg/AckermannDriveStamped"


def write_bag(log, path, odometry, kinds):
    """Write odometry and commands as ROS 2 messages, under topics of the same kinds."""
    from mcap_ros2.writer import Writer

    with path.open("wb") as file, Writer(file) as writer:
        schemas = {
            ODOMETRY: writer.register_msgdef(ODOMETRY, odometry),
            DRIVE: writer.register_msgdef(DRIVE, ACKERMANN),
        }
        for row, t in enumerate(log.t):
            time = round(1e9 * (t + 100.0))
            header = {"stamp": {"sec": time // 10**9, "nanosec": time % 10**9}, "frame_id": ""}
            half = 0.5 * log.psi[row]
            turned = {"x": 0.0, "y": 0.0, "z": np.sin(half), "w": np.cos(half)}
            pose = {"position": {"x": log.x[row], "y": log.y[row], "z": 0.0}, "orientation": turned}
            twist = {"linear": {"x": log.v_x[row]}, "angular": {"z": log.psi_dot[row]}}
            fields = {
                ODOMETRY: {"header": header, "pose": {"pose": pose}, "twist": {"twist": twist}},
                DRIVE: {
                    "header": header,
                    "drive": {"steering_angle": log.steer[row], "speed": log.speed[row]},
                },
            }
            for topic, kind in kinds.items():
                writer.write_message(topic, schemas[kind], fields[kind], time, time)


@pytest.fixture(scope="module")
def odometry():
    pytest.importorskip("mcap_ros2", reason="mcap-ros2-support is not installed")
    from pcs_racing_agents.watch.ros_messages import definition

    return definition(ODOMETRY)


def test_a_bag_is_read_by_the_types_of_its_topics(log, tmp_path, odometry):
    path = tmp_path / "bag.mcap"
    write_bag(log, path, odometry, {"/odom": ODOMETRY, "/drive": DRIVE})
    read = read_log(tmp_path)
    assert [name for name, _ in read.columns()] == [
        *("t", "v_x", "psi_dot", "steer", "speed", "x", "y", "psi")
    ]
    np.testing.assert_allclose(read.t, log.t, atol=1e-6)
    np.testing.assert_allclose(read.steer, log.steer, atol=1e-6)
    np.testing.assert_allclose(np.sin(read.psi), np.sin(log.psi), atol=1e-9)
    write_bag(log, path, odometry, {"/odom": ODOMETRY, "/pf": ODOMETRY, "/drive": DRIVE})
    refused("2 topics for odom: choose one of /odom, /pf", read_log, path)
    assert read_log(path, topics={"odom": "/pf"}).duration == pytest.approx(log.duration)
    refused("topic odom is '/tf'; it must be one of", read_log, path, topics={"odom": "/tf"})
    refused("the name of a topic is 'pose'", read_log, path, topics={"pose": "/pf"})
    write_bag(log, path, odometry, {"/odom": ODOMETRY})
    refused("has no topic of type ackermann_msgs/msg/Ackermann", read_log, path)
    path.write_bytes(path.read_bytes()[:1000])
    refused("bag.mcap", read_log, path)
