import dataclasses

import numpy as np
import pytest
from hypothesis import given, strategies as st
from refusal import refused

from pcs_racing.base.compilation import compiled
from pcs_racing.car.lanes import (
    LANES,
    LANES_SIZE,
    load_car,
    set_target,
    step_alone,
    step_lanes,
    steps_alone,
    store_car,
)
from pcs_racing.car.vehicle import (
    BETA,
    DELTA,
    F1TENTH,
    PARAMS_SIZE,
    PSI_DOT,
    STEER_DELAY,
    V,
    VehicleParams,
    load_vehicle,
    simulate,
)
from pcs_racing.envs.batch import MAX_RATE


def constant(steer: float, speed: float, steps: int) -> np.ndarray:
    return np.tile([steer, speed], (steps, 1))


def at_speed(v: float) -> np.ndarray:
    return np.array([0.0, 0.0, 0.0, v, 0.0, 0.0, 0.0])


def test_reproduces_the_established_simulator(reference):
    data = np.load(reference / "st_dynamics.npz")
    states, controls = data["raw_states"], data["raw_controls"]
    found = simulate(states[:, 0], controls, control_mode="rates")
    np.testing.assert_allclose(found, states, rtol=0.0, atol=1e-9)


def test_each_parameter_changes_one_car_and_one_car_is_a_batch_of_one():
    """Each parameter changes the car that has it, and no other."""
    # To the power and speed limits, at the steering limit, then backwards: every parameter has work
    # to do.
    controls = np.concatenate([constant(0.5, 25.0, 250), constant(-0.5, -9.0, 400)])
    start = at_speed(7.0)
    usual = simulate(start, controls)
    body = {"width", "length"}  # they matter for contacts only
    for field in dataclasses.fields(VehicleParams)[:STEER_DELAY]:  # the others matter in races only
        value = getattr(F1TENTH, field.name)
        other = dataclasses.replace(F1TENTH, **{field.name: 0.5 * value})
        pair = simulate(
            np.stack([start, start]), np.stack([controls, controls]), params=[F1TENTH, other]
        )
        np.testing.assert_array_equal(pair[0], usual)
        assert np.array_equal(pair[1], usual) == (field.name in body), field.name
    single = simulate(at_speed(3.0), constant(0.1, 4.0, 50))
    batch = simulate(at_speed(3.0)[None], constant(0.1, 4.0, 50)[None])
    assert single.shape == (51, 7)
    assert batch.shape == (1, 51, 7)
    np.testing.assert_array_equal(single, batch[0])


@given(
    targets=st.lists(st.floats(-1.0, 1.0), min_size=1, max_size=5),
    begin=st.floats(-0.4, 0.4),
    speed=st.floats(0.0, 8.0),
)
def test_steering_arrives_without_overshoot_or_chatter(targets, begin, speed):
    start = at_speed(speed)
    start[DELTA] = begin
    hold = 60  # long enough from stop to stop at 3.2 rad/s
    controls = np.concatenate([constant(target, speed, hold) for target in targets])
    delta = simulate(start, controls)[:, DELTA]
    limit = F1TENTH.steer_max
    assert np.abs(delta).max() <= limit + 1e-12
    for k, target in enumerate(targets):
        part = delta[k * hold : (k + 1) * hold + 1]
        goal = min(max(target, -limit), limit)
        moves = np.diff(part)
        assert (moves >= -1e-15).all() or (moves <= 1e-15).all()  # one way only
        assert part[-1] == pytest.approx(goal, abs=1e-12)  # and there
        assert np.abs(moves).max() <= F1TENTH.steer_rate_max * 0.01 + 1e-12


@given(
    seed=st.integers(0, 2**32 - 1),
    speed=st.floats(-5.0, 20.0),
    mode=st.sampled_from(["target", "rates"]),
)
def test_any_driving_keeps_the_state_finite_and_within_limits(seed, speed, mode):
    rng = np.random.default_rng(seed)
    high = [4.0, 12.0] if mode == "rates" else [0.6, 22.0]
    controls = rng.uniform(np.negative(high), high, (100, 2))
    states = simulate(at_speed(speed), controls, control_mode=mode)
    assert np.isfinite(states).all()
    # only "target" arrives exactly
    slack = 1e-9 + (F1TENTH.steer_rate_max * 0.01 if mode != "target" else 0.0)
    assert np.abs(states[:, DELTA]).max() <= F1TENTH.steer_max + slack
    assert states[:, V].min() >= F1TENTH.v_min - F1TENTH.a_max * 0.01 - 1e-9
    assert states[:, V].max() <= F1TENTH.v_max + F1TENTH.a_max * 0.01 + 1e-9
    assert ((states[1:, 4] >= 0.0) & (states[1:, 4] <= 2.0 * np.pi)).all()


