"""Strength of planners whose car is not perfect, against planners with a perfect car.

    python dev/benchmarks/imperfect_cars.py --out out/imperfect

Circuits are held out of all trainings. Cars start from both sides. Intervals of 95 % are clustered
by circuit and start line. A planner may be the folder of a training. Each finished batch of races
is a file in the folder; a stopped run goes on from there.
"""

import argparse
import os
from pathlib import Path

import numpy as np
from learned import LINE, OWN, REAL, WON, Races, estimate, maps_of

from pcs_racing.car.vehicle import load_vehicle

CARS = {
    "perfect": {},
    "Pacejka tyres": {"tyres": "pacejka"},
    "steering lag .1 s": {"steer_lag": 0.1},
    "opponent 100 ms late": {"opponent_delay": 0.1},
    "localisation noise .1 m": {"pose_noise": 0.1},
    "10 % of the beams lost": {"lidar_lost": 0.1},
}
"""Changes of the own car."""
PLANNERS = (
    *("line-ppo", "line-ppo-robust", "lidar-ppo", "lattice", "lattice:early", "mpcc"),
    *("pure-pursuit", "residual", "gap-follower"),
)
RIVALS = ("lattice:early", "pure-pursuit")
SLOW_TO_COMPUTE = ("mpcc",)  # a 25th of the races
TRACKS = ("Saltmere", "Vellindra", "Austin", "Monza")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("--out", type=Path, required=True, help="folder of finished races")
    add("--planners", nargs="+", default=PLANNERS, help="planners, or folders of trainings")
    add("--races", type=int, default=100, help="races against an opponent on a circuit")
    add("--threads", type=int, default=os.cpu_count(), help="threads that share the races")
    arguments = parser.parse_args()
    if arguments.races < 8 or arguments.threads < 1:
        said = f"--races {arguments.races} must be at least 8"
        parser.error(f"{said}, --threads {arguments.threads} at least 1")
    kept = Races(
        arguments.out, maps_of([track for track in TRACKS if track in REAL]), arguments.threads
    )
    print("| planner | car | score [95 %] | own crashes [95 %] | races |")
    print("|---|---|---|---|---|")
    rows = {}
    for planner in arguments.planners:
        races = arguments.races // 25 if planner in SLOW_TO_COMPUTE else arguments.races
        for name, changes in CARS.items():
            # Tyres are the same for both cars: with others the races show the grip alone.
            cars = load_vehicle(changes), load_vehicle({"tyres": changes.get("tyres", "linear")})
            found = [
                np.concatenate(
                    [kept.on(track, planner, rival, "contest", races, cars) for rival in RIVALS]
                )
                for track in TRACKS
            ]
            rows[planner, name] = found
            print(
                f"| {planner} | {name} | {estimate(found, WON)} | {estimate(found, OWN)}"
                f" | {sum(map(len, found))} |",
                flush=True,
            )
    for name in CARS if {"line-ppo", "line-ppo-robust"} <= set(arguments.planners) else ():
        plain, robust = (np.array(rows[one, name]) for one in ("line-ppo", "line-ppo-robust"))
        gain = robust - plain  # the same starts and noise
        gain[..., LINE] = plain[..., LINE]
        print(f"line-ppo-robust minus line-ppo, {name}: {estimate(list(gain), WON, False)}")


if __name__ == "__main__":
    main()
