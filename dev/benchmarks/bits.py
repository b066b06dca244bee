"""Compare results to the bit between processors: digests of results, here and under other
instructions.

    python dev/benchmarks/bits.py  # the digests of this machine, one a line
    python dev/benchmarks/bits.py --compare                    # and a table of their changes
    # with the circuits of another folder, too
    python dev/benchmarks/bits.py --compare --maps FOLDER

Each comparison runs this script again in a process without some instructions of the processor,
or with another kernel of the linear algebra library, and with caches of its own, so that everything
is compiled and built again: a few minutes each. ``--parts tracks races`` leaves the others out.
"""

import argparse
import hashlib
import json
import os
import platform
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy._core._multiarray_umath import __cpu_dispatch__

ROOT = Path(__file__).resolve().parents[2]
Digests = Iterator[tuple[str, Any]]

NO_AVX = " ".join(__cpu_dispatch__)  # numpy's names of dispensable instructions
NO_AVX512 = " ".join(name for name in __cpu_dispatch__ if name.startswith(("AVX512", "X86_V4")))
GLIBC = "-AVX512F,-AVX512VL,-AVX512DQ,-AVX512BW,-AVX2,-FMA,-FMA4"
# Environment of each process, by the name of the column.
SETTINGS: dict[str, dict[str, str]] = {
    "again": {},
    "compiled for any": {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": ""},
    "compiled for haswell": {
        "NUMBA_CPU_NAME": "haswell",
        "NUMBA_CPU_FEATURES": "+avx2,+fma,+bmi,+bmi2",
    },
    "numpy without AVX-512": {"NPY_DISABLE_CPU_FEATURES": NO_AVX512},
    "numpy without AVX": {"NPY_DISABLE_CPU_FEATURES": NO_AVX},
    "C library without FMA": {"GLIBC_TUNABLES": f"glibc.cpu.hwcaps={GLIBC}"},
    "BLAS for Prescott": {"OPENBLAS_CORETYPE": "Prescott"},
    "BLAS for Haswell": {"OPENBLAS_CORETYPE": "Haswell"},
    "one thread": {"NUMBA_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"},
    "all of the oldest": {
        "NUMBA_CPU_NAME": "generic",
        "NUMBA_CPU_FEATURES": "",
        "NPY_DISABLE_CPU_FEATURES": NO_AVX,
        "GLIBC_TUNABLES": f"glibc.cpu.hwcaps={GLIBC}",
        "OPENBLAS_CORETYPE": "Prescott",
    },
}
PLANNERS = ("lattice:pace=0.7", "lane-switcher:3", "pure-pursuit", "gap-follower")


def digest(value: Any) -> str:
    """Short hash of arrays, numbers and texts, nested in tuples, lists and dicts."""
    state = hashlib.sha256()

    def add(part: Any) -> None:
        if isinstance(part, dict):
            part = [item for key in sorted(part) for item in (key, part[key])]
        if isinstance(part, (list, tuple)):
            for item in part:
                add(item)
        else:
            array = np.ascontiguousarray(part)
            state.update(f"{array.dtype.str}{array.shape}".encode() + array.tobytes())

    add(value)
    return state.hexdigest()[:16]


def tracks(folders: list[Path]) -> Digests:
    """Every circuit with its lines, and from picture and yaml alone."""
    from pcs_racing import load_track

    for folder in folders:
        track = load_track(folder)
        yield f"{folder.name}, with its lines", (tuple(track.arrays), track.centerline)
        with tempfile.TemporaryDirectory() as temporary:
            bare = Path(temporary) / folder.name
            bare.mkdir()
            for file in folder.glob(f"{folder.name}_map.*"):
                shutil.copy(file, bare)
            try:
                track = load_track(bare)
            except Exception as error:
                yield f"{folder.name}, from its picture", str(error).replace(temporary, "")
            else:
                yield f"{folder.name}, from its picture", (tuple(track.arrays), track.centerline)


def generated(folders: list[Path]) -> Digests:
    """A random circuit of each style."""
    from pcs_racing.track.mapping.circuits import generate_circuit

    for style in ("hull", "voronoi", "hairpin"):
        circuit = generate_circuit(3, style, length_range=(60.0, 120.0))
        yield f"circuit of style {style}", (circuit.centerline, circuit.raceline, circuit.occupied)


def vehicles(folders: list[Path]) -> Digests:
    """Random controls, from standstill to the limit."""
    from pcs_racing.car.vehicle import simulate

    rng = np.random.default_rng(0)
    targets = np.stack(
        [rng.uniform(-0.4, 0.4, (20, 400)), rng.uniform(-2.0, 12.0, (20, 400))], axis=-1
    )
    yield "vehicle, target", simulate(np.zeros((20, 7)), targets)


def lidar(folders: list[Path]) -> Digests:
    """Scans with an opponent, with noise, and times to collision."""
    from pcs_racing import load_track
    from pcs_racing.car.collision import Rectangle
    from pcs_racing.car.ittc import Motion, minimum_ittc
    from pcs_racing.car.lidar import Lidar

    track = load_track("Quillburg")
    places = track.to_cartesian(np.column_stack([np.linspace(0.0, 110.0, 200), np.zeros(200)]))
    others = track.to_cartesian(np.column_stack([np.linspace(1.0, 111.0, 200), np.full(200, 0.2)]))
    yield "scans", Lidar(track).scan(places, others)
    noisy = Lidar(track, vehicle={"lidar_noise": 0.02})
    yield "scans with noise", noisy.scan(places, rng=np.random.default_rng(0))
    times = [
        minimum_ittc(
            track.arrays,
            Motion(x, y, 4.0, 1.0),
            s,
            Rectangle(*other, 0.29, 0.155),
            2.0,
            0.5,
            True,
            10.0,
        )
        for (x, y, _), other, s in zip(places, others, np.linspace(0.0, 110.0, 200), strict=True)
    ]
    yield "times to collision", np.array(times)


def races(folders: list[Path]) -> Digests:
    """Ten races of every planner under both rules: all states at the end."""
    from pcs_racing import load_rules, load_track, racer
    from pcs_racing.race.races import (
        RaceSetup,
        advance,
        draw_starts,
        pad_parameters,
        race_seeds,
        start_races,
    )

    ego, track = racer("lattice"), load_track("Quillburg")
    rivals = {text: racer(text) for text in PLANNERS}
    for rules in ("paper", "contest"):
        config = load_rules(rules)
        for name, rival in rivals.items():
            setup = RaceSetup(track, config, (ego.planner, rival.planner))
            state = start_races(setup, draw_starts(track, config, 10, 0), race_seeds(0, 10))
            theta = np.broadcast_to(
                pad_parameters([ego, rival], setup.theta_size), (10, 2, setup.theta_size)
            ).copy()
            advance(setup, state, theta, config.ticks)
            yield f"races, {rules}, {name}", tuple(state)


def environments(folders: list[Path]) -> Digests:
    """The episodes of the golden results."""
    sys.path.insert(0, str(ROOT / "tests" / "goldens"))
    from scenarios import SCENARIOS

    for name, scenario in SCENARIOS.items():
        yield f"episodes, {name.partition('/')[2]}", scenario()


def games(folders: list[Path]) -> Digests:
    """Solutions of a tree and of its races."""
    from pcs_racing_agents.solvers import GameTree, cfr, solve_exact

    tree = GameTree.from_payoffs(np.random.default_rng(0).normal(size=(4,) * 6))
    yield "exact solution", tuple(solve_exact(tree)[:4])
    yield "CFR, 500 iterations", cfr(tree, 500).average


def networks(folders: list[Path]) -> Digests:
    """A shipped network on random observations."""
    from pcs_racing_agents.networks import load_network

    network = load_network("default-paper-regret")
    yield "network", network(np.random.default_rng(0).normal(size=(50, len(network.elements))))


def statistics(folders: list[Path]) -> Digests:
    """Ratings, a clustered mean, a t-test."""
    from pcs_racing_agents.base.statistics import clustered_mean, t_interval
    from pcs_racing_agents.tournament.race_files import race_table
    from pcs_racing_agents.tournament.races import RaceRow
    from pcs_racing_agents.tournament.ratings import rate

    rng = np.random.default_rng(0)
    first = rng.integers(0, 8, 600)
    second = (first + rng.integers(1, 8, 600)) % 8
    winners = np.array(["ego", "opponent", "none"])[rng.integers(0, 3, 600)]
    races = race_table(
        RaceRow(ego=f"agent {i}", opponent=f"agent {j}", winner=winner, start_s=float(k))
        for k, (i, j, winner) in enumerate(zip(first, second, winners, strict=True))
    )
    ratings = rate(races, rng=rng, replicates=100)
    yield (
        "ratings",
        [np.asarray(value) for value in vars(ratings).values() if isinstance(value, np.ndarray)],
    )
    estimate = clustered_mean(rng.normal(size=600), first, second)
    yield "clustered mean", tuple(estimate)
    yield "t-test", [t_interval(t, 1.0, df) for t in (0.5, 2.0, 5.0) for df in (3, 30, 300)]


def archive(folders: list[Path]) -> Digests:
    """A small search."""
    from pcs_racing_agents.policies.archive_run import synthesize
    from pcs_racing_agents.policies.config import FrontConfig

    config = FrontConfig(
        tracks=("Pipkin",),
        generations=3,
        population=12,
        initial_sample=16,
        opponents=2,
        starts=1,
        duration=8.0,
        candidates=16,
        final_duration=8.0,
        final_starts=1,
        max_policies=8,
        seed=1,
    )
    with tempfile.TemporaryDirectory() as folder:
        made = synthesize(config, Path(folder) / "archive")
    yield "archive search", (made.parameters, made.coordinates)


PARTS: dict[str, Callable[[list[Path]], Digests]] = {
    part.__name__: part
    for part in (
        tracks,
        generated,
        vehicles,
        lidar,
        races,
        environments,
        games,
        networks,
        statistics,
        archive,
    )
}


def digests(parts: list[str], folders: list[Path]) -> dict[str, str]:
    """Digest of each result; a part that fails says why instead."""
    # A part that fails must not hide the digests of the others.
    found: dict[str, str] = {}
    for part in parts:
        try:
            for name, value in PARTS[part](folders):
                found[name] = digest(value)
        except Exception as error:
            print(f"{part}: {type(error).__name__}: {error}", file=sys.stderr)
            found[part] = f"failed: {type(error).__name__}"
    return found


def other_process(setting: dict[str, str], arguments: list[str]) -> dict[str, str]:
    """The digests that a process with these environment variables prints."""
    with tempfile.TemporaryDirectory() as caches:
        # Compiled code and tracks in the shared caches were made under other instructions.
        own = {"NUMBA_CACHE_DIR": f"{caches}/numba", "PCS_RACING_CACHE": f"{caches}/tracks"}
        environment = {**os.environ, "PYTHONPATH": str(ROOT), **own, **setting}
        command = [sys.executable, __file__, "--json", *arguments]
        done = subprocess.run(command, env=environment, capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(f"{setting}: {done.stderr[-2000:]}")
    return dict(json.loads(done.stdout.splitlines()[-1]))


def compare(chosen: list[str], arguments: list[str]) -> None:
    """Print the table of equal results."""
    base: dict[str, str] = {}
    rows: dict[str, dict[str, bool]] = {}
    for name in chosen:
        found = other_process(SETTINGS[name], arguments)
        if not base:
            base = found
        rows[name] = {what: found.get(what) == value for what, value in base.items()}
        changed = [what for what, same in rows[name].items() if not same]
        print(
            f"{name}: {len(base) - len(changed)} of {len(base)} the same",
            *changed,
            sep="\n    ",
            flush=True,
        )
    failed = [what for what, value in base.items() if value.startswith("failed")]
    print(f"processor: {platform.processor() or platform.machine()}; numpy {np.__version__}")
    always = [
        what for what in base if what not in failed and all(row[what] for row in rows.values())
    ]
    print(f"the same everywhere ({len(always)}):", *always, sep="\n    ")
    print("not the same everywhere:", *[what for what in base if what not in always], sep="\n    ")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--compare", action="store_true", help="run under other instructions and print the changes"
    )
    parser.add_argument("--maps", type=Path, help="a folder of map folders to take along")
    parser.add_argument(
        "--parts", nargs="+", choices=PARTS, default=list(PARTS), help="leave the others out"
    )
    parser.add_argument(
        "--settings",
        nargs="+",
        choices=SETTINGS,
        default=list(SETTINGS),
        help="leave the others out",
    )
    parser.add_argument("--json", action="store_true", help="end with one JSON line")
    given = parser.parse_args()
    if given.compare:
        arguments = [
            "--parts",
            *given.parts,
            *(["--maps", str(given.maps.resolve())] if given.maps else []),
        ]
        compare(["again", *(name for name in given.settings if name != "again")], arguments)
        return
    places = [ROOT / "maps", *([given.maps] if given.maps else [])]
    folders = [path for place in places for path in sorted(place.iterdir()) if path.is_dir()]
    found = digests(given.parts, folders)
    if given.json:
        print(json.dumps(found))
    else:
        print(*(f"{value}  {name}" for name, value in found.items()), sep="\n")


if __name__ == "__main__":
    main()
