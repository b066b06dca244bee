"""Race the strongest planner under the rules `contest`, and find the stability of a pursuit.

    python dev/benchmarks/driving.py --maps ../shared/maps
    python dev/benchmarks/driving.py --only equal --circuits Saltmere Vellindra
    python dev/benchmarks/driving.py --only stability

Circuits: two shipped ones and four real ones (``--maps``), without a part in any training. "Today"
are the rules before limited sight and a slower front car. Each section prints a row for each
circuit and the mean:

equal      copies of one driver: wins of the car in front at the start, overtakes a race, own
           crashes of a car
better     `line-ppo` at pace 1.4 against pace 0.9, and against the lattice: share of single races
           and of series won, own crashes
archive    round robins of the archive `contest`: standard deviation of the ratings by series over
           that by single races of today; signal, per race, of the differences between policies
           (squared mean score less one half over its variance), likewise
stability  largest eigenvalue of a car on a straight and its pursuit, by the course that the pursuit
           takes for the car's
"""

import argparse
import csv
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from pcs_racing import CONTEST, load_archive, load_track, run_races
from pcs_racing.base.typing import Floats
from pcs_racing.car import vehicle as _vehicle
from pcs_racing.car.vehicle import F1TENTH
from pcs_racing.game.reward import sum_winners, utility
from pcs_racing.race.config import FULL_SIGHT, Rules, load_rules
from pcs_racing.race.races import RaceResult
from pcs_racing.track.track import Track
from pcs_racing_agents.tournament import play_tournament
from pcs_racing_agents.tournament.ratings import rate

CIRCUITS = ("Saltmere", "Vellindra", "Austin", "Monza", "Sepang", "Zandvoort")
TODAY = load_rules("contest", sight=FULL_SIGHT, front_pace=(1.0, 1.0), heats=1)
EQUALS = ("line-ppo", "line-ppo:assertiveness=0.9,pace=1.4", "lattice")
PAIRS = (("line-ppo:pace=1.4", "line-ppo:pace=0.9"), ("line-ppo", "lattice"))
RACES, ARCHIVE_RACES = 200, 16  # races of a pair on a circuit
SEED = 6500

Row = dict[str, Any]


def points(result: RaceResult, rules: Rules) -> Floats:
    """Return car 0's score of each race, or of each series of two legs."""
    winner = result.winner
    if rules.legs == 2:
        state = result.state
        sums = utility(rules, result.lead, result.crashed, state.fault, winner)
        winner = sum_winners(rules, sums[::2] + sums[1::2])
    return np.where(winner < 0, 0.5, winner == 0).astype(np.float64)


def equal(track: Track) -> Row:
    row: Row = {}
    for name in EQUALS:
        for label, rules in (("today", TODAY), ("new", CONTEST)):
            result = run_races(track, [name] * RACES, name, rules, seed=SEED)
            first = np.where(result.starts.side == 0, result.winner == 0, result.winner == 1)
            row |= {
                f"{name}, {label}: front wins": first.mean(),
                f"{name}, {label}: overtakes": result.state.overtakes.sum(axis=1).mean(),
                f"{name}, {label}: own crashes": result.own_crash.mean(),
            }
    return row


def better(track: Track) -> Row:
    row: Row = {}
    for ego, opponent in PAIRS:
        for label, rules in (("today", TODAY), ("new", CONTEST)):
            result = run_races(track, [ego] * RACES, opponent, rules, seed=SEED)
            row |= {
                f"{ego} {opponent}, {label}: single": points(result, TODAY).mean(),
                f"{ego} {opponent}, {label}: series": points(result, CONTEST).mean(),
                f"{ego} {opponent}, {label}: own crashes": result.own_crash[:, 0].mean(),
            }
    return row


