"""Identify three known cars from noisy logs, and compare with the values put in.

    python dev/benchmarks/identification.py                  # three cars, two logs each: minutes
    python dev/benchmarks/identification.py --seconds 60 --seeds 5

Each log is a test drive with the noise of :class:`pcs_racing.identification.SensorNoise` and an
AR(1) disturbance of the steering; speed across the car is not logged. The start car has the right
mass, geometry and friction coefficient, and other tyres, lags and limits. Errors are shares of the
true value; a lag's error in ms where the true lag is 0. The yaw rate is predicted for fresh logs
without noise, in windows of 1 s: a drive below the limits, and one with full steering.
"""

import argparse
import time
from dataclasses import replace

import numpy as np

from pcs_racing.car.vehicle import F1TENTH_PACEJKA, FORZAETH_NUC2, VehicleParams
from pcs_racing.identification.fitting import identify, yaw_rate_error
from pcs_racing.identification.recording import SensorNoise, record_test_drive

DISTURBANCE = 0.01  # rad, of every steering command
EFFORTS = (0.4, 1.0)  # of fresh drives
UNKNOWN = {
    **{"b_f": 8.0, "c_f": 1.5, "d_f": 0.8, "e_f": 0.0, "b_r": 8.0, "c_r": 1.5, "d_r": 0.8},
    **{"e_r": 0.0, "steer_lag": 0.05, "speed_lag": 0.1, "steer_rate_max": 3.2},
}
HEAD = (
    *("car", "log", "mu D front", "mu D rear", "steering lag", "speed lag"),
    *(f"yaw rate, effort {effort:g}" for effort in EFFORTS),
    "cpu, s",
)


def drawn_car(seed: int = 2) -> VehicleParams:
    """Return a car with drawn tyres and lags.

    Seed 2 is the first whose test drive reaches .9 of the peak of both axles; the peaks of seeds 0
    and 1 would keep the start car's values.
    """
    rng = np.random.default_rng(seed)

    def draw(low: float, high: float) -> float:
        return round(float(rng.uniform(low, high)), 3)

    limits = {"b": (6.0, 14.0), "c": (1.2, 1.8), "d": (0.6, 0.9), "e": (-0.5, 0.5)}
    tyres = {f"{name}_{axle}": draw(*limits[name]) for axle in "fr" for name in limits}
    lags = {"steer_lag": draw(0.05, 0.15), "speed_lag": draw(0.1, 0.3)}
    return replace(F1TENTH_PACEJKA, mu=0.9, **tyres, **lags)


def cars() -> dict[str, VehicleParams]:
    """Return the three cars."""
    return {
        "f1tenth-pacejka": F1TENTH_PACEJKA,
        "forzaeth-nuc2": replace(FORZAETH_NUC2, steer_lag=0.158),
        "drawn": drawn_car(),
    }


def error(true: float, found: float) -> str:
    return f"{1e3 * found:+.0f} ms" if true == 0.0 else f"{100.0 * (found / true - 1.0):+.1f} %"


def row(name: str, car: VehicleParams, seed: int, seconds: float) -> tuple[str, ...]:
    """Identify a car from a log, and return a row of the table."""
    log = record_test_drive(
        replace(car, steer_noise=DISTURBANCE), seconds, noise=SensorNoise(), seed=seed
    ).without("v_y")
    begin = time.process_time()
    found = identify(log, replace(car, **UNKNOWN)).vehicle
    spent = time.process_time() - begin
    values = [(getattr(car, key), getattr(found, key)) for key in ("d_f", "d_r")]
    values += [(getattr(car, key), getattr(found, key)) for key in ("steer_lag", "speed_lag")]
    fresh = [record_test_drive(car, effort=effort, seed=1000 + seed) for effort in EFFORTS]
    errors = [f"{100.0 * yaw_rate_error(found, one):.1f} %" for one in fresh]
    return (name, str(seed), *(error(*pair) for pair in values), *errors, f"{spent:.1f}")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seconds", type=float, default=30.0, help="length of a log")
    parser.add_argument("--seeds", type=int, default=2, help="number of logs of each car")
    parser.add_argument("--cars", nargs="+", choices=cars(), default=list(cars()))
    given = parser.parse_args()
    for cells in (HEAD, ("---",) * len(HEAD)):
        print("|", " | ".join(cells), "|")
    for name in given.cars:
        for seed in range(1, 1 + given.seeds):
            print("|", " | ".join(row(name, cars()[name], seed, given.seconds)), "|", flush=True)


if __name__ == "__main__":
    main()
