"""The drivers of the field: alone, what a race of them costs, and what their papers say of pairs of
them.

    python dev/benchmarks/field.py  # everything, on the circuits that ship
    python dev/benchmarks/field.py --maps ../shared/maps --only alone --drivers spliner mppi
    python dev/benchmarks/field.py --only pairs --races 200

alone  own crashes in 40 s of a car alone at the driver's default parameters, and its mean speed;
rules `contest` cost   milliseconds of one core for a 40 s race of a driver against itself pairs
what the sources report, with 95 % intervals clustered by circuit and start
"""

import argparse
import time
from pathlib import Path

import numpy as np
from driving import Alone, circuits, show

from pcs_racing import CONTEST, load_track, parse_policy, run_races
from pcs_racing.planners.planner import Policy
from pcs_racing.planners.registry import SHIPPED
from pcs_racing.race.calibration import calibration_of
from pcs_racing.race.config import RaceConfig
from pcs_racing.race.driving import kernel_settings
from pcs_racing.race.start_grid import Starts
from pcs_racing.track.track import Track
from pcs_racing_agents.base.statistics import clustered_mean

LIDAR = (
    "gap-follower",
    "follow-the-gap",
    "disparity-extender",
    "potential-field",
    "residual",
    "lidar-ppo",
)
CARS = 200
SHARES = (0.5, 0.6, 0.7, 0.8, 0.9)


def alone(track: Track, policy: Policy, count: int = CARS) -> tuple[float, float]:
    """Return own crashes in 40 s, and mean speed, m/s, with the noise and speeds of `contest`."""
    low, high = calibration_of(track, CONTEST).speed_range
    # A driver without a map begins at a speed at which it can still brake.
    begins = 0.5 if policy.planner.name in LIDAR else low
    cars = Alone(track, policy.planner, begins, CONTEST.steering_noise, count, policy.parameters)
    cars.settings = kernel_settings(CONTEST, (low, high))._replace(ittc_horizon=0.0)
    return cars.result()


def cost(policy: Policy) -> float:
    """Milliseconds of one core for 40 s of a race on Pipkin; races that end early count by what
    they drove.
    """
    track, races = load_track("Pipkin"), 20 if policy.planner.drive is None else 1
    run_races(track, [policy], policy, CONTEST, seed=1, threads=1)
    times = []
    for repeat in range(3):
        begun = time.process_time()
        result = run_races(track, [policy] * races, policy, CONTEST, seed=repeat, threads=1)
        times.append((time.process_time() - begun) * 4e6 / float(result.state.tick.sum()))
    return min(times)


def _passes(track: Track, ego: Policy, slower: Policy, share: float, races: int) -> np.ndarray:
    """Whether a car passes one that starts 4 m ahead, without an own crash, in 40 s; and whether it
    crashes itself.

    The car ahead drives the race line at a share of the speed scale of the one behind.
    """
    low, high = calibration_of(track, CONTEST).speed_range
    scale = low + 0.5 * (high - low)
    # At pace 1 the ego drives the scale, at pace 0 the car ahead its share of it.
    config = RaceConfig(
        start="rolling",
        start_gap=4.0,
        start_spacing=0.0,
        steering_noise=CONTEST.steering_noise,
        speed_range=(share * scale, scale),
    )
    starts = Starts(np.arange(races) / races * track.length, np.ones(races, np.int64))
    fast = ego.planner.policy({"pace": 1.0})
    result = run_races(track, [fast] * races, slower, config, starts=starts, seed=7)
    own = result.state.fault[:, 0] == 1
    return np.stack([(result.state.overtakes[:, 0] > 0) & ~own, own])


def _share(values: list[np.ndarray], starts: list[np.ndarray]) -> str:
    """A share with its interval, clustered by start: one array of races for each circuit."""
    labels = np.concatenate(
        [np.char.add(f"{i} ", start.astype(str)) for i, start in enumerate(starts)]
    )
    found = clustered_mean(np.concatenate(values).astype(float), labels)
    return f"{found.mean:.3f} [{max(found.low, 0.0):.3f}, {min(found.high, 1.0):.3f}]"


