"""How well the lattice drives: alone beside pure pursuit, and in races against the house's other
planners and itself.

    python dev/benchmarks/driving.py                                  # the circuits that ship
    python dev/benchmarks/driving.py --maps ../shared/maps --only alone smooth
    python dev/benchmarks/driving.py --only search --csv out/search.csv

Each section prints a row for each circuit and the mean:

stability  largest eigenvalue of the car on a straight and its pursuit, by what the pursuit takes
for the car's course alone      own crashes in 40 s of a car alone, and its mean speed, beside pure
pursuit at the same speed scales smooth     steering rate and speed around the profile on straights,
over that of pure pursuit laps       best lap alone at pace 1 of the contest's range, over that of
`line-ppo` grip       crashes alone at pace 1 of the contest: whether the tyres slid before them,
or the car left its path search     the best of 110 random weight vectors against pure pursuit, lane
switcher and gap follower default    the default lattice against the default pure pursuit, `paper`
and `contest` paces      16 paces of the default lattice against each other: overtakes, places kept,
gaps
"""

import argparse
import csv
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np

from pcs_racing import CONTEST, load_track, racer, run_races
from pcs_racing.base.seeds import race_seeds
from pcs_racing.base.typing import Floats
from pcs_racing.car import vehicle as _vehicle
from pcs_racing.car.vehicle import F1TENTH
from pcs_racing.planners.field.pure_pursuit import PURE_PURSUIT
from pcs_racing.planners.lattice import LATTICE
from pcs_racing.planners.planner import Planner, Policy
from pcs_racing.race.calibration import calibration_of
from pcs_racing.race.config import KNOWN_RULES, Rules
from pcs_racing.race.driving import BareField, advance, kernel_settings
from pcs_racing.race.state import RaceState, empty_state
from pcs_racing.track.frenet import KAPPA, SPEED, X, Y
from pcs_racing.track.maps import list_tracks
from pcs_racing.track.track import Track

# Pace 1 of the contest until commit a58241f: the 50 % hazard of the planner of that time, with half
# of today's noise.
FORMER_TOP = {
    "Brackwater": 0.98,
    "Kestrelheim": 0.96,
    "Larkmoor": 0.99,
    "Pipkin": 1.05,
    "Quillburg": 1.05,
    "Saltmere": 0.98,
    "Tarnfjord": 1.05,
    "Vellindra": 1.04,
    "Austin": 0.93,
    "Budapest": 1.04,
    "Catalunya": 1.06,
    "Hockenheim": 0.98,
    "IMS": 1.03,
    "Monza": 0.99,
    "MoscowRaceway": 1.03,
    "Nuerburgring": 0.99,
    "Oschersleben": 1.0,
    "Sakhir": 0.97,
    "Sepang": 1.03,
    "Spielberg": 0.97,
}
FORMER_NOISE = 0.01  # rad
OPPONENTS = ("pure-pursuit", "lane-switcher", "gap-follower")
VECTORS, SEARCH_RACES, FRESH_RACES = 110, 16, 400
PACES, PACE_RACES = 16, 24
STRAIGHT = 0.05  # 1/m
# m/s^2 of lateral acceleration: all that the tyres' friction gives
SLIDING = F1TENTH.mu * _vehicle.GRAVITY
BEFORE = 0.5  # s before a crash; the tyres may have slid in them

Row = dict[str, Any]


