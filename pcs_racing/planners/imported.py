"""Drivers of others: classes in a Python file, in the forms in which courses and workshops have them handed in.

A class is a driver if it has one of these methods, of which the first counts:

- ``process_observation(ranges, ego_odom)`` and ``process_lidar(ranges)`` return speed (m/s) and steering angle (rad);
- ``plan(obs)`` returns steering angle and speed, as in the benchmarks that call it.

``ranges`` are 1080 beams over 4.7 rad from right to left, up to 30 m; ``ego_odom`` has ``pose_x``, ``pose_y``,
``pose_theta``, ``linear_vel_x``, ``linear_vel_y`` and ``angular_vel_z``; ``obs`` has these, the ranges as ``scan`` and
the vehicle's state. A driver is made anew for every race and asked every 0.02 s. What it keeps in its attributes is no
part of the race's state: such a race repeats from its start, but cannot go on from a copy in its middle.
"""

import sys
from dataclasses import dataclass, field
from functools import lru_cache
from importlib.util import module_from_spec, spec_from_file_location
from itertools import count
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.errors import InputError
from pcs_racing.car.lidar import Lidar
from pcs_racing.planners import view as _view
from pcs_racing.planners.planner import Parameter, Planner, Policy
from pcs_racing.planners.registry import get_planner, planner_names, register_planner
from pcs_racing.track.track import Track

METHODS = ("process_observation", "process_lidar", "plan")
ODOMETRY = {
    "pose_x": _view.OWN_X, "pose_y": _view.OWN_Y, "pose_theta": _view.OWN_PSI, "linear_vel_x": _view.OWN_V,
    "angular_vel_z": _view.OWN_PSI_DOT,
}  # fmt: skip
STATE = [_view.OWN_X, _view.OWN_Y, _view.OWN_DELTA, _view.OWN_V, _view.OWN_PSI, _view.OWN_PSI_DOT, _view.OWN_BETA]

_PREFIX = "drivers of "
_lidar = lru_cache(maxsize=8)(Lidar)  # 1080 beams over 4.7 rad, up to 30 m


@dataclass(eq=False)
class _Drivers:
    """The function ``drive`` of a planner: the first parameter says which class of the file drives."""

    path: str
    classes: list[type] = field(init=False)
    racing: dict[float, Any] = field(init=False, default_factory=dict)  #: Drivers by the number in their memory.
    numbers: "count[int]" = field(init=False, default_factory=lambda: count(1))

    def __post_init__(self) -> None:
        self.classes = driver_classes(self.path)
        if not self.classes:
            raise InputError(f"{self.path} has no driver: a class with a method {' or '.join(METHODS)}")

    def __reduce__(self) -> tuple[Any, ...]:
        return _Drivers, (self.path,)

    def __call__(
        self, track: Track, theta: NDArray[np.float64], view: NDArray[np.float64], memory: NDArray[np.float64]
    ) -> tuple[float, float]:
        cls = self.classes[min(int(theta[0]), len(self.classes) - 1)]
        try:
            if memory[0] == 0.0:
                memory[0] = next(self.numbers)
                self.racing[memory[0]] = cls()
            return _ask(self.racing[memory[0]], track, view)
        except Exception as error:  # whatever their code raises
            raise InputError(f"driver {self.path}:{cls.__name__}: {type(error).__name__}: {error}") from error


def _ask(driver: Any, track: Track, view: NDArray[np.float64]) -> tuple[float, float]:
    """Return the steering angle and the speed that a driver answers."""
    opponent = view[[_view.OPP_X, _view.OPP_Y, _view.OPP_PSI]]
    size = (float(view[_view.OPP_LENGTH]), float(view[_view.OPP_WIDTH]))
    ranges = _lidar(track).scan(view[[_view.OWN_X, _view.OWN_Y, _view.OWN_PSI]], opponent, opponent_size=size)
    odometry = {name: float(view[index]) for name, index in ODOMETRY.items()} | {"linear_vel_y": 0.0}
    if hasattr(driver, "process_observation"):
        speed, steering = driver.process_observation(ranges=ranges, ego_odom=odometry)
    elif hasattr(driver, "process_lidar"):
        speed, steering = driver.process_lidar(ranges)
    else:
        state = view[STATE]
        names = {"scan": ranges, "state": state, "vehicle_state": state, "vehicle_speed": float(view[_view.OWN_V])}
        steering, speed = driver.plan(odometry | names | {"pose": state[[0, 1, 4]], "time": float(view[_view.TIME])})
    return float(steering), float(speed)


def run_file(path: str | Path) -> ModuleType:
    """Run a Python file, once in this process, and return it as a module."""
    path = Path(path)
    name = f"{_PREFIX}{path.resolve()}".replace(".", ":")  # behind a dot pickle would look for a part of a package
    if name in sys.modules:
        return sys.modules[name]
    spec = spec_from_file_location(name, path)
    if not path.is_file() or spec is None or spec.loader is None:
        raise InputError(f"there is no Python file {path}")
    module = sys.modules[name] = module_from_spec(spec)
    sys.path.insert(0, str(path.resolve().parent))  # for the files beside it that it imports
    try:
        spec.loader.exec_module(module)
    except Exception as error:  # whatever their code raises
        del sys.modules[name]
        raise InputError(f"{path} can't be loaded: {type(error).__name__}: {error}") from error
    finally:
        sys.path.pop(0)
    return module


def files_run() -> list[str]:
    """Return the files that this process has run: another one needs them to unpack objects of their classes."""
    return [str(module.__file__) for name, module in sys.modules.items() if name.startswith(_PREFIX)]


def driver_classes(path: str | Path) -> list[type]:
    """Return the drivers among the classes of a file, which is run, in their order."""
    module = run_file(path)
    own = [value for value in vars(module).values() if isinstance(value, type) and value.__module__ == module.__name__]
    return [cls for cls in own if any(callable(getattr(cls, method, None)) for method in METHODS)]


def drivers_from(path: str | Path) -> dict[str, Policy]:
    """Return the drivers of a Python file, which is run, by the names of their classes.

    From then on this process knows them as ``"their_file.py:Class"``, with the path as it is given here, wherever a
    driver is named; ``"their_file.py"`` is the first one.
    """
    name = Path(path).as_posix()
    if name not in planner_names():
        drive = _Drivers(name)
        which = Parameter("driver", 0.0, float(len(drive.classes)), 0.0, "which class of the file drives, from 0")
        variants = {cls.__name__: (float(i),) for i, cls in enumerate(drive.classes)}
        register_planner(Planner(name, (which,), drive=drive, memory_size=1, variants=variants))
    planner = get_planner(name)
    return {cls: planner.policy(cls) for cls in planner.variants}
