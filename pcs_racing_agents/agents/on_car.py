"""Policies with measured states of the cars: on a real car, or in another simulator."""

from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.compilation import first_call, kernel
from pcs_racing.base.errors import InputError, check_array, check_number
from pcs_racing.car.lidar_kernel import scan_into
from pcs_racing.car.vehicle import (
    F1TENTH,
    LIDAR_NOISE,
    OPPONENT_LOST,
    STATE_SIZE,
    VehicleParams,
    X,
    Y,
    load_vehicle,
)
from pcs_racing.planners.calling import call_control, call_plan
from pcs_racing.planners.planner import Planner, Policy
from pcs_racing.planners.registry import parse_policy
from pcs_racing.planners.view import PATH_COLUMNS, PATH_POINTS, VIEW_SIZE
from pcs_racing.race.config import CONTROL_EVERY, DT, PLAN_EVERY, Rules, load_rules
from pcs_racing.race.kernel import fill_view
from pcs_racing.race.races import RaceSetup
from pcs_racing.race.state import empty_state
from pcs_racing.track.loading import load_track
from pcs_racing.track.track import Track

MEASURED = {
    "x": 1e5,
    "y": 1e5,
    "steering angle": 1.6,
    "speed": 100.0,
    "heading": 100.0,
    "yaw rate": 100.0,
    "slip angle": 3.2,
}
"""Max absolute values of a measured state, m, rad, m/s and rad/s."""


def scans(planner: Planner) -> bool:
    """Return whether the code of a compiled planner uses the simulated lidar."""
    pending: list[Any] = [planner.plan, planner.control]
    known: set[FunctionType] = set()
    while pending:
        function = pending.pop()
        if function is scan_into:
            return True
        python = getattr(function, "py_func", function)
        if isinstance(python, FunctionType) and python not in known:
            known.add(python)
            names, space = python.__code__.co_names, python.__globals__
            pending += [cell.cell_contents for cell in python.__closure__ or ()]
            pending += [space.get(name) for name in names]
            modules = [space[name] for name in names if isinstance(space.get(name), ModuleType)]
            pending += [getattr(module, name, None) for module in modules for name in names]
    return False


@kernel
def _ask(plan, control, due, track, theta, view, memory, scratch, path, command):
    if due:
        call_plan(plan, (track, theta, view, memory, scratch, path))
    call_control(control, (track, theta, view, memory, scratch, path, command))


