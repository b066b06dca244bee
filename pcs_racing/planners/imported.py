"""Third-party drivers: classes in a Python file, in the hand-in formats of courses and workshops.

A class is a driver if it has one of these methods; of several, the first counts:

- ``process_observation(ranges, ego_odom)`` and ``process_lidar(ranges)`` return speed (m/s) and
  steering angle (rad);
- ``plan(obs)`` returns steering angle and speed, as in benchmarks with this method.

``ranges`` are 1080 beams over 4.7 rad from right to left, up to 30 m. ``ego_odom`` has ``pose_x``,
``pose_y``, ``pose_theta``, ``linear_vel_x``, ``linear_vel_y`` and ``angular_vel_z``. ``obs`` has
the same fields, the ranges as ``scan``, and the vehicle's state. A node of ROS 2 is a driver as
well (:mod:`pcs_racing.planners.ros_nodes`).

The file is imported once (:mod:`pcs_racing.planners.own_files`); each race makes a driver for each
car and calls it every 0.02 s. A driver's attributes are no part of the race's state: such a race
repeats from its start, but cannot resume from a copy of its middle.
"""

import os
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from copy import deepcopy
from functools import lru_cache, partial
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.errors import InputError, one_line
from pcs_racing.car.lidar import Lidar
from pcs_racing.planners import view as _view
from pcs_racing.planners.own_files import drawing, own_file, seeded
from pcs_racing.planners.planner import Parameter, Planner, Policy
from pcs_racing.planners.registry import get_planner, planner_names, register_planner
from pcs_racing.planners.ros_nodes import Node, ask_node
from pcs_racing.planners.scanning import WORK, scan_beams
from pcs_racing.track.track import Track

METHODS = ("process_observation", "process_lidar", "plan")
STATE = [
    _view.OWN_X,
    _view.OWN_Y,
    _view.OWN_DELTA,
    _view.OWN_V,
    _view.OWN_PSI,
    _view.OWN_PSI_DOT,
    _view.OWN_BETA,
]
MAX_DRIVERS = 4096
"""Max number of drivers of a file in memory."""

_lidar = lru_cache(maxsize=8)(Lidar)  # 1080 beams over 4.7 rad, up to 30 m


class _Drive:
    """Function ``drive`` of a planner; the first parameter selects a class of the file."""

    takes_seed = True  # as two more arguments: seed and car

    def __init__(self, source: Any) -> None:
        self.source, self.name = source, str(source)
        self.makers: Mapping[str, Callable[[], Any]]  #: Classes of the file by name.
        self._running: Callable[[str, float], AbstractContextManager[None]]
        if isinstance(source, str):
            self.makers, self._running = driver_classes(source), own_file(source).running
        else:
            self.makers = {type(source).__name__: partial(deepcopy, source)}
            self._running = lambda what, now: one_line(what, ())
        if not self.makers:
            raise InputError(
                f"{self.name} has no driver: a class with a method {' or '.join(METHODS)}, or a ROS"
                " node"
            )
        #: Driver and states of its generators, by the number in the memory of the car.
        self._racing: dict[float, tuple[list[Any], list[Any]]] = {}
        self._numbers = count((os.getpid() << 24) + 1)

    def __reduce__(self) -> tuple[Any, ...]:
        return _Drive, (self.source,)

    def __call__(
        self,
        track: Track,
        theta: NDArray[np.float64],
        view: NDArray[np.float64],
        memory: NDArray[np.float64],
        seed: int = 0,
        car: int = 0,
    ) -> tuple[float, float]:
        which = int(theta[0]) if len(theta) else 0
        name, make = list(self.makers.items())[min(which, len(self.makers) - 1)]
        what, lidar = f"driver {self.name}:{name}", _lidar(track)
        if memory[0] == 0.0:
            if len(self._racing) >= MAX_DRIVERS:  # the oldest race is over: fewer run at once
                del self._racing[next(iter(self._racing))]
            memory[0] = next(self._numbers)
            self._racing[float(memory[0])] = [], seeded(seed, car)
        if float(memory[0]) not in self._racing:
            raise InputError(
                f"{what} is asked in the middle of a race that another process began, or that"
                f" began {MAX_DRIVERS} races ago"
            )
        made, generators = self._racing[float(memory[0])]
        ranges = np.empty(lidar.beams)
        scan_beams(track.arrays, lidar.kernel, view, 0.0, np.empty(WORK), ranges)
        with self._running(what, float(view[_view.TIME])), drawing(generators):
            if not made:
                made.append(make())
            return _ask(made[0], view, ranges)


