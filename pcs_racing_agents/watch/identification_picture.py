"""Picture of an identified car: measured against simulated."""

from typing import Any

import numpy as np

from pcs_racing.car.tyres import pacejka_curve
from pcs_racing.car.vehicle import VehicleParams
from pcs_racing.identification.fitting import Identification, tyre_points
from pcs_racing.identification.windows import outputs
from pcs_racing_agents.base.style import COLOURS, SOFT, new_figure, picture, tidy

_SHOWN = 10.0  # s of the log


@picture
def identification_picture(found: Identification) -> Any:
    """Draw yaw rate and speed over time, and the tyres' lateral forces over slip angles."""
    figure = new_figure(8.0, 5.0)
    above, below = figure.subplots(2, 2)
    _draw_course(above[0], found, "psi_dot", "yaw rate, rad/s")
    _draw_course(above[1], found, "v_x", "speed, m/s")
    slips, forces = tyre_points(found)
    for axes, slip, force, axle in zip(below, slips, forces, "fr", strict=True):
        _draw_tyres(axes, found, slip, force, axle)
    return figure


def _draw_course(axes: Any, found: Identification, name: str, label: str) -> None:
    windows = found.windows
    count = min(max(int(_SHOWN / (windows.rows.shape[1] * windows.period)), 1), len(windows.rows))
    rows = windows.rows[:count]
    measured = windows.yaw_rate_raw if name == "psi_dot" else windows.measured.get(name, windows.v)
    simulated = outputs(found.states[:count], name)
    for at, values in zip(rows, simulated, strict=True):  # windows: not a continuous line
        axes.plot(at * windows.period, measured[at], color=SOFT, lw=0.7)
        axes.plot(at * windows.period, values, color=COLOURS[1], lw=1.3)
    axes.set_title(f"{label}: measured (grey), simulated")
    axes.set_xlabel("s")
    tidy(axes)


def _draw_tyres(axes: Any, found: Identification, slip: Any, force: Any, axle: str) -> None:
    every = max(len(slip) // 3000, 1)
    axes.plot(slip[::every], force[::every], ".", ms=1.5, color=SOFT, alpha=0.5)
    reach = float(np.quantile(np.abs(slip), 0.995))
    angles = np.linspace(-reach, reach, 121)
    axes.plot(angles, _forces(found.start, angles, axle), "--", color=COLOURS[0], label="start")
    axes.plot(angles, _forces(found.vehicle, angles, axle), color=COLOURS[1], label="found")
    axes.legend(loc="upper left")
    axes.set_xlim(-reach, reach)
    axes.set_ylim(-1.5 * np.abs(force).mean() - 0.5, 1.5 * np.abs(force).mean() + 0.5)
    name = "front" if axle == "f" else "rear"
    axes.set_title(f"{name} tyres: lateral force per load")
    axes.set_xlabel("slip angle, rad")
    tidy(axes)


def _forces(car: VehicleParams, slips: Any, axle: str) -> Any:
    """Return lateral forces per load at slip angles, rad."""
    if car.tyres == "linear":
        return car.mu * getattr(car, f"c_s{axle}") * slips
    b, c, d, e = (getattr(car, f"{name}_{axle}") for name in "bcde")
    return np.array([car.mu * d * pacejka_curve(slip, b, c, e) for slip in slips])
