"""Cars in lockstep drive as each of them does alone, to the bit."""

from dataclasses import replace

import numpy as np
import pytest

from pcs_racing.base.compilation import compiled
from pcs_racing.car.lanes import LANES, LANES_SIZE, load_car, set_target, step_lanes, step_slow_car, store_car
from pcs_racing.car.vehicle import F1TENTH, simulate

TARGETS = np.stack([np.linspace(-0.5, 0.5, LANES), np.linspace(0.0, 12.0, LANES)], axis=1)


@compiled
def _drive(lanes, states, params, targets, steps):  # type: ignore[no-untyped-def]
    """Drive the cars in their lanes, those that are too slow for them alone."""
    for lane in range(states.shape[0]):
        load_car(lanes, lane, states[lane], params[lane])
        set_target(lanes, lane, targets[lane, 0], targets[lane, 1])
    slow = np.zeros(states.shape[0], np.bool_)
    taken = 0
    for _ in range(steps):
        for lane in range(states.shape[0]):
            slow[lane] = step_slow_car(lanes, lane, states[lane], params[lane], 0.01)
        step_lanes(lanes, states.shape[0], 0.01)
        for lane in range(states.shape[0]):
            if slow[lane]:
                load_car(lanes, lane, states[lane], params[lane])
                taken += 1
            else:
                store_car(lanes, lane, states[lane])
    return taken


@pytest.mark.parametrize("cars", [1, 2, 5, LANES])
def test_cars_in_lanes_drive_as_alone(cars):
    vehicles = [replace(F1TENTH, mu=0.8 + 0.05 * k, m=3.0 + 0.3 * k) for k in range(cars)]
    states = np.zeros((cars, 7))
    states[:, 3] = np.linspace(0.3, 7.0, cars)
    expected = simulate(states, np.tile(TARGETS[:cars, None], (1, 150, 1)), params=vehicles)[:, -1]
    rows = np.array([vehicle.as_row() for vehicle in vehicles])
    slow_steps = _drive(np.full(LANES_SIZE, np.nan), states, rows, TARGETS[:cars], 150)
    np.testing.assert_array_equal(states, expected)
    assert 0 < slow_steps <= 150 * cars
