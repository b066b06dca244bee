"""Compiled code does the same whatever a process compiled or loaded before, and whoever else compiles."""

import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from types import FunctionType

import numpy as np
import pytest
from llvmlite.binding import Linkage
from numba import njit
from numba.core.caching import IndexDataCacheFile

from pcs_racing.compilation import compiled, kernel

RACES = """
import hashlib
import sys

import numpy as np

from pcs_racing import make_game
from pcs_racing.planners import spiral

if sys.argv[1] == "spirals first":
    spiral.solve_spirals(np.ones(10_000), 0.1)
    spiral.sample_spirals(np.ones(10_000), 0.1, 0.0, 0.0, 0.0)
game = make_game("Pipkin")
state = game.reset(games=20, seed=1)
for _ in range(2):
    state = game.step(state, np.zeros((20, 2), dtype=int))
print(hashlib.sha256(state.race.cars.tobytes()).hexdigest())
"""


def test_races_do_not_depend_on_what_was_loaded_before():
    """The planner's copies of these two functions round differently from the ones that Python calls."""
    said = [
        subprocess.run([sys.executable, "-c", RACES, before], capture_output=True, text=True, check=True).stdout
        for before in ("nothing first", "spirals first")
    ]
    assert said[0] == said[1]


def long_sum(x):
    """Too long to be put into its caller line by line: a copy of it stays a function."""
    total = 0.0
    for i in range(x.shape[0]):
        for j in range(x.shape[0]):
            total += np.sin(x[i]) * np.exp(x[j]) + np.tan(x[i] * x[j]) - np.arctan2(x[i], x[j]) / np.log(2.0 + x[j])
            total += np.sinh(x[i]) * np.log(x[j]) + np.cos(x[i] - x[j]) - np.arcsin(x[i]) / np.sqrt(2.0 + x[j])
    return total


def caller_of(inner, decorate):
    """A compiled function that calls another one several times."""

    @decorate
    def outer(x):
        return inner(x) + inner(x[1:]) + inner(x[2:]) + inner(x[3:])

    return outer


def linkage_of_copies(dispatcher, name):
    """How a library links its copies of a function."""
    (result,) = dispatcher.overloads.values()
    functions = result.library._final_module.functions
    return {function.linkage for function in functions if function.name.startswith("_ZN") and name in function.name}


@pytest.mark.parametrize("decorate", [compiled, kernel])
def test_a_library_keeps_its_copies_to_itself(decorate):
    values = np.array([0.1, 0.2, 0.3, 0.4])
    outer = caller_of(decorate(long_sum), njit)
    found = outer(values)
    assert linkage_of_copies(outer, "long_sum") == {Linkage.internal}
    assert found == pytest.approx(sum(long_sum(values[k:]) for k in range(4)))
    assert caller_of(outer, njit)(values) > found  # what was linked once can be linked again


def test_functions_of_others_are_left_alone():
    name = "sum_of_others"
    others = FunctionType(long_sum.__code__.replace(co_name=name, co_qualname=name), globals(), name)
    outer = caller_of(njit(error_model="numpy", _nrt=True)(others), njit)
    outer(np.array([0.1, 0.2, 0.3, 0.4]))
    assert linkage_of_copies(outer, name) == {Linkage.linkonce_odr}


def test_two_writers_of_one_index_take_turns(tmp_path, monkeypatch):
    """Without turns both read the index before the other has written it, and a line is lost or points elsewhere."""
    load_index = IndexDataCacheFile._load_index

    def slowly(self):
        index = load_index(self)
        time.sleep(0.02)
        return index

    def write(number):
        IndexDataCacheFile(str(tmp_path), "f-1.py311", "stamp").save(f"signature {number}", f"code {number}")

    monkeypatch.setattr(IndexDataCacheFile, "_load_index", slowly)
    with ThreadPoolExecutor(6) as pool:
        list(pool.map(write, range(6)))
    monkeypatch.undo()
    for number in range(6):
        found = IndexDataCacheFile(str(tmp_path), "f-1.py311", "stamp").load(f"signature {number}")
        assert found == f"code {number}"