def side_slip_model(y, rate, a, car):
    """CommonRoad's single-track model with load transfer, axle by axle (Althoff, Koschi and
    Manzinger 2017).
    """
    _, _, delta, v, psi, yaw_rate, beta = y
    length, g = car.lf + car.lr, 9.81
    # braking (a < 0) presses the front axle down
    load_front = car.m * (g * car.lr - a * car.h) / length
    load_rear = car.m * (g * car.lf + a * car.h) / length
    force_front = car.mu * car.c_sf * load_front * (delta - beta - car.lf * yaw_rate / v)
    force_rear = car.mu * car.c_sr * load_rear * (-beta + car.lr * yaw_rate / v)
    return np.array(
        [
            v * np.cos(psi + beta),
            v * np.sin(psi + beta),
            rate,
            a,
            yaw_rate,
            (car.lf * force_front - car.lr * force_rear) / car.inertia,
            (force_front + force_rear) / (car.m * v) - yaw_rate,
        ]
    )


def rolling_model(y, rate, a, car):
    """The kinematic model below 0.5 m/s; slip and yaw rate are differentiated in small steps."""
    _, _, delta, v, psi, _, beta = y
    length, h = car.lf + car.lr, 1e-6

    def slip(angle):
        return np.arctan(car.lr / length * np.tan(angle))

    def yaw_rate(angle, speed, side):
        return speed * np.cos(side) * np.tan(angle) / length

    slip_dot = rate * (slip(delta + h) - slip(delta - h)) / (2.0 * h)
    change = np.array([rate, a, slip_dot])
    now = np.array([delta, v, beta])
    yaw_dot = (yaw_rate(*(now + h * change)) - yaw_rate(*(now - h * change))) / (2.0 * h)
    way = psi + slip(delta)
    return np.array(
        [
            v * np.cos(way),
            v * np.sin(way),
            rate,
            a,
            yaw_rate(delta, v, slip(delta)),
            yaw_dot,
            slip_dot,
        ]
    )


def limited(y, rate, a, car):
    """Inputs that the car can follow."""
    delta, v = y[2], y[3]
    rate = np.clip(rate, -car.steer_rate_max, car.steer_rate_max)
    if abs(delta) >= car.steer_max and rate * delta >= 0.0:
        rate = 0.0
    a = np.clip(a, -car.a_max, car.a_max * min(1.0, car.v_switch / max(v, 1e-9)))
    if (v <= car.v_min and a <= 0.0) or (v >= car.v_max and a >= 0.0):
        a = 0.0
    return rate, a


def runge_kutta(y, rate, a, car, dt):
    """One classic Runge-Kutta step."""

    def change(state):
        model = side_slip_model if state[3] >= 0.5 else rolling_model
        return model(state, *limited(state, rate, a, car), car)

    k1 = change(y)
    k2 = change(y + 0.5 * dt * k1)
    k3 = change(y + 0.5 * dt * k2)
    k4 = change(y + dt * k3)
    after = y + dt / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    after[4] %= 2.0 * np.pi
    return after


OTHER_CAR = VehicleParams(
    0.9, 4.1, 5.9, 0.14, 0.19, 0.09, 3.1, 0.05, 0.40, 2.9, 5.5, 8.0, -4.0, 15.0, 0.28, 0.5
)


@pytest.mark.parametrize("car", [F1TENTH, OTHER_CAR], ids=["f1tenth", "another"])
@pytest.mark.parametrize(
    ("speeds", "tolerance"),
    [((0.6, 15.0), 1e-11), ((-3.5, 0.4), 1e-7)],
    ids=["dynamic", "kinematic"],
)
def test_a_step_is_a_runge_kutta_step_of_the_models_equations(car, speeds, tolerance):
    rng = np.random.default_rng(1)
    for _ in range(150):
        y = rng.uniform(
            [-9.0, -9.0, -0.39, speeds[0], -20.0, -4.0, -0.4],
            [9.0, 9.0, 0.39, speeds[1], 20.0, 4.0, 0.4],
        )
        rate, a, dt = rng.uniform(-4.0, 4.0), rng.uniform(-12.0, 12.0), rng.uniform(0.002, 0.012)
        found = simulate(y, [[rate, a]], control_mode="rates", params=car, dt=dt)[1]
        np.testing.assert_allclose(
            found, runge_kutta(y, rate, a, car, dt), rtol=tolerance, atol=tolerance
        )


