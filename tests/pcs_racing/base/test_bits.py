"""Races and tracks are the same to the bit whatever instructions the processor has.

A second process is told to do without: numba compiles for any x86-64 processor, numpy, the C library and BLAS take the
code that they keep for the oldest ones. `benchmarks/bits.py` does the same at length.
"""

import hashlib
import json
import os
import platform
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from numpy._core._multiarray_umath import __cpu_dispatch__

from pcs_racing import build_track, draw_starts, load_race_config, load_track, parse_policy, start_races
from pcs_racing.race.races import RaceSetup, advance, pad_parameters, race_seeds
from pcs_racing.track.maps import find_shipped, read_map

WITHOUT = {
    "NUMBA_CPU_NAME": "generic",
    "NUMBA_CPU_FEATURES": "",
    "NPY_DISABLE_CPU_FEATURES": " ".join(__cpu_dispatch__),
    "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX512F,-AVX512VL,-AVX512DQ,-AVX512BW,-AVX2,-FMA,-FMA4",
    "OPENBLAS_CORETYPE": "Prescott",
}
RIVALS = ("lattice:pace=0.9", "lane-switcher:3", "pure-pursuit", "gap-follower")


def digest(arrays) -> str:
    state = hashlib.sha256()
    for array in arrays:
        state.update(np.ascontiguousarray(array).tobytes())
    return state.hexdigest()


def races() -> dict[str, str]:
    """Two short races of each planner under both presets: all of their states at the end."""
    track, ego = load_track("Quillburg"), parse_policy("lattice")
    found = {}
    for preset in ("paper", "contest"):
        config = load_race_config(preset, duration=6.0, start_lines=2)
        for text in RIVALS:
            rival = parse_policy(text)
            setup = RaceSetup(track, config, (ego.planner, rival.planner))
            state = start_races(setup, draw_starts(track, config, 2, 0), race_seeds(0, 2))
            theta = np.broadcast_to(pad_parameters([ego, rival], setup.theta_size), (2, 2, setup.theta_size)).copy()
            advance(setup, state, theta, config.ticks, threads=1)
            found[f"{preset}, {text}"] = digest(state)
    return found


def track_from_its_picture() -> str:
    """A circuit without its lines; nothing of it comes from a cache."""
    from pcs_racing.track.building.centerline import centerline_from_grid
    from pcs_racing.track.building.raceline import minimum_curvature_raceline

    found = read_map(find_shipped("Pipkin"))
    grid = (found.occupied, found.resolution, found.origin)
    center = centerline_from_grid(*grid)
    track = build_track("Pipkin", *grid, center, minimum_curvature_raceline(center, *grid))
    return digest([*track.arrays, track.centerline])


def results() -> dict[str, str]:
    return {"track": track_from_its_picture(), **races()}


@pytest.mark.skipif(platform.machine() not in ("x86_64", "AMD64"), reason="the promise is about x86-64")
def test_races_and_tracks_need_no_instruction_of_a_newer_processor(tmp_path):
    caches = {"NUMBA_CACHE_DIR": str(tmp_path / "code"), "PCS_RACING_CACHE": str(tmp_path / "tracks")}
    source = str(Path(__file__).resolve().parents[3])
    environment = {**os.environ, **WITHOUT, **caches, "PYTHONPATH": source}
    child = subprocess.run([sys.executable, __file__], env=environment, capture_output=True, text=True)
    assert child.returncode == 0, child.stderr
    assert json.loads(child.stdout.splitlines()[-1]) == results()


if __name__ == "__main__":
    print(json.dumps(results()))