def passing(tracks: list[Track], names: list[str], races: int) -> None:
    """Passes of a car on the race line, by its share of the ego's speed."""
    ahead = parse_policy("pure-pursuit:pace=0,follow_distance=0")
    print(
        "\na car on the race line, by its share of the ego's speed: passed in 40 s without own"
        " crash, own crashes"
    )
    for name in names:
        for share in SHARES:
            found = [_passes(track, parse_policy(name), ahead, share, races) for track in tracks]
            passed, own = ([one[k] for one in found] for k in range(2))
            starts = [np.arange(races)] * len(tracks)
            print(
                f"{name:24}{share:5.2f}  {_share(passed, starts)}  {_share(own, starts)}",
                flush=True,
            )


def beats(tracks: list[Track], first: str, second: str, races: int) -> None:
    """Share of races that one driver wins against another in `contest`, slots and car numbers in
    balance.
    """
    won, own, starts = [], [], []
    for track in tracks:
        # Starts alternate between the slots of a line: each driver has all of them as either car.
        both = [
            run_races(track, [parse_policy(a)] * races, parse_policy(b), CONTEST, seed=20)
            for a, b in ((first, second), (second, first))
        ]
        won.append(
            np.concatenate([np.where(r.winner < 0, 0.5, r.winner == k) for k, r in enumerate(both)])
        )
        own.append(np.concatenate([r.state.fault[:, [k, 1 - k]] == 1 for k, r in enumerate(both)]))
        starts.append(np.tile(np.arange(races) // 2 % CONTEST.start_lines, 2))
    faults = np.concatenate(own).mean(axis=0)
    print(
        f"{first} against {second}: {_share(won, starts)}; own crashes {faults[0]:.3f},"
        f" {faults[1]:.3f}",
        flush=True,
    )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--drivers", nargs="+", default=sorted(SHIPPED), help="names of drivers (default: all)"
    )
    parser.add_argument(
        "--maps", type=Path, help="folder of map folders, beside the circuits that ship"
    )
    parser.add_argument("--tracks", nargs="+", help="names of circuits")
    parser.add_argument(
        "--only", nargs="+", choices=["alone", "cost", "pairs"], help="sections (default: all)"
    )
    parser.add_argument("--cars", type=int, default=CARS, help="cars alone on a circuit, even")
    parser.add_argument("--races", type=int, default=50, help="races of a pair on a circuit")
    arguments = parser.parse_args()
    only = arguments.only or ["alone", "cost", "pairs"]
    tracks = circuits(arguments.maps, arguments.tracks)
    policies = [parse_policy(name) for name in arguments.drivers]
    if "alone" in only:
        found = [
            (track, [alone(track, policy, arguments.cars) for policy in policies])
            for track in tracks
        ]
        for k, what in enumerate(("own crashes in 40 s alone", "mean speed, m/s")):
            show(
                what,
                [
                    {"track": t.name} | {p.name: r[k] for p, r in zip(policies, rows, strict=True)}
                    for t, rows in found
                ],
            )
    if "cost" in only:
        show(
            "ms for a 40 s race of two", [{"track": "Pipkin"} | {p.name: cost(p) for p in policies}]
        )
    if "pairs" in only:
        known = [
            name
            for name in ("pure-pursuit", "spliner", "predictive-spliner")
            if name in arguments.drivers
        ]
        passing(tracks, known, arguments.races)
        print("\nwon in contest")
        for pair in (
            ("disparity-extender", "follow-the-gap"),
            ("iterated-best-response", "frenet-sampling"),
        ):
            if set(pair) <= set(arguments.drivers):
                beats(tracks, *pair, arguments.races)


if __name__ == "__main__":
    main()
