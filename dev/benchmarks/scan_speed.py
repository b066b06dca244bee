"""Time one lidar scan, one minimum iTTC and one wall check on one core, and check the scans.

    python dev/benchmarks/scan_speed.py [--track NAME_OR_FOLDER] [--reference FOLDER]

Scans are taken from poses all around a circuit, without an opponent and with one ahead, behind and
alongside. The median over the rounds is reported for each, in microseconds of the thread's time.
With the folder of reference data, and ``--track`` the folder of the circuit Spielberg that they
were made on, the errors against exact cell traversal follow.
"""

import argparse
import time
from pathlib import Path
from typing import Any

import numpy as np

from pcs_racing.base.compilation import compiled
from pcs_racing.car.collision import Rectangle, car_hits_wall
from pcs_racing.car.ittc import Motion, minimum_ittc
from pcs_racing.car.lidar import Lidar
from pcs_racing.car.lidar_kernel import WORK_SHAPE, Pose, scan_into
from pcs_racing.track.loading import load_track
from pcs_racing.track.track import Track

HALF_LENGTH, HALF_WIDTH = 0.29, 0.155
POSES = 100
ROUNDS = 51

# Places of the opponent: metres ahead and to the left.
PLACES = {
    "alone": None,
    "opponent ahead": (1.5, 0.0),
    "opponent behind": (-1.0, 0.0),
    "opponent alongside": (0.0, 0.5),
}


@compiled
def scans(track, beams, rows, has_opponent, work, out):  # type: ignore[no-untyped-def]
    for k in range(rows.shape[0]):
        x, y, psi, s, ox, oy, opsi = rows[k, :7]
        other = Rectangle(ox, oy, opsi, HALF_LENGTH, HALF_WIDTH)
        scan_into(track, beams, Pose(x, y, psi), s, has_opponent, other, work, out)


@compiled
def ittcs(track, rows):  # type: ignore[no-untyped-def]
    total = 0.0
    for k in range(rows.shape[0]):
        x, y, psi, s, ox, oy, opsi, v = rows[k]
        c, sn = v * np.cos(psi), v * np.sin(psi)
        oc, osn = 5.0 * np.cos(opsi), 5.0 * np.sin(opsi)
        other = Rectangle(ox, oy, opsi, HALF_LENGTH, HALF_WIDTH)
        total += minimum_ittc(track, Motion(x, y, c, sn), s, other, oc, osn, True, 10.0)
    return total


@compiled
def wall_checks(track, rows):  # type: ignore[no-untyped-def]
    hits = 0
    for k in range(rows.shape[0]):
        hits += car_hits_wall(
            track, rows[k, 0], rows[k, 1], rows[k, 2], HALF_LENGTH, HALF_WIDTH, rows[k, 3]
        )
    return hits


def situations(track: Track, place: tuple[float, float] | None) -> np.ndarray:
    """Rows of x, y, psi, s, opponent's x, y, psi, and speed, near the race line all around the
    circuit.
    """
    rng = np.random.default_rng(0)
    sd = np.column_stack([rng.uniform(0.0, track.length, POSES), rng.uniform(-0.3, 0.3, POSES)])
    poses = track.to_cartesian(sd) + [0.0, 0.0, 1.0] * rng.normal(0.0, 0.1, (POSES, 1))
    others = track.to_cartesian(sd + (place or (1.5, 0.0)))
    s = track.to_frenet(poses[:, :2])[:, :1]
    return np.hstack([poses, s, others, rng.uniform(3.0, 8.0, (POSES, 1))])


def median_us(function: Any, *arguments: Any) -> float:
    """Median time of one of the ``POSES`` calls that a compiled loop makes, in microseconds."""
    function(*arguments)
    rounds = []
    # The median of many short rounds: one interruption must not decide.
    for _ in range(ROUNDS):
        start = time.thread_time()
        for _ in range(5):
            function(*arguments)
        rounds.append((time.thread_time() - start) / (5 * POSES))
    return 1e6 * float(np.median(rounds))


def errors(track: Track, reference: Path) -> dict[str, float]:
    """Deviation from the exact scans of the reference."""
    data = np.load(reference / "scans_spielberg.npz")
    exact = np.minimum(data["exact_scans"], 30.0)
    error = np.abs(Lidar(track).scan(data["poses"]) - exact)
    # Errors of ray marching on a grid, and ours.
    marched = np.abs(data["gym_scans"] - exact)
    return {
        "median_m": float(np.median(error)),
        "p99_m": float(np.quantile(error, 0.99)),
        "over_1_m": float((error > 1.0).mean()),
        "f1tenth_gym_median_m": float(np.median(marched)),
        "f1tenth_gym_over_1_m": float((marched > 1.0).mean()),
    }


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--track", default="Tarnfjord", help="name or folder of a circuit (default: Tarnfjord)"
    )
    parser.add_argument("--reference", type=Path, help="folder of scans_spielberg.npz")
    options = parser.parse_args()
    if options.reference and not (options.reference / "scans_spielberg.npz").is_file():
        parser.error(f"there is no {options.reference / 'scans_spielberg.npz'}")
    track = load_track(options.track)
    for beams in (1080, 108):
        lidar = Lidar(track, beams=beams)
        work, out = np.empty(WORK_SHAPE), np.empty(beams)
        for name, place in PLACES.items():
            rows = situations(track, place)
            us = median_us(scans, track.arrays, lidar.kernel, rows, place is not None, work, out)
            print(f"scan of {beams:4} beams, {name:15} {us:7.2f} us")
    rows = situations(track, PLACES["opponent ahead"])
    for name, function in (("minimum_ittc", ittcs), ("car_hits_wall", wall_checks)):
        us = median_us(function, track.arrays, rows)
        print(f"{name:34} {us:7.2f} us")
    if options.reference:
        found = errors(track, options.reference)
        print(
            "errors against exact scans:",
            ", ".join(f"{name} {value:.5f}" for name, value in found.items()),
        )


if __name__ == "__main__":
    main()
