"""Count beginnings and ends of races on any circuit, loaded from its picture and yaml file alone.

On every circuit and under both rules, lattice policies race each other whose paces are drawn
evenly from 0 to 1. The races come in pairs: the same two policies on the same start line, with the
sides swapped. Nothing is configured: speed range and start places come from the calibration that
the package does by itself.

    # and the circuits that ship with the package
    python dev/benchmarks/circuits.py --maps ../shared/maps
"""

import argparse
import csv
import shutil
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from pcs_racing import CONTEST, PAPER, load_track, run_races
from pcs_racing.base.errors import InputError
from pcs_racing.planners.lattice import LATTICE
from pcs_racing.planners.planner import Policy
from pcs_racing.race.calibration import calibration_of
from pcs_racing.race.config import Rules
from pcs_racing.track.map_files import parse_map
from pcs_racing.track.maps import find_map, find_shipped, list_tracks, read_bytes
from pcs_racing.track.track import Track

EARLY = 2.0  # s
COLUMNS = (
    "track",
    "rules",
    "length",
    "speeds",
    "spacing",
    "early",
    "crash",
    "left wins",
    "overtakes",
    "calibration s",
)
# most early; fewest and most crashes
AIMS = {"paper": (0.01, 0.0, 0.08), "contest": (0.02, 0.15, 0.45)}


def bare_track(folder: Path, where: Path) -> Track:
    """Load a map from copies of its picture and yaml file, without its folder."""
    files = find_map(folder)
    content = parse_map(files, read_bytes(files))
    copy = where / content.name
    copy.mkdir()
    shutil.copy(files.yaml, copy)
    for name in read_bytes(files._replace(centerline=None, raceline=None, info=None)):
        shutil.copy(files.folder / name, copy / name)
    return load_track(copy)


def drawn_pace(rng: np.random.Generator) -> Policy:
    return LATTICE.policy({"pace": float(rng.uniform())})


def measure(track: Track, config: Rules, races: int, seed: int) -> dict[str, object]:
    """A row of the table."""
    begin = time.perf_counter()
    calibration = calibration_of(track, config)
    took = time.perf_counter() - begin
    rng = np.random.default_rng(seed)
    egos = [policy for _ in range(races // 2) for policy in [drawn_pace(rng)] * 2]
    rivals = [policy for _ in range(races // 2) for policy in [drawn_pace(rng)] * 2]
    result = run_races(track, egos, rivals, config, seed=seed)
    won = result.winner >= 0
    return {
        "track": track.name,
        "rules": config.name,
        "length": f"{track.length:.0f}",
        "speeds": "{:.2f}-{:.2f}".format(*calibration.speed_range),
        "spacing": f"{calibration.start_spacing:g}",
        "early": f"{(result.crashed & (result.time < EARLY)).mean():.3f}",
        "crash": f"{result.crashed.mean():.3f}",
        "left wins": f"{(result.winner == result.starts.side)[won].mean():.3f}",
        "overtakes": f"{(result.state.overtakes.sum(axis=1) > 0).mean():.3f}",
        "calibration s": f"{took:.1f}",
    }


def misses(row: dict[str, object]) -> list[str]:
    """Values of a row that miss the aims."""
    if row["early"] == "refused":
        return ["refused"]
    early, crash, left = (float(str(row[key])) for key in ("early", "crash", "left wins"))
    most_early, fewest, most = AIMS[str(row["rules"])]
    found = [] if early <= most_early else [f"early > {most_early:g}"]
    found += [] if fewest <= crash <= most else [f"crash outside {fewest:g}-{most:g}"]
    found += [] if row["rules"] != "paper" or 0.45 <= left <= 0.55 else ["left outside .45-.55"]
    return found


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--maps", type=Path, help="folder of map folders, in addition to the circuits that ship"
    )
    parser.add_argument("--only", nargs="+", help="names of circuits")
    parser.add_argument(
        "--races", type=int, default=1000, help="races of a circuit and rules (default 1000)"
    )
    parser.add_argument(
        "--seed", type=int, default=1, help="of policies, start lines and noise (default 1)"
    )
    parser.add_argument("--csv", type=Path, help="file to write the table to")
    arguments = parser.parse_args()
    folders = [find_shipped(name) for name in list_tracks()]
    if arguments.maps is not None:
        folders += sorted(path for path in arguments.maps.iterdir() if path.is_dir())
    rows = []
    print("  ".join(f"{column:>{max(len(column), 8)}}" for column in COLUMNS))
    with tempfile.TemporaryDirectory() as temporary:
        for folder in folders:
            if arguments.only and folder.name not in arguments.only:
                continue
            track = bare_track(folder, Path(temporary))
            for config in (PAPER, CONTEST):
                try:
                    row = measure(track, config, arguments.races, arguments.seed)
                except InputError as error:
                    row = dict.fromkeys(COLUMNS, "") | {
                        "track": track.name,
                        "rules": config.name,
                        "early": "refused",
                    }
                    print(error, file=sys.stderr)
                rows.append(row)
                line = "  ".join(f"{row[column]!s:>{max(len(column), 8)}}" for column in COLUMNS)
                print(line, *misses(row), flush=True)
    if arguments.csv is not None:
        with open(arguments.csv, "w", newline="") as file:
            writer = csv.DictWriter(file, COLUMNS)
            writer.writeheader()
            writer.writerows(rows)
    print(f"{sum(map(bool, map(misses, rows)))} of {len(rows)} rows miss an aim")


if __name__ == "__main__":
    main()
