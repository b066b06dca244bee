"""Races and tracks are the same to the bit for all instructions of a processor.

Numba's code is searched for sources of other rounding: operations that the compiler may fuse or
reorder, and functions of the C library. For the rest, a second process disables new instructions,
so numpy, the C library and BLAS use their code for the oldest processors. `dev/benchmarks/bits.py`
and `nox -s machines` also compile everything for any x86-64 processor, which takes minutes.
"""

import hashlib
import json
import math
import os
import platform
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from numba import njit
from numba.core.registry import CPUDispatcher
from numpy._core._multiarray_umath import __cpu_dispatch__

from pcs_racing import load_rules, load_track, racer
from pcs_racing.base.seeds import race_seeds
from pcs_racing.race.driving import advance
from pcs_racing.race.races import RaceSetup, draw_starts, pad_parameters, start_races
from pcs_racing.track.building.centerline import centerline_from_grid
from pcs_racing.track.building.raceline import minimum_curvature_raceline
from pcs_racing.track.building.tracks import build_track
from pcs_racing.track.map_files import read_map
from pcs_racing.track.maps import find_shipped

WITHOUT = {
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
    """Two short races of each planner under both rules: all of their states at the end."""
    track, ego = load_track("Quillburg"), racer("lattice")
    found = {}
    for rules in ("paper", "contest"):
        config = load_rules(rules, duration=6.0, start_lines=2)
        for text in RIVALS:
            rival = racer(text)
            setup = RaceSetup(track, config, (ego.planner, rival.planner))
            state = start_races(setup, draw_starts(track, config, 2, 0), race_seeds(0, 2))
            theta = np.broadcast_to(
                pad_parameters([ego, rival], setup.theta_size), (2, 2, setup.theta_size)
            ).copy()
            advance(setup, state, theta, config.ticks, threads=1)
            found[f"{rules}, {text}"] = digest(state)
    return found


def track_from_its_picture() -> str:
    """A circuit without its lines; nothing of it comes from a cache."""
    found = read_map(find_shipped("Pipkin"))
    grid = (found.occupied, found.resolution, found.origin)
    center = centerline_from_grid(*grid)
    track = build_track("Pipkin", *grid, center, minimum_curvature_raceline(center, *grid))
    return digest([*track.arrays, track.centerline])


def results() -> dict[str, str]:
    return {"track": track_from_its_picture(), **races()}


EXACT = {"sqrt", "fabs", "floor", "ceil", "copysign"}
"""Functions whose results IEEE 754 defines to the bit."""

DEFINE = re.compile(r'^define [^@]*@"?([^"(]+)', re.MULTILINE)
CALL = re.compile(r'\bcall ([^@\n]*)@"?([^"(\s]+)"?\(([^\n]*)')
FLOATING = re.compile(r"\b(double|float)\b")
LOOSE = re.compile(r" = (?:tail )?(f\w+|call|select|phi) .*?\b(fast|contract|reassoc|arcp|afn)\b ")


def inexact(dispatcher: CPUDispatcher) -> Iterator[str]:
    """Return code that could change the bits of a compiled function's results: instructions of the
    processor, and libraries.

    The code is the compiler's, with all inlined functions, before it becomes machine code. Numba
    shows it only of functions that this process has compiled; functions from its cache keep it in
    ``_shared_module``.
    """
    for overload in dispatcher.overloads.values():
        library = overload.library
        text = str(library._shared_module or library._final_module)
        functions = {match[1] for match in DEFINE.finditer(text)}
        for body in re.split(r"^(?=define )", text, flags=re.MULTILINE):
            named = DEFINE.match(body)
            # numba's: how many digits an error has to show
            if named is None or "raise_with_shape" in named[1]:
                continue
            yield from (" ".join(match.groups()) for match in LOOSE.finditer(body))
            for result, name, arguments in CALL.findall(body):
                function = re.sub(r"^llvm\.([a-z0-9]+).*", r"\1", name)
                known = (
                    function in EXACT
                    or name in functions
                    or name.startswith(("Py", "llvm.masked."))
                )
                linear_algebra = name.startswith(("numba_xx", "numba_ez", "numba_raw"))
                if linear_algebra or (not known and FLOATING.search(f"{result} {arguments}")):
                    yield name


def test_fused_operations_and_functions_of_the_c_library_are_found():
    fused = njit(fastmath=True)(lambda a, b: a * b + 1.0)
    sine = njit(lambda a, b: math.sin(a) * b)
    both = njit(lambda a, b: np.dot(a, b))
    plain = njit(lambda a, b: math.sqrt(a) * b + math.floor(b))
    for function in (fused, sine, plain):
        function(1.0, 2.0)
    both(np.ones(2), np.ones(2))
    assert set(inexact(fused)) == {"fmul fast", "fadd fast"}
    assert set(inexact(sine)) == {"llvm.sin.f64"}
    assert "numba_xxdot" in set(inexact(both))
    assert list(inexact(plain)) == []


@pytest.mark.skipif(
    platform.machine() not in ("x86_64", "AMD64"), reason="the promise is about x86-64"
)
def test_races_and_tracks_need_no_instruction_of_a_newer_processor(tmp_path):
    source = str(Path(__file__).resolve().parents[3])
    environment = {**os.environ, **WITHOUT, "PCS_RACING_CACHE": str(tmp_path), "PYTHONPATH": source}
    child = subprocess.run(
        [sys.executable, __file__], env=environment, capture_output=True, text=True
    )
    assert child.returncode == 0, child.stderr
    theirs = json.loads(child.stdout.splitlines()[-1])
    assert theirs.pop("inexact") == []
    assert {"advance_races", "lookup_grid", "wall_clearance"} <= set(theirs.pop("compiled"))
    assert theirs == results()


def called() -> list[CPUDispatcher]:
    """The compiled functions of ours that Python has called, with all those which they call."""
    modules = [module for name, module in sys.modules.items() if name.startswith("pcs_racing")]
    functions = {id(value): value for module in modules for value in vars(module).values()}
    return [
        value
        for value in functions.values()
        if isinstance(value, CPUDispatcher) and value.overloads
    ]


if __name__ == "__main__":
    found = results()
    compiled = called()
    names = [function.py_func.__qualname__ for function in compiled]
    print(
        json.dumps(
            {
                **found,
                "compiled": names,
                "inexact": sorted({x for f in compiled for x in inexact(f)}),
            }
        )
    )
