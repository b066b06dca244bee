"""Pacejka tyres: the published equations, their limits, and cars that races are driven with."""

import dataclasses

import numpy as np
import pytest
from refusal import refused
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from pcs_racing.car.tyres import pacejka_curve, pacejka_peak
from pcs_racing.car.vehicle import (
    BETA,
    F1TENTH,
    F1TENTH_PACEJKA,
    FORZAETH_NUC2,
    PSI_DOT,
    VEHICLES,
    V,
    VehicleParams,
    load_vehicle,
    load_vehicles,
    simulate,
)

CARS = pytest.mark.parametrize(
    "car", [F1TENTH_PACEJKA, FORZAETH_NUC2], ids=["f1tenth-pacejka", "forzaeth-nuc2"]
)


def share(slip, b, c, e):
    """Pacejka's formula, as published, as a share of its peak."""
    return np.sin(c * np.arctan(b * slip - e * (b * slip - np.arctan(b * slip))))


def loads(car, a):
    """Loads of the axles under a longitudinal acceleration, N."""
    front = car.m * (9.81 * car.lr - a * car.h) / car.wheelbase
    return front, car.m * (9.81 * car.lf + a * car.h) / car.wheelbase


def published(_, y, rate, a, car):
    """The single-track model with Pacejka tyres of f110-simulator and gymkhana: accelerations along
    the car and across it, turned into the derivatives of speed and slip angle.
    """
    _, _, delta, v, psi, yaw_rate, beta = y
    along, across = v * np.cos(beta), v * np.sin(beta)
    front_slip = -np.arctan((across + car.lf * yaw_rate) / along) + delta
    rear_slip = -np.arctan((across - car.lr * yaw_rate) / along)
    front_load, rear_load = loads(car, a)
    front = car.mu * car.d_f * front_load * share(front_slip, car.b_f, car.c_f, car.e_f)
    rear = car.mu * car.d_r * rear_load * share(rear_slip, car.b_r, car.c_r, car.e_r)
    ahead = a - front * np.sin(delta) / car.m + across * yaw_rate
    aside = (front * np.cos(delta) + rear) / car.m - along * yaw_rate
    return [
        v * np.cos(psi + beta),
        v * np.sin(psi + beta),
        rate,
        ahead * np.cos(beta) + aside * np.sin(beta),
        yaw_rate,
        (car.lf * front * np.cos(delta) - car.lr * rear) / car.inertia,
        (aside * np.cos(beta) - ahead * np.sin(beta)) / v,
    ]


@CARS
def test_steps_are_the_integral_of_the_published_equations(car):
    rng = np.random.default_rng(2)
    for _ in range(25):
        speed = rng.uniform(3.0, 12.0)
        start = np.array([1.0, 2.0, rng.uniform(-0.3, 0.3), speed, rng.uniform(1.0, 5.0), 0.0, 0.0])
        start[PSI_DOT], start[BETA] = rng.uniform(-0.3, 0.3) * speed, rng.uniform(-0.07, 0.07)
        inputs = rng.uniform(-3.0, 3.0), rng.uniform(-8.0, 4.0)
        found = simulate(
            start, np.tile(inputs, (100, 1)), control_mode="rates", dt=1e-4, params=car
        )
        exact = solve_ivp(
            published, (0.0, 0.01), start, "DOP853", rtol=1e-12, atol=1e-14, args=(*inputs, car)
        )
        np.testing.assert_allclose(found[-1], exact.y[:, -1], rtol=1e-9, atol=1e-11)


@CARS
@pytest.mark.parametrize("speed", [1.5, 2.5, 4.0, 5.5, 7.0])
def test_in_steady_cornering_the_axles_carry_the_car(car, speed):
    """Each axle's force is its share of the lateral force; the steering is the wheelbase over the
    radius, plus the slip of the front tyres minus the slip of the rear ones.
    """
    radius = speed**2 / (0.5 * 0.6 * 9.81)  # at half of the grip
    states = simulate(
        [0.0, 0.0, 0.0, speed, 0.0, 0.0, 0.0],
        np.tile([car.wheelbase / radius, speed], (1500, 1)),
        params=car,
    )
    _, _, delta, v, _, yaw_rate, beta = states[-1]
    np.testing.assert_allclose(states[-1, [3, 5, 6]], states[-100, [3, 5, 6]], rtol=1e-9)
    along, a = v * np.cos(beta), 10.0 * (speed - v)  # which makes up for the drag of the bend
    front_load, rear_load = loads(car, a)
    lateral = car.m * along * yaw_rate
    front, rear = lateral * car.lr / car.wheelbase / np.cos(delta), lateral * car.lf / car.wheelbase

    def slip(force, load, b, c, d, e):
        """Invert the rising part of the curve."""
        wanted = force / (car.mu * d * load)
        return brentq(lambda one: share(one, b, c, e) - wanted, 0.0, 0.055, xtol=1e-14)

    front_slip = slip(front, front_load, car.b_f, car.c_f, car.d_f, car.e_f)
    rear_slip = slip(rear, rear_load, car.b_r, car.c_r, car.d_r, car.e_r)
    turn = np.tan(-rear_slip) + car.wheelbase * yaw_rate / along
    assert delta == pytest.approx(np.arctan(turn) + front_slip, abs=1e-9)
    understeer = delta - np.arctan(car.wheelbase * yaw_rate / v)
    assert understeer == pytest.approx(front_slip - rear_slip, abs=0.1 * delta**2)