def _ask(
    driver: Any, view: NDArray[np.float64], ranges: NDArray[np.float64]
) -> tuple[float, float]:
    """Return a driver's steering angle and speed."""
    time = float(view[_view.TIME])
    own = view[[_view.OWN_X, _view.OWN_Y, _view.OWN_PSI, _view.OWN_V, _view.OWN_PSI_DOT]]
    odometry = _odometry(*own.tolist())
    if isinstance(driver, Node):
        other = view[[_view.OPP_X, _view.OPP_Y, _view.OPP_PSI, _view.OPP_V]]
        return ask_node(driver, time, ranges, odometry, _odometry(*other.tolist()))
    if hasattr(driver, "process_observation"):
        speed, steering = driver.process_observation(ranges=ranges, ego_odom=odometry)
    elif hasattr(driver, "process_lidar"):
        speed, steering = driver.process_lidar(ranges)
    else:
        state = view[STATE]
        seen = {"scan": ranges, "state": state, "vehicle_state": state, "time": time}
        more = {"vehicle_speed": odometry["linear_vel_x"], "pose": state[[0, 1, 4]]}
        steering, speed = driver.plan({**odometry, **seen, **more})
    return float(steering), float(speed)


def _odometry(x: float, y: float, psi: float, v: float, yaw_rate: float = 0.0) -> dict[str, float]:
    velocity = {"linear_vel_x": v, "linear_vel_y": 0.0, "angular_vel_z": yaw_rate}
    return {"pose_x": x, "pose_y": y, "pose_theta": psi, **velocity}


def is_driver(made: Any) -> bool:
    """Return whether an object is a driver class."""
    if not isinstance(made, type) or made is Node:
        return False
    return issubclass(made, Node) or any(callable(getattr(made, one, None)) for one in METHODS)


def driver_classes(path: str | Path) -> dict[str, type]:
    """Return the drivers of a file by name: its own classes, then classes of its modules."""
    module = own_file(path).module
    with one_line(f"{path} can't be loaded"):
        found = {
            name: one
            for name, one in vars(module).items()
            if is_driver(one) and one.__module__.startswith(module.__name__)
        }
        return dict(sorted(found.items(), key=lambda one: one[1].__module__ != module.__name__))


def drivers_from(path: str | Path) -> dict[str, Policy]:
    """Import a Python file and return its drivers by class name.

    From then on ``"their_file.py:Class"``, with the path as given here, is the name of a driver in
    this process; ``"their_file.py"`` is the name of the first driver.
    """
    name = Path(path).as_posix()
    if name not in planner_names():
        drive = _Drive(name)
        which = Parameter(
            "driver", 0.0, float(len(drive.makers)), 0.0, "number of the class in the file, from 0"
        )
        variants = {driver: (float(i),) for i, driver in enumerate(drive.makers)}
        register_planner(Planner(name, (which,), drive=drive, memory_size=1, variants=variants))
    planner = get_planner(name)
    return {driver: planner.policy(driver) for driver in planner.variants}


def object_policy(driver: Any) -> Policy:
    """Return the policy of a driver in memory; each race drives a copy of it."""
    drive = _Drive(driver)
    return Planner(type(driver).__name__, (), drive=drive, memory_size=1).policy()
