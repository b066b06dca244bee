"""Third-party drivers: classes in a Python file, in the hand-in formats of courses and workshops.

A class is a driver if it has one of these methods; of several, the first counts:

- ``process_observation(ranges, ego_odom)`` and ``process_lidar(ranges)`` return speed (m/s) and
  steering angle (rad);
- ``plan(obs)`` returns steering angle and speed, as in benchmarks with this method.

``ranges`` are 1080 beams over 4.7 rad from right to left, up to 30 m. ``ego_odom`` has ``pose_x``,
``pose_y``, ``pose_theta``, ``linear_vel_x``, ``linear_vel_y`` and ``angular_vel_z``. ``obs`` has
the same fields, the ranges as ``scan``, and the vehicle's state. A node of ROS 2 is a driver as
well (:mod:`pcs_racing.planners.ros_nodes`).

The file is run again for every race (:mod:`pcs_racing.planners.own_files`), and its driver is
called every 0.02 s. The driver's attributes and globals are no part of the race's state: such a
race repeats from its start, but cannot resume from a copy of its middle.
"""

import os
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.errors import InputError
from pcs_racing.car.lidar import Lidar
from pcs_racing.planners import view as _view
from pcs_racing.planners.own_files import Run, one_line, run_file
from pcs_racing.planners.planner import Parameter, Planner, Policy
from pcs_racing.planners.registry import get_planner, planner_names, register_planner
from pcs_racing.planners.ros_nodes import Node, ask_node
from pcs_racing.planners.scanning import WORK, scan_beams
from pcs_racing.track.track import Track

METHODS = ("process_observation", "process_lidar", "plan")
ODOMETRY = {
    "pose_x": _view.OWN_X,
    "pose_y": _view.OWN_Y,
    "pose_theta": _view.OWN_PSI,
    "linear_vel_x": _view.OWN_V,
    "angular_vel_z": _view.OWN_PSI_DOT,
}
STATE = [
    _view.OWN_X,
    _view.OWN_Y,
    _view.OWN_DELTA,
    _view.OWN_V,
    _view.OWN_PSI,
    _view.OWN_PSI_DOT,
    _view.OWN_BETA,
]

MAX_RUNS = 4096
"""Max number of races of a file with modules and drivers in memory."""

_lidar = lru_cache(maxsize=8)(Lidar)  # 1080 beams over 4.7 rad, up to 30 m


@dataclass(eq=False)
class _Drivers:
    """Function ``drive`` of a planner; the first parameter selects a class of the file."""

    path: str
    names: list[str] = field(init=False)  #: Names of the file's drivers.
    #: Runs of the file by the number in memory.
    racing: dict[float, Run] = field(init=False, default_factory=dict)
    numbers: "count[int]" = field(
        init=False, default_factory=lambda: count((os.getpid() << 24) + 1)
    )
    takes_seed = True  # as two more arguments: seed and car

    def __post_init__(self) -> None:
        self.names = list(driver_classes(self.path))
        if not self.names:
            raise InputError(
                f"{self.path} has no driver: a class with a method {' or '.join(METHODS)}, or a ROS"
                " node"
            )

    def __reduce__(self) -> tuple[Any, ...]:
        return _Drivers, (self.path,)

    def __call__(
        self,
        track: Track,
        theta: NDArray[np.float64],
        view: NDArray[np.float64],
        memory: NDArray[np.float64],
        seed: int = 0,
        car: int = 0,
    ) -> tuple[float, float]:
        name = self.names[min(int(theta[0]), len(self.names) - 1)]
        if memory[0] == 0.0:
            if len(self.racing) >= MAX_RUNS:  # the oldest race is over: fewer races run at once
                self.racing.pop(next(iter(self.racing))).forget()
            number = next(self.numbers)
            self.racing[number] = Run(Path(self.path), number, (seed, car))
            memory[0] = number
        if memory[0] not in self.racing:
            raise InputError(
                f"driver {self.path}:{name} is asked in the middle of a race that another process"
                f" began, or that began {MAX_RUNS} races ago"
            )
        run = self.racing[float(memory[0])]
        run.now = max(run.now, float(view[_view.TIME]))
        with run.entered(f"driver {self.path}:{name}"):
            if run.driver is None:
                run.driver = getattr(run.module, name)()
            return _ask(run.driver, track, view)


def _ask(driver: Any, track: Track, view: NDArray[np.float64]) -> tuple[float, float]:
    """Return a driver's steering angle and speed."""
    lidar = _lidar(track)
    ranges = np.empty(lidar.beams)
    scan_beams(track.arrays, lidar.kernel, view, 0.0, np.empty(WORK), ranges)
    odometry = {name: float(view[index]) for name, index in ODOMETRY.items()} | {
        "linear_vel_y": 0.0
    }
    if isinstance(driver, Node):
        x, y, theta = view[[_view.OPP_X, _view.OPP_Y, _view.OPP_PSI]].tolist()
        other = {
            "pose_x": x,
            "pose_y": y,
            "pose_theta": theta,
            "linear_vel_x": float(view[_view.OPP_V]),
        }
        return ask_node(
            driver,
            float(view[_view.TIME]),
            ranges,
            odometry,
            odometry | other | {"angular_vel_z": 0.0},
        )
    if hasattr(driver, "process_observation"):
        speed, steering = driver.process_observation(ranges=ranges, ego_odom=odometry)
    elif hasattr(driver, "process_lidar"):
        speed, steering = driver.process_lidar(ranges)
    else:
        state = view[STATE]
        names = {
            "scan": ranges,
            "state": state,
            "vehicle_state": state,
            "vehicle_speed": float(view[_view.OWN_V]),
        }
        steering, speed = driver.plan(
            odometry | names | {"pose": state[[0, 1, 4]], "time": float(view[_view.TIME])}
        )
    return float(steering), float(speed)


def is_driver(made: Any) -> bool:
    """Return whether an object is a driver class."""
    if not isinstance(made, type) or made is Node:
        return False
    return issubclass(made, Node) or any(
        callable(getattr(made, method, None)) for method in METHODS
    )


def driver_classes(path: str | Path) -> dict[str, type]:
    """Run a file and return its drivers by name.

    The file's own classes come first, then classes of its folder's modules.
    """
    module = run_file(path)
    found = {name: value for name, value in vars(module).items() if isinstance(value, type)}
    with one_line(f"{path} can't be loaded"):
        own = {
            name: cls
            for name, cls in found.items()
            if cls.__module__ == module.__name__ and is_driver(cls)
        }
        below = f"{module.__name__}."
        return own | {
            n: cls
            for n, cls in found.items()
            if cls.__module__.startswith(below) and is_driver(cls)
        }


def drivers_from(path: str | Path) -> dict[str, Policy]:
    """Run a Python file and return its drivers by class name.

    From then on ``"their_file.py:Class"``, with the path as given here, is the name of a driver in
    this process; ``"their_file.py"`` is the name of the first driver.
    """
    name = Path(path).as_posix()
    if name not in planner_names():
        drive = _Drivers(name)
        which = Parameter(
            "driver", 0.0, float(len(drive.names)), 0.0, "which class of the file drives, from 0"
        )
        variants = {driver: (float(i),) for i, driver in enumerate(drive.names)}
        register_planner(Planner(name, (which,), drive=drive, memory_size=1, variants=variants))
    planner = get_planner(name)
    return {driver: planner.policy(driver) for driver in planner.variants}
