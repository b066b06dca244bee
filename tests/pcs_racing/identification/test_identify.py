"""A known car drives with noise, and comes back from its log."""

from dataclasses import replace

import numpy as np
import pytest
from refusal import refused

from pcs_racing.car.vehicle import F1TENTH, FORZAETH_NUC2, load_vehicle
from pcs_racing.identification import (
    SensorNoise,
    identify,
    record_test_drive,
    write_vehicle,
    yaw_rate_error,
)
from pcs_racing.identification.fitting import tyre_points

CAR = replace(FORZAETH_NUC2, steer_lag=0.158, speed_delay=0.04, steer_noise=0.01)
OTHER = {
    **{"b_f": 8.0, "c_f": 1.5, "d_f": 0.8, "e_f": 0.0, "b_r": 8.0, "c_r": 1.5, "d_r": 0.8},
    **{"e_r": 0.0, "steer_lag": 0.05, "speed_delay": 0.0},
}
START = replace(CAR, **OTHER)


@pytest.fixture(scope="module")
def log():
    return record_test_drive(CAR, 10.0, noise=SensorNoise(), seed=1).without("v_y")


@pytest.fixture(scope="module")
def found(log):
    return identify(log, START)


def kept(found):
    return {one.name: one.reason for one in found.findings if one.reason}


def test_peaks_and_lags_come_back(found):
    car = found.vehicle
    for name, share in (("d_f", 0.05), ("d_r", 0.05), ("steer_lag", 0.08), ("speed_lag", 0.08)):
        assert getattr(car, name) == pytest.approx(getattr(CAR, name), rel=share), name
    assert (car.steer_delay, car.speed_delay) == (CAR.steer_delay, CAR.speed_delay)
    assert (car.m, car.lf, car.mu) == (CAR.m, CAR.lf, CAR.mu)
    assert kept(found)["steer_max"] == "no command passes this limit"
    peak = next(one for one in found.findings if one.name == "d_f")
    assert 0.0 < peak.deviation < 0.05


def test_the_car_predicts_another_drive(found):
    fresh = record_test_drive(replace(CAR, steer_noise=None), 6.0, effort=0.4, seed=7)
    errors = [yaw_rate_error(car, fresh) for car in (CAR, found.vehicle, START)]
    assert errors[0] < errors[1] < 0.1 < errors[2]


def test_measured_forces_lie_on_the_curve(found):
    slips, forces = tyre_points(found)
    small = np.abs(slips) < 0.04
    for axle, stiffness in enumerate((4.8 * 2.16 * 0.65, 20.0 * 1.5 * 0.618)):
        slope = np.polyfit(slips[axle][small[axle]], forces[axle][small[axle]], 1)[0]
        assert slope == pytest.approx(stiffness, rel=0.35)


def test_a_written_car_is_a_vehicle_file(found, tmp_path):
    path = write_vehicle(found, tmp_path / "my_car.yaml")
    assert load_vehicle(path) == found.vehicle
    assert "# kept: no command passes this limit" in path.read_text()


def test_a_gentle_drive_keeps_peaks_and_says_why():
    log = record_test_drive(CAR, 8.0, effort=0.15, noise=SensorNoise(), seed=3)
    reasons = kept(identify(log, START))
    assert {"d_f", "d_r"} <= reasons.keys()
    assert "slip angles of the rear tyres up to 0.0" in reasons["d_r"]


def test_a_log_without_commands_or_with_constant_speed_keeps_lags():
    log = record_test_drive(CAR, 8.0, effort=0.3, noise=SensorNoise(), seed=3)
    reasons = kept(identify(log.without("steer", "speed"), START))
    assert reasons["steer_lag"] == "the log has no steering command"
    assert reasons["a_max"] == "the log has no speed command"
    constant = replace(log.without("steer"), speed=np.full_like(log.t, 3.0))
    reasons = kept(identify(constant, START))
    assert reasons["speed_lag"] == "the command varies by 0 only"
    assert reasons["speed_delay"] == "speed_lag is not found either"


def test_linear_tyres_come_back():
    start = replace(F1TENTH, c_sf=8.0, c_sr=8.0)
    log = record_test_drive(F1TENTH, 8.0, effort=0.2, noise=SensorNoise(), seed=2)
    found = identify(log, start).vehicle
    assert found.c_sf == pytest.approx(F1TENTH.c_sf, rel=0.1)
    assert found.c_sr == pytest.approx(F1TENTH.c_sr, rel=0.1)


def test_a_log_that_shows_no_tyres_is_refused(log):
    bare = log.without("x", "y", "psi", "delta")
    straight = replace(bare, psi_dot=0.0 * log.t)
    refused("reaches 0 m/s.2 of lateral acceleration", identify, straight, START)
    slow = replace(bare, v_x=0.1 * log.v_x)
    refused("the log holds .* s of driving above 1 m/s; at least 5 s", identify, slow, START)