class Alone:
    """Place cars on the race line at its speed: two in each race, half a lap apart."""

    def __init__(
        self,
        track: Track,
        planner: Planner,
        scale: float,
        noise: float,
        cars: int,
        theta: Any = None,
    ):
        races = cars // 2
        self.track, self.planner = track, planner
        self.theta = np.zeros((races, 2, max(1, len(planner.parameters))))
        self.theta[:, :, : len(planner.parameters)] = planner.default if theta is None else theta
        config = Rules(steering_noise=noise)
        self.settings = kernel_settings(config, (scale, scale + 1e-6))._replace(ittc_horizon=0.0)
        self.state = empty_state(races, planner.memory_total)
        self.state.seed[:] = race_seeds(0, races)
        for car in range(2):
            s = np.mod((np.arange(races) / races + car) * 0.5 * track.length, track.length)
            pose = track.to_cartesian(np.stack([s, np.zeros(races)], axis=-1))
            self.state.cars[:, car, X], self.state.cars[:, car, Y] = pose[:, 0], pose[:, 1]
            self.state.cars[:, car, _vehicle.PSI] = np.mod(pose[:, 2], 2.0 * np.pi)
            self.state.cars[:, car, _vehicle.V] = scale * self.sampled(s)[:, SPEED]
            self.state.frenet[:, car, 0] = s
            self.state.progress[:, car] = 0.5 * car * track.length
        self.start = self.state.progress.copy()

    def sampled(self, s: Floats) -> Floats:
        """Samples of the race line at arc lengths."""
        line = self.track.arrays.line
        return line[(s / self.track.arrays.ds).astype(np.intp) % len(line)]

    def drive(self, ticks: int) -> RaceState:
        """Drive on; returns the state, which is overwritten by the next call."""
        planners, cars = (self.planner, self.planner), (F1TENTH, F1TENTH)
        field = BareField(self.track, self.settings, planners, cars)
        advance(field, self.state, self.theta, ticks)
        return self.state

    def result(self) -> tuple[float, float]:
        """Own crashes in 40 s, and mean speed, m/s."""
        state = self.drive(4000)
        driven = 0.02 * state.tick.sum()
        crash = 1.0 - np.exp(-40.0 * (state.crash == 1).sum() / driven)
        return float(crash), float((state.progress - self.start).sum() / driven)


def alone(track: Track) -> Row:
    top = FORMER_TOP[track.name]
    row: Row = {}
    for label, scale in (
        ("former .6", top - 0.128),
        ("former 1", top),
        ("scale 1.2", 1.2),
        ("scale 1.3", 1.3),
    ):
        noise = FORMER_NOISE if label.startswith("former") else CONTEST.steering_noise
        (ours, fast), (theirs, slow) = (
            Alone(track, p, scale, noise, 100).result() for p in (LATTICE, PURE_PURSUIT)
        )
        row |= (
            {f"{label}: crash": ours, "pursuit": theirs, "speed ratio": fast / slow}
            if label == "former 1"
            else {
                f"{label}: crash": ours,
                f"{label}: pursuit": theirs,
            }
        )
    return row


def smooth(track: Track) -> Row:
    """RMS over straights, at the former top, after 4 s."""
    found = {}
    for planner in (LATTICE, PURE_PURSUIT):
        cars = Alone(track, planner, FORMER_TOP[track.name], FORMER_NOISE, 40)
        rates, speeds = [], []
        before = cars.drive(400).cars[:, :, _vehicle.DELTA].copy()
        for _ in range(400):
            state = cars.drive(2)
            sample = cars.sampled(state.frenet[:, :, 0])
            profile = cars.settings.speed_low * sample[..., SPEED]
            here = (np.abs(sample[..., KAPPA]) < STRAIGHT) & (state.crash == 0)
            rates.append(((state.cars[:, :, _vehicle.DELTA] - before) / 0.02)[here])
            speeds.append((state.cars[:, :, _vehicle.V] - profile)[here])
            before = state.cars[:, :, _vehicle.DELTA].copy()
        found[planner.name] = [
            float(np.sqrt(np.mean(np.concatenate(x) ** 2))) for x in (rates, speeds)
        ]
    (rate, speed), (other_rate, other_speed) = found["lattice"], found["pure-pursuit"]
    return {"steering rate": rate / other_rate, "speed around the profile": speed / other_speed}


def laps(track: Track) -> Row:
    _, high = calibration_of(track, CONTEST).speed_range
    ours = Alone(track, LATTICE, high, 0.0, 8).drive(6000).best_lap
    learned = racer("line-ppo")
    theirs = Alone(track, learned.planner, high, 0.0, 8, learned.parameters).drive(6000).best_lap
    best = [float(x[x > 0].min()) if (x > 0).any() else float("nan") for x in (ours, theirs)]
    return {"lap": best[0], "line-ppo": best[1], "ratio": best[0] / best[1]}


