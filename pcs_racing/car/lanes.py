"""Several cars driven in lockstep, one in each lane of the processor's vectors.

A *lanes* array is flat: rows of ``LANES`` numbers, one for each car. The length of a row is fixed
at compilation, so that loops over the lanes use vector instructions; a lane without a car costs
nothing extra. Each lane is bit-identical to :func:`pcs_racing.car.vehicle.step`.
"""

import numpy as np

from pcs_racing.base.compilation import inner_kernel, kernel
from pcs_racing.car import vehicle as _vehicle
from pcs_racing.car.vehicle import (
    Actuators,
    Handling,
    State,
    actuators,
    handling,
    runge_kutta,
    step_linear,
    step_to_target,
    target_inputs,
)

LANES = 8

VECTOR = 4
"""Number of lanes computed at a time: a loop over all lanes is too long for a race of two cars."""

# Rows: the state, the target, the actuators, the speed below which a car is stepped alone, and the
# handling.
_STATE = 0
_STEER = LANES * _vehicle.STATE_SIZE
_SPEED = _STEER + LANES
_SHARE = _SPEED + LANES
_GAIN = _SHARE + LANES
_ALONE_BELOW = _GAIN + LANES
_HANDLING = _ALONE_BELOW + LANES
LANES_SIZE = _HANDLING + LANES * len(Handling._fields)


@kernel
def load_car(lanes, lane, state, p, dt):
    """Put a car with a row of parameters into a lane, for steps of ``dt`` seconds."""
    for k in range(_vehicle.STATE_SIZE):
        lanes[_STATE + LANES * k + lane] = state[k]
    lanes[_SHARE + lane], lanes[_GAIN + lane] = actuators(p, dt)
    car = handling(p)
    rate = dt * _vehicle.eigenvalue(p, car, _vehicle.KINEMATIC_BELOW)
    usual = p[_vehicle.TYRES] == 0.0 and rate <= _vehicle.STABLE
    lanes[_ALONE_BELOW + lane] = (
        _vehicle.KINEMATIC_BELOW + p[_vehicle.A_MAX] * dt if usual else np.inf
    )
    for k in range(len(car)):
        lanes[_HANDLING + LANES * k + lane] = car[k]


@inner_kernel(forceinline=True)
def store_car(lanes, lane, state):
    """Read the state of the car in a lane."""
    for k in range(_vehicle.STATE_SIZE):
        state[k] = lanes[_STATE + LANES * k + lane]


@inner_kernel(forceinline=True)
def set_target(lanes, lane, steer, speed):
    """Set the target steering angle (rad) and speed (m/s) of the car in a lane."""
    lanes[_STEER + lane] = steer
    lanes[_SPEED + lane] = speed


@inner_kernel(forceinline=True)
def steps_alone(lanes, lane):
    """Return whether a lane's car is not one for `step_lanes`.

    Cars that are too slow or too stiff for one step, and cars with Pacejka tyres, are stepped
    alone.
    """
    return not lanes[LANES * _vehicle.V + lane] >= lanes[_ALONE_BELOW + lane]


@inner_kernel
def step_alone(lanes, lane, state, p, dt):
    """Advance the ``state`` of a lane's car alone."""
    store_car(lanes, lane, state)
    step_to_target(state, lanes[_STEER + lane], lanes[_SPEED + lane], p, dt)


@inner_kernel
def step_slow(lanes, lane, state, p, dt):
    """Advance the ``state`` of a lane's car with linear tyres alone."""
    store_car(lanes, lane, state)
    car, steer, speed = handling(p), lanes[_STEER + lane], lanes[_SPEED + lane]
    delta, v = state[_vehicle.DELTA], state[_vehicle.V]
    rate, acceleration = target_inputs(delta, v, steer, speed, car, actuators(p, dt), dt)
    step_linear(state, rate, acceleration, p, car, dt)


@inner_kernel
def step_lanes(lanes, cars, dt):
    """Advance the cars in the first ``cars`` lanes by one step of ``dt`` seconds towards their
    targets.

    ``VECTOR`` lanes are computed at a time. The lanes beyond the cars, up to the next multiple, are
    computed as well and may hold any numbers; numbers below 1e-307 would slow down the arithmetic.

    Results are wrong for the cars of `steps_alone`.
    """
    for first in range(0, cars, VECTOR):
        part = lanes[first:]
        for i in range(VECTOR):
            car = Handling(
                part[_HANDLING + i],
                part[_HANDLING + LANES + i],
                part[_HANDLING + 2 * LANES + i],
                part[_HANDLING + 3 * LANES + i],
                part[_HANDLING + 4 * LANES + i],
                part[_HANDLING + 5 * LANES + i],
                part[_HANDLING + 6 * LANES + i],
                part[_HANDLING + 7 * LANES + i],
                part[_HANDLING + 8 * LANES + i],
                part[_HANDLING + 9 * LANES + i],
                part[_HANDLING + 10 * LANES + i],
                part[_HANDLING + 11 * LANES + i],
                part[_HANDLING + 12 * LANES + i],
                part[_HANDLING + 13 * LANES + i],
            )
            state = State(
                part[LANES * _vehicle.X + i],
                part[LANES * _vehicle.Y + i],
                part[LANES * _vehicle.DELTA + i],
                part[LANES * _vehicle.V + i],
                part[LANES * _vehicle.PSI + i],
                part[LANES * _vehicle.PSI_DOT + i],
                part[LANES * _vehicle.BETA + i],
            )
            moves = Actuators(part[_SHARE + i], part[_GAIN + i])
            rate, acceleration = target_inputs(
                state.delta, state.v, part[_STEER + i], part[_SPEED + i], car, moves, dt
            )
            # No branch here: a branch would prevent vectorisation of the loop.
            state = runge_kutta(state, rate, acceleration, car, None, dt, -np.inf)
            part[LANES * _vehicle.X + i] = state.x
            part[LANES * _vehicle.Y + i] = state.y
            part[LANES * _vehicle.DELTA + i] = state.delta
            part[LANES * _vehicle.V + i] = state.v
            part[LANES * _vehicle.PSI + i] = state.psi
            part[LANES * _vehicle.PSI_DOT + i] = state.psi_dot
            part[LANES * _vehicle.BETA + i] = state.beta
