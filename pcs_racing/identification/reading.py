"""Logs from files: csv, recorded races, and MCAP files of ROS 2."""

import csv
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pcs_racing.base.checks import check_choice, check_whole
from pcs_racing.base.errors import InputError, require
from pcs_racing.base.files import read_limited
from pcs_racing.car.vehicle import BETA, DELTA, PSI, PSI_DOT, V, X, Y
from pcs_racing.identification.logs import COLUMNS, DrivingLog, Floats
from pcs_racing.race.replay import read_replay

_MAX_BYTES = 200_000_000
_MAX_MESSAGES = 500_000
_MAX_OFFSET = 10.0  # s between the stamp of a message and its place in the log
KINDS = {
    "odom": "nav_msgs/msg/Odometry",
    "drive": "ackermann_msgs/msg/AckermannDriveStamped",
    "imu": "sensor_msgs/msg/Imu",
}
"""Message types by the names of their topics in ``topics``."""


def read_log(
    path: str | os.PathLike[str], *, car: int = 0, topics: Mapping[str, str] | None = None
) -> DrivingLog:
    """Read a log from a file; its ending decides the format.

    Parameters
    ----------
    path : path
        ``.csv`` with a row of names (:data:`pcs_racing.identification.logs.COLUMNS`), a replay
        (``.json``, ``.html``), or ``.mcap``, or the folder of a ROS 2 bag with one such file.
    car : int
        Car of a replay.
    topics : mapping of str to str, optional
        Topics of an MCAP file by ``odom``, ``drive`` and ``imu``, where a type has several.

    Returns
    -------
    DrivingLog
    """
    path = Path(path)
    if path.is_dir():
        files = sorted(path.glob("*.mcap"))
        if len(files) != 1:
            raise InputError(f"folder {path} holds {len(files)} .mcap files; give one of them")
        (path,) = files
    if path.suffix == ".csv":
        return read_csv_log(path)
    if path.suffix in (".json", ".html"):
        return replay_log(path, car)
    if path.suffix == ".mcap":
        return read_bag(path, topics or {})
    hint = "; 'ros2 bag convert' makes MCAP of it" if path.suffix == ".db3" else ""
    raise InputError(f"{path} is no log: give a .csv, .mcap, .json or .html file{hint}")


def read_csv_log(path: Path) -> DrivingLog:
    """Read a log from a csv file; columns of other names are left out."""
    content = read_limited(path, _MAX_BYTES, "a log", InputError)
    try:
        head, *rows = csv.reader(content.decode("utf-8-sig").splitlines())
    except (ValueError, csv.Error):
        raise InputError(f"{path} is not a csv file with a row of names") from None
    names = [name.strip() for name in head]
    if "t" not in names or len(set(names)) < len(names):
        raise InputError(
            f"{path} must begin with a row of different names, t among them; it begins with"
            f" {', '.join(names):.80}"
        )
    numbers = np.empty((len(rows), len(names)))
    for i, row in enumerate(rows):
        try:
            numbers[i] = np.array([float(cell or "nan") for cell in row]).reshape(len(names))
        except ValueError:
            raise InputError(
                f"row {i} of {path} is {','.join(row):.60}; it must hold {len(names)} numbers"
            ) from None
    return DrivingLog(**{name: numbers[:, names.index(name)] for name in COLUMNS if name in names})


def replay_log(path: Path, car: int = 0) -> DrivingLog:
    """Return the log of a car in a recorded race; it has no commands."""
    race = read_replay(path)
    check_whole("car", car, 0, len(race.car_names) - 1)
    states = race.cars[:, car]
    speed, beta = states[:, V], states[:, BETA]
    return DrivingLog(
        t=race.frame_dt * np.arange(len(states), dtype=np.float64),
        v_x=speed * np.cos(beta),
        v_y=speed * np.sin(beta),
        psi_dot=states[:, PSI_DOT],
        delta=states[:, DELTA],
        x=states[:, X],
        y=states[:, Y],
        psi=states[:, PSI],
    )


class _Series(NamedTuple):
    """Values of a topic: times, shape (N,), and numbers, shape (N, K)."""

    t: Floats
    values: Floats


