"""Races of cars at rest at given places, for tests of the consequences."""

import numpy as np

from pcs_racing import load_rules
from pcs_racing.base.compilation import compiled
from pcs_racing.car.vehicle import F1TENTH
from pcs_racing.planners.planner import Parameter, Planner
from pcs_racing.planners.view import VIEW_SIZE
from pcs_racing.race.kernel import fill_view
from pcs_racing.race.races import RaceSetup
from pcs_racing.race.start_grid import settle
from pcs_racing.race.state import empty_state

X, Y, DELTA, V, PSI, PSI_DOT, BETA = range(7)


@compiled
def hold(track, theta, view, memory, scratch, path, command):
    command[0] = theta[0]
    command[1] = theta[1]


STEER_AND_SPEED = (
    Parameter("steer", -0.4, 0.4, 0.0, "rad"),
    Parameter("speed", -3.0, 9.0, 0.0, "m/s"),
)
HOLD = Planner("hold", STEER_AND_SPEED, control=hold)


def view_of(setup, state, race, car):
    """View of the driver of a car."""
    view, vehicles = np.zeros(VIEW_SIZE), np.stack([vehicle.as_row() for vehicle in setup.vehicles])
    fill_view(setup.track.arrays, state, race, car, vehicles, setup.settings, view)
    return view


def placed(track, places, speeds=None, planner=HOLD, vehicles=None, **rules):
    """A race of cars that stand at (s, d) or (s, d, turned by) or drive so fast; they hold their
    speed.
    """
    count = len(places)
    speeds = [0.0] * count if speeds is None else speeds
    setup = RaceSetup(
        track,
        load_rules("paper", **rules),
        (planner,) * count,
        vehicles or (F1TENTH,) * count,
    )
    state = empty_state(1, setup.memory_size, count, setup.rules.laps)
    for car, (s, d, *turned) in enumerate(places):
        x, y, psi = track.to_cartesian([s, d])
        state.cars[0, car, [X, Y, V, PSI]] = x, y, speeds[car], psi + sum(turned)
        state.progress[0, car] = s
    settle(track, setup.vehicles, state)
    return setup, state, np.array([[(0.0, speed) for speed in speeds]])