def round_robin(track: Track, rules: Rules) -> tuple[float, float]:
    """Return the standard deviation of the ratings of the archive, and the signal of a race."""
    known = load_archive("contest")
    entrants = {f"policy {k}": known.policy(k) for k in range(len(known))}
    each = {"archive": known, "races_per_pair": ARCHIVE_RACES, "seed": SEED}
    series = play_tournament(track, entrants, rules, **each).series
    scores = np.array([series.score[rows] for rows in series.pairs.values()])
    units = scores.shape[1]
    mean, variance = scores.mean(axis=1), scores.var(axis=1, ddof=1)
    signal = ((mean - 0.5) ** 2 - variance / units).mean() / variance.mean()
    return float(rate(series).strength.std()), float(signal * units / ARCHIVE_RACES)


def archive(track: Track) -> Row:
    before, after = (round_robin(track, rules) for rules in (TODAY, CONTEST))
    return {
        "spread, today": before[0],
        "spread, series": after[0],
        "ratio": after[0] / before[0],
        "signal, today": before[1],
        "signal, series": after[1],
    }


def _straight(car: Floats, v: float, measured_slip: bool) -> Floats:
    """One control period of a car that pursues a straight line: y, steering angle, heading, yaw
    rate, slip.
    """
    y, delta, psi, rate, beta = car
    reach = 0.3 + 0.1 * v  # as follow_path looks ahead
    course = psi + (beta if measured_slip else 0.0)
    across = -np.sqrt(reach * reach - y * y) * np.sin(course) - y * np.cos(course)
    steer = np.arctan(F1TENTH.wheelbase * 2.0 * across / (reach * reach))
    state, params = np.array([0.0, y, delta, v, psi, rate, beta]), F1TENTH.as_row()
    for _ in range(2):
        wanted = (steer - state[_vehicle.DELTA]) / 0.01
        _vehicle.step(
            state,
            np.clip(wanted, -F1TENTH.steer_rate_max, F1TENTH.steer_rate_max),
            0.0,
            params,
            0.01,
        )
    heading = np.mod(state[_vehicle.PSI] + np.pi, 2.0 * np.pi) - np.pi
    return np.array(
        [state[1], state[_vehicle.DELTA], heading, state[_vehicle.PSI_DOT], state[_vehicle.BETA]]
    )


def stability() -> list[Row]:
    """Above 1 every stray grows from one control period to the next."""
    rows = []
    for v in (5.0, 6.0, 6.5, 7.0, 8.0, 10.0):
        row: Row = {"track": f"{v:g} m/s"}
        for name, measured in (("slip of a steady bend", False), ("slip of the moment", True)):
            ahead, back = (
                np.array([_straight(sign * 1e-6 * e, v, measured) for e in np.eye(5)])
                for sign in (1.0, -1.0)
            )
            row[name] = float(np.abs(np.linalg.eigvals((ahead - back).T / 2e-6)).max())
        rows.append(row)
    return rows


SECTIONS: dict[str, Callable[[Track], Row]] = {
    "equal": equal,
    "better": better,
    "archive": archive,
}


def show(section: str, rows: list[Row]) -> None:
    columns = [key for key in rows[0] if key != "track"]
    mean = {key: np.nanmean([row[key] for row in rows]) for key in columns}
    print(f"\n{section}")
    for key in columns:
        each = "  ".join(f"{row['track']} {row[key]:.3f}" for row in rows)
        print(f"{key:58} {mean[key]:.3f}  ({each})", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--maps", type=Path, help="folder of the real circuits")
    parser.add_argument("--circuits", nargs="+", default=CIRCUITS, help="names of circuits")
    parser.add_argument("--only", nargs="+", choices=["stability", *SECTIONS], help="sections")
    parser.add_argument("--csv", type=Path, help="file to write all rows to")
    arguments = parser.parse_args()
    folder, written = arguments.maps, []
    for section in arguments.only or ["stability", *SECTIONS]:
        rows = stability() if section == "stability" else []
        for name in arguments.circuits if section != "stability" else ():
            track = load_track(folder / name if folder and (folder / name).is_dir() else name)
            rows.append({"track": track.name} | SECTIONS[section](track))
        show(section, rows)
        written += [(section, row["track"], *one) for row in rows for one in row.items()]
    if arguments.csv is not None:
        with arguments.csv.open("w", newline="", encoding="utf-8") as file:
            csv.writer(file).writerows(written)


if __name__ == "__main__":
    main()
