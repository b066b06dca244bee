import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcs_racing import F1TENTH, InputError, VehicleParams, simulate
from pcs_racing.vehicle import BETA, DELTA, PSI_DOT, V, X


def constant(steer: float, speed: float, steps: int) -> np.ndarray:
    return np.tile([steer, speed], (steps, 1))


def at_speed(v: float) -> np.ndarray:
    return np.array([0.0, 0.0, 0.0, v, 0.0, 0.0, 0.0])


@pytest.mark.parametrize(("mode", "name"), [("rates", "raw"), ("f1tenth_gym", "cmd")])
def test_reproduces_the_established_simulator(reference, mode, name):
    data = np.load(reference / "st_dynamics.npz")
    states, controls = data[f"{name}_states"], data[f"{name}_controls"]
    found = simulate(states[:, 0], controls, control_mode=mode)
    np.testing.assert_allclose(found, states, rtol=0.0, atol=1e-9)


def test_one_vehicle_equals_a_batch_of_one():
    single = simulate(at_speed(3.0), constant(0.1, 4.0, 50))
    batch = simulate(at_speed(3.0)[None], constant(0.1, 4.0, 50)[None])
    assert single.shape == (51, 7)
    assert batch.shape == (1, 51, 7)
    np.testing.assert_array_equal(single, batch[0])


def test_every_parameter_belongs_to_one_car():
    """Each parameter changes the car that has it, and no other."""
    # To the power and speed limits, at the steering limit, then backwards: every parameter has work to do.
    controls = np.concatenate([constant(0.5, 25.0, 250), constant(-0.5, -9.0, 400)])
    start = at_speed(7.0)
    usual = simulate(start, controls)
    body = {"width", "length"}  # they matter for contacts only
    for field in dataclasses.fields(VehicleParams):
        value = getattr(F1TENTH, field.name)
        other = dataclasses.replace(F1TENTH, **{field.name: 0.5 * value})
        pair = simulate(np.stack([start, start]), np.stack([controls, controls]), params=[F1TENTH, other])
        np.testing.assert_array_equal(pair[0], usual)
        assert np.array_equal(pair[1], usual) == (field.name in body), field.name


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


def test_speed_reaches_its_target_without_overshoot():
    v = simulate(at_speed(2.0), constant(0.0, 6.0, 300))[:, V]
    assert (np.diff(v) >= 0.0).all()
    assert v[-1] == pytest.approx(6.0, abs=1e-3)
    v = simulate(at_speed(6.0), constant(0.0, 2.0, 300))[:, V]
    assert (np.diff(v) <= 0.0).all()
    assert v[-1] == pytest.approx(2.0, abs=1e-3)
    assert np.diff(v).min() >= -F1TENTH.a_max * 0.01 - 1e-12


def test_straight_ahead_stays_straight():
    states = simulate(at_speed(5.0), constant(0.0, 5.0, 100))
    assert states[-1, X] == pytest.approx(5.0)
    np.testing.assert_array_equal(states[:, [1, DELTA, PSI_DOT, BETA]], 0.0)


def test_left_and_right_are_mirror_images():
    left = simulate(at_speed(4.0), constant(0.2, 5.0, 100))
    right = simulate(at_speed(4.0), constant(-0.2, 5.0, 100))
    mirror = np.array([1.0, -1.0, -1.0, 1.0, -1.0, -1.0, -1.0])
    heading = np.mod(right[1:, 4], 2 * np.pi)
    np.testing.assert_allclose(np.mod(-left[1:, 4], 2 * np.pi), heading, atol=1e-12)
    np.testing.assert_allclose((left * mirror)[:, [0, 1, 2, 3, 5, 6]], right[:, [0, 1, 2, 3, 5, 6]], atol=1e-12)


@given(
    seed=st.integers(0, 2**32 - 1),
    speed=st.floats(-5.0, 20.0),
    mode=st.sampled_from(["target", "rates", "f1tenth_gym"]),
)
def test_any_driving_keeps_the_state_finite_and_within_limits(seed, speed, mode):
    rng = np.random.default_rng(seed)
    high = [4.0, 12.0] if mode == "rates" else [0.6, 22.0]
    controls = rng.uniform(np.negative(high), high, (100, 2))
    states = simulate(at_speed(speed), controls, control_mode=mode)
    assert np.isfinite(states).all()
    slack = 1e-9 + (F1TENTH.steer_rate_max * 0.01 if mode != "target" else 0.0)  # only "target" arrives exactly
    assert np.abs(states[:, DELTA]).max() <= F1TENTH.steer_max + slack
    assert states[:, V].min() >= F1TENTH.v_min - F1TENTH.a_max * 0.01 - 1e-9
    assert states[:, V].max() <= F1TENTH.v_max + F1TENTH.a_max * 0.01 + 1e-9
    assert ((states[1:, 4] >= 0.0) & (states[1:, 4] <= 2.0 * np.pi)).all()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"initial_state": np.zeros(6)}, r"initial_state has shape \(6,\)"),
        ({"controls": np.zeros((10, 3))}, r"controls have shape \(10, 3\)"),
        ({"controls": np.zeros((2, 10, 2))}, "controls have shape"),
        ({"controls": np.full((10, 2), np.nan)}, "NaN or infinity"),
        ({"initial_state": np.full(7, np.inf)}, "NaN or infinity"),
        ({"control_mode": "telepathy"}, "control_mode is 'telepathy'"),
        ({"dt": 0.0}, "dt is 0.0"),
        ({"dt": 0.1}, "dt is 0.1"),
        ({"params": [F1TENTH, F1TENTH]}, "2 sets for 1 vehicles"),
    ],
)
def test_bad_input_is_refused(change, message):
    arguments = {"initial_state": np.zeros(7), "controls": np.zeros((10, 2))} | change
    with pytest.raises(InputError, match=message):
        simulate(arguments.pop("initial_state"), arguments.pop("controls"), **arguments)


@pytest.mark.parametrize(
    ("parameter", "value"), [("m", 0.0), ("mu", -1.0), ("lf", np.nan), ("a_max", np.inf), ("v_min", 1.0)]
)
def test_impossible_vehicles_are_refused(parameter, value):
    with pytest.raises(InputError, match=f"vehicle parameter {parameter} is"):
        VehicleParams(**{parameter: value})
