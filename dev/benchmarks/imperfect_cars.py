"""Strength of planners whose car is not perfect, against planners with a perfect car.

    python dev/benchmarks/imperfect_cars.py --out out/imperfect

Circuits are held out of all trainings. Cars start from both sides. Intervals of 95 % are clustered
by circuit and start line. A planner may be the folder of a training. Each finished batch of races
is a file in the folder; a stopped run goes on from there.
"""

import argparse
import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pcs_racing import load_track, run_races
from pcs_racing.car.vehicle import F1TENTH, VehicleParams, load_vehicle
from pcs_racing.planners.racers import policy_racer
from pcs_racing.race.config import load_rules
from pcs_racing_agents.base.fingerprint import fingerprint
from pcs_racing_agents.base.statistics import clustered_mean

CARS = {
    "perfect": {},
    "Pacejka tyres": {"tyres": "pacejka"},
    "steering lag .1 s": {"steer_lag": 0.1},
    "speed lag .2 s": {"speed_lag": 0.2},
    "steering 40 ms late": {"steer_delay": 0.04},
    "speed 100 ms late": {"speed_delay": 0.1},
    "opponent 100 ms late": {"opponent_delay": 0.1},
    "localisation noise .1 m": {"pose_noise": 0.1},
    "10 % of the beams lost": {"lidar_lost": 0.1},
}
"""Changes of the own car."""
PLANNERS = (
    *("line-ppo", "lidar-ppo", "lattice", "lattice:early"),
    *("pure-pursuit", "gap-follower"),
)
RIVALS = ("lattice:early", "pure-pursuit")
REAL = ("Austin", "Monza")
TRACKS = ("Saltmere", "Vellindra", *REAL)
SEED = 4049
WON, OWN, WORSE, OVERTAKES, SPEED, LINE = range(6)
"""Columns of a race."""


class Races:
    """Races of pairs, kept in a folder."""

    def __init__(self, folder: Path, maps: Path, threads: int) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.folder, self.maps, self.threads = folder, maps, threads

    def on(
        self,
        track: str,
        ego: str,
        rival: str,
        rules: str,
        races: int,
        vehicles: tuple[VehicleParams, ...] = (),
    ) -> np.ndarray:
        """Return a row for each race: score, own crash, the rival's, overtakes, speed, line."""
        circuit = load_track(str(self.maps / track) if track in REAL else track)
        policies = [policy_racer(text) for text in (ego, rival)]
        config = load_rules(rules)
        # Weights, rules, cars or circuits that changed are other races.
        mark = fingerprint(policies, config, circuit.content_hash, SEED, *vehicles)[:12]
        pair = f"{ego} {rival}".replace("/", "-")
        file = self.folder / f"{pair} {rules} {track} {races} {mark}.npy"
        if not file.exists():
            result = run_races(
                circuit,
                [policies[0]] * races,
                policies[1],
                config,
                seed=SEED,
                vehicle=vehicles or F1TENTH,
                threads=self.threads,
            )
            state = result.state
            won = np.where(result.winner == -1, 0.5, result.winner == 0)
            speed = state.progress[:, 0] / np.maximum(result.time, 0.1)
            line = np.arange(races) // 2 % config.start_lines
            columns = [won, *result.own_crash.T, state.overtakes[:, 0], speed, line]
            new = file.with_suffix(".new.npy")
            np.save(new, np.stack(columns, axis=1).astype(float))
            new.replace(file)
        return np.load(file)


def estimate(found: Sequence[np.ndarray], column: int) -> str:
    """Return the mean of a column of shares, with its interval."""
    labels = [f"{k} {line}" for k, rows in enumerate(found) for line in rows[:, LINE]]
    mean = clustered_mean(np.concatenate(found)[:, column], labels)
    return f"{mean.mean:.3f} [{max(mean.low, 0.0):.3f}, {min(mean.high, 1.0):.3f}]"


def maps_of(names: Sequence[str]) -> Path:
    """Return the folder of real circuits, which has these names."""
    maps = Path(os.environ.get("PCS_RACING_MAPS", "../shared/maps"))
    missing = [name for name in names if not (maps / name).is_dir()]
    if missing:
        raise SystemExit(f"{maps} lacks {', '.join(missing)}; set PCS_RACING_MAPS to the circuits")
    return maps


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
    kept = Races(arguments.out, maps_of(REAL), arguments.threads)
    print("| planner | car | score [95 %] | own crashes [95 %] | races |")
    print("|---|---|---|---|---|")
    for planner in arguments.planners:
        for name, changes in CARS.items():
            # Tyres are the same for both cars: with others the races show the grip alone.
            cars = load_vehicle(changes), load_vehicle({"tyres": changes.get("tyres", "linear")})
            found = [
                np.concatenate(
                    [
                        kept.on(track, planner, rival, "contest", arguments.races, cars)
                        for rival in RIVALS
                    ]
                )
                for track in TRACKS
            ]
            print(
                f"| {planner} | {name} | {estimate(found, WON)} | {estimate(found, OWN)}"
                f" | {sum(map(len, found))} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