def test_at_its_limits_the_car_follows_what_it_can():
    for column, value, inputs in [
        (DELTA, 0.4189, (2.0, 0.0)),  # at the stop, and further
        (DELTA, 0.4189, (-2.0, 0.0)),  # and back
        (DELTA, -0.43, (-2.0, 0.0)),
        (DELTA, -0.43, (2.0, 0.0)),
        (V, 20.0, (0.0, 3.0)),
        (V, 20.0, (0.0, -3.0)),
        (V, 12.0, (0.0, 9.0)),  # in the range of speeds that power limits
        (V, -5.0, (0.0, -3.0)),
        (V, -5.0, (0.0, 3.0)),
        (V, 3.0, (9.0, 99.0)),
        (V, 3.0, (-9.0, -99.0)),
    ]:
        y = at_speed(3.0)
        y[column] = value
        found = simulate(y, [inputs], control_mode="rates")[1]
        np.testing.assert_allclose(
            found, runge_kutta(y, *inputs, F1TENTH, 0.01), rtol=1e-7, atol=1e-9
        )


def test_the_default_car_is_that_of_the_established_simulator():
    """The numbers that f1tenth_gym publishes for its car."""
    published = (
        "mu 1.0489 c_sf 4.718 c_sr 5.4562 lf 0.15875 lr 0.17145 h 0.074 m 3.74 inertia 0.04712"
        " steer_max 0.4189"
    )
    published += (
        " steer_rate_max 3.2 v_switch 7.319 a_max 9.51 v_min -5.0 v_max 20.0 width 0.31 length 0.58"
    )
    words = published.split()
    # That car has ideal actuators, apart from a time constant of its speed, and ideal sensors.
    actuators = {"steer_delay": 0.0, "steer_noise": None, "steer_lag": 0.0, "speed_delay": 0.0}
    actuators |= {"speed_lag": 0.1, "speed_noise": 0.0}
    ideal = {"lidar_fov": 2.0 * np.pi, "opponent_lost_time": 0.5}  # where 0 is no ideal
    names = [field.name for field in dataclasses.fields(F1TENTH)]
    sensors = {name: ideal.get(name, 0.0) for name in names[names.index("lidar_x") :]}
    own = dataclasses.asdict(F1TENTH)
    assert own.pop("tyres") == "linear"
    for name in ("b_f", "c_f", "d_f", "e_f", "b_r", "c_r", "d_r", "e_r"):
        own.pop(name)
    assert own == {
        **dict(zip(words[::2], map(float, words[1::2]), strict=True)),
        **actuators,
        **sensors,
    }
    assert len(F1TENTH.as_row()) == PARAMS_SIZE
    assert F1TENTH.wheelbase == pytest.approx(0.3302)


@pytest.mark.parametrize("dt", [0.01, 0.04])
def test_a_lag_is_the_exact_answer_of_a_first_order_servo_within_its_rate(dt):
    car = VehicleParams(steer_lag=0.1)
    times = dt * np.arange(41)
    small = simulate(at_speed(3.0), constant(0.02, 3.0, 40), params=car, dt=dt)[:, DELTA]
    np.testing.assert_allclose(small, 0.02 * (1.0 - np.exp(-times / 0.1)), rtol=1e-12, atol=1e-15)
    slow = dataclasses.replace(car, steer_rate_max=0.5)
    far = simulate(at_speed(3.0), constant(0.3, 3.0, 40), params=slow, dt=dt)[:, DELTA]
    reached = 0.0
    for angle in far[1:]:
        reached += min((1.0 - np.exp(-dt / 0.1)) * (0.3 - reached), 0.5 * dt)
        assert angle == pytest.approx(reached, abs=1e-12)
    assert far[1] == pytest.approx(0.5 * dt)


def test_the_speed_approaches_its_command_with_its_time_constant():
    for lag in (0.1, 0.25):
        car = VehicleParams(speed_lag=lag)
        speeds = simulate(at_speed(4.0), constant(0.0, 4.5, 30), params=car)[:, V]
        expected = 4.5 - 0.5 * (1.0 - 0.01 / lag) ** np.arange(31)
        np.testing.assert_allclose(speeds, expected, rtol=1e-12)


TARGETS = np.stack([np.linspace(-0.5, 0.5, LANES), np.linspace(0.0, 12.0, LANES)], axis=1)


@compiled
def _drive(lanes, states, params, targets, steps):  # type: ignore[no-untyped-def]
    """Drive the cars in their lanes, and alone where the lanes cannot."""
    for lane in range(states.shape[0]):
        load_car(lanes, lane, states[lane], params[lane], 0.01)
        set_target(lanes, lane, targets[lane, 0], targets[lane, 1])
    slow = np.zeros(states.shape[0], np.bool_)
    taken = 0
    for _ in range(steps):
        for lane in range(states.shape[0]):
            slow[lane] = steps_alone(lanes, lane)
            if slow[lane]:
                step_alone(lanes, lane, states[lane], params[lane], 0.01)
        step_lanes(lanes, states.shape[0], 0.01)
        for lane in range(states.shape[0]):
            if slow[lane]:
                load_car(lanes, lane, states[lane], params[lane], 0.01)
                taken += 1
            else:
                store_car(lanes, lane, states[lane])
    return taken


