"""Results change only together with a version: recorded results of the environments when their
version was new.
"""

import re
from pathlib import Path

import numpy as np
import pytest
from scenarios import LEAD, RACES_ID, SCENARIOS, STRAY, differences, file_name, track_hash

from pcs_racing.envs import GYMNASIUM_IDS, PETTINGZOO_IDS

HERE = Path(__file__).resolve().parent


@pytest.mark.parametrize("name", SCENARIOS)
def test_results_are_those_of_the_version(name):
    file = HERE / file_name(name)
    assert file.is_file(), f"{name} has no results: python dev/tools/make_goldens.py keeps them"
    with np.load(file, allow_pickle=False) as stored:
        kept = dict(stored)
    assert str(kept["track"]) == track_hash(), (
        "the circuit has changed: its name must change, or the results' version"
    )
    found = {**SCENARIOS[name](), "track": kept["track"]}
    told = f"{name} has other results than when it was new: docs/versions.md says what to do"
    assert differences(found, kept) == [], told


def test_every_id_has_a_scenario_and_a_version():
    assert set(SCENARIOS) == {RACES_ID, *GYMNASIUM_IDS, *PETTINGZOO_IDS}
    assert all(re.fullmatch(r"pcs_racing/\w+-v\d+", name) for name in SCENARIOS)


def test_no_results_of_versions_that_are_gone():
    assert {path.name for path in HERE.glob("*.npz")} == {file_name(name) for name in SCENARIOS}


def values(**changes: np.ndarray) -> dict[str, np.ndarray]:
    base = {
        "values cars": np.linspace(0.0, 30.0, 12).reshape(3, 4),
        "values seen": np.linspace(-1.0, 1.0, 6, dtype=np.float32),
        "values ends": np.array([False, True]),
        "ends paper": np.column_stack([np.arange(6.0), np.full(6, 40.0)]),
    }
    return {**base, **changes}


def test_last_bits_do_not_count():
    other = {
        name: array * (1.0 + 1e-12) if array.dtype == np.float64 else array
        for name, array in values().items()
    }
    other["values seen"] = np.nextafter(values()["values seen"], np.float32(2.0))
    assert differences(other, values()) == []


@pytest.mark.parametrize(
    ("name", "change"),
    [("values cars", 1e-7), ("values seen", np.float32(1e-4)), ("ends paper", 1.5 * LEAD)],
)
def test_changes_of_physics_do(name, change):
    (line,) = differences(values(**{name: values()[name] + change}), values())
    assert line.startswith(name)


def test_one_long_race_may_stray():
    strayed = values()["ends paper"].copy()
    strayed[:STRAY, 0] += 3.0
    assert differences(values(**{"ends paper": strayed}), values()) == []
    strayed[: STRAY + 1, 0] += 3.0
    assert differences(values(**{"ends paper": strayed}), values()) != []


def test_other_names_shapes_and_truths_do():
    assert differences(values(more=np.zeros(1)), values()) == ["more is in one of the two only"]
    assert differences(values(**{"values ends": np.array([True, True])}), values()) != []
    assert differences(values(**{"values cars": np.zeros(3)}), values()) != []
    spoiled = values()["values cars"].copy()
    spoiled[0, 0] = np.nan
    assert differences(values(**{"values cars": spoiled}), values()) != []