def grip(track: Track) -> Row:
    """Of the crashes alone, the share before which a car asked its tyres for more than their
    friction.
    """
    cars = Alone(
        track, LATTICE, calibration_of(track, CONTEST).speed_range[1], CONTEST.steering_noise, 160
    )
    last = np.full(cars.state.crash.shape, -np.inf)
    for step in range(2000):
        state = cars.drive(2)
        sideways = np.abs(state.cars[:, :, _vehicle.V] * state.cars[:, :, _vehicle.PSI_DOT])
        last[sideways > SLIDING] = np.maximum(last, state.tick[:, None])[sideways > SLIDING]
        if step % 500 == 499 and state.crash.any(axis=1).all():
            break
    own = state.crash == 1
    slid = own & (state.tick[:, None] - last <= 100.0 * BEFORE)
    return {"crashes": int(own.sum()), "share that slid": float(slid.sum() / max(own.sum(), 1))}


def score(
    track: Track, egos: list[Policy], rival: Policy, config: Rules, each: int, seed: int
) -> dict[str, Floats]:
    """Return means over an ego's races: won, own crashes, won from the rear slot, overtakes."""
    result = run_races(
        track,
        [ego for ego in egos for _ in range(each)],
        [rival] * len(egos) * each,
        config,
        seed=seed,
    )
    won, own = result.winner == 0, result.state.fault[:, 0] == 1
    rear = result.starts.side == 1
    shape = (len(egos), each)
    return {
        "score": won.reshape(shape).mean(axis=1),
        "own": own.reshape(shape).mean(axis=1),
        "rear": (
            (won & rear).reshape(shape).sum(axis=1) / np.maximum(rear.reshape(shape).sum(axis=1), 1)
        ),
        "overtakes": result.state.overtakes.sum(axis=1).reshape(shape).mean(axis=1),
    }


def best_pursuit(tracks: list[Track]) -> Policy:
    """Return the pace of pure pursuit with the best mean score against lattice and others."""
    paces = [PURE_PURSUIT.policy({"pace": pace}) for pace in np.linspace(0.0, 1.0, 6)]
    rivals = [racer(name) for name in ("lattice", *OPPONENTS[1:])]
    total = sum(
        score(track, paces, rival, CONTEST, 20, 3)["score"] for track in tracks for rival in rivals
    )
    return paces[int(np.argmax(total))]


def search(tracks: list[Track]) -> list[Row]:
    """Random search, and the best vector on fresh races."""
    rng = np.random.default_rng(3)
    egos = [LATTICE.policy(LATTICE.sample(rng)) for _ in range(VECTORS)]
    pursuit = best_pursuit(tracks)
    rivals = [pursuit, *(racer(name) for name in OPPONENTS[1:])]
    found = [
        [score(track, egos, rival, CONTEST, SEARCH_RACES, 7) for rival in rivals]
        for track in tracks
    ]
    means = np.mean([[one["score"] for one in row] for row in found], axis=(0, 1))
    own = np.mean([[one["own"] for one in row] for row in found], axis=(0, 1))
    allowed = np.where(own <= 0.12, means, -1.0) if (own <= 0.12).any() else means
    best = egos[int(np.argmax(allowed))]
    print(
        f"best pure pursuit: pace {pursuit.parameters[0]:.1f}; median of all vectors"
        f" {np.median(means):.3f}"
    )
    print(
        "best:",
        ", ".join(
            f"{p.name} {x:.2f}" for p, x in zip(LATTICE.parameters, best.parameters, strict=True)
        ),
    )
    rows = []
    for track in tracks:
        fresh = [score(track, [best], rival, CONTEST, FRESH_RACES, 1000) for rival in rivals]
        row: Row = {"track": track.name, "score": np.mean([one["score"] for one in fresh])}
        row |= {name: one["score"][0] for name, one in zip(OPPONENTS, fresh, strict=True)}
        rows.append(
            row
            | {
                "own crash": np.mean([one["own"] for one in fresh]),
                "rear, lane-switcher": fresh[1]["rear"][0],
            }
        )
    return rows