def read_bag(path: Path, topics: Mapping[str, str]) -> DrivingLog:
    """Read a log from an MCAP file (extra "ros"): odometry, drive commands, and an IMU if any.

    The rows are the odometry's, the commands the last ones before.
    """
    require("mcap_ros2", extra="ros")
    for name in topics:
        check_choice("the name of a topic", name, KINDS)
    found = _topics(path, topics)
    for name in ("odom", "drive"):
        if name not in found:
            raise InputError(f"{path} has no topic of type {KINDS[name]}, for {name}")
    odometry = _read(path, found["odom"], _odometry)
    drive = _read(path, found["drive"], _drive)
    first, last = max(odometry.t[0], drive.t[0]), odometry.t[-1]
    t = odometry.t[(odometry.t >= first) & (odometry.t <= last)]
    pose = odometry.values[-len(t) :]
    command = drive.values[np.searchsorted(drive.t, t, side="right") - 1]
    columns = dict(zip(("x", "y", "psi", "v_x", "v_y", "psi_dot"), pose.T, strict=True))
    # Odometry of wheels has no speed across; some has no yaw rate either.
    columns = {
        name: values
        for name, values in columns.items()
        if name not in ("v_y", "psi_dot") or values.any()
    }
    if "imu" in found:
        imu = _read(path, found["imu"], lambda message: (message.angular_velocity.z,))
        columns["psi_dot"] = np.interp(t, imu.t, imu.values[:, 0])
    return DrivingLog(t=t - first, steer=command[:, 0], speed=command[:, 1], **columns)


def _topics(path: Path, chosen: Mapping[str, str]) -> dict[str, str]:
    """Return the topics to read, by name."""
    from mcap.reader import make_reader

    try:
        with path.open("rb") as file:
            summary = make_reader(file).get_summary()
    except OSError:
        raise
    except Exception as error:  # damaged files: errors of many types
        raise InputError(f"{path} is not an MCAP file: {error!r:.80}") from None
    if summary is None:
        raise InputError(f"{path} ends too early: 'mcap recover' repairs it")
    kinds = {
        channel.topic: summary.schemas[channel.schema_id].name
        for channel in summary.channels.values()
        if channel.schema_id in summary.schemas
    }
    found = {}
    for name, kind in KINDS.items():
        fitting = [topic for topic, its in kinds.items() if its == kind]
        if name in chosen:
            found[name] = check_choice(f"topic {name}", chosen[name], fitting)
        elif len(fitting) > 1:
            raise InputError(
                f"{path} has {len(fitting)} topics for {name}: choose one of {', '.join(fitting)}"
            )
        elif fitting:
            (found[name],) = fitting
    return found


def _read(path: Path, topic: str, values: Any) -> _Series:
    """Return the numbers of a topic's messages in order of time."""
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    rows: list[tuple[float, ...]] = []
    try:
        with path.open("rb") as file:
            reader = make_reader(file, decoder_factories=[DecoderFactory()])
            for _, _, message, fields in reader.iter_decoded_messages(topics=[topic]):
                logged, stamp = 1e-9 * message.log_time, fields.header.stamp
                time = stamp.sec + 1e-9 * stamp.nanosec
                time = time if abs(time - logged) < _MAX_OFFSET else logged
                rows.append((time, *values(fields)))
                if len(rows) > _MAX_MESSAGES:
                    raise InputError(f"topic {topic} has more than {_MAX_MESSAGES} messages")
    except (OSError, InputError):
        raise
    except Exception as error:  # damaged files: errors of many types
        raise InputError(f"{path} can't be decoded at {topic}: {error!r:.80}") from None
    if not rows:
        raise InputError(f"topic {topic} of {path} has no messages")
    table = np.array(rows, dtype=np.float64)
    table = table[np.argsort(table[:, 0], kind="stable")]
    table = table[np.append(True, np.diff(table[:, 0]) > 0.0)]  # of equal stamps the first
    return _Series(table[:, 0], table[:, 1:])


def _odometry(message: Any) -> tuple[float, ...]:
    pose, twist = message.pose.pose, message.twist.twist
    q = pose.orientation
    psi = np.arctan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y**2 + q.z**2))
    at = (pose.position.x, pose.position.y, float(psi))
    return (*at, twist.linear.x, twist.linear.y, twist.angular.z)


def _drive(message: Any) -> tuple[float, ...]:
    return message.drive.steering_angle, message.drive.speed
