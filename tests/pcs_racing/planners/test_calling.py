"""Planners' functions as the race kernel calls them."""

import sys

import numpy as np
import pytest
from numba import njit
from refusal import refused

from pcs_racing import load_rules, load_track, run_races
from pcs_racing.planners.calling import control_address
from pcs_racing.planners.planner import Planner
from pcs_racing.race.driving import advance
from pcs_racing.race.races import RaceSetup, draw_starts, start_races


def control(track, theta, view, memory, scratch, path, command):
    command[0] = 0.0
    command[1] = 1.0 + 0.0 * track.length


def failing(track, theta, view, memory, scratch, path, command):
    if view[0] > 0.1:  # the time, s
        raise ValueError("nowhere to go")
    command[0] = 0.0
    command[1] = 1.0


def returning(track, theta, view, memory, scratch, path, command):
    return view[0]


def allocating(track, theta, view, memory, scratch, path, command):
    line, values = track.line, np.ones(2)
    command[0] = 0.0
    command[1] = values[0] + 0.0 * line[0, 0]


def race(function):
    planner = Planner("test", (), control=function)
    config = load_rules("paper", duration=0.4)
    return run_races(
        load_track("Tarnfjord"), [planner.policy()], planner.policy(), config, seed=0, threads=1
    )


def test_plain_compiled_and_typed_functions_drive_the_same_and_what_they_raise_is_told():
    assert (race(control).state.cars == race(njit(control)).state.cars).all()
    assert control_address(control) == control_address(control)
    # It has no file, so numba has no place for its code.
    typed = (
        "def control(track, theta, view, memory, scratch, path, command):\n    command[0],"
        " command[1] = 0.0, 1.0\n"
    )
    names = {"__name__": "__main__"}
    exec(compile(typed, "<stdin>", "exec"), names)
    assert (race(names["control"]).state.cars == race(control).state.cars).all()
    refused("nowhere to go", race, failing, error=ValueError)
    refused("returning", race, returning)


@pytest.mark.parametrize("function", [control, allocating, failing])
def test_references_to_arrays_are_counted_right(function):
    """For any planner, no array is freed too early, or never."""
    planner, track, config = (
        Planner("test", (), control=function),
        load_track("Tarnfjord"),
        load_rules("paper"),
    )
    setup = RaceSetup(track, config, (planner, planner))
    state = start_races(setup, draw_starts(track, config, 1, 0), np.zeros(1, np.uint64))
    theta = np.zeros((1, 2, 1))
    watched = [theta, *state, *(array for array in track.arrays if isinstance(array, np.ndarray))]

    def drive():
        if function is failing:
            with pytest.raises(ValueError, match="nowhere to go"):
                advance(setup, state, theta, 100, threads=1)
        else:
            advance(setup, state, theta, 2, threads=1)

    drive()
    before = [sys.getrefcount(array) for array in watched]
    for _ in range(20):
        drive()
    assert [sys.getrefcount(array) for array in watched] == before


def test_functions_with_options_of_their_own_are_compiled_anew(tmp_path, monkeypatch):
    """Code that numba keeps of a user's function, here with another error model, is not taken for
    the race.
    """
    (tmp_path / "users_planner.py").write_text(
        "from numba import njit\n\n\n"
        "@njit(cache=True)\n"
        "def control(track, theta, view, memory, scratch, path, command):\n"
        "    command[0] = 0.0\n"
        "    command[1] = min(1.0 / memory[0], 1.0)\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    from users_planner import control as users

    command = np.zeros(2)
    with pytest.raises(ZeroDivisionError):
        users(
            load_track("Tarnfjord").arrays,
            *(np.zeros(1) for _ in range(4)),
            np.zeros((12, 4)),
            command,
        )
    planner = Planner("test", (), control=users, memory_size=1)
    config = load_rules("paper", duration=0.1)
    run_races(
        load_track("Tarnfjord"), [planner.policy()], planner.policy(), config, seed=0, threads=1
    )
