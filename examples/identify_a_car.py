"""Identify the parameters of a car from the log of a test drive.

    python examples/identify_a_car.py
    python examples/identify_a_car.py --duration 60

A simulated car with known parameters makes a test drive, with sensor noise. Its log is written as
CSV and read again; the identification begins with other parameters. For a log of your own:
``pcs-racing identify drive.csv --out my_car.yaml``.
"""

import argparse
from pathlib import Path

from pcs_racing.identification import (
    SensorNoise,
    identify,
    load_vehicle,
    read_log,
    record_test_drive,
    write_log,
    write_vehicle,
    yaw_rate_error,
)

KNOWN = {
    **{"m": 3.54, "inertia": 0.058, "lf": 0.162, "lr": 0.145, "h": 0.014, "mu": 1.0},
    "tyres": "pacejka",
}
HIDDEN = {
    **{"b_f": 4.8, "c_f": 2.16, "d_f": 0.65, "e_f": 0.37, "b_r": 20.0, "c_r": 1.5, "d_r": 0.618},
    **{"e_r": 0.0, "steer_lag": 0.158, "steer_noise": 0.01},
}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--duration", type=float, default=30.0, help="length of the log in s")
    parser.add_argument("--seed", type=int, default=1, help="seed of the drive and of the noise")
    parser.add_argument(
        "--out", type=Path, default=Path("out/identify_a_car"), help="output folder"
    )
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)

    car = load_vehicle({**KNOWN, **HIDDEN})
    log = record_test_drive(car, arguments.duration, noise=SensorNoise(), seed=arguments.seed)
    # Few cars measure their lateral speed.
    file = write_log(log.without("v_y"), arguments.out / "drive.csv")

    found = identify(read_log(file), load_vehicle(KNOWN))
    print(f"{'parameter':<16}{'true':>8}{'found':>8}{'+-':>8}")
    for one in found.findings:
        about = f"  kept: {one.reason}" if one.reason else ""
        true = getattr(car, one.name)
        print(f"{one.name:<16}{true:8.3f}{one.value:8.3f}{1.96 * one.deviation:8.3f}{about}")
    fresh = record_test_drive(car, 10.0, effort=0.4, seed=arguments.seed + 1)
    print(f"yaw rate of a held-out drive: {yaw_rate_error(found.vehicle, fresh):.1%} RMS error")
    print("car:", write_vehicle(found, arguments.out / "my_car.yaml"))


if __name__ == "__main__":
    main()