@pytest.mark.parametrize("cars", [1, 2, 5, LANES])
def test_cars_in_lanes_drive_as_alone(cars):
    tyres, lags = ("linear", "linear", "pacejka"), (0.0, 0.05)
    vehicles = [
        VehicleParams(
            mu=0.8 + 0.05 * k,
            m=3.0 + 0.3 * k,
            tyres=tyres[k % 3],
            inertia=0.001 if k == 4 else 0.05,  # too stiff for one step
            steer_lag=lags[k % 2],
            speed_lag=0.1 + 0.02 * k,
        )
        for k in range(cars)
    ]
    states = np.zeros((cars, 7))
    states[:, 3] = np.linspace(0.3, 7.0, cars)
    expected = simulate(states, np.tile(TARGETS[:cars, None], (1, 150, 1)), params=vehicles)[:, -1]
    rows = np.array([vehicle.as_row() for vehicle in vehicles])
    slow_steps = _drive(np.full(LANES_SIZE, np.nan), states, rows, TARGETS[:cars], 150)
    np.testing.assert_array_equal(states, expected)
    assert 0 < slow_steps <= 150 * cars


STIFF = ({"c_sf": 20.89, "c_sr": 20.89}, {"inertia": 1e-6}, {"m": 1e5}, {"mu": 10.0})
STIFF += ({"c_sf": 1000.0, "c_sr": 1000.0}, {"lf": 0.001, "c_sr": 900.0}, {"lr": 2.0})


@pytest.mark.parametrize("speed", [0.6, 3.0])
@pytest.mark.parametrize("change", STIFF, ids=str)
def test_stiff_cars_reach_their_steady_turn(change, speed):
    """The steering angle is curvature times wheelbase and understeer of the tyres' stiffness."""
    car = VehicleParams(**change)
    understeer = (1.0 / car.c_sf - 1.0 / car.c_sr) / (9.81 * car.mu)
    states = simulate(at_speed(speed), constant(0.02, speed, 300), params=car)
    expected = speed * 0.02 / (car.wheelbase + understeer * speed**2)
    assert states[-1, PSI_DOT] == pytest.approx(expected, rel=1e-4)


@given(seed=st.integers(0, 2**32 - 1))
def test_a_car_without_grip_spins_within_limits(seed):
    """Linear tyres hold an oversteering car at no speed; its state can be restored."""
    car = VehicleParams(c_sf=1000.0, c_sr=0.01, inertia=1e-6, h=10.0, a_max=1000.0, v_max=1000.0)
    targets = np.random.default_rng(seed).uniform([-1.0, -5.0], [1.0, 999.0], (300, 2))
    states = simulate(at_speed(5.0), targets, params=car)
    assert np.abs(states[:, [V, PSI_DOT, BETA]]).max() <= MAX_RATE


def test_the_names_of_the_gym_lead_to_ours():
    for theirs, ours in {
        "C_Sf": "c_sf",
        "C_Sr": "c_sr",
        "I": "inertia",
        "s_min": "steer_max",
        "sv_max": "steer_rate_max",
    }.items():
        refused(
            rf"unknown vehicle setting '{theirs}'.*did you mean '{ours}'",
            load_vehicle,
            {theirs: 1.0},
        )


def test_bad_input_and_impossible_vehicles_are_refused():
    for change, message in [
        ({"initial_state": np.zeros(6)}, r"initial_state has shape \(6,\)"),
        ({"controls": np.zeros((10, 3))}, r"controls have shape \(10, 3\)"),
        ({"controls": np.zeros((2, 10, 2))}, "controls have shape"),
        ({"controls": np.full((10, 2), np.nan)}, "NaN or infinity"),
        ({"initial_state": np.full(7, np.inf)}, "NaN or infinity"),
        ({"control_mode": "telepathy"}, "control_mode is 'telepathy'"),
        ({"dt": 0.0}, "dt is 0.0"),
        ({"dt": 0.1}, "dt is 0.1"),
        ({"params": [F1TENTH, F1TENTH]}, "2 sets for 1 vehicles"),
    ]:
        arguments = {"initial_state": np.zeros(7), "controls": np.zeros((10, 2))} | change
        refused(
            message,
            simulate,
            arguments.pop("initial_state"),
            arguments.pop("controls"),
            **arguments,
        )
    assert VehicleParams(steer_delay=0.5, steer_noise=0.0).steer_delay == 0.5
    wrong = {"m": 0.0, "mu": -1.0, "lf": np.nan, "a_max": np.inf, "v_min": 1.0, "steer_delay": 0.52}
    wrong |= {"steer_lag": -0.1, "speed_lag": 0.0, "speed_delay": 0.03, "speed_noise": np.nan}
    for parameter, value in wrong.items():
        refused(f"^{parameter} is", VehicleParams, **{parameter: value})