class PolicyOnCar:
    """Policy with measured states of the cars as input, outside races.

    A state is a row of seven numbers: x, y (m), steering angle (rad), speed (m/s), heading (rad),
    yaw rate (rad/s) and slip angle (rad), at the centre of gravity and in the frame of the map. As
    in races, the policy plans ten times a second, and each call follows the plan. Planners with a
    lidar are refused, because they would scan the map; a file of
    :func:`pcs_racing_agents.agents.export_onnx` takes measured ranges.

    Parameters
    ----------
    policy : Policy or str
        Policy of a compiled planner.
    track : Track, str or path
        Track, name of a shipped track, or map folder.
    rules : Rules, str or path
        Rules with the speed range of the policies.
    vehicle : VehicleParams, mapping, str or path
        Vehicle of both cars (:func:`pcs_racing.car.vehicle.load_vehicle`). The measured states have
        the errors of the real sensors, so errors and delays of the vehicle's sensors are ignored.

    Attributes
    ----------
    path : ndarray, shape (12, 4)
        Path of the last plan: x, y (m), speed (m/s) and curvature (1/m).
    view : ndarray
        Last view of the planner (:data:`pcs_racing.planners.VIEW`).
    memory : ndarray
        Memory of the planner.

    Examples
    --------
    >>> on_car = PolicyOnCar("line-ppo", "Brackwater")
    >>> x, y, heading = on_car.track.to_cartesian([0.0, 0.0])
    >>> steering, speed = on_car.command(0.0, [x, y, 0.0, 3.0, heading, 0.0, 0.0])
    >>> speed > 3.0
    True
    """

    def __init__(
        self,
        policy: Policy | str,
        track: Track | str | PathLike[str],
        *,
        rules: Rules | str | Path = "paper",
        vehicle: VehicleParams | Mapping[str, Any] | str | PathLike[str] = F1TENTH,
    ) -> None:
        policy = parse_policy(policy) if isinstance(policy, str) else policy
        planner = policy.planner
        if planner.drive is not None:
            raise InputError(
                f"policy {policy.name!r} is no compiled planner; export_onnx takes a model"
            )
        if scans(planner):
            raise InputError(
                f"planner {planner.name!r} would scan the map, not the road; give a planner"
                " without a lidar, or the file of pcs-racing export lidar-ppo and measured ranges"
            )
        self.policy, self.track = policy, track if isinstance(track, Track) else load_track(track)
        cars = (load_vehicle(vehicle),) * 2
        self._setup = RaceSetup(self.track, load_rules(rules), (planner, planner), cars)
        self._vehicles = np.stack([car.as_row() for car in cars])
        self._vehicles[:, LIDAR_NOISE : OPPONENT_LOST + 1] = 0.0  # all errors and delays of sensors
        self._states = {count: empty_state(1, 0, count) for count in (1, 2)}
        sizes = (planner.memory_size, planner.scratch_size, VIEW_SIZE, 2)
        self.memory, self._scratch, self.view, self._command = map(np.zeros, sizes)
        self.path = np.zeros((PATH_POINTS, PATH_COLUMNS))
        self.reset()
        self._theta = policy.parameters.copy()  # writeable, as the compiled functions ask
        with first_call(_ask, "the policy", 190.0):
            self._code = planner.pointers()

    def reset(self) -> None:
        """Forget all calls: the next one may have any time, and plans."""
        self.memory[:], self.path[:], self._planned, self._time = 0.0, 0.0, -1, 0.0

    def command(
        self, time: float, car: ArrayLike, opponent: ArrayLike | None = None
    ) -> tuple[float, float]:
        """Return the steering angle (rad) and the speed (m/s) to command now.

        Parameters
        ----------
        time : float
            Time since the start, s; 0 or above, and not below the time of the last call. After
            :meth:`reset` it may go back.
        car : array_like, shape (7,)
            State of the own car, on the track.
        opponent : array_like, shape (7,), optional
            State of the opponent, on the track; without it there is no opponent near.
        """
        time = check_number("time", time, self._time)
        tick = CONTROL_EVERY * round(time / (CONTROL_EVERY * DT))
        rows = [self._measured("car", car)]
        if opponent is not None:
            rows.append(self._measured("opponent", opponent))
        self._time = time
        self._look(tick, np.stack(rows))
        due, self._planned = tick // PLAN_EVERY != self._planned, tick // PLAN_EVERY
        own = self._theta, self.view, self.memory, self._scratch, self.path, self._command
        _ask(*self._code, due, self.track.arrays, *own)
        steering, speed = self._command.tolist()
        return steering, speed

    def _measured(self, whose: str, given: ArrayLike) -> NDArray[np.float64]:
        """Return a measured state, or refuse an impossible one."""
        row = check_array(whose, given, (STATE_SIZE,))
        for (name, limit), value in zip(MEASURED.items(), row.tolist(), strict=True):
            if abs(value) > limit:
                raise InputError(f"{whose} has {name} {value:g}; it must be within +-{limit:g}")
        if not self.track.wall_distance(row[[X, Y]]) > 0.0:
            raise InputError(
                f"{whose} is at x = {row[X]:.2f}, y = {row[Y]:.2f} m, which is not on track"
                f" {self.track.name!r}"
            )
        return row

    def _look(self, tick: int, cars: NDArray[np.float64]) -> None:
        """Fill the view of the own car; the opponent's gap is the shorter way along the track."""
        track, state = self.track, self._states[len(cars)]
        places = track.to_frenet(cars[:, [X, Y]])
        half = 0.5 * track.length
        gaps = (places[:, 0] - places[0, 0] + half) % track.length - half
        state.tick[0], state.cars[0], state.frenet[0], state.progress[0] = tick, cars, places, gaps
        fill_view(track.arrays, state, 0, 0, self._vehicles, self._setup.settings, self.view)