def default(track: Track) -> Row:
    row: Row = {}
    for name, config in KNOWN_RULES.items():
        found = score(track, [LATTICE.policy()], PURE_PURSUIT.policy(), config, FRESH_RACES, 5)
        row |= {name: found["score"][0], f"{name}: own": found["own"][0]}
    return row


def paces(track: Track) -> Row:
    policies = [LATTICE.policy({"pace": pace}) for pace in np.linspace(0.0, 1.0, PACES)]
    first = np.repeat(np.arange(PACES), PACES * PACE_RACES)
    second = np.tile(np.repeat(np.arange(PACES), PACE_RACES), PACES)
    result = run_races(
        track, [policies[i] for i in first], [policies[j] for j in second], CONTEST, seed=11
    )
    shape = (PACES, PACES, PACE_RACES)
    won = ((result.winner == 0) + 0.5 * (result.winner < 0)).reshape(shape)
    ratings = won.mean(axis=(1, 2))
    close = np.broadcast_to((np.abs(ratings[:, None] - ratings) < 0.1)[:, :, None], shape).ravel()
    front = np.where(result.starts.side == 0, result.winner == 0, result.winner == 1)
    overtakes = result.state.overtakes.sum(axis=1)
    finished = close & ~result.crashed
    return {
        "overtakes": overtakes.mean(),
        "front wins": front[close].mean(),
        "gap": np.median(np.abs(result.lead[finished])),
        "change of lead": (overtakes[close] > 0).mean(),
        "crash": result.crashed.mean(),
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
    "alone": alone,
    "smooth": smooth,
    "laps": laps,
    "grip": grip,
    "default": default,
    "paces": paces,
}


def show(section: str, rows: list[Row]) -> None:
    if not rows:
        print(f"\n{section}: no circuit with a former top speed")
        return
    columns = [key for key in rows[0] if key != "track"]
    mean = {key: np.nanmean([row[key] for row in rows]) for key in columns}
    print(f"\n{section}\n{'':14}" + "  ".join(columns))
    for row in [*rows, {"track": "mean"} | mean]:
        print(
            f"{row['track']:14}"
            + "  ".join(f"{row[key]:>{max(len(key), 6)}.3f}" for key in columns),
            flush=True,
        )


def circuits(folder: Path | None, names: Iterable[str] | None) -> list[Track]:
    found = [load_track(name) for name in list_tracks() if names is None or name in names]
    if folder is not None:
        for path in sorted(folder.iterdir()):
            if path.is_dir() and (names is None or path.name in names):
                try:
                    found.append(load_track(path))
                except ValueError as error:
                    print(f"{path.name}: left out ({error})", file=sys.stderr)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--maps", type=Path, help="folder of map folders, in addition to the circuits that ship"
    )
    parser.add_argument("--tracks", nargs="+", help="names of circuits")
    parser.add_argument(
        "--only",
        nargs="+",
        choices=["stability", *SECTIONS, "search"],
        help="sections (default: all)",
    )
    parser.add_argument("--csv", type=Path, help="file to write all rows to")
    arguments = parser.parse_args()
    tracks = circuits(arguments.maps, arguments.tracks)
    if not tracks:
        parser.error(
            f"none of {', '.join(arguments.tracks or [])} is a shipped circuit or in the folder of"
            " --maps"
        )
    written = []
    for section in arguments.only or ["stability", *SECTIONS, "search"]:
        if section == "search":
            rows = search(tracks)
        elif section == "stability":
            rows = stability()
        else:
            # The former top of a circuit is measured, not guessed: one without it has no row in
            # these sections.
            known = [
                track
                for track in tracks
                if section not in ("alone", "smooth") or track.name in FORMER_TOP
            ]
            rows = [{"track": track.name} | SECTIONS[section](track) for track in known]
        show(section, rows)
        written += [
            (section, row["track"], key, value)
            for row in rows
            for key, value in row.items()
            if key != "track"
        ]
    if arguments.csv is not None:
        arguments.csv.parent.mkdir(parents=True, exist_ok=True)
        with arguments.csv.open("w", newline="") as file:
            csv.writer(file).writerows([("section", "track", "quantity", "value"), *written])


if __name__ == "__main__":
    main()
