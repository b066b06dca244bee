"""How near the mapping tools come to the shipped lines of real circuits.

    python benchmarks/mapping_accuracy.py [--maps FOLDER] [--json]

For every circuit: the distance of our centre line (from the grid alone) to the shipped one, and lap times of our race
line and of the shipped one, both with our own speed profile. Where the shipped line keeps another clearance than ours,
ours is also computed with that clearance.
"""

import argparse
import json
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from pcs_racing.track.building.centerline import centerline_from_grid
from pcs_racing.track.building.clearance import wall_clearance
from pcs_racing.track.building.curves import resample
from pcs_racing.track.building.raceline import CLEARANCE, minimum_curvature_raceline, raceline_rows
from pcs_racing.track.building.speed import lap_time
from pcs_racing.track.maps import MapFolder, read_map

DEFAULT = Path(os.environ.get("PCS_RACING_MAPS", Path(__file__).resolve().parents[2] / "shared" / "maps"))


HEADER = """\
circuit      | centre line             | race line                         | shipped         | ours at its
             | mean    worst    time   | time    length clearance lap      | clearance lap   | clearance"""
ROW = (
    "{circuit:12} | {centre_mean_m:.4f} m {centre_worst_m:.3f} m {centre_s:.2f} s | {race_s:.2f} s "
    "{race_length_m:7.1f} m {race_clearance_m:.3f} m {race_lap_s:.2f} s | "
    "{shipped_clearance_m:.3f} m {shipped_lap_s:.2f} s | {equal_clearance_lap_s:.2f} s"
)


def timed(function: Callable[[], np.ndarray], repeats: int = 3) -> tuple[np.ndarray, float]:
    """Result and shortest time in s; the first call, which may compile, is not counted."""
    result, best = function(), np.inf
    for _ in range(repeats):
        start = time.perf_counter()
        function()
        best = min(best, time.perf_counter() - start)
    return result, best


def lap(xy: np.ndarray) -> float:
    rows = raceline_rows(xy, spacing=0.1)
    return lap_time(rows[:-1, 5], rows[1, 0])


def measure(found: MapFolder) -> dict[str, Any]:
    assert found.centerline is not None
    grid, resolution, origin = found.occupied, found.resolution, np.asarray(found.origin)

    def clearance(xy: np.ndarray) -> float:
        return float(wall_clearance(resample(xy, 0.02), grid, resolution, origin, 2.0).min())

    center, center_time = timed(lambda: centerline_from_grid(grid, resolution, origin))
    away = cKDTree(resample(found.centerline[:, :2], 0.01)).query(resample(center[:, :2], 0.05))[0]
    race, race_time = timed(lambda: minimum_curvature_raceline(center, grid, resolution, origin))
    row: dict[str, Any] = dict.fromkeys(("shipped_clearance_m", "shipped_lap_s", "equal_clearance_lap_s"), np.nan)
    row |= {
        "circuit": found.name,
        "centre_mean_m": float(away.mean()),
        "centre_worst_m": float(away.max()),
        "centre_s": center_time,
        "race_s": race_time,
        "race_length_m": float(raceline_rows(race)[-1, 0]),
        "race_clearance_m": clearance(race),
        "race_lap_s": lap(race),
        "centre_lap_s": lap(center[:, :2]),
    }
    if found.raceline is not None:
        shipped = found.raceline[:-1, 1:3]
        row["shipped_clearance_m"] = clearance(shipped)
        row["shipped_lap_s"] = lap(shipped)
        equal = minimum_curvature_raceline(
            center, grid, resolution, origin, clearance=min(row["shipped_clearance_m"], CLEARANCE + 0.1)
        )
        row["equal_clearance_lap_s"] = lap(equal)
    return row


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--maps", type=Path, default=DEFAULT, help="folder of f1tenth_racetracks map folders")
    parser.add_argument("--json", action="store_true", help="end with one line of JSON")
    arguments = parser.parse_args()
    folders = sorted(path for path in arguments.maps.iterdir() if path.is_dir())
    print(HEADER)
    rows = []
    for folder in folders:
        row = measure(read_map(folder))
        rows.append(row)
        print(ROW.format(**row), flush=True)
    if arguments.json:
        plain = [{key: None if value != value else value for key, value in row.items()} for row in rows]
        print(json.dumps({"mapping_accuracy": plain}))


if __name__ == "__main__":
    main()