@pytest.mark.parametrize(
    ("b", "c", "e"), [(6.6185, 1.6102, 0.7826), (7.9507, 3.692, 0.5595), (20.0, 1.5, 0.0)]
)
def test_the_force_has_its_peak_at_the_right_slip_angle(b, c, e):
    """Where C times the arctangent is a quarter turn."""
    x = brentq(lambda one: one - e * (one - np.arctan(one)) - np.tan(0.5 * np.pi / c), 0.0, 50.0)
    assert pacejka_curve(x / b, b, c, e) == pytest.approx(1.0, abs=1e-12)
    assert pacejka_curve(-x / b, b, c, e) == pytest.approx(-1.0, abs=1e-12)
    assert pacejka_peak(c, e) == 1.0
    for other in (0.95 * x / b, 1.05 * x / b):
        assert pacejka_curve(other, b, c, e) < 0.9999
    small = 1e-6
    assert pacejka_curve(small, b, c, e) == pytest.approx(b * c * small, rel=1e-6)


@pytest.mark.parametrize(("c", "e"), [(0.4182, 0.3722), (0.5624, 1.0648), (1.2, 1.5), (0.5, 1.0)])
def test_a_curve_without_a_peak_has_its_largest_value_as_one(c, e):
    slips = np.geomspace(1e-3, 1e6, 4000)
    largest = max(pacejka_curve(slip, 5.0, c, e) for slip in slips)
    assert pacejka_peak(c, e) == pytest.approx(largest, abs=1e-5)


def test_no_slip_makes_a_force_that_speeds_the_slide_up():
    """A fit to small slip angles reverses at large ones (the rear tyres of ``f1tenth_stp``)."""
    assert share(0.3, 7.9507, 3.692, 0.5595) < -0.6
    for slip in np.linspace(-1.5, 1.5, 61):
        assert pacejka_curve(slip, 7.9507, 3.692, 0.5595) * slip >= 0.0


@CARS
def test_a_car_creeps_without_chatter_and_recovers_from_a_spin(car):
    creep = simulate(np.zeros(7), np.tile([0.2, 0.7], (300, 1)), params=car)
    rolling = 0.7 * np.tan(0.2) / car.wheelbase
    np.testing.assert_allclose(creep[-50:, PSI_DOT], rolling, rtol=0.05)
    assert np.ptp(creep[-50:, PSI_DOT]) < 1e-4
    spinning = np.array([0.0, 0.0, 0.0, 2.0, 0.0, 8.0, 2.5])
    after = simulate(spinning, np.tile([0.0, 3.0], (500, 1)), params=car)
    assert after[-1, V] == pytest.approx(3.0, abs=1e-3)
    assert after[-1, [PSI_DOT, BETA]] == pytest.approx([0.0, 0.0], abs=1e-6)
    assert after[:, V].max() < 3.1


def test_each_coefficient_changes_a_car_with_pacejka_tyres_only():
    controls = np.concatenate([np.tile([0.15, 5.0], (60, 1)), np.tile([-0.1, 2.0], (60, 1))])
    start = [0.0, 0.0, 0.0, 5.0, 0.0, 0.0, 0.0]
    usual = {car: simulate(start, controls, params=car) for car in (F1TENTH, F1TENTH_PACEJKA)}
    for name in ("b_f", "c_f", "d_f", "e_f", "b_r", "c_r", "d_r", "e_r", "c_sf", "c_sr"):
        for car, states in usual.items():
            other = dataclasses.replace(car, **{name: 0.9 * getattr(car, name)})
            same = np.array_equal(simulate(start, controls, params=other), states)
            assert same == (name.startswith("c_s") == (car.tyres == "pacejka")), name


def test_shipped_cars_have_published_numbers_and_a_name(tmp_path):
    stp = load_vehicle("f1tenth-pacejka")
    assert dataclasses.replace(stp, tyres="linear") == load_vehicle("f1tenth") == F1TENTH
    assert [stp.b_f, stp.c_f, stp.d_f, stp.e_f] == [6.6185, 1.6102, 0.652, 0.7826]
    assert [stp.b_r, stp.c_r, stp.d_r, stp.e_r] == [7.9507, 3.692, 0.6691, 0.5595]
    nuc2 = load_vehicle("forzaeth-nuc2")
    assert (nuc2.m, nuc2.inertia, nuc2.lf, nuc2.lr, nuc2.h) == (3.54, 0.05797, 0.162, 0.145, 0.014)
    assert [nuc2.b_r, nuc2.c_r, nuc2.d_r, nuc2.e_r] == [20.0, 1.5, 0.618418, 0.0]
    assert load_vehicles(["f1tenth", "forzaeth-nuc2"]) == (F1TENTH, nuc2)
    for car in VEHICLES.values():  # they were made without the checks
        assert VehicleParams(**dataclasses.asdict(car)) == car
    own = tmp_path / "mine.yaml"
    own.write_text("tyres: pacejka\nd_f: 0.9\n")
    assert load_vehicle(own) == dataclasses.replace(stp, d_f=0.9)
    unknown = "'forzaeth-nuc3' are unknown; use f1tenth, f1tenth-pacejka, forzaeth-nuc2"
    refused(unknown, load_vehicle, "forzaeth-nuc3")


@pytest.mark.parametrize(
    ("name", "value", "limits"),
    [
        ("b_f", 0.0, "from 0.1 to 100"),
        ("b_r", -7.0, "from 0.1 to 100"),
        ("c_f", np.nan, "from 0.1 to 4"),
        ("c_r", 4.5, "from 0.1 to 4"),
        ("d_f", 3.1, "from 0.01 to 3"),
        ("d_r", 0.0, "from 0.01 to 3"),
        ("e_f", 2.5, "from -20 to 2"),
        ("e_r", "flat", "from -20 to 2"),
        ("tyres", "slicks", "linear, pacejka"),
    ],
)
def test_impossible_tyres_are_refused(name, value, limits):
    message = rf"^{name} is {value!r}; it must be .*{limits}"
    refused(message, load_vehicle, {"tyres": "pacejka", name: value})
